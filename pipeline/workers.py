"""Worker processes, and the number of threads each may use."""

from __future__ import annotations

import ctypes
import math
import multiprocessing
import os
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from functools import cache, partial
from multiprocessing import resource_tracker
from multiprocessing.connection import wait
from multiprocessing.process import BaseProcess
from typing import Any, ParamSpec, TypeVar

from threadpoolctl import ThreadpoolController, threadpool_limits

_ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in ("OPENBLAS", "OMP", "MKL")}
_GRACE = 5.0  # s to finish a file once the work was given up
_PATIENCE = 1.5  # s until a process is ended less gently
_START_TIMEOUT = 600.0  # s for a new process to begin its first call; a guess
_LONGEST_WAIT = 2e6  # s, for which pipes can wait; longer limits are none
_P = ParamSpec("_P")
_T = TypeVar("_T")
_given_up = threading.Event()


def cores() -> int:
    """Return the number of cores this process may use."""
    if hasattr(os, "sched_getaffinity"):  # Linux; elsewhere a process may use all
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


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
def one_blas_thread() -> Iterator[None]:
    """Limit linear algebra to one thread here, which takes less than 0.1 ms."""
    with _libraries().limit(limits=1, user_api="blas"):
        yield


@cache  # to find them takes milliseconds
def _libraries() -> ThreadpoolController:
    import scipy.linalg  # noqa: F401 - has a BLAS of its own

    return ThreadpoolController()


@contextmanager
def workers(
    count: int | None = None, *, environment: Mapping[str, str] | None = None
) -> Iterator[Workers]:
    """Yield processes, by default one per core, with extra variables; then end them."""
    with one_thread(), set_variables(environment or {}):
        pool = Workers(count)
        try:
            yield pool
        finally:
            pool.end(_GRACE)


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


def _watch(receiver: Any) -> None:
    """Note that the work was given up, and end after the parent process does."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([receiver, parent.sentinel])
        _given_up.set()
        parent.join()
        time.sleep(_GRACE)
        os._exit(1)


class ProcessDiedError(Exception):
    """The process that ran a call died, perhaps for lack of memory."""


class Workers(ThreadPoolExecutor):
    """Processes that run calls, with a thread here for each that waits for its results.

    Each has one thread of linear algebra, and ends with its parent, however that ends.
    A call whose process dies raises ProcessDiedError; the others go on.
    """

    def __init__(self, count: int | None = None) -> None:
        super().__init__(count or cores())
        # Not forked, which threads of the engine and of linear algebra do not survive.
        self._context = multiprocessing.get_context("spawn")
        self._receiver, self._sender = self._context.Pipe(duplex=False)
        self._own = threading.local()  # each thread's process, and the way to it
        self._processes: list[BaseProcess] = []
        self._starting = threading.Lock()

    def submit(
        self, function: Callable[_P, _T], /, *args: _P.args, **kwargs: _P.kwargs
    ) -> Future[_T]:
        """Run a module's function in a process."""
        return self.submit_within(math.inf, partial(function, *args, **kwargs))

    def submit_within(self, seconds: float, call: Callable[[], _T]) -> Future[_T]:
        """Run a call, which raises TimeoutError so many seconds after it has begun."""
        return super().submit(self._run, seconds, call)

    def _run(self, seconds: float, call: Callable[[], _T]) -> _T:
        process, calls = vars(self._own).pop("worker", None) or self._start()
        late = False
        try:
            calls.send(call)
            for limit in (_START_TIMEOUT, seconds):  # until it begins, until it ends
                late = not calls.poll(limit if limit < _LONGEST_WAIT else None)
                if late:
                    process.kill()
                    raise EOFError
                error, result = calls.recv()
        except (EOFError, OSError):
            raise (TimeoutError if late else ProcessDiedError) from None
        self._own.worker = process, calls
        if error is not None:
            raise error
        returned: _T = result
        return returned

    def _start(self) -> tuple[BaseProcess, Any]:
        calls, theirs = self._context.Pipe()
        args = theirs, self._receiver
        process = self._context.Process(target=_serve, args=args, daemon=True)
        with self._starting, theirs, set_variables(_ONE_THREAD), _uninterrupted():
            process.start()
        self._processes.append(process)
        return process, calls

    def end(self, patience: float = _PATIENCE) -> None:
        """Give up all calls, and kill the processes that run longer than ``patience``.

        Ctrl-C ends the wait [s]. May be called repeatedly.
        """
        self.shutdown(wait=False, cancel_futures=True)
        self._sender.close()
        until = time.monotonic() + patience
        try:
            for process in self._processes:
                process.join(max(until - time.monotonic(), 0.0))
        finally:
            for process in self._processes:
                process.kill()
            self.shutdown()
            for process in self._processes:
                process.join(_PATIENCE)


@contextmanager
def _uninterrupted() -> Iterator[None]:
    """Shield processes that start meanwhile from Ctrl-C, even before they ignore it."""
    if sys.platform == "win32":  # it has no such call
        yield
        return
    resource_tracker.ensure_running()  # whose start would unblock Ctrl-C
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _serve(calls: Any, receiver: Any) -> None:
    """Run calls until they are given up; send when each begins, then its outcome."""
    for number in signal.Signals:  # Ctrl-C, which reaches all, is left to the parent
        if number.name in ("SIGINT", "SIGBREAK"):  # Windows has both
            signal.signal(number, signal.SIG_IGN)
    threading.Thread(target=_watch, args=(receiver,), daemon=True).start()
    with suppress(EOFError, OSError):
        while receiver not in wait([calls, receiver]):
            call = calls.recv()
            calls.send((None, None))
            try:
                outcome: tuple[Exception | None, Any] = None, call()
            except Exception as error:
                error.add_note(traceback.format_exc())
                outcome = error, None
            calls.send(outcome)
