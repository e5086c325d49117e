"""Processes side by side, and how many threads each may use."""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker
from multiprocessing.connection import wait
from multiprocessing.process import BaseProcess
from typing import Any

from threadpoolctl import threadpool_limits

_ONE_THREAD = dict.fromkeys(
    ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"
)
_MOST_WAITED_FOR = 61  # processes: what Windows waits for at a time
_GRACE = 5.0  # s to finish a file in, once nobody waits for it
_PATIENCE = 1.5  # s until a process that should end is ended less gently

_given_up = threading.Event()


def cores() -> int:
    """Return how many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):  # Linux; elsewhere a process may use all
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def at_most(count: int) -> int:
    """Return how many of so many processes a system lets wait for at a time."""
    return min(count, _MOST_WAITED_FOR) if sys.platform == "win32" else count


def given_up() -> bool:
    """Tell, inside a worker, whether nobody waits for its work any more."""
    return _given_up.is_set()


def give_back_memory() -> None:
    """Give freed memory back to the system, which glibc keeps in pieces.

    Over a thousand takes a process otherwise grows by a third; it takes 2 to 6 ms.
    """
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        if trim is not None:  # other C libraries have no such call
            trim(0)


@contextmanager
def one_thread() -> Iterator[None]:
    """Give linear algebra one thread, in this process and in those begun inside.

    With matrices this small, several threads only get in each other's way: on two busy
    cores training is eight times as fast with one.
    """
    # The environment is for libraries loaded later, and for new processes.
    with _environment(_ONE_THREAD), threadpool_limits(1):
        yield


@contextmanager
def workers(
    count: int | None = None, *, environment: Mapping[str, str] | None = None
) -> Iterator[ProcessPoolExecutor]:
    """Yield processes to work in, by default one a core, with variables of their own.

    Each has one thread of linear algebra, and ends with the process that waits for it,
    however that ends.
    """
    # Not forked: threads of the engine and of linear algebra do not survive it.
    context = multiprocessing.get_context("spawn")
    heard, told = context.Pipe(duplex=False)
    with one_thread(), _environment(environment or {}):
        pool = ProcessPoolExecutor(
            at_most(count or cores()),
            mp_context=context,
            initializer=_begin,
            initargs=(heard,),
        )
        try:
            yield pool
        except BaseException:
            told.close()
            raise
        finally:
            pool.shutdown(cancel_futures=True)
            told.close()
            heard.close()


@contextmanager
def _environment(variables: Mapping[str, str]) -> Iterator[None]:
    """Set environment variables for a while."""
    before = dict(os.environ)
    os.environ.update(variables)
    try:
        yield
    finally:
        for name in variables:
            os.environ.pop(name, None)
        os.environ.update({k: before[k] for k in variables if k in before})


def _begin(told: Any) -> None:
    """Prepare a worker; Ctrl-C, which reaches all, is for the process that waits."""
    for number in signal.Signals:
        if number.name in ("SIGINT", "SIGBREAK"):  # of these, Windows has both
            signal.signal(number, signal.SIG_IGN)
    threading.Thread(target=_watch, args=(told,), daemon=True).start()


def _watch(told: Any) -> None:
    """Note when nobody waits for the work, and end with the process that did."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([told, parent.sentinel])
        _given_up.set()
        parent.join()
        time.sleep(_GRACE)
        os._exit(1)


class Worker:
    """A process that does one call at a time and can be ended whatever it is doing.

    It has one thread of linear algebra, and ends with the process that began it,
    however that ends.
    """

    def __init__(self) -> None:
        context = multiprocessing.get_context("spawn")
        self.calls, theirs = context.Pipe()
        heard, self._told = context.Pipe(duplex=False)
        self.process = context.Process(target=_serve, args=(theirs, heard), daemon=True)
        with _environment(_ONE_THREAD), _unheard():
            self.process.start()
        theirs.close()
        heard.close()

    def call(self, function: Callable[[Any], object], argument: object) -> None:
        """Let it call a function of a module; ``calls`` then has True and the result.

        True comes when the call begins. If the process dies, reading raises EOFError or
        OSError.
        """
        with suppress(OSError):  # it died while it rested, as reading will tell
            self.calls.send((function, argument))

    def end(self) -> None:
        """End it now."""
        end_workers([self], 0.0)


@contextmanager
def _unheard() -> Iterator[None]:
    """Start processes that never hear Ctrl-C, not even before ``_begin``."""
    if sys.platform == "win32":  # it has no such call
        yield
        return
    resource_tracker.ensure_running()  # starting it would let Ctrl-C through
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def end_workers(ended: Sequence[Worker], patience: float = _PATIENCE) -> None:
    """End processes: each is told that nobody waits, then terminated, then killed.

    Each step has as many seconds, and Ctrl-C ends the waiting.
    """
    processes = [worker.process for worker in ended]
    try:
        for worker in ended:
            worker.calls.close()
            worker._told.close()
        _join(processes, patience)
        for process in processes:
            process.terminate()
        _join(processes, _PATIENCE)
    finally:
        for process in processes:
            process.kill()
        _join(processes, _PATIENCE)


def _join(processes: Sequence[BaseProcess], seconds: float) -> None:
    until = time.monotonic() + seconds
    for process in processes:
        process.join(max(until - time.monotonic(), 0.0))


def _serve(calls: Any, heard: Any) -> None:
    """Do calls until nobody has any more."""
    _begin(heard)
    with suppress(EOFError, OSError):
        while True:
            function, argument = calls.recv()
            calls.send(True)
            calls.send(function(argument))
