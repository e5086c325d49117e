"""A recorded take sent as a sensor would send it, at its own time stamps."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Sequence

import numpy as np

from kinefilter.characters import InputError, Take

from .messages import Frame, SeenBody, format_frame
from .senders import Sender


def frames_of(takes: Sequence[Take], *, loop: bool = False) -> Iterator[Frame]:
    """Yield the frames of a recording, those of one stamp together.

    People in whom no joint is seen are left out.

    Args:
        takes: The people of one recording, who become bodies 1, 2 and so on.
        loop: Whether to begin again at the end, time going on.
    """
    time = np.unique(np.concatenate([take.time for take in takes]))
    rows = [np.searchsorted(take.time, time) for take in takes]
    usual = float(np.median(np.diff(time))) if len(time) > 1 else 1.0
    passed, length = 0.0, float(time[-1] - time[0]) + usual
    while True:
        for k, stamp in enumerate(time.tolist()):
            bodies = [
                _seen(take, int(row[k]), number)
                for number, (take, row) in enumerate(zip(takes, rows, strict=True), 1)
                if row[k] < len(take) and take.time[row[k]] == stamp
            ]
            seen = tuple(body for body in bodies if body.is_seen)
            yield Frame(stamp + passed, seen)
        if not loop:
            return
        passed += length


def _seen(take: Take, row: int, number: int) -> SeenBody:
    return SeenBody(str(number), take.positions[row], take.state[row])


async def replay(
    takes: Sequence[Take],
    sender: Sender,
    stop: asyncio.Event,
    *,
    speed: float = 1.0,
    loop: bool = False,
) -> int:
    """Send a recording's frames when they are due, until it ends or is stopped.

    Args:
        takes: The people of one recording.
        sender: Where frames go.
        stop: Set by whoever wants it to end.
        speed: How many times as fast as it was recorded.
        loop: Whether to begin again at the end.

    Returns:
        How many frames were sent.

    Raises:
        InputError: The speed is none.
    """
    if not 0.0 < speed < np.inf:
        raise InputError(f"--speed {speed:g}: expected a number over 0, such as 2")
    clock = asyncio.get_running_loop()
    began, first, sent = clock.time(), None, 0
    for frame in frames_of(takes, loop=loop):
        first = frame.time if first is None else first
        due = began + (frame.time - first) / speed
        if due > clock.time():
            await _until(due, stop)
        if stop.is_set():
            break
        sent += await sender.send(format_frame(frame))
    return sent


async def _until(due: float, stop: asyncio.Event) -> None:
    """Wait for a time of the loop's clock [s], or to be stopped."""
    try:
        async with asyncio.timeout_at(due):
            await stop.wait()
    except TimeoutError:
        return
