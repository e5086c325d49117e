"""A limb hidden in a take, and the simplest guesses where it went meanwhile."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from kinefilter.characters import Skeleton, State, Take
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import unit
from kinefilter.pipeline.edits import LIMBS
from kinefilter.pipeline.reconstruct.continuity import REFERENCE_RATE, bridge
from kinefilter.retarget import HeadingFrame, find_yaw

HIDDEN = dict(LIMBS)
"""Joints that are hidden with a limb, by its name."""
HIDDEN["hand"] = HIDDEN["wrist"] = HIDDEN["right-hand"]

Guess = Literal["none", "drift", "hang", "jitter"]
SIMPLE = ("hold", "slerp", "spline")

_DRIFT = 0.2  # m/s
_DRIFT_TURNS = 2.0  # by which the direction of the drift wanders in a second: a guess
_JITTER = 0.05  # m, standard deviation along each axis


def hide(
    take: Take, joints: Sequence[int], span: slice, guess: Guess, seed: int = 0
) -> Take:
    """Return a take in which the sensor does not see some joints for some frames.

    Args:
        take: The recording.
        joints: The hidden joints.
        span: The frames in which they are hidden; the limb is seen before.
        guess: What the sensor says of them: nothing, or a wrong place, as inferred.
        seed: Of the wrong places.
    """
    positions, state = take.positions.copy(), take.state.copy()
    positions[span, joints] = np.nan
    last, skeleton = take.positions[span.start - 1], take.skeleton
    steps = np.diff(take.time[span.start - 1 : span.stop])[:, None]
    rng = np.random.default_rng(seed)
    turns = rng.normal(size=(2, len(steps), 3)) * np.sqrt(steps)
    ways = rng.normal(size=(2, 1, 3)) + _DRIFT_TURNS * np.cumsum(turns, axis=1)
    ways /= np.linalg.norm(ways, axis=2, keepdims=True)
    drift = np.cumsum(_DRIFT * ways * steps, axis=1)
    for j in (j for j in skeleton.order if j in joints and guess != "none"):
        base = skeleton.parents[j]
        if guess == "hang":
            length = np.linalg.norm(last[j] - last[base])
            positions[span, j] = positions[span, base] - [0.0, length, 0.0]
            continue
        while base in joints:
            base = skeleton.parents[base]
        positions[span, j] = positions[span, base] + last[j] - last[base]
        if guess == "jitter":
            positions[span, j] += rng.normal(scale=_JITTER, size=(len(steps), 3))
        else:
            positions[span, j] += drift[int(skeleton.joints[j].endswith("Left"))]
    # Where the sensor had no such joint before, it guesses none.
    missing = np.any(np.isnan(positions[span][:, joints]), axis=2)
    positions[span, joints] = np.where(
        missing[..., None], np.nan, positions[span][:, joints]
    )
    state[span, joints] = np.where(missing, State.NOT_TRACKED, State.INFERRED)
    return replace(take, positions=positions, state=state)


def simple_guesses(
    positions: Array, skeleton: Skeleton, joints: Sequence[int], span: slice
) -> dict[str, Array]:
    """Return a motion [m] with a limb as each of ``SIMPLE`` guesses it, (T, J, 3).

    Directions of the hidden bones in the heading frame are held; are turned evenly from
    the last seen to the next (slerp); or are smoothed by second differences through the
    frames around the gap (Whittaker's spline). All else is as it is, also joints that
    are missing in a frame. A smoothed motion is no place to draw a spline into: the
    frames beside the gap have looked into it.

    Args:
        positions: The motion with nothing hidden, shape (T, J, 3).
        skeleton: Its joints.
        joints: The hidden joints.
        span: The frames in which they are hidden; the limb is seen before and after.
    """
    yaw = find_yaw(positions, np.ones(positions.shape[:-1]), skeleton)
    frame = HeadingFrame(positions[:, skeleton.root], yaw)
    facing = frame.remove(positions)
    guessed = {name: facing.copy() for name in SIMPLE}
    seen = np.asarray(~np.isnan(facing).any(axis=(0, 2)))
    for j in (j for j in skeleton.order if j in joints and seen[j]):
        parent = skeleton.parents[j]
        bones = facing[:, j] - facing[:, parent]
        lengths = np.linalg.norm(bones, axis=1, keepdims=True)
        found = _directions(unit(bones), span)
        for limb, ways in zip(guessed.values(), found, strict=True):
            limb[span, j] = limb[span, parent] + unit(ways) * lengths[span]
    return {name: frame.restore(limb) for name, limb in guessed.items()}


def _directions(seen: Array, span: slice) -> tuple[Array, Array, Array]:
    """Return a bone's directions in a gap held, by slerp and by spline, (N, 3)."""
    first, last, count = seen[span.start - 1], seen[span.stop], span.stop - span.start
    angle = max(float(np.arccos(np.clip(first @ last, -1.0, 1.0))), 1e-6)
    part = np.arange(1, count + 1)[:, None] / (count + 1)
    slerp = np.sin((1 - part) * angle) * first + np.sin(part * angle) * last
    known = np.ones(len(seen), dtype=np.bool_)
    known[span] = False
    spline = bridge(seen, known, REFERENCE_RATE)[span]
    return np.tile(first, (count, 1)), np.asarray(slerp), spline
