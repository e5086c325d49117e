"""The commands ``live`` and ``replay``."""

from __future__ import annotations

import asyncio
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import OmitArgPrefixes, Positional, arg

from kinefilter.characters import InputError
from kinefilter.pipeline.config import TakeFormat
from kinefilter.pipeline.formats import read_recording
from kinefilter.pipeline.formats.plain import counted
from kinefilter.pipeline.live.background import meanwhile
from kinefilter.pipeline.live.endpoints import parse_address
from kinefilter.pipeline.live.live_config import AccessConfig, LiveConfig
from kinefilter.pipeline.live.tally import Event, Tally
from kinefilter.pipeline.loopback import is_loopback

from .terminal import check_output, err, logger, stopped_by_signals, write_json

if TYPE_CHECKING:
    from rich.table import Table

    from kinefilter.characters import Take
    from kinefilter.pipeline.live.endpoints import Address
    from kinefilter.pipeline.live.live_session import Session

_REFRESH = 0.3  # s between status updates on a terminal


@dataclass(frozen=True)
class Live:
    """Stream cleaned poses frame by frame to games, engines and browsers.

    --out vmc://127.0.0.1:39539 drives a VMC receiver, and a second person the receiver
    on the next port; --out vrchat://127.0.0.1:9000 moves an avatar in VRChat; --out
    ws://127.0.0.1:9001 sends poses to web pages that this machine serves (one opened as
    a file needs --origin null), which read them with new
    WebSocket("ws://127.0.0.1:9001").onmessage = e => JSON.parse(e.data). Each person is
    measured during the first second unless --height is given. A sensor upside down or
    strongly tilted is reported and corrected for. The newest frame wins; late, missing,
    malformed and dropped frames are counted, as are frames with an impossible body.
    Several sensors, with one --in each, follow people together: their placement and
    clock offsets are found and printed while a person walks back and forth in front of
    them. Poses are sent with the frames of the first sensor and never wait for another;
    people it loses are followed by the sensors that still see them. Needs pip install
    "kinefilter[live]".
    """

    config: OmitArgPrefixes[LiveConfig]
    access: OmitArgPrefixes[AccessConfig]
    json: Path | None = None
    """Also write the final counts and latencies to this JSON file."""

    def run(self) -> int:
        """Follow people until Ctrl-C, SIGTERM or the end of the input."""
        from kinefilter.pipeline.live.live_session import Session

        check_output(self.json)
        session = Session(self.config, self.access)
        asyncio.run(self._follow(session))
        err.print(summary(session.tally))
        for path in session.recorded:
            err.print(f"wrote {path}")
        write_json(session.tally.as_json(), self.json)
        if session.failure is None:
            return 0
        err.print(f"kinefilter: {session.failure}")
        return 1

    async def _follow(self, session: Session) -> None:
        stop = asyncio.Event()
        with stopped_by_signals(stop):
            async with meanwhile(_show(session)):
                await session.run(stop, lambda used: self._print_places(session, used))

    def _print_places(self, session: Session, used: list[Address]) -> None:
        count, names = len(session.endpoints.sources), [*map(str, used)]
        err.print(f"from {', '.join(names[:count])} to {', '.join(names[count:])}")
        sockets = [address for address in used if address.scheme in ("ws", "wss")]
        token = session.endpoints.access.token
        if sockets and token is not None and self.access.token_file is None:
            err.print(f"token {token}")
        if any(a.scheme == "ws" and not is_loopback(a.host) for a in sockets):
            err.print(
                "without --certificate, anyone on the network can read token and poses"
            )


async def _show(session: Session) -> None:
    """Keep a status line up to date, and print each note once."""
    from rich.live import Live as Display
    from rich.text import Text

    printed, log = list[str](), logger()
    shown = Display(console=err, auto_refresh=False, transient=True)
    with shown if err.is_terminal else nullcontext() as display:
        while True:
            await asyncio.sleep(_REFRESH)
            if display:
                display.update(Text(status(session), overflow="ellipsis"), refresh=True)
            else:
                log(status(session))
            before, printed = printed, session.tally.all_notes()
            for note in printed:
                if note not in before:
                    err.print(note)


