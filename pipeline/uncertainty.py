"""How far each joint of a clip may be from where it was.

It depends on how fast the joint moves, how reliable it is and how well its posture is
known; where it was hidden, on how far the frame is from one that shows it, and how fast
it went before and after. The weights were learned from people in front of a sensor,
beside marker mocap, whom the corrector had not learned from
(``pipeline.lab.uncertainty_lessons``).
"""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array, Flags, runs

from .draft import Draft

PARTS = ("Shoulder", "Elbow", "Wrist", "Hip", "Knee", "Ankle")
"""The joints that are judged, left and right; others are as the nearest of these."""
SEEN = ("speed", "unreliable", "unknown posture")
HIDDEN = ("until seen", "speed at ends", "unknown posture")
"""What the uncertainty of joints that the sensor saw, and of hidden ones, depends on:
times and speeds as logarithms."""

_LEAST, _MOST = 0.005, 0.5  # m
_STRANGEST = 0.2  # beyond, errors grow no more
_ENDS = 3  # frames beside a gap that its speed is a mean over


def uncertainty(draft: Draft) -> Array:
    """Return how far joints may be off [m], NaN where never seen, shape (T, J).

    Standard deviation of each coordinate of a joint's error relative to the middle of
    the hips: some 70 % of coordinates are nearer to the truth than this, and 93 % than
    twice as much.
    """
    path = Path(__file__).with_name("embedded") / "uncertainty.toml"
    weights = tomllib.loads(path.read_text("utf-8"))
    found = np.exp(log_uncertainty(weights, *describe(draft)))
    found = np.clip(found, _LEAST, _MOST)
    columns = _judged_by(draft.skeleton)
    return np.stack([found[:, of].mean(axis=1) for of in columns], axis=1)


def log_uncertainty(
    weights: dict[str, dict[str, list[float]]], seen: Array, gone: Array, hidden: Flags
) -> Array:
    """Return the logarithm of the uncertainty [m] of judged joints, shape (T, 2 P).

    ``weights`` are bias and weights of each of PARTS, where it is ``seen`` and
    ``hidden``; the others are as ``describe`` returns them.
    """
    found = np.empty(hidden.shape)
    for k, part in enumerate(PARTS):
        both = slice(2 * k, 2 * k + 2)
        bias, *scales = weights["seen"][part]
        shown = bias + seen[:, both] @ np.array(scales)
        bias, *scales = weights["hidden"][part]
        guessed = bias + gone[:, both] @ np.array(scales)
        found[:, both] = np.where(hidden[:, both], guessed, shown)
    return found


def describe(draft: Draft) -> tuple[Array, Array, Flags]:
    """Return SEEN and HIDDEN of the judged joints, and which of these are hidden.

    Shapes (T, 2 P, 3) twice and (T, 2 P); joints in the order of PARTS, left before
    right. Of a joint that is never seen HIDDEN is NaN.
    """
    skeleton, time = draft.skeleton, draft.time
    joints = judged(skeleton)
    hips = draft.positions[:, skeleton.hips].mean(axis=1, keepdims=True)
    path = draft.positions[:, joints] - hips
    speed = np.linalg.norm(np.gradient(path, time, axis=0), axis=2)
    hidden = draft.missing if draft.hidden is None else draft.missing | draft.hidden
    hidden = hidden[:, joints]
    known = np.nan_to_num(np.asarray(draft.coverage, dtype=float))[:, None]
    strange = np.broadcast_to(np.minimum(1.0 - known, _STRANGEST), speed.shape)
    seen = [np.log(speed + 0.05), 1.0 - draft.geometry[:, joints], strange]
    gone = np.full((*speed.shape, len(HIDDEN)), np.nan)
    gone[..., -1] = strange
    for k in np.flatnonzero(hidden.any(axis=0) & ~hidden.all(axis=0)):
        for gap in runs(hidden[:, k]):
            gone[gap, k, :-1] = _gap(speed[:, k], gap, time)
    return np.stack(seen, axis=2), gone, hidden


def _gap(speed: Array, gap: slice, time: Array) -> Array:
    """Return all but the last of HIDDEN in the frames of a gap, shape (N, 2)."""
    before = time[gap] - time[gap.start - 1] if gap.start else np.inf
    after = time[gap.stop] - time[gap] if gap.stop < len(speed) else np.inf
    ends = speed[max(gap.start - _ENDS, 0) : gap.start]
    ends = np.append(ends, speed[gap.stop : gap.stop + _ENDS])
    nearest, fast = np.minimum(before, after), np.full(len(time[gap]), ends.mean())
    return np.stack([np.log(nearest + 0.05), np.log(fast + 0.05)], axis=1)


def judged(skeleton: Skeleton) -> list[int]:
    """Return the indices of the judged joints, in the order of PARTS."""
    return [j for part in PARTS for j in skeleton.sides(part)]


def _judged_by(skeleton: Skeleton) -> list[list[int]]:
    """Return, for each joint, which of the judged joints it is as uncertain as."""
    joints = judged(skeleton)
    shoulders, hips = (
        [joints.index(j) for j in skeleton.sides(part)] for part in ("Shoulder", "Hip")
    )
    upper = {skeleton.girdle, *skeleton.beyond(skeleton.girdle)}
    columns = []
    for j in range(len(skeleton)):
        # The outer of the joints that it hangs on comes last.
        on = [k for k, top in enumerate(joints) if j in (top, *skeleton.beyond(top))]
        columns.append(on[-1:] or (shoulders if j in upper else hips))
    return columns
