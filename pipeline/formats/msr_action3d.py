"""MSR Action3D: 20 joints of a depth camera of 2010 as text.

Layout of the real-world files, ``aXX_sYY_eZZ_skeleton3D.txt`` (Li, Zhang & Liu 2010,
Action recognition based on a bag of 3D points, CVPR workshops): a joint a row, ``x y z
c``, 20 rows a frame, 15 frames a second; meters, y up, z away from the camera, c the
tracker's confidence. The joints come in an order of their own. The same data set's
files of screen coordinates, ``u v d c``, hold pixels and raw depth: without the
camera's lens they are no positions.
"""

from __future__ import annotations

from itertools import chain

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import KINECT_V1, InputError

from .recording import MOST_FRAMES, Recording, check_length, open_rows, recording_of
from .rows import RowReader

JOINTS = (
    *("ShoulderRight", "ShoulderLeft", "ShoulderCenter", "Spine"),
    *("HipRight", "HipLeft", "HipCenter"),
    *("ElbowRight", "ElbowLeft", "WristRight", "WristLeft", "HandRight", "HandLeft"),
    *("KneeRight", "KneeLeft", "AnkleRight", "AnkleLeft", "FootRight", "FootLeft"),
    "Head",
)
"""The joints in the order of the rows."""
_FRAMES_PER_SECOND = 15.0
_COLUMNS = ("x", "y", "z", "confidence")
_PIXELS = 20.0  # a person is less meters wide, and more pixels


def read_msr_action3d(source: str) -> Recording:
    """Read a file of real-world coordinates; raises InputError if it is malformed."""
    blocks, count = [], 0
    with open_rows(source) as (row, line, lines):
        for block in RowReader(source, _COLUMNS).blocks(chain([line], lines), row):
            blocks.append(block.values)
            count += len(block.values)
            if count > MOST_FRAMES * len(JOINTS):
                break
    if count % len(JOINTS):
        raise InputError(
            f"{source}: has {count} rows, expected {len(JOINTS)} a frame; the file may "
            "be cut off, download it again"
        )
    check_length(count // len(JOINTS), source)
    values = np.concatenate(blocks).reshape(-1, len(JOINTS), len(_COLUMNS))
    _check_meters(values, source)
    ours = [JOINTS.index(joint) for joint in KINECT_V1.joints]
    time = np.arange(len(values)) / _FRAMES_PER_SECOND
    places, states = values[:, ours, :3], _states(values[:, ours, 3])
    return recording_of(time, places, states, KINECT_V1, source, "msr-action3d")


def _check_meters(values: NDArray[np.float64], source: str) -> None:
    width = float(np.nanmedian(np.ptp(values[..., :2], axis=1), axis=0).max())
    if width > _PIXELS:
        raise InputError(
            f"{source}: rows of u v d c, pixels and raw depth, are no positions; take "
            "the data set's files of real-world coordinates (..._skeleton3D.txt)"
        )


def _states(confidence: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Return states for confidences, of which OpenNI knows 0, 0.5 and 1."""
    halves = np.round(2.0 * np.clip(np.nan_to_num(confidence), 0.0, 1.0))
    return halves.astype(np.uint8)
