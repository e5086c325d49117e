"""NTU RGB+D: skeletons of Kinect v2 as text (.skeleton).

Layout (Shahroudy et al. 2016, NTU RGB+D, CVPR; the data set's own reader): the number
of frames; per frame the number of bodies; per body a line of ten values, the body's
number first, the number of joints, and a line of twelve values a joint: x, y, z [m],
depth image x and y, color image x and y, orientation w, x, y, z, tracking state. The
joints are those of Kinect v2 in the SDK's order, 30 frames a second.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NoReturn

import numpy as np

from kinefilter.characters import KINECT_V2, InputError, State

from .recording import (
    MOST_FRAMES,
    Recording,
    Sighting,
    check_length,
    open_rows,
    takes_of,
)

_FRAMES_PER_SECOND = 30.0
_BODY_VALUES = 10
_JOINT_VALUES = 12


def read_ntu(source: str) -> Recording:
    """Read a .skeleton file; raises InputError where it is malformed."""
    sightings: list[Sighting] = []
    with open_rows(source) as (row, line, lines):
        reader = _Reader(source, lines, row)
        count = reader.whole(line, "the number of frames")
        for frame in range(min(count, MOST_FRAMES + 1)):
            reader.frame = f"frame {frame + 1} of {count}"
            bodies = reader.whole(reader.line(), "the number of bodies")
            sightings += [reader.body(frame) for _ in range(bodies)]
        check_length(count, source)
        reader.expect_end(count)
    time = np.arange(count) / _FRAMES_PER_SECOND
    return Recording(takes_of(time, sightings, KINECT_V2, source), "ntu")


@dataclass
class _Reader:
    """Takes one line after the other and says which is wrong."""

    source: str
    lines: Iterator[str]
    row: int
    frame: str = ""

    def line(self) -> str:
        for line in self.lines:
            self.row += 1
            if line.strip():
                return line
        raise InputError(
            f"{self.source}: row {self.row} ends the file in {self.frame}; the file "
            "may be cut off, download it again or correct row 1"
        )

    def expect_end(self, count: int) -> None:
        for line in self.lines:
            self.row += 1
            if line.strip():
                self.fail(f"goes on after {count} frames; correct row 1")

    def whole(self, line: str, meaning: str) -> int:
        """Return the whole number that a line is, 0 or more."""
        word = line.strip()
        if not word.isascii() or not word.isdigit() or len(word) > 18:
            self.fail(f"is {word[:40]!r}, expected {meaning}")
        return int(word)

    def body(self, frame: int) -> Sighting:
        words = self.line().split()
        if len(words) != _BODY_VALUES:
            self.fail(
                f"has {len(words)} values, expected the {_BODY_VALUES} of a body; is "
                "row 1 the number of frames?"
            )
        body = self.whole(words[0], "the body's number")
        joints = self.whole(self.line(), "the number of joints")
        if joints != len(KINECT_V2):
            self.fail(f"is {joints} joints, expected {len(KINECT_V2)}")
        values = np.array([self._joint() for _ in range(joints)])
        return Sighting(frame, body, values[:, :3], values[:, -1].astype(np.uint8))

    def _joint(self) -> list[float]:
        words = self.line().split()
        if len(words) != _JOINT_VALUES:
            self.fail(
                f"has {len(words)} values, expected the {_JOINT_VALUES} of a joint"
            )
        try:
            values = [float(word) for word in (*words[:3], words[-1])]
        except ValueError:
            self.fail("holds a word, expected numbers")
        if any(abs(value) == float("inf") for value in values):
            self.fail("holds an infinite number, expected finite ones")
        if values[-1] not in list(State):
            self.fail(
                f"ends in {words[-1][:40]!r}, expected a tracking state: 0 not "
                "tracked, 1 inferred, 2 tracked"
            )
        return values

    def fail(self, complaint: str) -> NoReturn:
        raise InputError(f"{self.source}: row {self.row} {complaint}")
