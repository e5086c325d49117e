"""The task of drawing a clip, what its pictures show, and drawing them in a process.

MuJoCo is imported only by processes that draw, as it then chooses its OpenGL.
"""

from __future__ import annotations

import atexit
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from kinefilter.characters import Clip, InputError, Prop
from kinefilter.characters.props import CORNERS
from kinefilter.pipeline.formats.export import resampled
from kinefilter.pipeline.formats.files import atomic_path
from kinefilter.pipeline.target.floor import find_placement
from kinefilter.pipeline.workers import given_up

from .cameras import axes_toward, camera_path
from .comparison import raw_positions
from .drawing import Drawing, corners_of, offset_beside, read_finite_clip
from .options import Look

if TYPE_CHECKING:
    from .video_files import Coded, Pixels
    from .video_model import OffscreenRenderer

PART = 60
"""Frames in a part of a video; each starts with a keyframe, where players can seek."""

_SKIN = 0.13  # m from a joint to the skin, at most: roughly the head's radius
_GPU_SAMPLES = 4  # makes edges smooth, and a GPU is hardly slower
_ASTRAY = 1.0  # m from the character, within which a raw joint counts for the camera
_SKEW = 1e-6  # s by which a frame may lie outside --from and --to


@dataclass(frozen=True)
class RenderTask:
    """A clip, how to draw it, and the file or pattern (``%05d.png``) to write."""

    clip: Path
    out: Path
    look: Look
    gpu: bool = False
    """Whether a GPU draws; without one, shadows and smooth edges take long."""


class Composition:
    """What the pictures of a task show; needs no OpenGL.

    Raises an InputError if the clip, the take, the scene or the camera is invalid.
    """

    def __init__(self, task: RenderTask) -> None:
        look, whole = task.look, read_finite_clip(task.clip)
        clip, self.rate = shown_frames(whole, look)  # frame rate of the pictures [1/s]
        if look.scene is not None:
            clip = replace(clip, props=props_around(whole, clip.props, look.scene))
        width, height = look.pixels
        aspect, rate = width / height, self.rate
        seen_by = partial(camera_path, look.camera, clip, aspect=aspect, rate=rate)
        joints, raw = clip.positions, None
        cubes = joints[:, :, None] + _SKIN * CORNERS
        points = [cubes.reshape(len(clip), -1, 3)]
        points += [corners_of(prop, len(clip)) for prop in clip.props]
        if look.compare is not None:
            raw = raw_positions(look.compare, whole, clip.time)
            if look.place == "beside":
                right, _ = axes_toward(seen_by(joints).toward)
                raw = raw + offset_beside(joints, -right, 2.0 * _SKIN)
            # For raw joints that are missing or far off, use the character's joints.
            place = joints + np.nanmedian(raw - joints, axis=(0, 1))
            near = np.linalg.norm(raw - place, axis=-1) < _ASTRAY
            points.append(np.where(near[..., None], raw, place))
        self.drawing = Drawing(clip, raw)  # the frames that are drawn
        self.camera = seen_by(np.concatenate(points, axis=1))
        """The camera that shows everything."""


def shown_frames(clip: Clip, look: Look) -> tuple[Clip, float]:
    """Return the frames to draw, evenly spaced in time, and their rate [1/s].

    Raises an InputError if the clip has no frame between --from and --to.
    """
    rate = look.fps or clip.fps
    even = resampled(clip, rate)
    since = even.time - even.time[0]
    end = np.inf if look.to is None else look.to
    chosen = np.flatnonzero((since >= look.start - _SKEW) & (since <= end + _SKEW))
    if not len(chosen):
        to = "the end" if look.to is None else f"{look.to:g} s"
        none = f"no frames from {look.start:g} s to {to}"
        raise InputError(f"{clip.source}: {none}; it lasts {since[-1]:.2f} s")
    return even.at(chosen), rate


def props_around(clip: Clip, props: tuple[Prop, ...], scene: str) -> tuple[Prop, ...]:
    """Return props and the rest of a scene, placed as ``clean --scene`` does, at rest.

    The person starts at the scene's origin in ``clip``, which is the whole clip. Raises
    an InputError as ``load_scene`` does.
    """
    import mujoco  # by now its OpenGL is chosen

    from kinefilter.pipeline.physics.scene_props import SceneProps
    from kinefilter.scenes import load_scene

    data = mujoco.MjData(load_scene(scene).compile())
    mujoco.mj_forward(data.model, data)
    things = SceneProps(data, (), 1)
    things.record(0)
    names = {prop.name for prop in props}
    others = things.props(find_placement(clip.positions, clip.skeleton))
    return props + tuple(prop for prop in others if prop.name not in names)


def draw_parts(task: RenderTask, frames: range) -> list[list[Coded]]:
    """Draw frames of a task, counted from its first picture.

    Returns the encoded parts of a video or a GIF; numbered pictures are written. Raises
    an InputError if something cannot be drawn or written.
    """
    from .video_files import encode_png, encode_video  # loads av

    out, suffix = task.out, task.out.suffix.lower()
    parts = [frames[k : k + PART] for k in range(0, len(frames), PART)]
    if suffix == ".gif":
        return [[(encode_png(p), True) for p in _pictures(task, k)] for k in parts]
    if suffix == ".mp4":
        rate = _opened(task)[0].rate
        return [encode_video(_pictures(task, k), task.look.pixels, rate) for k in parts]
    for number, picture in zip(frames, _pictures(task, frames), strict=True):
        with atomic_path(out.with_name(out.name % number)) as temporary:
            temporary.write_bytes(encode_png(picture))
    return []


def _pictures(task: RenderTask, numbers: range) -> Iterator[Pixels]:
    for number in numbers:
        if given_up():
            raise InputError(f"{task.clip}: interrupted")
        yield _opened(task)[1].render(number)


# The latest task, kept open: the next part is often of the same task.
_open: list[tuple[RenderTask, Composition, OffscreenRenderer]] = []


def _opened(task: RenderTask) -> tuple[Composition, OffscreenRenderer]:
    """Return what draws a task, after closing that of the previous task."""
    if not _open or _open[0][0] != task:
        from .video_model import ClipModel, OffscreenRenderer

        _close()
        what, look = Composition(task), task.look
        model = ClipModel(
            what.drawing,
            size=look.pixels,
            samples=_GPU_SAMPLES if task.gpu else 0,
            toward=what.camera.toward,
            seams=look.seams,
            translucent=what.drawing.raw is not None and look.place == "over",
        )
        shadows = look.shadows or task.gpu
        renderer = OffscreenRenderer(model, what.camera, shadows=shadows)
        _open.append((task, what, renderer))
    return _open[0][1:]


@atexit.register
def _close() -> None:
    """Release OpenGL's resources; after Python's shutdown it would be too late."""
    while _open:
        _open.pop()[2].close()
