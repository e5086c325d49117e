"""Report pages, and the limits of their metrics, such as ``skate>0.003``."""

import base64
import html
import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from string import Template
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import CONTACTS, Clip, InputError, Origin, Take, Term
from kinefilter.characters.arrays import Array, shown
from kinefilter.pipeline.formats.files import AnyPath, atomic_path
from kinefilter.pipeline.formats.plain import finite
from kinefilter.pipeline.metrics import METRICS, even_differences

from .comparison import Comparison
from .drawing import ORIGINS, RELIABILITY, TERMS, UNKNOWN

_NUMBER = r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
_FORM = re.compile(rf"\s*(\w+)\s*([<>])\s*({_NUMBER})\s*")
_TEMPLATE = Path(__file__).parent / "template"
_SHARED = (_TEMPLATE / "page.css", _TEMPLATE / "drawing.js")  # of all pages
_SCRIPTS = ("arrays", "figures", "sensors", "maps", "tables", "page")
_MISSING = -(2**15)  # for a missing position, stored as int16
_FARTHEST = 2**15 - 1  # mm from the origin
_NO_RATE = 255  # for unknown reliability, stored as uint8


@dataclass(frozen=True)
class Limit:
    """A metric (``METRICS``) fails on this side of a number, in its own unit."""

    metric: str
    side: Literal["<", ">"]
    number: float

    def __str__(self) -> str:
        return f"{self.metric}{self.side}{self.number:g}"

    def fails(self, figures: Mapping[str, float]) -> bool:
        """Return True if the metric is beyond the limit; NaN (not measured) is not."""
        value = figures[self.metric]
        return value > self.number if self.side == ">" else value < self.number


def parse_limit(text: str) -> Limit:
    """Parse a limit such as ``skate>0.003``, or raise an InputError."""
    form = _FORM.fullmatch(text)
    if form is None or form[1] not in METRICS or math.isinf(float(form[3])):
        raise InputError(
            f"{shown(text)}: expected a metric, < or >, and a number, such as "
            f"skate>0.003; metrics: {', '.join(METRICS)}"
        )
    return Limit(form[1], ">" if form[2] == ">" else "<", float(form[3]))


LIMITS = (
    Limit("skate", ">", 0.003),  # m per frame: 9 cm per second at 30 Hz
    Limit("skate_share_over_0p2", ">", 0.1),
    Limit("float_mm", ">", 20.0),
    Limit("penetration_mm", ">", 20.0),
    Limit("bone_length_cv", ">", 0.001),  # the bones of a clip are rigid
    Limit("jitter", ">", 200.0),  # m/s^3; raw takes have several hundred
    Limit("amplitude_kept", "<", 0.8),  # if less, the motion was smoothed away
    Limit("moved_cm", ">", 10.0),
)
"""What a page marks as failed: guesses at what animators notice."""


def write_report(
    comparison: Comparison, path: AnyPath, gates: Sequence[Limit] = ()
) -> None:
    """Write a report page that needs no other file or network, whole or not at all.

    The table of metrics shows which of LIMITS fail, and which ``gates``, which replace
    those of the same metrics. Raises an InputError if the file cannot be written.
    """
    gated = {gate.metric for gate in gates}
    limits = (*(limit for limit in LIMITS if limit.metric not in gated), *gates)
    contents = page_contents(comparison, limits)
    files = [_TEMPLATE / "page.html", *(_TEMPLATE / f"{name}.js" for name in _SCRIPTS)]
    write_page(path, f"kinefilter: {contents['source']}", contents, files)


def write_page(
    path: AnyPath, title: str, contents: Mapping[str, Any], files: Sequence[Path]
) -> None:
    """Write contents and the files that show them as one page, whole or not at all.

    ``files`` are the .html of the body, .css and .js, appended to the ``page.css`` and
    ``drawing.js`` of all pages. Raises an InputError if the page cannot be written.
    """
    texts: dict[str, list[str]] = {"css": [], "js": [], "html": []}
    for file in (*_SHARED, *files):
        texts[file.suffix[1:]].append(file.read_text(encoding="utf-8"))
    data = json.dumps(contents, allow_nan=False, separators=(",", ":"))
    for mark in "<>&":  # or they could end the script element
        data = data.replace(mark, f"\\u{ord(mark):04x}")
    page = Template((_TEMPLATE / "frame.html").read_text(encoding="utf-8")).substitute(
        {kind: "\n".join(text) for kind, text in texts.items()},
        title=html.escape(title),
        data=data,
    )
    with atomic_path(path) as temporary:
        temporary.write_bytes(page.encode("utf-8", "replace"))


