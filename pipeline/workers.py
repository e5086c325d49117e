"""Worker processes, and the number of threads each may use."""

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

_ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in ("OPENBLAS", "OMP", "MKL")}
_MOST_ON_WINDOWS = 61  # processes that Windows can wait for at a time
_GRACE = 5.0  # s to finish a file once the work was given up
_PATIENCE = 1.5  # s until a process is ended less gently
_given_up = threading.Event()


def cores() -> int:
    """Return the number of cores this process may use."""
    if hasattr(os, "sched_getaffinity"):  # Linux; elsewhere a process may use all
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def at_most(count: int) -> int:
    """Return a number of processes, limited to what the system can wait for."""
    return min(count, _MOST_ON_WINDOWS) if sys.platform == "win32" else count


def given_up() -> bool:
    """Return True, inside a worker, if nothing waits for its work any more."""
    return _given_up.is_set()


def give_back_memory() -> None:
    """Return freed memory to the system, which glibc keeps in fragments.

    Otherwise a process grows by a third over a thousand takes. Takes 2 to 6 ms.
    """
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        if trim is not None:  # other C libraries have no such call
            trim(0)


@contextmanager
def one_thread() -> Iterator[None]:
    """Limit linear algebra to one thread, here and in processes started inside.

    For matrices this small, several threads only get in each other's way: on two busy
    cores training is eight times as fast with one.
    """
    # The environment is for libraries loaded later, and for new processes.
    with set_variables(_ONE_THREAD), threadpool_limits(1):
        yield


@contextmanager
def workers(
    count: int | None = None, *, environment: Mapping[str, str] | None = None
) -> Iterator[ProcessPoolExecutor]:
    """Yield a pool of processes, by default one per core, with extra variables.

    Each has one thread of linear algebra, and ends with its parent, however that ends.
    """
    # Not forked, which threads of the engine and of linear algebra do not survive.
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    with one_thread(), set_variables(environment or {}):
        pool = ProcessPoolExecutor(
            at_most(count or cores()),
            mp_context=context,
            initializer=_begin,
            initargs=(receiver,),
        )
        with receiver, sender:
            try:
                yield pool
            except BaseException:
                sender.close()
                raise
            finally:
                pool.shutdown(cancel_futures=True)


@contextmanager
def set_variables(variables: Mapping[str, str]) -> Iterator[None]:
    """Set environment variables for a while."""
    before = dict(os.environ)
    os.environ.update(variables)
    try:
        yield
    finally:
        for name in variables:
            os.environ.pop(name, None)
        os.environ.update({k: before[k] for k in variables if k in before})


def _begin(receiver: Any) -> None:
    """Prepare a worker: Ctrl-C, which reaches all, is left to its parent process."""
    for number in signal.Signals:
        if number.name in ("SIGINT", "SIGBREAK"):  # Windows has both
            signal.signal(number, signal.SIG_IGN)
    threading.Thread(target=_watch, args=(receiver,), daemon=True).start()


def _watch(receiver: Any) -> None:
    """Note that the work was given up, and end after the parent process does."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([receiver, parent.sentinel])
        _given_up.set()
        parent.join()
        time.sleep(_GRACE)
        os._exit(1)


class Worker:
    """A process that runs one call at a time and can be ended at any point.

    It has one thread of linear algebra, and ends with its parent, however that ends.
    """

    def __init__(self) -> None:
        context = multiprocessing.get_context("spawn")
        self.calls, calls = context.Pipe()
        receiver, self._sender = context.Pipe(duplex=False)
        arguments = calls, receiver
        self.process = context.Process(target=_serve, args=arguments, daemon=True)
        with calls, receiver, set_variables(_ONE_THREAD), _uninterrupted():
            self.process.start()

    def call(self, function: Callable[[Any], object], argument: object) -> None:
        """Run a module's function; ``calls`` then receives True and the result.

        True comes when it begins. Once the process is dead, reading raises an error.
        """
        with suppress(OSError):  # it died while idle, as reading will show
            self.calls.send((function, argument))

    def end(self) -> None:
        """End the process now."""
        end_workers([self], 0.0)


@contextmanager
def _uninterrupted() -> Iterator[None]:
    """Shield processes that start meanwhile from Ctrl-C, even before ``_begin``."""
    if sys.platform == "win32":  # it has no such call
        yield
        return
    resource_tracker.ensure_running()  # whose start would unblock Ctrl-C
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def end_workers(ended: Sequence[Worker], patience: float = _PATIENCE) -> None:
    """End processes: give up their work, then terminate, then kill them.

    Each step waits at most ``patience`` seconds, later ones 1.5; Ctrl-C ends the wait.
    """
    processes = [worker.process for worker in ended]
    try:
        for worker in ended:
            worker.calls.close()
            worker._sender.close()
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


def _serve(calls: Any, receiver: Any) -> None:
    """Run calls until there are no more."""
    _begin(receiver)
    with suppress(EOFError, OSError):
        while True:
            function, argument = calls.recv()
            calls.send(True)
            calls.send(function(argument))
