"""Text files of two public data sets: NTU RGB+D and MSR Action3D.

NTU RGB+D, ``.skeleton`` (Shahroudy et al. 2016, NTU RGB+D, CVPR; the data set's own
reader): the number of frames; per frame the number of bodies; per body a line of ten
values, the body's number first, the number of joints, and a line of twelve values per
joint: x, y, z [m], depth image x and y, color image x and y, orientation w, x, y, z,
tracking state. The joints are those of Kinect v2 in the SDK's order, 30 frames/s.

MSR Action3D, ``aXX_sYY_eZZ_skeleton3D.txt`` (Li, Zhang & Liu 2010, Action recognition
based on a bag of 3D points, CVPR workshops): one joint per row, ``x y z c``, 20 rows
per frame, 15 frames/s; meters, y up, z away from the camera, c the tracker's
confidence. The joints have an order of their own. The data set's files of screen
coordinates, ``u v d c``, hold pixels and raw depth: without the parameters of the
camera's lens they are not positions.
"""

from dataclasses import dataclass
from itertools import chain

import numpy as np

from kinefilter.characters import KINECT_V1, KINECT_V2, InputError, State

from .recording import Recording, Sighting, check_length, takes_of_people, takes_of_rows
from .rows import MOST_FRAMES, STATES, LineReader, RowReader, open_rows

_NTU_FPS, _MSR_FPS = 30.0, 15.0
_PER_BODY, _PER_JOINT = 10, 12  # values in a line of NTU

MSR_JOINTS = (
    *("ShoulderRight", "ShoulderLeft", "ShoulderCenter", "Spine"),
    *("HipRight", "HipLeft", "HipCenter"),
    *("ElbowRight", "ElbowLeft", "WristRight", "WristLeft", "HandRight", "HandLeft"),
    *("KneeRight", "KneeLeft", "AnkleRight", "AnkleLeft", "FootRight", "FootLeft"),
    "Head",
)
"""The joints of MSR Action3D in the order of the rows."""
_MSR_COLUMNS = ("x", "y", "z", "confidence")
_PIXELS = 20.0  # a person is less wide than this in meters, and wider in pixels


def read_msr_action3d(source: str) -> Recording:
    """Read a file of real-world coordinates; raises InputError if malformed."""
    joints = len(MSR_JOINTS)
    with open_rows(source) as (row, line, lines):
        reader = RowReader(source, _MSR_COLUMNS)
        rows = reader.read(chain([line], lines), row, MOST_FRAMES * joints).values
    if len(rows) % joints:
        raise InputError(
            f"{source}: has {len(rows)} rows, expected {joints} per frame; the file "
            "may be cut off, download it again"
        )
    values = rows.reshape(-1, joints, len(_MSR_COLUMNS))
    width = float(np.nanmedian(np.ptp(values[..., :2], axis=1), axis=0).max())
    if width > _PIXELS:
        raise InputError(
            f"{source}: the rows are u v d c, in pixels and raw depth, not positions; "
            "use the files of real-world coordinates (..._skeleton3D.txt)"
        )
    values = values[:, [MSR_JOINTS.index(joint) for joint in KINECT_V1.joints]]
    # The tracker, OpenNI, knows confidences of 0, 0.5 and 1.
    halves = np.round(2.0 * np.clip(np.nan_to_num(values[..., 3]), 0.0, 1.0))
    time = np.arange(len(values)) / _MSR_FPS
    places, states = values[..., :3], halves.astype(np.uint8)
    takes, notes = takes_of_rows(time, places, states, KINECT_V1, source)
    return Recording(takes, notes=notes)


def read_ntu(source: str) -> Recording:
    """Read a .skeleton file; raises InputError if it is malformed."""
    sightings: list[Sighting] = []
    with open_rows(source) as (row, line, lines):
        reader = _NtuReader(source, chain([line], lines), row - 1)
        count = reader.whole("the number of frames")
        for frame in range(min(count, MOST_FRAMES + 1)):
            reader.frame = f"frame {frame + 1} of {count}"
            bodies = reader.whole("the number of bodies")
            sightings += [reader.body(frame) for _ in range(bodies)]
        check_length(count, source)
        if next(reader.filled(), None):
            reader.fail(f"comes after the last of {count} frames; correct row 1")
    time = np.arange(count) / _NTU_FPS
    takes, notes = takes_of_people(time, sightings, KINECT_V2, source)
    return Recording(takes, notes=notes)


@dataclass
class _NtuReader(LineReader):
    noun = "row"
    frame: str = ""

    def words(self) -> list[str]:
        """Return the words of the next line that is not blank."""
        words = next(self.filled(), None)
        if words is None:
            self.fail(
                f"ends the file in {self.frame}; the file may be cut off, download it "
                "again or correct row 1"
            )
        return words

    def whole(self, meaning: str, word: str | None = None) -> int:
        """Parse a word, or the next line, as a whole number that is not negative."""
        word = " ".join(self.words()) if word is None else word
        if not word.isascii() or not word.isdigit() or len(word) > 18:
            self.fail(f"is {word[:40]!r}, expected {meaning}")
        return int(word)

    def body(self, frame: int) -> Sighting:
        words = self.words()
        if len(words) != _PER_BODY:
            self.fail(
                f"has {len(words)} values, not the {_PER_BODY} of a body; row 1 may "
                "have the wrong number of frames"
            )
        body = self.whole("the body's number", words[0])
        joints = self.whole("the number of joints")
        if joints != len(KINECT_V2):
            self.fail(f"is {joints} joints, expected {len(KINECT_V2)}")
        values = np.empty((joints, 4))
        for row in values:
            words = self.words()
            if len(words) != _PER_JOINT:
                self.fail(f"has {len(words)} values, not the {_PER_JOINT} of a joint")
            try:
                row[:] = *words[:3], words[-1]
            except ValueError:
                row[:] = np.inf
            if np.isinf(row).any():
                self.fail("has a word or an infinite number, expected finite numbers")
            if row[-1] not in list(State):
                self.fail(f"ends in {words[-1][:40]!r}, expected {STATES}")
        return Sighting(frame, body, values[:, :3], values[:, -1].astype(np.uint8))
