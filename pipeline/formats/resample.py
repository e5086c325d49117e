"""Clips at another frame rate, and in another rest pose."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from kinefilter.characters import Clip, standard_body
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import between, multiply, slerp

_CHUNK = 4096  # frames at a time, to bound the memory
_END = 1e-6  # of a frame: the last one is not lost to rounding
_ON_A_LINE = (
    *("root", "reliability", "moved_by_correction", "moved_by_physics"),
    "external_force",
)
_NEAREST = ("state", "deciding_term", "origin", "contacts")


def resampled(clip: Clip, fps: float) -> Clip:
    """Return a clip with ``fps`` frames a second, from its first to its last.

    Positions and numbers between frames are interpolated on a line, rotations on the
    shortest arc; what has no middle, such as contacts, is the nearest frame's. Of
    frames with the same time, the last counts.
    """
    known = np.flatnonzero(np.append(np.diff(clip.time) > 0.0, True))
    stamps = clip.time[known]
    count = int((stamps[-1] - stamps[0]) * fps + _END) + 1
    time = stamps[0] + np.arange(count) / fps
    last = np.clip(np.searchsorted(stamps, time, "right"), 1, max(len(known) - 1, 1))
    last = np.minimum(last, len(known) - 1)
    first = np.maximum(last - 1, 0)
    step = np.maximum(stamps[last] - stamps[first], 1e-12)
    share = np.clip((time - stamps[first]) / step, 0.0, 1.0)
    before, after = known[first], known[last]

    def line(values: Array) -> Array:
        part = share.reshape(-1, *[1] * (values.ndim - 1))
        start = values[before]
        moved = start + part * (values[after] - start)
        # A frame that is there already is kept as it is, also beside a missing one.
        return np.asarray(np.where(part == 0.0, start, moved))

    def arc(rotations: Array) -> Array:
        part = share.reshape(-1, *[1] * (rotations.ndim - 2))
        found = np.empty((count, *rotations.shape[1:]))
        for start in range(0, count, _CHUNK):
            some = slice(start, start + _CHUNK)
            found[some] = slerp(
                rotations[before[some]], rotations[after[some]], part[some]
            )
        return found

    nearest = np.where(share < 0.5, before, after)
    found: dict[str, Any] = {
        **{name: line(getattr(clip, name)) for name in _ON_A_LINE},
        **{name: getattr(clip, name)[nearest] for name in _NEAREST},
    }
    props = [
        replace(prop, positions=line(prop.positions), rotations=arc(prop.rotations))
        if prop.moves
        else prop
        for prop in clip.props
    ]
    return replace(
        clip, time=time, rotations=arc(clip.rotations), props=tuple(props), **found
    )


def in_strict_t(clip: Clip) -> Clip:
    """Return the same motion with a rest posture in which every bone is square."""
    body = clip.body
    square = standard_body(body.skeleton).directions
    turns = between(square, body.directions)
    return replace(
        clip,
        rotations=multiply(clip.rotations, turns),
        body=replace(body, directions=square),
    )
