"""What one process of a rendering does: it draws some frames of a clip.

MuJoCo is imported only where something is drawn: it then chooses its OpenGL, which only
processes that draw may have.
"""

from __future__ import annotations

import atexit
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from kinefilter.characters import InputError
from kinefilter.pipeline.workers import given_up

from .video_files import (
    Coded,
    Pixels,
    encode_png,
    encode_video,
    frame_path,
    is_drawn,
    write_frame,
)
from .video_task import Composition, RenderTask

if TYPE_CHECKING:
    from .video_offscreen import OffscreenRenderer

Parts = tuple[range, ...]
"""Frames of a clip in parts, counted from the first that is drawn."""


def draw_parts(task: RenderTask, parts: Parts, fingerprint: str) -> list[list[Coded]]:
    """Draw some frames of a task.

    Numbered pictures are written; pictures of a video or a GIF are returned.

    Raises:
        InputError: The task cannot be drawn, or a picture cannot be written.
    """
    suffix = task.out.suffix.lower()
    if suffix == ".png":
        for part in parts:
            _write_missing(task, part, fingerprint)
        return [[] for _ in parts]
    if suffix == ".gif":
        return [[(encode_png(p), True) for p in _pictures(task, k)] for k in parts]
    rate = _opened(task)[0].rate
    return [encode_video(_pictures(task, k), task.look.pixels, rate) for k in parts]


def _write_missing(task: RenderTask, numbers: range, fingerprint: str) -> None:
    paths = {n: frame_path(task.out, n) for n in numbers}
    missing = [n for n, path in paths.items() if not is_drawn(path, fingerprint)]
    for number, picture in zip(missing, _pictures(task, missing), strict=True):
        write_frame(picture, paths[number], fingerprint)


def _pictures(task: RenderTask, numbers: Sequence[int]) -> Iterator[Pixels]:
    for number in numbers:
        if given_up():
            raise InputError(f"{task.clip}: interrupted")
        yield _opened(task)[1].render(number)


# The task at hand, kept ready: the next part is often of the same.
_open: list[tuple[RenderTask, Composition, OffscreenRenderer]] = []


def _opened(task: RenderTask) -> tuple[Composition, OffscreenRenderer]:
    """Return the task ready to be drawn; the one before it is closed."""
    if not _open or _open[0][0] != task:
        from .video_model import ClipModel
        from .video_offscreen import OffscreenRenderer

        _close()
        made = Composition(task)
        model = ClipModel(
            made.drawing,
            size=task.look.pixels,
            samples=task.look.samples or 0,
            toward=made.camera.toward,
            translucent=made.drawing.raw is not None and task.look.place == "over",
        )
        renderer = OffscreenRenderer(model, made.camera, shadows=task.look.shadows)
        _open.append((task, made, renderer))
    return _open[0][1:]


@atexit.register
def _close() -> None:
    """Release what OpenGL holds: after Python's shutdown that is too late."""
    while _open:
        _open.pop()[2].close()
