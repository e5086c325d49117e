"""Where and when the sensors of a session are, in a file for its other takes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import Rotation

from kinefilter.characters import InputError
from kinefilter.pipeline.formats import atomic_path

from .alignment import Alignment
from .lag import Clock
from .rigid import Placement

if TYPE_CHECKING:
    from .session import Merged

_KIND = "kinefilter calibration"
_FARTHEST = 100.0  # m from one sensor to another
_UNREADABLE = (ArithmeticError, LookupError, TypeError, ValueError, RecursionError)


def write_calibration(merged: Merged, path: Path) -> None:
    """Write where and when the sensors are, for other takes of the session (JSON)."""
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
    with atomic_path(path) as temporary:
        text = json.dumps({"file": _KIND, "sensors": sensors}, indent=2) + "\n"
        temporary.write_text(text, encoding="utf-8", newline="\n")


def read_calibration(path: Path | None) -> tuple[Alignment, ...]:
    """Read a calibration, if there is a path; raises InputError for what is none."""
    if path is None:
        return ()
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        if found["file"] != _KIND:
            raise ValueError(f"not a {_KIND}")
        alignments = []
        for sensor in found["sensors"][1:]:
            turn, shift = (
                np.array(sensor[key], dtype=float)
                for key in ("turn_xyzw", "shift_meters")
            )
            lag = float(sensor["lag_seconds"])
            if (
                turn.shape != (4,)
                or shift.shape != (3,)
                or not np.isfinite([*turn, *shift, lag]).all()
            ):
                raise ValueError("numbers are missing")
            if np.abs(shift).max() > _FARTHEST:
                raise ValueError(f"a sensor more than {_FARTHEST:g} m away")
            placed = Placement(Rotation.from_quat(turn), shift)
            alignments.append(
                Alignment(Clock(0.0, lag), placed, np.nan, np.inf, np.inf)
            )
    except (OSError, *_UNREADABLE) as error:
        raise InputError(
            f"{path}: not a calibration of 'kinefilter merge --save-calibration' "
            f"({str(error)[:80]})"
        ) from None
    return tuple(alignments)