def status(session: Session) -> str:
    """Return a one-line status of the session."""
    tally, crowd, events = session.tally, session.crowd, session.tally.events
    frames, poses = events[Event.FRAMES], events[Event.POSES]
    parts = [
        f"{len(crowd)} {'person' if len(crowd) == 1 else 'people'}"
        + (f", measuring {crowd.measuring}" if crowd.measuring else ""),
        f"{counted(frames, 'frame')} in",
        f"{counted(poses, 'pose')} out",
    ]
    if poses:
        median, p99 = tally.latency.recent(0.5), tally.latency.recent(0.99)
        parts.append(f"{median * 1e3:.1f} ms (99 %: {p99 * 1e3:.1f})")
    noted = (
        Event.IMPOSSIBLE,
        Event.DROPPED,
        Event.LATE,
        Event.REPEATED,
        Event.MISSING,
        Event.SLOW,
        Event.REFUSED,
    )
    parts += [f"{events[event]} {event}" for event in noted if events[event]]
    if tally.malformed:
        parts.append(f"{tally.malformed.total()} malformed")
    if session.failure is not None:
        parts.append("recording stopped")
    return ", ".join(parts)


def summary(tally: Tally) -> Table:
    """Return a table of all nonzero counts and the latencies."""
    from rich.table import Table

    table = Table(show_header=False, box=None)
    for event in Event:
        if event in (Event.FRAMES, Event.POSES) or tally.events[event]:
            table.add_row(str(event), str(tally.events[event]))
    for reason, count in sorted(tally.malformed.items()):
        table.add_row(f"malformed: {reason}", str(count))
    for note in tally.all_notes():
        table.add_row("note", note)
    if tally.events[Event.POSES]:
        latency = tally.latency
        values = (latency.quantile(0.5), latency.quantile(0.99), latency.most)
        cells = " / ".join(f"{value * 1e3:.1f}" for value in values)
        table.add_row("ms from frame to pose: median, 99 %, maximum", cells)
    return table


@dataclass(frozen=True)
class Replay:
    """Send a recorded take to 'kinefilter live' in real time."""

    take: Positional[Path]
    """Recording in any of the formats of --format, gzipped or not."""
    out: Annotated[str, arg(metavar="ADDRESS")]
    """Where to send frames: udp://HOST:PORT, ws://HOST:PORT, wss://HOST:PORT, or - for
    standard output."""
    speed: float = 1.0
    """Playback speed relative to the recording."""
    loop: bool = False
    """Start over at the end."""
    token_file: Path | None = None
    """File with the token that the WebSocket server requires."""
    certificate: Path | None = None
    """Certificate (PEM) to trust for wss, in addition to the system's."""
    format: TakeFormat | None = None
    """Format of the take; default: detected from its content."""

    def run(self) -> int:
        """Send the take, until it ends or a signal arrives."""
        address = parse_address(self.out, ("udp", "ws", "wss", "-"))
        takes = read_recording(self.take, format=self.format).takes
        if not takes[0].by_kinect:
            err.print("joints not from a Kinect, which 'live' corrects as a Kinect's")
        sent = asyncio.run(self._sent(takes, address))
        err.print(f"sent {counted(sent, 'frame')} of {takes[0].skeleton.name}")
        return 0

    async def _sent(self, takes: tuple[Take, ...], address: Address) -> int:
        from kinefilter.pipeline.live.playback import open_sender, replay

        stop = asyncio.Event()
        with stopped_by_signals(stop):
            async with open_sender(
                address,
                token_file=self.token_file,
                certificate=self.certificate,
                say=err.print,
            ) as send:
                sent = await replay(takes, send, stop, speed=self.speed, loop=self.loop)
                if not (sent or stop.is_set()):
                    nobody = "nobody took a frame; start the receiver first"
                    raise InputError(f"{self.out}: {nobody}")
                return sent
