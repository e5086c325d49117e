"""C3D: points that marker mocap measured, read by ezc3d (extra ``c3d``).

Only points that are joints are of use here: named as the Kinect's joints, or as the
joint centers that Vicon's Plug-in Gait writes. Where bare markers are all there is,
the program that solves the skeleton has to come first.
"""

from __future__ import annotations

import os
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import InputError
from kinefilter.pipeline.extras import require

from .bvh import LARGEST_NUMBER, MOST_CELLS
from .files import check_file
from .guarded import read_guarded
from .mocap import Mocap

_BLOCK = 512  # bytes
MAGIC = 0x50
"""Second byte of every C3D file."""
_LARGEST = 2**30  # bytes


def read_c3d(path: str | os.PathLike[str]) -> Mocap:
    """Read a C3D file; raises InputError if it is malformed or ezc3d is missing."""
    source = os.fspath(path)
    _check_header(source)
    require("ezc3d", f"{source}: C3D", "c3d")
    arrays = read_guarded("c3d:arrays_of", source)
    points, rate = arrays["points"], float(arrays["rate"].item())
    names, count = tuple(arrays["names"].tolist()), points.shape[1]
    if not 0.01 < rate < 1e4 or len(names) < count or not points.size:
        raise InputError(
            f"{source}: has {points.shape[2]} frames of {count} points, "
            f"{len(names)} labels, {rate:g} frames a second; export it again"
        )
    positions = np.moveaxis(points[:3], 0, -1).swapaxes(0, 1)
    # What no camera saw has a residual below zero, and zeros for a place.
    unseen = (arrays["residuals"] < 0) | (positions == 0).all(axis=-1)
    positions = np.where(unseen[..., None], np.nan, positions)
    if not np.nanmax(np.abs(positions), initial=0.0) < LARGEST_NUMBER:
        raise InputError(f"{source}: a point is beyond any room; export it again")
    return Mocap(names[:count], positions, None, 1.0 / rate, source)


def arrays_of(path: str) -> dict[str, NDArray[Any]]:
    """Return points, residuals, labels and rate of a file, or raise InputError."""
    import ezc3d

    try:
        file = ezc3d.c3d(path)
        parameters = file["parameters"]["POINT"]
        names = [str(name) for name in parameters["LABELS"]["value"]]
        return {
            "points": np.asarray(file["data"]["points"], dtype=np.float64),
            "residuals": np.asarray(file["data"]["meta_points"]["residuals"][0].T),
            "names": np.array(names, dtype=str),
            "rate": np.array(float(parameters["RATE"]["value"][0])),
        }
    except Exception as error:  # ezc3d raises whatever its C++ does
        raise InputError(
            f"{path}: cannot be read as C3D ({type(error).__name__}); export it again"
        ) from None


def _check_header(source: str) -> None:
    """Raise InputError for a file that is not as long as its header says.

    ezc3d believes the header: of a damaged one it asks for any amount of memory.
    """
    path = check_file(source)
    size = path.stat().st_size
    with path.open("rb") as file:
        header = file.read(_BLOCK)
    if len(header) < _BLOCK or header[1] != MAGIC or size > _LARGEST:
        raise InputError(f"{source}: not a C3D file, or cut off; export it again")
    points, analog, first, last = struct.unpack("<4H", header[2:10])
    scale, start = struct.unpack("<fH", header[12:18])
    frames = last - first + 1
    # Whole numbers where the scale is positive, floats where it is negative.
    width = 4 if scale < 0 else 2
    needed = frames * (4 * points + analog) * width
    if frames < 1 or start * _BLOCK > size or needed > size or points == 0:
        raise InputError(
            f"{source}: {frames} frames of {points} points do not fit into {size} "
            "bytes; the file may be cut off, or its header damaged"
        )
    if frames * points > MOST_CELLS:
        raise InputError(
            f"{source}: {frames} frames of {points} points are more than any "
            "recording has; cut it into shorter files"
        )
