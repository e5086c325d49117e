"""What commands share: consoles, progress bars, signals, files not to overwrite."""

from __future__ import annotations

import json
import signal
import threading
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from rich.console import Console

from kinefilter.characters import InputError
from kinefilter.pipeline.formats import check_folder
from kinefilter.pipeline.formats.files import new_text
from kinefilter.pipeline.formats.plain import finite
from kinefilter.pipeline.progress import Progress

if TYPE_CHECKING:
    import asyncio

    from rich.progress import Progress as RichProgress

# Names of files are printed as they are, whatever brackets and colons they hold.
out = Console(soft_wrap=True, highlight=False, markup=False, emoji=False)
err = Console(stderr=True, soft_wrap=True, highlight=False, markup=False, emoji=False)

Skeletons = Literal["kinect_v1", "kinect_v2"]

# Windows' SIGBREAK is Ctrl-Break, and a console that is closed.
_REQUESTS = ("SIGTERM", "SIGBREAK")  # to end; no system has all of them
_ENDS = (*_REQUESTS, "SIGINT", "SIGHUP")


def check_output(path: Path | None, *others: Path | None, suffix: str = "") -> None:
    """Raise an InputError if a file, if any, is not one that should be written.

    It needs a folder and the suffix, and must not be one of ``others``.
    """
    if path is None:
        return
    if not path.name.endswith(suffix):
        raise InputError(f"{path}: expected a name that ends in {suffix}")
    check_folder(path)
    keep(path, *others)


def keep(written: Path, *others: Path | None) -> None:
    """Raise an InputError if a file to write is one that must not be lost."""
    for other in others:
        if other is not None and written.resolve() == other.resolve():
            raise InputError(f"{written}: would overwrite {other}; give another name")


def progress_display(*, counted: bool = True) -> RichProgress:
    """Return bars, with counts or percentages, for a terminal; nothing elsewhere."""
    from rich import progress  # takes long to load

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
    """Yield what shows on the terminal how far long work is."""
    with progress_display() as bars:
        yield lambda stage, count: bars.track(range(count), count, description=stage)


def check_calibration(path: Path | None, takes: Collection[Path]) -> None:
    """Raise an InputError if the place of sensors is given for a take of one."""
    if path is not None and len(takes) < 2:
        raise InputError("--calibration is for takes of several sensors")


def write_json(figures: object, path: Path | None) -> None:
    """Write figures as JSON, whole or not at all, if a file for them is given."""
    if path is not None:
        with new_text(path) as file:
            file.write(json.dumps(finite(figures), indent=2, allow_nan=False) + "\n")


@contextmanager
def ended_gently() -> Iterator[None]:
    """Treat a request to end, as batch systems send it, like Ctrl-C."""
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread may say what a signal does
        return
    with _handling(_REQUESTS, signal.default_int_handler):
        yield


@contextmanager
def stopped_by_signals(stop: asyncio.Event) -> Iterator[None]:
    """Set an event when the process is asked to end."""
    import asyncio  # takes long to load, and few commands need it

    loop = asyncio.get_running_loop()

    def asked(*_: object) -> None:
        loop.call_soon_threadsafe(stop.set)

    with _handling(_ENDS, asked):
        yield


@contextmanager
def _handling(names: Collection[str], handler: Callable[..., Any]) -> Iterator[None]:
    """Handle those of the signals that this system has."""
    numbers = [number for number in signal.Signals if number.name in names]
    before = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield
    finally:
        for number, earlier in before.items():
            signal.signal(number, earlier)
