"""The uncertainty of each joint of a clip: its expected error.

It depends on the joint's speed and reliability and on the coverage of its posture; for
a hidden joint, on the time to the nearest frame that shows it, and on its speed before
and after. The weights were trained on recordings of people with marker mocap beside
them, none of whom the corrector was trained on (``pipeline.lab.uncertainty_lessons``).
"""

import tomllib
from pathlib import Path

import numpy as np

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array, Flags, runs
from kinefilter.characters.skeleton import LIMB_PARTS

from .draft import Draft

SEEN = ("speed", "unreliable", "unknown posture")
HIDDEN = ("until seen", "speed at ends", "unknown posture")
"""Features of the joints the sensor saw, and of hidden ones; times and speeds are
logarithmic."""
_LEAST, _MOST = 0.005, 0.5  # m
_STRANGEST = 0.2  # 1 - coverage beyond which errors grow no more
_ENDS = 3  # frames on either side of a gap over which its speed is averaged


def uncertainty(draft: Draft) -> Array:
    """Return the uncertainty of joints [m], NaN if never seen, shape (T, J).

    This is the standard deviation of each coordinate of a joint's error relative to the
    middle of the hips: some 70 % of errors are smaller, and 93 % smaller than twice it.
    """
    path = Path(__file__).with_name("embedded") / "uncertainty.toml"
    weights = tomllib.loads(path.read_text("utf-8"))
    sigma = np.exp(log_uncertainty(weights, *describe(draft))).clip(_LEAST, _MOST)
    columns = _nearest_judged(draft.skeleton)
    return np.stack([sigma[:, of].mean(axis=1) for of in columns], axis=1)


def log_uncertainty(
    weights: dict[str, dict[str, list[float]]], seen: Array, gone: Array, hidden: Flags
) -> Array:
    """Return the logarithm of the uncertainty [m] of the judged joints, (T, 2 P).

    ``weights`` are by seen or hidden, then by part; ``describe`` returns the rest.
    """
    found = np.empty(hidden.shape)
    for k, part in enumerate(LIMB_PARTS):
        sides = slice(2 * k, 2 * k + 2)
        logs = []
        for kind, features in (("seen", seen), ("hidden", gone)):
            bias, *scales = weights[kind][part]
            logs.append(bias + features[:, sides] @ np.array(scales))
        found[:, sides] = np.where(hidden[:, sides], logs[1], logs[0])
    return found


def describe(draft: Draft) -> tuple[Array, Array, Flags]:
    """Return features SEEN and HIDDEN of the judged joints, and which are hidden.

    Shapes (T, 2 P, 3) twice and (T, 2 P), joints in the order of LIMB_PARTS, left
    before right. HIDDEN is NaN for a joint that is never seen.
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
    """Return the first two features HIDDEN in the frames of a gap, shape (N, 2)."""
    before = time[gap] - time[gap.start - 1] if gap.start else np.inf
    after = time[gap.stop] - time[gap] if gap.stop < len(speed) else np.inf
    ends = speed[max(gap.start - _ENDS, 0) : gap.start]
    ends = np.append(ends, speed[gap.stop : gap.stop + _ENDS])
    nearest, fast = np.minimum(before, after), np.full(len(time[gap]), ends.mean())
    return np.stack([np.log(nearest + 0.05), np.log(fast + 0.05)], axis=1)


def judged(skeleton: Skeleton) -> list[int]:
    """Return the indices of the judged joints, in the order of LIMB_PARTS."""
    return [j for part in LIMB_PARTS for j in skeleton.sides(part)]


def _nearest_judged(skeleton: Skeleton) -> list[list[int]]:
    """Return, for each joint, the judged joints whose uncertainty it gets."""
    joints = judged(skeleton)
    sides = map(skeleton.sides, ("Shoulder", "Hip"))
    shoulders, hips = ([joints.index(j) for j in pair] for pair in sides)
    upper = {skeleton.girdle, *skeleton.descendants(skeleton.girdle)}
    hanging = [(j, *skeleton.descendants(j)) for j in joints]
    columns = []
    for j in range(len(skeleton)):
        # Of the judged joints it hangs from, the outermost comes last.
        above = [k for k, part in enumerate(hanging) if j in part]
        columns.append(above[-1:] or (shoulders if j in upper else hips))
    return columns
