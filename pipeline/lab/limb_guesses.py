"""Hides a limb in a take, and fills the gap with simple baselines."""

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

HIDDEN = dict(LIMBS)  # joints that are hidden with each limb
HIDDEN["hand"] = HIDDEN["wrist"] = HIDDEN["right-hand"]
Guess = Literal["none", "drift", "hang", "jitter"]
SIMPLE = ("hold", "slerp", "spline")
_DRIFT = 0.2  # m/s
_DRIFT_TURNS = 2.0  # random walk of the drift's direction in a second. A guess.
_JITTER = 0.05  # m, standard deviation along each axis


def hide(
    take: Take, joints: Sequence[int], span: slice, guess: Guess, seed: int = 0
) -> Take:
    """Return a take in which joints are hidden from the sensor for some frames.

    The ``span`` of frames does not contain the first. ``guess`` is what the sensor
    reports instead: nothing, or inferred wrong positions, drawn from a ``seed``.
    """
    positions, state = take.positions.copy(), take.state.copy()
    positions[span, joints] = np.nan
    last, skeleton = take.positions[span.start - 1], take.skeleton
    steps = np.diff(take.time[span.start - 1 : span.stop])[:, None]
    rng = np.random.default_rng(seed)
    turns = rng.normal(size=(2, len(steps), 3)) * np.sqrt(steps)
    directions = rng.normal(size=(2, 1, 3)) + _DRIFT_TURNS * np.cumsum(turns, axis=1)
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    drift = np.cumsum(_DRIFT * directions * steps, axis=1)
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
    # A joint that was missing before the gap, or whose parent is, gets no guess.
    missing = np.any(np.isnan(positions[span][:, joints]), axis=2)
    state[span, joints] = np.where(missing, State.NOT_TRACKED, State.INFERRED)
    return replace(take, positions=positions, state=state)


def simple_guesses(
    positions: Array, skeleton: Skeleton, joints: Sequence[int], span: slice
) -> dict[str, Array]:
    """Return the motion [m] with each of the ``SIMPLE`` guesses of a limb, (T, J, 3).

    In the heading frame, the directions of the hidden bones are held, interpolated
    from the last visible frame to the next (slerp), or smoothed by second differences
    through the frames around the gap (Whittaker's spline). Joints that are missing in a
    frame stay so. Draw the spline into the raw take, not the cleaned motion, whose
    frames beside the gap are smoothed with those in it. ``positions`` [m] have nothing
    hidden, shape (T, J, 3).
    """
    frame = HeadingFrame(positions[:, skeleton.root], find_yaw(positions, skeleton))
    facing = frame.remove(positions)
    guessed = {name: facing.copy() for name in SIMPLE}
    seen = np.asarray(~np.isnan(facing).any(axis=(0, 2)))
    for j in (j for j in skeleton.order if j in joints and seen[j]):
        parent = skeleton.parents[j]
        bones = facing[:, j] - facing[:, parent]
        lengths = np.linalg.norm(bones, axis=1, keepdims=True)
        guesses = _directions(unit(bones), span)
        for motion, directions in zip(guessed.values(), guesses, strict=True):
            motion[span, j] = motion[span, parent] + unit(directions) * lengths[span]
    return {name: frame.restore(motion) for name, motion in guessed.items()}


def _directions(seen: Array, span: slice) -> tuple[Array, Array, Array]:
    """Return a bone's directions in a gap: held, by slerp and by spline, (N, 3)."""
    first, last, count = seen[span.start - 1], seen[span.stop], span.stop - span.start
    angle = max(float(np.arccos(np.clip(first @ last, -1.0, 1.0))), 1e-6)
    part = np.arange(1, count + 1)[:, None] / (count + 1)
    slerp = np.sin((1 - part) * angle) * first + np.sin(part * angle) * last
    known = np.ones(len(seen), dtype=np.bool_)
    known[span] = False
    spline = bridge(seen, known, REFERENCE_RATE)[span]
    return np.tile(first, (count, 1)), np.asarray(slerp), spline
