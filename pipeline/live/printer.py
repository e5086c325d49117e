"""Poses as lines on the standard output."""

from __future__ import annotations

import asyncio
import contextlib
import os
import threading
from collections import deque
from collections.abc import Callable

from kinefilter.characters import Skeleton

from .poses import LivePose, gone_line, pose_line, skeleton_line
from .tally import Event, Tally

_STDOUT = 1
_WAITING = 32  # lines that wait for a reader, as for those of WebSockets
_GOODBYE = 1.0  # s for the last lines


class Printer:
    """Writes lines; where nobody reads for long, the oldest are lost and counted.

    Args:
        skeleton: The joints of poses.
        tally: What counts lost lines.
        lost: Told when the other end is closed.
    """

    def __init__(
        self, skeleton: Skeleton, tally: Tally, lost: Callable[[], None]
    ) -> None:
        self._tally, self._lost = tally, lost
        self._loop = asyncio.get_running_loop()
        self._change = threading.Condition()
        self._lines: deque[str] = deque()
        self._busy, self._over = False, False
        self._idle = asyncio.Event()
        first = skeleton_line(skeleton)
        # A daemon: nothing ends a write that nobody reads.
        threading.Thread(target=self._write, args=(first,), daemon=True).start()

    def send(self, live: LivePose) -> None:
        """Write a line as soon as the last is out."""
        self._put(pose_line(live))

    def gone(self, body: str, slot: int) -> None:  # noqa: ARG002 - as all sinks
        """Write that somebody is gone."""
        self._put(gone_line(body))

    async def flushed(self) -> None:
        """Wait until all lines are out."""
        await self._idle.wait()

    async def finish(self) -> None:
        """Wait a moment for the last lines."""
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._idle.wait(), _GOODBYE)
        with self._change:
            self._over = True
            self._change.notify()

    def _put(self, line: str) -> None:
        with self._change:
            if len(self._lines) == _WAITING:
                self._lines.popleft()
                self._tally.count(Event.SLOW)
            self._lines.append(line)
            self._idle.clear()
            self._change.notify()

    def _write(self, first: str) -> None:
        text = first
        try:
            while True:
                write_out(f"{text}\n".encode())
                with self._change:
                    self._busy = False
                    if not self._lines:
                        self._loop.call_soon_threadsafe(self._settle)
                    self._change.wait_for(lambda: self._lines or self._over)
                    if self._over:
                        return
                    text, self._busy = "\n".join(self._lines), True
                    self._lines.clear()
        except OSError:
            with contextlib.suppress(RuntimeError):
                self._loop.call_soon_threadsafe(self._closed)
        except RuntimeError:
            return  # the loop is closed

    def _settle(self) -> None:
        with self._change:
            if not self._lines and not self._busy:
                self._idle.set()

    def _closed(self) -> None:
        self._idle.set()
        self._lost()


def write_out(data: bytes) -> None:
    """Write to the standard output; wait while nobody reads.

    Raises:
        OSError: The other end is closed.
    """
    # To the descriptor: a buffer's lock would outlive the interpreter.
    while data:
        data = data[os.write(_STDOUT, data) :]
