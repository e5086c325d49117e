"""One clip to draw into one place, and the process that draws a part of it."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from pathlib import Path

import numpy as np

from kinefilter.characters.arrays import Array
from kinefilter.pipeline.settings import hash_of

from .backend import Backend
from .cameras import CameraPath, axes_toward, camera_path
from .look import Look
from .motions import read_motion, shown_frames
from .raw_take import raw_positions
from .surroundings import corners_of, props_around

_SKIN = 0.13  # m from a joint to the skin: the head's, about
_BESIDE = 0.35  # m between the raw figure and the character, a guess by eye
_GPU_SAMPLES = 4  # edges are smooth, and a GPU hardly slower
_ASTRAY = 1.0  # m from the character that a raw joint counts for the camera


@dataclass(frozen=True)
class Shot:
    """A clip, how it is drawn, and into what."""

    clip: Path
    """The clip's file."""
    out: Path
    """A video, a GIF, or pictures with their number in the name (``%05d.png``)."""
    look: Look
    """How it is drawn."""
    shadows: bool = False
    """Whether to draw shadows."""
    samples: int = 0
    """Samples a pixel."""
    renderer: str = ""
    """The OpenGL that draws."""

    def drawn_by(self, backend: Backend) -> Shot:
        """Return the shot with what the look leaves to who draws.

        Where that is no GPU, shadows and samples multiply the time.
        """
        soft, look = backend.software, self.look
        samples = 0 if soft else _GPU_SAMPLES
        return replace(
            self,
            shadows=look.shadows or not soft,
            samples=samples if look.samples is None else look.samples,
            renderer=str(backend),
        )

    def fingerprint(self) -> str:
        """Return a hash of all that decides the pictures of the shot.

        Files count by what is in them; those that a scene includes do not.
        """
        look = self.look
        files = [
            self.clip,
            *map(Path, (look.compare or "", look.camera, look.scene or "")),
        ]
        known = {
            **asdict(look),
            "shadows": self.shadows,
            "samples": self.samples,
            "renderer": self.renderer,
            "kinefilter": version("kinefilter"),
            "files": [hash_of(file) for file in files if file.is_file()],
        }
        text = json.dumps(known, sort_keys=True, default=str)
        return hashlib.sha256(text.encode()).hexdigest()[:32]


class Staged:
    """What a shot shows in each frame; read once, without OpenGL.

    Raises:
        InputError: The clip, the take, the scene or the camera cannot be used.
    """

    def __init__(self, shot: Shot) -> None:
        self.shot = shot
        look = shot.look
        clip = read_motion(shot.clip)
        self.clip, self.rate = shown_frames(clip, look)
        """The frames that are drawn, and how many of them a second has [1/s]."""
        self.raw: Array | None = None
        """Joint positions of the raw take [m], shape (T, J, 3)."""
        self.props = props_around(clip, self.clip, look.scene)
        """What is around the character in these frames."""
        if look.compare is not None:
            self.raw = raw_positions(look.compare, clip, self.clip.time)
            if look.place == "beside":
                self.raw = self.raw + self._aside()
        self.camera = self._camera(self._points())
        """Where everything is looked at from."""

    def __len__(self) -> int:
        return len(self.clip)

    def _camera(self, points: Array) -> CameraPath:
        width, height = self.shot.look.pixels
        return camera_path(
            self.shot.look.camera,
            self.clip,
            points,
            aspect=width / height,
            rate=self.rate,
        )

    def _points(self) -> Array:
        """Return points [m] that are all seen if everything is, shape (T, N, 3)."""
        joints = self.clip.positions
        corners = _SKIN * np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, 8).T
        points = [(joints[:, :, None] + corners).reshape(len(joints), -1, 3)]
        if self.raw is not None:
            points.append(self._tamed(self.raw))
        points += [corners_of(prop, len(joints)) for prop in self.props]
        return np.concatenate(points, axis=1)

    def _tamed(self, raw: Array) -> Array:
        """Return where the raw take is, without what leaps away or is missing."""
        joints = self.clip.positions
        place = np.nanmedian(raw - joints, axis=(0, 1))
        strays = ~(np.linalg.norm(raw - joints - place, axis=-1) < _ASTRAY)
        return np.where(strays[..., None], joints + place, raw)

    def _aside(self) -> Array:
        """Return the way [m] to the picture's left that keeps two figures apart."""
        camera = self._camera(self.clip.positions)
        position, target = camera.at(0)
        toward = (position - target) / np.linalg.norm(position - target)
        right, _ = axes_toward(toward)
        clean = self.clip.positions @ right
        width = np.ptp(clean, axis=1).max()
        return np.asarray(-right * (width + _BESIDE + 2.0 * _SKIN))
