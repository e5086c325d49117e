"""What a terminal shows of a live session: a line now, a table at the end."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING

from rich.live import Live
from rich.table import Table
from rich.text import Text

from .terminal import err

if TYPE_CHECKING:
    from kinefilter.pipeline.live import Session
    from kinefilter.pipeline.live.tally import Tally

_REFRESH = 0.3  # s between two lines on a terminal
_LOGGED = 60.0  # s between two lines where there is no terminal, as in a log file


@asynccontextmanager
async def shown(session: Session) -> AsyncIterator[None]:
    """Show the session's state for as long as it runs."""
    task = asyncio.ensure_future(_show(session) if err.is_terminal else _log(session))
    try:
        yield
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


async def _show(session: Session) -> None:
    with Live(console=err, auto_refresh=False, transient=True) as live:
        while True:
            live.update(Text(status(session), overflow="ellipsis"), refresh=True)
            await asyncio.sleep(_REFRESH)


async def _log(session: Session) -> None:
    while True:
        await asyncio.sleep(_LOGGED)
        err.print(status(session))


def status(session: Session) -> str:
    """Return one line of how the session goes."""
    from kinefilter.pipeline.live.tally import Event

    tally, crowd = session.tally, session.crowd
    events = tally.events
    who = f"{len(crowd)} there"
    if crowd.measuring:
        who += f", measuring {crowd.measuring}"
    parts = [
        who,
        f"{events[Event.FRAMES]} frames in",
        f"{events[Event.POSES]} poses out",
    ]
    if events[Event.POSES]:
        half, most = tally.latency.recent(0.5), tally.latency.recent(0.99)
        parts.append(f"{half * 1e3:.1f} ms (99 %: {most * 1e3:.1f})")
    noted = (Event.DROPPED, Event.LATE, Event.REPEATED, Event.MISSING, Event.SLOW)
    parts += [f"{events[event]} {event}" for event in noted if events[event]]
    if tally.malformed:
        parts.append(f"{tally.malformed.total()} malformed")
    if session.recorder is not None and session.recorder.failure is not None:
        parts.append("not recorded any more")
    return ", ".join(parts)


def summary(tally: Tally) -> Table:
    """Return a table of what happened, without what did not."""
    from kinefilter.pipeline.live.tally import Event

    table = Table(show_header=False, box=None)
    always = (Event.FRAMES, Event.POSES)
    for event in Event:
        if event in always or tally.events[event]:
            table.add_row(str(event), str(tally.events[event]))
    for reason, count in sorted(tally.malformed.items()):
        table.add_row(f"malformed: {reason}", str(count))
    if tally.events[Event.POSES]:
        latency = tally.latency
        values = (latency.quantile(0.5), latency.quantile(0.99), latency.most)
        cells = " / ".join(f"{value * 1e3:.1f}" for value in values)
        table.add_row("ms from frame to pose: half, 99 %, most", cells)
    return table
