"""The options of ``render``."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from kinefilter.characters import InputError


@dataclass(frozen=True)
class Look:
    """Which frames to draw, from where, and with what around the character."""

    size: str = "640x360"
    """Width and height of the picture in pixels."""
    fps: float | None = None
    """Frames per second; default: the frame rate of the clip."""
    camera: str = "three-quarter"
    """Camera: front, side, three-quarter, orbit, follow, or a TOML file with position
    and target (meters, y up) and fov (vertical field of view, degrees)."""
    begin: float = 0.0
    """Time in the clip to begin at, in seconds."""
    end: float | None = None
    """Time in the clip to end at, in seconds; at most, and by default, its end."""
    compare: Path | None = None
    """The take that the clip was made from, drawn as a stick figure with joints colored
    by reliability: blue (reliable), pale yellow, red (unreliable)."""
    place: Literal["beside", "over"] = "beside"
    """Place of the take of --compare: beside the character or over it."""
    scene: str | None = None
    """Room to draw around the clip: a scene (an unknown name lists them) or an MJCF
    file (.xml); default: the props stored in the clip."""
    seams: bool = False
    """Draw lines along and across the limbs, which show how they twist."""
    shadows: bool = False
    """Draw shadows even without a GPU, which takes at least five times as long."""

    def __post_init__(self) -> None:
        if self.fps is not None and not 0.1 <= self.fps <= 240.0:
            raise InputError(f"--fps {self.fps:g}: expected 0.1 to 240")
        if not 0.0 <= self.begin <= (np.inf if self.end is None else self.end):
            span = f"--begin {self.begin:g} --end {self.end}"
            raise InputError(f"{span}: expected 0 <= begin <= end")
        _ = self.pixels  # raises an error if --size is wrong

    @property
    def pixels(self) -> tuple[int, int]:
        """Width and height in pixels."""
        width, _, height = self.size.lower().partition("x")
        if width.isdecimal() and height.isdecimal():
            pixels = int(width), int(height)
            if min(pixels) >= 16 and max(pixels) <= 8192:  # limits of codecs and OpenGL
                return pixels
        raise InputError(
            f"--size {self.size}: expected a width and a height of 16 to 8192 pixels, "
            "such as 1280x720"
        )
