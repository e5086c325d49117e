"""Scores how likely a limb's joint is far from where the sensor places it.

A logistic regression recognizes limbs that the sensor guesses from their motion and the
sensor's view. It was trained on people in front of two sensors, of which the frontal
one showed which joints of the side-on one were off by more than 12 cm. The scores rank
joints and are not calibrated. No stage of cleaning uses them.
"""

import tomllib
from importlib import resources

import numpy as np
from scipy.ndimage import maximum_filter1d, uniform_filter1d
from scipy.special import expit

from kinefilter.characters import Skeleton, Take
from kinefilter.characters.arrays import Array
from kinefilter.characters.motion import nominal_step
from kinefilter.characters.rotations import unit
from kinefilter.characters.skeleton import SIDES
from kinefilter.retarget import HeadingFrame, find_yaw

PARTS = {"Elbow": "Shoulder", "Wrist": "Shoulder", "Knee": "Hip", "Ankle": "Hip"}
"""The scored joints, and the first joints of their limbs."""
FEATURES = (
    *("own length", "length before", "length beyond", "length trembles", "speed"),
    *("acceleration", "leap", "far side", "near side", "faces sensor", "hangs"),
    *("straight", "behind trunk", "behind limb", "across", "ahead", "unlike other"),
    "farther than other",
)
_SHORT, _MIDDLE, _LONG = 1.0 / 3.0, 0.5, 1.0  # s, windows of the features
_FASTEST, _SHARPEST = 10.0, 300.0  # m/s and m/s^2 at which features are clipped
_TRUNK = 0.25  # m from the trunk's middle line within which it may hide a joint
_FARTHEST = 0.5  # m beyond which the opposite limb hides nothing


def misplaced(take: Take) -> Array:
    """Return a score in [0, 1] of each joint of PARTS being 12 cm off, shape (T, J)."""
    scores = np.zeros(take.positions.shape[:2])
    path = resources.files("kinefilter.pipeline.lab").joinpath("misplaced.toml")
    weights = tomllib.loads(path.read_text("utf-8"))
    features = describe_limbs(take)
    for part in PARTS:
        bias, *scales = weights[part]
        for j in take.skeleton.sides(part):
            scores[:, j] = expit(bias + features[:, j] @ np.array(scales))
    return scores


