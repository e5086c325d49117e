"""``kinefilter live``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import OmitArgPrefixes

from kinefilter.pipeline.live.config import LiveConfig, OpenConfig

from .terminal import err, write_json

if TYPE_CHECKING:
    from kinefilter.pipeline.live import Session
    from kinefilter.pipeline.live.addresses import Address


@dataclass(frozen=True)
class Live:
    """Follow people frame by frame: for games, engines and browsers.

    --out vmc://127.0.0.1:39539 moves a VMC receiver, the second person that on the next
    port; --out ws://127.0.0.1:9001 sends poses to pages of this machine, which read
    them by new WebSocket("ws://127.0.0.1:9001").onmessage = e => JSON.parse(e.data).
    Each person is measured in the first second, or --height says it. The newest frame
    wins; what is late, missing, malformed or dropped is counted. Needs pip install
    "kinefilter[live]".
    """

    config: OmitArgPrefixes[LiveConfig]
    access: OmitArgPrefixes[OpenConfig]
    json: Path | None = None
    """Write the counts and latencies at the end to this file too."""

    def run(self) -> int:
        """Follow until Ctrl-C, SIGTERM or the end of the input."""
        import asyncio

        from kinefilter.pipeline.formats import check_folder
        from kinefilter.pipeline.live import Session

        if self.json is not None:
            check_folder(self.json)
        session = Session(self.config, self.access)
        asyncio.run(self._followed(session))
        return self._ended(session)

    async def _followed(self, session: Session) -> None:
        import asyncio

        from .live_status import shown
        from .signals import stopped_by_signals

        stop = asyncio.Event()
        with stopped_by_signals(stop):
            async with shown(session):
                await session.run(stop, lambda places: self._tell(session, places))

    def _tell(self, session: Session, places: list[Address]) -> None:
        """Print where frames are expected and poses go, and a token that is new."""
        from kinefilter.pipeline.loopback import is_loopback

        source, *targets = places
        err.print(f"from {source} to {', '.join(map(str, targets))}")
        sockets = [place for place in places if place.scheme in ("ws", "wss")]
        token = session.ends.access.token
        if sockets and token is not None and self.access.token_file is None:
            err.print(f"token {token}")
        if any(p.scheme == "ws" and not is_loopback(p.host) for p in sockets):
            err.print(
                "without --certificate, who is on the network reads token and poses"
            )

    def _ended(self, session: Session) -> int:
        """Print what happened and return the exit code."""
        from .live_status import summary

        err.print(summary(session.tally))
        for path in session.recorded:
            err.print(f"wrote {path}")
        if self.json is not None:
            write_json(session.tally.as_json(), self.json)
        failure = session.recorder.failure if session.recorder is not None else None
        if failure is not None:
            err.print(f"kinefilter: {failure}")
        return 0 if failure is None else 1
