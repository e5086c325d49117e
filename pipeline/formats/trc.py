"""TRC, the text in which Motion Analysis and OpenSim keep marker positions.

Five lines of header, split by tabs: kind and name of the file; names and then values of
rates and units; ``Frame#``, ``Time`` and every third column a marker's name; and the
names of the coordinates. Then a row for each frame; empty cells are missing.
"""

from __future__ import annotations

import os
from itertools import islice

import numpy as np

from kinefilter.characters import InputError

from .bvh import MOST_CELLS
from .files import AnyPath, open_text
from .recording import FASTEST, Mocap
from .rows import LARGEST_NUMBER, RowReader

MAGIC = "PathFileType"
"""What a TRC file begins with."""
_HEADER = 5  # lines
_LEAST_RATE = 0.01  # frames a second


def read_trc(path: AnyPath) -> Mocap:
    """Read a TRC file; raises InputError if it is malformed."""
    source = os.fspath(path)
    with open_text(path) as lines:
        header = [line.rstrip("\r\n").split("\t") for line in islice(lines, _HEADER)]
        if len(header) < _HEADER or header[0][0].strip() != MAGIC:
            raise InputError(f"{source}: not TRC, or cut off; export it again")
        rate = _rate(dict(zip(header[1], header[2], strict=False)), source)
        names = tuple(name.strip() for name in header[3][2:] if name.strip())
        if not names:
            raise InputError(f"{source}: line 4 names no marker; export it again")
        axes = [f"{name}.{axis}" for name in names for axis in "xyz"]
        columns = ("Frame#", "Time", *axes)

        def cells(line: str) -> str:
            values = [cell.strip() for cell in line.split("\t")]
            values += [""] * (len(columns) - len(values))  # the last markers' gaps
            while len(values) > len(columns) and not values[-1]:
                values.pop()
            return ",".join(values)

        reader, frames, rows = RowReader(source, columns, cells), [], 0
        for block in reader.blocks(lines, _HEADER + 1):
            frames.append(block.values[:, 2:])
            rows += len(block.values)
            if rows * len(names) > MOST_CELLS:
                raise InputError(f"{source}: too many frames of markers; split it")
    if rows < 2:
        raise InputError(f"{source}: has {rows} frames, expected at least 2")
    positions = np.concatenate(frames).reshape(rows, len(names), 3)
    missing = np.isnan(positions).any(axis=2) | (positions == 0).all(axis=2)
    positions[missing] = np.nan
    if not np.nanmax(np.abs(positions), initial=0.0) < LARGEST_NUMBER:
        raise InputError(f"{source}: a marker is beyond any room; export it again")
    return Mocap(names, positions, None, 1.0 / rate, source)


def _rate(values: dict[str, str], source: str) -> float:
    """Return the frames a second that the header states, or raise InputError."""
    stated = values.get("DataRate", "")
    try:
        rate = float(stated)
    except ValueError:
        rate = float("nan")
    if not _LEAST_RATE < rate <= FASTEST:
        raise InputError(
            f"{source}: line 3 has DataRate {stated[:20]!r}, expected frames a second"
        )
    return rate
