"""What a report's page is told: names, tables, and arrays as base64."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import CONTACTS, Origin, Term
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.metrics import even_differences

from .compared import Compared
from .limits import Limit
from .table import METRICS

_MISSING = -(2**15)  # of the int16 that a position is written as
_FARTHEST = 2**15 - 1  # mm from the origin


def contents_of(compared: Compared, limits: Sequence[Limit]) -> dict[str, Any]:
    """Return everything that a page shows, ready for ``json.dumps``.

    Arrays are base64 of little-endian numbers, frame by frame: positions int16 [mm],
    with -32768 where missing, reliability uint8 [%], what moved int16 [mm].

    Args:
        compared: A clip and its take.
        limits: What fails.
    """
    clip = compared.clip
    time = clip.time - clip.time[0]
    return {
        "source": clip.source,
        "skeleton": clip.skeleton.name,
        "fps": clip.fps,
        "height": clip.body.height,
        "joints": list(clip.skeleton.joints),
        "parents": list(clip.skeleton.parents),
        "terms": [term.words for term in Term],
        "origins": [origin.name.lower() for origin in Origin],
        "parts": list(CONTACTS),
        "time": _packed(time, "<f4"),
        "raw": _packed(_millimeters(compared.raw), "<i2"),
        "clean": _packed(_millimeters(clip.positions), "<i2"),
        "reliability": _packed(np.clip(clip.reliability, 0.0, 1.0) * 100.0, "u1"),
        "term": _packed(clip.deciding_term, "u1"),
        "origin": _packed(clip.origin, "u1"),
        "correction": _packed(_millimeters(clip.moved_by_correction), "<i2"),
        "physics": _packed(_millimeters(clip.moved_by_physics), "<i2"),
        "contacts": _packed(clip.contacts, "u1"),
        "curves": [
            _curve("speed, m/s", clip.time, compared, 1),
            _curve("jitter, m/s³", clip.time, compared, 3),
        ],
        "metrics": _metrics(compared, limits),
    }


def _packed(values: NDArray[Any], kind: str) -> str:
    if np.issubdtype(np.dtype(kind), np.integer):
        values = np.rint(values)
    return base64.b64encode(values.astype(kind).tobytes()).decode("ascii")


def _millimeters(meters: Array) -> Array:
    near = np.clip(np.nan_to_num(meters) * 1e3, -_FARTHEST, _FARTHEST)
    return np.where(np.isfinite(meters), near, _MISSING)


def _curve(name: str, time: Array, compared: Compared, order: int) -> dict[str, Any]:
    """Return the mean magnitude of a derivative of the joints, raw and clean."""
    return {
        "name": name,
        "raw": _packed(_derivative(time, compared.raw, order), "<f4"),
        "clean": _packed(_derivative(time, compared.clip.positions, order), "<f4"),
    }


def _derivative(time: Array, positions: Array, order: int) -> Array:
    """Return the mean over joints of the magnitude of a difference over dt^order.

    As in ``metrics.jitter``, only frames at the nominal rate (within half a step)
    count, and joints that are there in all of them; NaN in the others, shape (T,).
    """
    values = np.full(len(time), np.nan)
    size, nominal = even_differences(time, positions, order)
    known = ~np.isnan(size)
    total = np.where(known, size, 0.0).sum(axis=1)
    count = known.sum(axis=1)
    first = order // 2  # the difference is that of the frame in its middle
    values[first : first + len(size)] = np.where(
        count > 0, total / np.maximum(count, 1) / nominal**order, np.nan
    )
    return values


def _metrics(compared: Compared, limits: Sequence[Limit]) -> list[dict[str, Any]]:
    return [
        {
            "name": name,
            "meaning": meaning,
            "raw": _finite(compared.before[name]),
            "clean": _finite(compared.after[name]),
            "limits": [
                {"text": f"{k.side} {k.number:g}", "fails": k.fails(compared.after)}
                for k in limits
                if k.metric == name
            ],
        }
        for name, meaning in METRICS.items()
    ]


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None
