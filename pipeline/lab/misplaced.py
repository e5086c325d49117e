"""How likely a limb's joint is somewhere else than the sensor says.

A sensor that does not see a limb still places it: it lets it hang, freezes it, drifts,
or jumps between two guesses. A logistic regression tells this from what the limb does
and from where the sensor stands. It was learned where a second sensor, in front of the
person, saw the joints that the first one, beside the person, got wrong by more than 12
cm. How likely it is depends on how often the sensor is wrong at all, which is much
rarer from the front: it ranks joints, and no stage takes it for a probability yet.
"""

from __future__ import annotations

import tomllib
from importlib import resources

import numpy as np
from scipy.ndimage import maximum_filter1d, uniform_filter1d
from scipy.special import expit

from kinefilter.characters import Skeleton, Take
from kinefilter.characters.arrays import Array
from kinefilter.characters.motion import nominal_step
from kinefilter.characters.rotations import unit
from kinefilter.retarget import HeadingFrame, find_yaw

PARTS = {"Elbow": "Shoulder", "Wrist": "Shoulder", "Knee": "Hip", "Ankle": "Hip"}
"""The joints that are judged, and where their limbs begin."""
FEATURES = (
    "own length",
    "length before",
    "length beyond",
    "length trembles",
    "speed",
    "acceleration",
    "leap",
    "far side",
    "near side",
    "faces sensor",
    "hangs",
    "straight",
    "behind trunk",
    "behind limb",
    "across",
    "ahead",
    "unlike other",
    "farther than other",
)
_SIDES = ("Left", "Right")
_SHORT, _MIDDLE, _LONG = 1.0 / 3.0, 0.5, 1.0  # s that features look at
_FASTEST, _SHARPEST = 10.0, 300.0  # m/s and m/s^2: more says no more
_TRUNK = 0.25  # m from the trunk's middle line, at which it begins to hide something
_FARTHEST = 0.5  # m: other limbs that are farther off hide nothing


def misplaced(take: Take) -> Array:
    """Return how likely each joint is 12 cm or more off, in [0, 1], shape (T, J).

    0 for joints that are not judged: all but elbows, wrists, knees and ankles.
    """
    found = np.zeros(take.positions.shape[:2])
    path = resources.files("kinefilter.pipeline.lab").joinpath("misplaced.toml")
    weights = tomllib.loads(path.read_text("utf-8"))
    time, first, frames = np.unique(take.time, return_index=True, return_inverse=True)
    distinct = Take(time, take.positions[first], take.state[first], take.skeleton)
    features = describe_limbs(distinct)[frames]
    for part in PARTS:
        bias, *scales = weights[part]
        for side in _SIDES:
            j = take.skeleton.index(part + side)
            found[:, j] = expit(bias + features[:, j] @ np.array(scales))
    return found


