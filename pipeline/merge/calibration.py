"""Calibration files: the sensors of a session, for other takes of it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import Rotation

from kinefilter.characters import InputError
from kinefilter.characters.arrays import as_numbers
from kinefilter.pipeline.formats.files import check_file, new_text

from .alignment import Alignment
from .lag import Clock
from .rigid import Placement

if TYPE_CHECKING:
    from .session import Merged

_KIND = "kinefilter calibration"
_UNREADABLE = (OSError, InputError, LookupError, TypeError, ValueError, RecursionError)
_SHAPES = {"turn_xyzw": (4,), "shift_meters": (3,), "lag_seconds": ()}
_MAX_DISTANCE = 100.0  # m from one sensor to another


def write_calibration(merged: Merged, path: Path) -> None:
    """Write place and clock of the sensors, for other takes of the session (JSON)."""
    sensors: list[dict[str, Any]] = [{"source": Path(merged.sources[0]).name}]
    for source, found in zip(merged.sources[1:], merged.alignments, strict=True):
        sensors.append(
            {
                "source": Path(source).name,
                "lag_seconds": found.clock.lag - found.clock.start,
                "turn_xyzw": found.placed.turn.as_quat().tolist(),
                "shift_meters": found.placed.shift.tolist(),
            }
        )
    with new_text(path) as file:
        file.write(json.dumps({"file": _KIND, "sensors": sensors}, indent=2) + "\n")


def read_calibration(path: Path | None) -> tuple[Alignment, ...]:
    """Read a calibration, none without a path; raise InputError if it is invalid."""
    if path is None:
        return ()
    check_file(path)
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        if found["file"] != _KIND:
            raise ValueError(f"not a {_KIND}")
        alignments = []
        for sensor in found["sensors"][1:]:
            turn, shift, lag = (
                as_numbers(sensor[key], key, shape, finite=True).astype(float)
                for key, shape in _SHAPES.items()
            )
            if np.abs(shift).max() > _MAX_DISTANCE:
                raise ValueError(f"a sensor is over {_MAX_DISTANCE:g} m away")
            clock = Clock(0.0, float(lag))
            placed = Placement(Rotation.from_quat(turn), shift)
            alignments.append(Alignment(clock, placed, np.nan, np.inf, np.inf))
    except _UNREADABLE as error:
        raise InputError(
            f"{path}: not a calibration from 'kinefilter merge --save-calibration' "
            f"({str(error)[:80]})"
        ) from None
    return tuple(alignments)
