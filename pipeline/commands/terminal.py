"""Shared by commands: consoles, progress bars, signals, overwrite protection."""

from __future__ import annotations

import json
import signal
import threading
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from os.path import realpath
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any, Literal, NoReturn

from rich.console import Console

from kinefilter.characters import InputError
from kinefilter.pipeline.formats import check_folder
from kinefilter.pipeline.formats.files import new_text
from kinefilter.pipeline.formats.plain import finite
from kinefilter.pipeline.progress import Progress

if TYPE_CHECKING:
    import asyncio

    from rich.progress import Progress as RichProgress

# File names may contain brackets and colons, which rich would interpret.
out = Console(soft_wrap=True, highlight=False, markup=False, emoji=False)
err = Console(stderr=True, soft_wrap=True, highlight=False, markup=False, emoji=False)


def _unread() -> NoReturn:
    raise BrokenPipeError  # which cli treats alike for all output; rich exits with 1


vars(out)["on_broken_pipe"] = vars(err)["on_broken_pipe"] = _unread

Skeletons = Literal["kinect_v1", "kinect_v2"]

# SIGBREAK is sent on Windows by Ctrl-Break, or when the console is closed.
_REQUESTS = ("SIGTERM", "SIGBREAK")  # no system has both
_ENDS = (*_REQUESTS, "SIGINT", "SIGHUP")
_LOGGED = 60.0  # s between lines of a log


def check_output(path: Path | None, *others: Path | None, suffix: str = "") -> None:
    """Raise an InputError if an output path is unusable; None is ignored.

    Its name must end in ``suffix``, and it must not be one of ``others``.
    """
    if path is None:
        return
    if not path.name.lower().endswith(suffix):
        raise InputError(f"{path}: the name must end in {suffix}")
    check_folder(path)
    keep(path, *others)


def check_outputs(written: Sequence[Path | None], *read: Path | None) -> None:
    """Raise an InputError if an output is unusable, an input, or given twice."""
    for k, path in enumerate(written):
        check_output(path, *read, *written[:k])


def keep(written: Path, *others: Path | None) -> None:
    """Raise an InputError if writing a file would overwrite one of ``others``."""
    for other in others:
        if other is not None and realpath(written) == realpath(other):
            raise InputError(f"{written}: would overwrite {other}; choose another name")


def logger() -> Callable[[str], None]:
    """Return a function that prints a message a minute, and none on a terminal."""
    printed = monotonic()

    def log(words: str) -> None:
        nonlocal printed
        if not err.is_terminal and monotonic() - printed >= _LOGGED:
            err.print(words)
            printed = monotonic()

    return log


def progress_display(*, counted: bool = True) -> RichProgress:
    """Return progress bars with counts or percentages; hidden without a terminal."""
    from rich import progress  # slow to import

    return progress.Progress(
        progress.TextColumn("{task.description}"),
        progress.BarColumn(),
        progress.MofNCompleteColumn() if counted else progress.TaskProgressColumn(),
        progress.TimeRemainingColumn(),
        console=err,
        transient=True,
        disable=not err.is_terminal,
    )


@contextmanager
def progress_bars() -> Iterator[Progress]:
    """Yield a factory of progress bars on the terminal, or of lines in a log."""
    with progress_display() as bars:
        log = logger()

        def steps(stage: str, count: int) -> Iterator[int]:
            for k in bars.track(range(count), count, description=stage):
                log(f"{stage} {k}/{count}")
                yield k

        yield steps


def check_calibration(path: Path | None, takes: Collection[Path]) -> None:
    """Raise an InputError if a calibration is given for a single sensor."""
    if path is not None and len(takes) < 2:
        raise InputError("--calibration requires the takes of several sensors")


def write_json(figures: object, path: Path | None) -> None:
    """Write figures as JSON, whole or not at all; no-op without a path."""
    if path is not None:
        with new_text(path) as file:
            file.write(json.dumps(finite(figures), indent=2, allow_nan=False) + "\n")


@contextmanager
def ended_gently() -> Iterator[None]:
    """Treat SIGTERM, as batch systems send it, like Ctrl-C."""
    # Only the main thread may install signal handlers.
    main = threading.current_thread() is threading.main_thread()
    with _handling(_REQUESTS if main else (), signal.default_int_handler):
        yield


@contextmanager
def stopped_by_signals(stop: asyncio.Event) -> Iterator[None]:
    """Set an event when the process receives a signal to end."""
    import asyncio  # slow to import, and few commands need it

    loop = asyncio.get_running_loop()
    with _handling(_ENDS, lambda *_: loop.call_soon_threadsafe(stop.set)):
        yield


@contextmanager
def _handling(names: Collection[str], handler: Callable[..., Any]) -> Iterator[None]:
    """Install a handler for those signals that exist on this system."""
    with ExitStack() as before:
        for number in signal.Signals:
            if number.name in names:
                before.callback(signal.signal, number, signal.signal(number, handler))
        yield
