"""Tasks beside a block of code, and standard input and output without blocking."""

import asyncio
import os
import threading
from collections.abc import AsyncIterator, Callable, Coroutine
from concurrent.futures import Future
from contextlib import asynccontextmanager
from typing import Any, TypeVar

_T = TypeVar("_T")
_STDIN, _STDOUT = 0, 1  # descriptors, as streams lock and could block exiting
_CHUNK = 2**16  # bytes


@asynccontextmanager
async def meanwhile(
    *work: Coroutine[Any, Any, object],
) -> AsyncIterator[list[asyncio.Task[object]]]:
    """Run coroutines until the block ends, then cancel them; yield their tasks."""
    tasks = [asyncio.ensure_future(each) for each in work]
    try:
        yield tasks
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def read_stdin() -> bytes:
    """Return the next bytes from standard input, or none at its end."""
    return await _in_daemon_thread(lambda: os.read(_STDIN, _CHUNK))


async def write_stdout(text: str) -> None:
    """Write text to standard output; raise OSError if its reader has ended."""

    def write() -> None:
        data = text.encode()
        while data:
            data = data[os.write(_STDOUT, data) :]

    await _in_daemon_thread(write)


async def _in_daemon_thread(work: Callable[[], _T]) -> _T:
    """Run work in a thread that, unlike an executor's, is not joined at exit."""
    done: Future[_T] = Future()

    def run() -> None:
        done.set_running_or_notify_cancel()
        try:
            done.set_result(work())
        except OSError as error:
            done.set_exception(error)

    threading.Thread(target=run, daemon=True).start()
    return await asyncio.wrap_future(done)