def describe_limbs(take: Take) -> Array:
    """Return the FEATURES of each joint, 0 for joints not scored, shape (T, J, F)."""
    time, first, rows = np.unique(take.time, return_index=True, return_inverse=True)
    skeleton, step = take.skeleton, nominal_step(time)
    positions = _filled(take.positions[first])
    features = np.zeros((*positions.shape[:2], len(FEATURES)))
    yaw = find_yaw(positions, np.ones(positions.shape[:2]), skeleton)
    yaw = np.where(np.isnan(yaw), 0.0, yaw)
    root = positions[:, skeleton.root]
    placed = HeadingFrame(root, yaw).remove(positions)
    turned = yaw - np.arctan2(-root[:, 0], -root[:, 2])  # 0 facing the sensor
    elapsed = np.diff(time, prepend=time[0] - step)[:, None, None]
    velocity = np.diff(placed, axis=0, prepend=placed[:1]) / elapsed
    change = np.diff(velocity, axis=0, prepend=velocity[:1]) / elapsed
    speed = np.minimum(np.linalg.norm(velocity, axis=2), _FASTEST)
    acceleration = np.minimum(np.linalg.norm(change, axis=2), _SHARPEST)

    def frames(seconds: float) -> int:
        return max(round(seconds / step), 1)

    def averaged(values: Array, seconds: float) -> Array:
        return np.asarray(uniform_filter1d(values, frames(seconds), axis=0))

    bones = positions - positions[:, skeleton.parents]
    lengths = np.maximum(np.linalg.norm(bones, axis=2), 1e-3)
    ratio = np.log(lengths / np.median(lengths, axis=0))
    variance = averaged(ratio**2, _MIDDLE) - averaged(ratio, _MIDDLE) ** 2
    length_jitter = np.sqrt(np.maximum(variance, 0.0))
    mean_speed = averaged(speed, _LONG)
    mean_acceleration = averaged(acceleration, _LONG)
    leap = maximum_filter1d(speed, frames(_SHORT), axis=0)
    away = np.linalg.norm(positions, axis=2)
    rays = positions / np.maximum(away, 1e-6)[..., None]
    cover = _behind_trunk(positions, rays, skeleton)
    for part, top in PARTS.items():
        for side, sign in zip(SIDES, (1.0, -1.0), strict=True):
            j, begin = skeleton.index(part + side), skeleton.index(top + side)
            other, opposite = skeleton.mirror[[j, begin]]
            before, beyond = skeleton.parents[j], skeleton.children[j][0]
            outwards = np.array([sign, 1.0, 1.0])
            middle = before if before != begin else j
            far = sign * np.sin(turned)
            reach = (placed[:, j] - placed[:, begin]) * outwards
            mirrored = (placed[:, other] - placed[:, opposite]) * [-1.0, 1.0, 1.0]
            along = unit(positions[:, middle] - positions[:, begin])
            columns = [
                np.abs(ratio[:, j]),
                np.abs(ratio[:, before]),
                np.abs(ratio[:, beyond]),
                length_jitter[:, j],
                mean_speed[:, j],
                mean_acceleration[:, j] / 30.0,
                leap[:, j],
                np.maximum(far, 0.0),
                np.maximum(-far, 0.0),
                np.cos(turned),
                -unit(bones[:, j])[:, 1],
                np.vecdot(unit(bones[:, j]), along),
                cover[:, j],
                _behind_limb(positions, rays, away, j, skeleton),
                np.maximum(-reach[:, 0], 0.0),
                reach[:, 2],
                np.linalg.norm(reach - mirrored * outwards, axis=1),
                away[:, j] - away[:, other],
            ]
            features[:, j] = np.stack(columns, axis=1)
    return features[rows]


def _behind_trunk(positions: Array, rays: Array, skeleton: Skeleton) -> Array:
    """Return how close to the trunk's middle line joints appear, in [0, 1], (T, J)."""
    root = positions[:, None, skeleton.root]
    up = positions[:, None, skeleton.girdle] - root
    share = np.vecdot(positions - root, up) / np.maximum(np.vecdot(up, up), 1e-9)
    middle = root + np.clip(share, 0.0, 1.0)[..., None] * up
    return np.asarray(np.clip(1.0 - _distances(middle, rays) / _TRUNK, 0.0, 1.0))


def _behind_limb(
    positions: Array, rays: Array, away: Array, j: int, skeleton: Skeleton
) -> Array:
    """Return how close a joint appears to nearer joints of the other side [m], (T,)."""
    side = "Right" if skeleton.joints[j].endswith("Left") else "Left"
    names = ("Elbow", "Wrist", "Hand", "Knee", "Ankle")
    others = [skeleton.index(name + side) for name in names]
    off = _distances(positions[:, others], rays[:, None, j])
    off = np.where(away[:, others] < away[:, None, j], off, _FARTHEST)
    return np.asarray(np.minimum(off.min(axis=1), _FARTHEST))


def _distances(points: Array, rays: Array) -> Array:
    along = rays * np.vecdot(points, rays)[..., None]
    return np.asarray(np.linalg.norm(points - along, axis=2))


def _filled(positions: Array) -> Array:
    """Fill missing positions with the last known ones, or with 0 before those."""
    rows = np.arange(len(positions))[:, None]
    known = ~np.isnan(positions[..., 0])
    last = np.maximum.accumulate(np.where(known, rows, 0), axis=0)
    return np.nan_to_num(np.take_along_axis(positions, last[..., None], axis=0))