def page_contents(comparison: Comparison, limits: Sequence[Limit]) -> dict[str, Any]:
    """Return everything that a report shows, ready for ``json.dumps``.

    Arrays are ``packed`` frame by frame: positions and distances as int16 [mm], -32768
    where missing; reliability as uint8 [%], 255 where unknown.
    """
    clip = comparison.clip
    corners = np.stack([f(clip.positions, axis=(0, 1)) for f in (np.min, np.max)])
    rates = np.where(np.isnan(clip.reliability), _NO_RATE, clip.reliability * 100.0)
    metrics = [
        {
            "name": name,
            "meaning": meaning,
            "raw": comparison.before[name],
            "clean": comparison.after[name],
            "limits": [
                {"text": f"{k.side} {k.number:g}", "fails": k.fails(comparison.after)}
                for k in limits
                if k.metric == name
            ],
        }
        for name, meaning in METRICS.items()
    ]
    return {
        "source": clip.source,
        "skeleton": clip.skeleton.name,
        "fps": clip.fps,
        "height": clip.body.height,
        "damage": comparison.damage,
        "joints": list(clip.skeleton.joints),
        "parents": list(clip.skeleton.parents),
        "terms": [term.words for term in Term],
        "origins": [origin.name.lower() for origin in Origin],
        "parts": list(CONTACTS),
        "colors": {
            "reliability": RELIABILITY,
            "origins": ORIGINS,
            "terms": TERMS,
            "unknown": UNKNOWN,
        },
        "facing": facing(clip),
        "bounds": millimeters(corners).tolist(),
        "time": packed(clip.time - clip.time[0], "f8"),
        "raw": packed(millimeters(comparison.raw), "i2"),
        "clean": packed(millimeters(clip.positions), "i2"),
        "reliability": packed(rates, "u1"),
        "term": packed(clip.deciding_term, "u1"),
        "origin": packed(clip.origin, "u1"),
        "correction": packed(millimeters(clip.moved_by_correction), "i2"),
        "physics": packed(millimeters(clip.moved_by_physics), "i2"),
        "uncertainty": packed(millimeters(clip.uncertainty), "i2"),
        "contacts": packed(clip.contacts, "u1"),
        "curves": [
            {
                "name": name,
                "raw": packed(_derivative(clip.time, comparison.raw, order), "f4"),
                "clean": packed(_derivative(clip.time, clip.positions, order), "f4"),
            }
            for name, order in (("speed, m/s", 1), ("jitter, m/s³", 3))
        ],
        "moved": {
            "reliability": _of_joints(clip.reliability)["mean"],
            "filled": (clip.origin == Origin.FILLED).mean(axis=0).tolist(),
            "by": [
                _of_joints(meters * 100.0)
                for meters in (clip.moved_by_correction, clip.moved_by_physics)
            ],
        },
        "metrics": finite(metrics),
        "sensors": [
            {
                "name": sensor.name,
                "color": "#{:02x}{:02x}{:02x}".format(*sensor.color),
                "edges": millimeters(sensor.edges).tolist(),
                "joints": packed(millimeters(sensor.positions), "i2"),
                "residuals": packed(millimeters(sensor.residuals), "i2"),
                "shares": packed(sensor.shares * 100.0, "u1"),
                "share": packed(sensor.shares.mean(axis=1) * 100.0, "f4"),
                "figures": finite(sensor.figures),
            }
            for sensor in comparison.sensors
        ],
    }


def _of_joints(values: Array) -> dict[str, Any]:
    """Return mean and maximum over the frames, None for joints without a value."""
    valid = np.ma.masked_invalid(values)
    return {"mean": valid.mean(axis=0).tolist(), "most": valid.max(axis=0).tolist()}


def packed(values: NDArray[Any], kind: str) -> dict[str, str]:
    """Return numbers as base64, by their little-endian type; round to integer types."""
    if np.issubdtype(np.dtype(kind), np.integer):
        values = np.rint(values)
    data = values.astype(f"<{kind}").tobytes()
    return {kind: base64.b64encode(data).decode("ascii")}


def facing(motion: Clip | Take) -> float:
    """Return the yaw [rad] of a camera that looks at the face, averaged over time."""
    left, right = motion.skeleton.sides("Shoulder")
    across = motion.positions[:, left] - motion.positions[:, right]
    x, _, z = np.nan_to_num(across).sum(axis=0)
    return float(np.arctan2(-z, -x))


def millimeters(meters: Array) -> Array:
    """Return millimeters in the range of int16, -32768 where not finite."""
    near = np.clip(np.nan_to_num(meters) * 1e3, -_FARTHEST, _FARTHEST)
    return np.where(np.isfinite(meters), near, _MISSING)


def _derivative(time: Array, positions: Array, order: int) -> Array:
    """Return the mean magnitude of the derivative of joint positions, shape (T,).

    As in ``metrics.jitter``; NaN where frames are uneven or all joints are missing.
    """
    values = np.full(len(time), np.nan)
    size, nominal = even_differences(time, positions, order)
    valid = ~np.isnan(size).all(axis=1)
    middle = np.flatnonzero(valid) + order // 2  # frame of each difference
    values[middle] = np.nanmean(size[valid], axis=1) / nominal**order
    return values
