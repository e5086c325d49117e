"""Points from marker mocap: C3D, and TRC of Motion Analysis and OpenSim.

C3D is read by ezc3d (extra ``c3d``). TRC has five header lines of cells separated by
tabs: type and name of the file; names of rates and units; their values; ``Frame#``,
``Time`` and every third column a marker's name; and the names of the coordinates. Then
comes a row for each frame, with empty cells for missing points.
"""

import os
import struct
from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import InputError
from kinefilter.characters.arrays import Array
from kinefilter.characters.motion import frames_per_second
from kinefilter.pipeline.extras import require

from .bvh import MOST_CELLS
from .files import AnyPath, check_file, open_text
from .guarded import read_guarded
from .plain import counted
from .recording import FASTEST, Mocap
from .rows import LARGEST_NUMBER, RowReader

TRC_MAGIC = "PathFileType"  # first word of a TRC file
C3D_MAGIC = 0x50  # second byte of every C3D file
_BLOCK = 512  # bytes of a C3D file
_LARGEST_C3D = 2**30  # bytes
_HEADER = 5  # lines
_LEAST_RATE = 0.01  # frames/s


def read_trc(path: AnyPath) -> Mocap:
    """Read a TRC file; raises InputError if it is malformed."""
    source = os.fspath(path)
    with open_text(path) as lines:
        lines = (line.replace(",", ".") for line in lines)  # decimal commas
        header = [line.rstrip("\r\n").split("\t") for line in islice(lines, _HEADER)]
        if len(header) < _HEADER or header[0][0].strip() != TRC_MAGIC:
            raise InputError(f"{source}: is not TRC, or cut off; export it again")
        rate = _data_rate(dict(zip(header[1], header[2], strict=False)), source)
        names = tuple(name.strip() for name in header[3][2:] if name.strip())
        if not names:
            raise InputError(f"{source}: line 4 names no marker; export it again")
        points = (f"{name}.{axis}" for name in names for axis in "xyz")
        columns = ("Frame#", "Time", *points)

        def cells(line: str) -> str:
            values = [cell.strip() for cell in line.split("\t")]
            values += [""] * (len(columns) - len(values))  # if the last are missing
            while len(values) > len(columns) and not values[-1]:
                values.pop()
            return ",".join(values)

        most = MOST_CELLS // len(names)
        values = RowReader(source, columns, cells).read(lines, _HEADER + 1, most).values
    if len(values) > most:
        raise InputError(f"{source}: too many frames of markers; split it")
    if len(values) < 2:
        count = counted(len(values), "frame")
        raise InputError(f"{source}: has {count}, expected at least 2")
    positions = values[:, 2:].reshape(len(values), len(names), 3)
    time = _uneven_stamps(values[:, 1], rate, source)
    return replace(mocap_of_points(names, positions, rate, source), time=time)


def _uneven_stamps(time: Array, rate: float, source: str) -> Array | None:
    """Return time stamps [s] from 0, or None if they are even, as the rate says."""
    time = time - time[0]
    if not (np.diff(time) > 0.0).all():  # not every tool fills the column
        return None
    stated = frames_per_second(time)
    if not 0.8 < stated / rate < 1.25:
        told = f"DataRate says {rate:g} frames/s, the column Time {stated:.4g}"
        raise InputError(f"{source}: {told}; correct one of them")
    even = np.abs(time - np.arange(len(time)) / rate) < 0.5 / rate
    return None if even.all() else time


def _data_rate(values: dict[str, str], source: str) -> float:
    stated = values.get("DataRate", "")
    try:
        rate = float(stated)
    except ValueError:
        rate = float("nan")
    if not _LEAST_RATE < rate <= FASTEST:
        raise InputError(
            f"{source}: line 3 has DataRate {stated[:20]!r}, expected frames/s"
        )
    return rate


def read_c3d(path: AnyPath) -> Mocap:
    """Read a C3D file; raises InputError if it is malformed or ezc3d is missing."""
    source = os.fspath(path)
    _check_header(source)
    require("ezc3d", f"{source}: C3D", "c3d")
    arrays = read_guarded("markers:c3d_arrays", source)
    points, rate = arrays["points"], float(arrays["rate"].item())
    names, count = tuple(arrays["names"].tolist()), points.shape[1]
    if not _LEAST_RATE < rate < 1e4 or len(names) < count or not points.size:
        raise InputError(
            f"{source}: has {points.shape[2]} frames of {count} points, "
            f"{len(names)} labels and {rate:g} frames/s; export it again"
        )
    positions = np.moveaxis(points[:3], 0, -1).swapaxes(0, 1)
    unseen = arrays["residuals"] < 0
    positions = np.where(unseen[..., None], np.nan, positions)
    return mocap_of_points(names[:count], positions, rate, source)


def c3d_arrays(path: str) -> dict[str, NDArray[Any]]:
    """Read points, residuals, labels and rate, or raise InputError."""
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
    except Exception as error:  # ezc3d may raise anything that its C++ code does
        raise InputError(
            f"{path}: cannot be read as C3D ({type(error).__name__}); export it again"
        ) from None


def _check_header(source: str) -> None:
    """Raise InputError for wrong lengths in the header, which ezc3d would trust."""
    path = check_file(source)
    size = path.stat().st_size
    with path.open("rb") as file:
        header = file.read(_BLOCK)
    if len(header) < _BLOCK or header[1] != C3D_MAGIC or size > _LARGEST_C3D:
        raise InputError(f"{source}: is not C3D, or cut off; export it again")
    points, analog, first, last, scale, start = struct.unpack("<4H2xfH", header[2:18])
    frames = last - first + 1
    # A positive scale means integers, a negative one floats.
    width = 4 if scale < 0 else 2
    needed = frames * (4 * points + analog) * width
    if frames < 1 or start * _BLOCK > size or needed > size or points == 0:
        raise InputError(
            f"{source}: {frames} frames of {points} points do not fit into {size} "
            "bytes; the file may be cut off or damaged, export it again"
        )
    if frames * points > MOST_CELLS:
        raise InputError(
            f"{source}: {frames} frames of {points} points are too many; split it"
        )


def mocap_of_points(
    names: tuple[str, ...],
    positions: Array,
    rate: float,
    source: str,
    confidence: Array | None = None,
) -> Mocap:
    """Make mocap of points (T, N, 3); those at the origin or partly NaN are missing."""
    unseen = np.isnan(positions).any(axis=2) | (positions == 0).all(axis=2)
    positions = np.where(unseen[..., None], np.nan, positions)
    if not np.nanmax(np.abs(positions), initial=0.0) < LARGEST_NUMBER:
        raise InputError(f"{source}: a coordinate is too large; export it again")
    return Mocap(names, positions, None, 1.0 / rate, source, confidence)
