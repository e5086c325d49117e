"""What goes on beside a block, and the standard input and output, which may block."""

from __future__ import annotations

import asyncio
import os
import threading
from collections.abc import AsyncIterator, Callable, Coroutine
from concurrent.futures import Future
from contextlib import asynccontextmanager
from typing import Any, TypeVar

_T = TypeVar("_T")

# Descriptors: the lock of a buffer would outlive the interpreter.
_STDIN, _STDOUT = 0, 1
_CHUNK = 2**16  # bytes


@asynccontextmanager
async def meanwhile(
    *work: Coroutine[Any, Any, object],
) -> AsyncIterator[list[asyncio.Task[object]]]:
    """Let some work go on until the block ends; yields its tasks."""
    tasks = [asyncio.ensure_future(each) for each in work]
    try:
        yield tasks
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def read_in() -> bytes:
    """Return what comes next from the standard input; nothing at its end."""
    return await _waited(lambda: os.read(_STDIN, _CHUNK))


async def write_out(text: str) -> None:
    """Write a text to the standard output; raises OSError if nobody reads it."""

    def write() -> None:
        data = text.encode()
        while data:
            data = data[os.write(_STDOUT, data) :]

    await _waited(write)


async def _waited(work: Callable[[], _T]) -> _T:
    """Do something that may never end, in a thread that the program does not wait for.

    Threads of executors would be waited for when the interpreter ends.
    """
    done: Future[_T] = Future()

    def run() -> None:
        done.set_running_or_notify_cancel()
        try:
            done.set_result(work())
        except OSError as error:
            done.set_exception(error)

    threading.Thread(target=run, daemon=True).start()
    return await asyncio.wrap_future(done)
