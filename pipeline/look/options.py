"""The options of a rendering."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import arg

from kinefilter.characters import InputError

_SAMPLES = (0, 1, 2, 4, 8, 16)


@dataclass(frozen=True)
class Look:
    """Which frames are drawn, from where, and with what beside the character."""

    size: str = "640x360"
    """Width and height in pixels."""
    fps: float | None = None
    """Frames a second; default: the clip's own."""
    camera: str = "three-quarter"
    """front, side, three-quarter, orbit, follow, or a TOML file with position, target
    (meters, y up) and fov (vertical, degrees)."""
    start: Annotated[float, arg(name="from")] = 0.0
    """Where to begin, in seconds of the clip."""
    to: float | None = None
    """Where to end, in seconds of the clip; default: its end."""
    every: int = 1
    """Draw only every Nth frame; a video plays at the same speed."""
    compare: Path | None = None
    """The take that the clip was made from, drawn as a stick figure with joints from
    blue (reliable) over pale yellow to red."""
    place: Literal["beside", "over"] = "beside"
    """Where the take of --compare stands."""
    scene: str | None = None
    """Room to draw around the clip: a scene (an unknown name lists them), or an MJCF
    file (.xml); default: the props that the clip itself holds."""
    shadows: bool = False
    """Draw shadows even where no GPU draws, which takes at least five times as
    long."""
    samples: int | None = None
    """Samples per pixel, against jagged edges; default: 4 where a GPU draws, else
    0."""

    def __post_init__(self) -> None:
        if self.fps is not None and not 0.1 <= self.fps <= 240.0:
            raise InputError(f"--fps {self.fps:g}: expected 0.1 to 240")
        if self.every < 1:
            raise InputError(f"--every {self.every}: expected 1 or more")
        if self.samples is not None and self.samples not in _SAMPLES:
            known = ", ".join(map(str, _SAMPLES))
            raise InputError(f"--samples {self.samples}: expected one of {known}")
        if not self.start >= 0.0 or (self.to is not None and not self.to >= self.start):
            raise InputError(
                f"--from {self.start:g} --to {self.to}: expected 0 <= from <= to"
            )
        _ = self.pixels  # raises if --size is wrong

    @property
    def pixels(self) -> tuple[int, int]:
        """Width and height."""
        width, _, height = self.size.lower().partition("x")
        if width.isdecimal() and height.isdecimal():
            pixels = int(width), int(height)
            if min(pixels) >= 16 and max(pixels) <= 8192:  # as codecs and OpenGL take
                return pixels
        raise InputError(
            f"--size {self.size}: expected a width and a height of 16 to 8192 pixels, "
            "such as 1280x720"
        )