def describe_limbs(take: Take) -> Array:
    """Return FEATURES of each joint, 0 for those not judged, shape (T, J, F).

    Args:
        take: The recording, with strictly increasing time stamps.
    """
    skeleton, step = take.skeleton, nominal_step(take.time)
    count, joints = take.positions.shape[:2]
    features = np.zeros((count, joints, len(FEATURES)))
    positions = _filled(take.positions)
    yaw = find_yaw(positions, np.ones((count, joints)), skeleton)
    yaw = np.where(np.isnan(yaw), 0.0, yaw)
    root = positions[:, skeleton.root]
    placed = HeadingFrame(root, yaw).remove(positions)
    turned = yaw - np.arctan2(-root[:, 0], -root[:, 2])  # to the left of the sensor
    elapsed = np.diff(take.time, prepend=take.time[0] - step)[:, None, None]
    velocity = np.diff(placed, axis=0, prepend=placed[:1]) / elapsed
    change = np.diff(velocity, axis=0, prepend=velocity[:1]) / elapsed
    speed = np.minimum(np.linalg.norm(velocity, axis=2), _FASTEST)
    sharp = np.minimum(np.linalg.norm(change, axis=2), _SHARPEST)

    def frames(seconds: float) -> int:
        return max(round(seconds / step), 1)

    bones = positions - positions[:, skeleton.parents]
    lengths = np.maximum(np.linalg.norm(bones, axis=2), 1e-3)
    ratio = np.log(lengths / np.median(lengths, axis=0))
    mean, square = (
        uniform_filter1d(x, frames(_MIDDLE), axis=0) for x in (ratio, ratio**2)
    )
    trembles = np.sqrt(np.maximum(square - mean**2, 0.0))
    average, bends = (
        uniform_filter1d(x, frames(_LONG), axis=0) for x in (speed, sharp)
    )
    leap = maximum_filter1d(speed, frames(_SHORT), axis=0)
    away = np.linalg.norm(positions, axis=2)
    rays = positions / np.maximum(away, 1e-6)[..., None]
    cover = _behind_trunk(positions, rays, skeleton)
    for part, top in PARTS.items():
        for k, side in enumerate(_SIDES):
            j, other = (skeleton.index(part + s) for s in (side, _SIDES[1 - k]))
            begin, opposite = (skeleton.index(top + s) for s in (side, _SIDES[1 - k]))
            before, beyond = skeleton.parents[j], skeleton.children[j][0]
            outwards = np.array([1.0 - 2.0 * k, 1.0, 1.0])
            middle = before if before != begin else j
            far = outwards[0] * np.sin(turned)
            reach = (placed[:, j] - placed[:, begin]) * outwards
            mirrored = (placed[:, other] - placed[:, opposite]) * [-1.0, 1.0, 1.0]
            along = unit(positions[:, middle] - positions[:, begin])
            features[:, j] = np.stack(
                [
                    np.abs(ratio[:, j]),
                    np.abs(ratio[:, before]),
                    np.abs(ratio[:, beyond]),
                    trembles[:, j],
                    average[:, j],
                    bends[:, j] / 30.0,
                    leap[:, j],
                    np.maximum(far, 0.0),
                    np.maximum(-far, 0.0),
                    np.cos(turned),
                    -unit(bones[:, j])[:, 1],
                    np.vecdot(unit(bones[:, j]), along),
                    cover[:, j],
                    _behind_limb(positions, rays, away, j, _SIDES[1 - k], skeleton),
                    np.maximum(-reach[:, 0], 0.0),
                    reach[:, 2],
                    np.linalg.norm(reach - mirrored * outwards, axis=1),
                    away[:, j] - away[:, other],
                ],
                axis=1,
            )
    return features


def _behind_trunk(positions: Array, rays: Array, skeleton: Skeleton) -> Array:
    """Return how near to the trunk's middle line joints are seen, in [0, 1], (T, J)."""
    root = positions[:, None, skeleton.root]
    up = positions[:, None, skeleton.girdle] - root
    share = np.vecdot(positions - root, up) / np.maximum(np.vecdot(up, up), 1e-9)
    middle = root + np.clip(share, 0.0, 1.0)[..., None] * up
    off = np.linalg.norm(middle - rays * np.vecdot(middle, rays)[..., None], axis=2)
    return np.asarray(np.clip(1.0 - off / _TRUNK, 0.0, 1.0))


def _behind_limb(
    positions: Array, rays: Array, away: Array, j: int, side: str, skeleton: Skeleton
) -> Array:
    """Return how far from the nearest joint before it a joint is seen [m], (T,)."""
    names = ("Elbow", "Wrist", "Hand", "Knee", "Ankle")
    others = [skeleton.index(name + side) for name in names]
    there, ray = positions[:, others], rays[:, None, j]
    off = np.linalg.norm(there - ray * np.vecdot(there, ray)[..., None], axis=2)
    off = np.where(away[:, others] < away[:, None, j], off, _FARTHEST)
    return np.asarray(np.minimum(off.min(axis=1), _FARTHEST))


def _filled(positions: Array) -> Array:
    """Return positions whose missing frames are those before, or 0 where never."""
    rows = np.arange(len(positions))[:, None]
    known = ~np.isnan(positions[..., 0])
    last = np.maximum.accumulate(np.where(known, rows, 0), axis=0)
    return np.nan_to_num(np.take_along_axis(positions, last[..., None], axis=0))
