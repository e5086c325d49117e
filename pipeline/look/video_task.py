"""A clip to draw, and what is in each of its pictures; without OpenGL."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from pathlib import Path

import numpy as np

from kinefilter.characters import Clip, InputError, Prop
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.formats.export import resampled
from kinefilter.pipeline.settings import hash_of
from kinefilter.pipeline.target.floor import place_of

from .cameras import CameraPath, axes_toward, camera_path
from .drawing import Drawing, offset_beside, read_finite_clip
from .figures import corners_around, corners_of
from .options import Look
from .placing import raw_positions
from .video_opengl import Backend

_SKIN = 0.13  # m from a joint to the skin, at most: the head's, about
_GPU_SAMPLES = 4  # edges are smooth, and a GPU is hardly slower
_ASTRAY = 1.0  # m from the character within which a raw joint counts for the camera
_SKEW = 1e-6  # s by which a frame may lie outside of --from and --to


@dataclass(frozen=True)
class RenderTask:
    """A clip, how it is drawn, and into what."""

    clip: Path
    """The clip's file."""
    out: Path
    """A video, a GIF, or pictures with their number in the name (``%05d.png``)."""
    look: Look
    """How it is drawn."""
    renderer: str = ""
    """The OpenGL that draws."""

    def drawn_by(self, backend: Backend) -> RenderTask:
        """Return the task with the options that the look leaves to the backend.

        Without a GPU, shadows and samples multiply the time.
        """
        soft, look = backend.software, self.look
        samples = 0 if soft else _GPU_SAMPLES
        look = replace(
            look,
            shadows=look.shadows or not soft,
            samples=samples if look.samples is None else look.samples,
        )
        return replace(self, look=look, renderer=str(backend))

    def fingerprint(self) -> str:
        """Return a hash of all that decides the pictures.

        Files count by their content; those that a scene includes do not count.
        """
        look = self.look
        named = (look.compare or "", look.camera, look.scene or "")
        known = {
            **asdict(look),
            "renderer": self.renderer,
            "kinefilter": version("kinefilter"),
            "files": [
                hash_of(file)
                for file in (self.clip, *map(Path, named))
                if file.is_file()
            ],
        }
        text = json.dumps(known, sort_keys=True, default=str)
        return hashlib.sha256(text.encode()).hexdigest()[:32]


class Composition:
    """What is in each picture of a task; read once, without OpenGL.

    Raises:
        InputError: The clip, the take, the scene or the camera cannot be used.
    """

    def __init__(self, task: RenderTask) -> None:
        look, whole = task.look, read_finite_clip(task.clip)
        self._look = look
        clip, self.rate = shown_frames(whole, look)
        """Frames a second [1/s]."""
        if look.scene is not None:
            clip = replace(clip, props=props_around(whole, clip.props, look.scene))
        raw = None
        if look.compare is not None:
            raw = raw_positions(look.compare, whole, clip.time)
            if look.place == "beside":
                right, _ = axes_toward(self._camera(clip, clip.positions).toward)
                raw = raw + offset_beside(clip.positions, -right, 2.0 * _SKIN)
        self.drawing = Drawing(clip, raw)
        """The frames that are drawn."""
        self.camera = self._camera(clip, self._points())
        """Where everything is seen from."""

    def __len__(self) -> int:
        return len(self.drawing.clip)

    def _camera(self, clip: Clip, points: Array) -> CameraPath:
        width, height = self._look.pixels
        return camera_path(
            self._look.camera, clip, points, aspect=width / height, rate=self.rate
        )

    def _points(self) -> Array:
        """Return points [m] that are to be in the picture, shape (T, N, 3)."""
        clip, raw = self.drawing.clip, self.drawing.raw
        joints = clip.positions
        points = [corners_around(joints, _SKIN)]
        if raw is not None:
            # Raw joints that leap away or are missing count where the character is.
            place = joints + np.nanmedian(raw - joints, axis=(0, 1))
            near = np.linalg.norm(raw - place, axis=-1) < _ASTRAY
            points.append(np.where(near[..., None], raw, place))
        points += [corners_of(prop, len(joints)) for prop in clip.props]
        return np.concatenate(points, axis=1)


def shown_frames(clip: Clip, look: Look) -> tuple[Clip, float]:
    """Return the frames that are drawn and how many of them a second has.

    Frames are evenly spaced in time, however irregular the sensor was.

    Raises:
        InputError: The clip has none between --from and --to.
    """
    rate = look.fps or clip.fps
    even = resampled(clip, rate)
    since = even.time - even.time[0]
    end = np.inf if look.to is None else look.to
    chosen = np.flatnonzero((since >= look.start - _SKEW) & (since <= end + _SKEW))
    if not len(chosen):
        raise InputError(
            f"{clip.source}: has no frame from {look.start:g} s"
            + (f" to {look.to:g} s" if look.to is not None else "")
            + f"; it lasts {since[-1]:.2f} s"
        )
    return even.at(chosen[:: look.every]), rate / look.every


def props_around(clip: Clip, props: tuple[Prop, ...], scene: str) -> tuple[Prop, ...]:
    """Return props and what else a scene has, at rest.

    The scene lies where ``clean --scene`` puts it: the person, in the whole clip,
    begins at its origin.

    Raises:
        InputError: As ``load_scene``.
    """
    import mujoco  # by now its OpenGL is chosen

    from kinefilter.pipeline.physics.filter import Things
    from kinefilter.scenes import load_scene

    model = load_scene(scene).compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    things = Things(model, data, -1, 1)
    things.record(0)
    known = {prop.name for prop in props}
    others = things.props(place_of(clip.positions, clip.skeleton))
    return props + tuple(prop for prop in others if prop.name not in known)
