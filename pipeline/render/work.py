"""What a process that draws does: one part of a shot after another.

MuJoCo is imported once there is something to draw: it then picks its OpenGL, which only
processes that draw may have.
"""

from __future__ import annotations

import atexit
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import InputError
from kinefilter.pipeline.workers import given_up

from .codec import Coded, encode_png, encode_video
from .frames import frame_path, is_drawn, write_frame
from .parts import Parts
from .shot import Shot, Staged

if TYPE_CHECKING:
    from .painter import Painter

Pixels = NDArray[np.uint8]

_LEAST_REACH = 1.5  # m


class _Set:
    """The shot that this process draws at present: the next part is often its own."""

    shot: Shot | None = None
    painter: Painter
    staged: Staged


@atexit.register
def _put_away() -> None:
    """Give back what OpenGL holds: later, Python can no longer."""
    if _Set.shot is not None:
        _Set.shot = None
        _Set.painter.close()


def draw_parts(shot: Shot, parts: Parts, fingerprint: str) -> list[list[Coded]]:
    """Draw some frames of a shot.

    Pictures of their own are written; those of a video or a GIF are returned.

    Args:
        shot: What to draw.
        parts: Frames, counted from the first that is drawn.
        fingerprint: The shot's, for pictures of their own.

    Raises:
        InputError: The shot cannot be used, or a picture cannot be written.
    """
    suffix = shot.out.suffix.lower()
    if suffix == ".png":
        return [_write(shot, part, fingerprint) for part in parts]
    if suffix == ".gif":
        return [
            [Coded(encode_png(p), k, True) for k, p in enumerate(_painted(shot, part))]
            for part in parts
        ]
    rate = _set_of(shot).staged.rate
    return [encode_video(_painted(shot, p), shot.look.pixels, rate) for p in parts]


def _write(shot: Shot, numbers: range, fingerprint: str) -> list[Coded]:
    """Write the pictures that are not there yet."""
    paths = {n: frame_path(shot.out, n) for n in numbers}
    missing = [n for n, path in paths.items() if not is_drawn(path, fingerprint)]
    for number, picture in zip(missing, _painted(shot, missing), strict=True):
        write_frame(picture, paths[number], fingerprint)
    return []


def _painted(shot: Shot, numbers: Sequence[int]) -> Iterator[Pixels]:
    if numbers:
        painter = _set_of(shot).painter
        for number in numbers:
            if given_up():
                raise InputError(f"{shot.clip}: interrupted")
            yield painter.paint(number)


def _set_of(shot: Shot) -> type[_Set]:
    """Return the shot ready to be drawn; the one before it is put away."""
    if _Set.shot != shot:
        _put_away()
        _Set.staged = Staged(shot)
        _Set.painter = _painter(_Set.staged)
        _Set.shot = shot
    return _Set


def _painter(staged: Staged) -> Painter:
    from .painter import Painter
    from .raw_figure import RawFigure, figure_names
    from .scene import Scene

    shot, clip, raw = staged.shot, staged.clip, staged.raw
    camera = staged.camera
    toward = camera.positions[0] - camera.targets[0]
    level = toward * [1.0, 0.0, 1.0]
    spread = clip.positions - clip.positions[:, clip.skeleton.root].mean(axis=0)
    scene = Scene(
        clip,
        staged.props,
        size=shot.look.pixels,
        samples=shot.samples,
        facing=level / np.linalg.norm(level),
        reach=max(_LEAST_REACH, float(np.linalg.norm(spread, axis=-1).max())),
        translucent=raw is not None and shot.look.place == "over",
        figure=() if raw is None else figure_names(clip.skeleton),
    )
    figure = None if raw is None else RawFigure(scene.model, raw, clip)
    return Painter(scene, camera, figure=figure, shadows=shot.shadows)
