"""Log odds of being planted in live motion, by how legs have moved.

A small network learned them from takes beside mocap, which shows when feet rest on the
floor (``pipeline.lab.stance_lessons``). Right feet are treated as mirror images of left
ones.

``legs`` (T, 4, 3) are the positions [m] of both hips and both ankles, left ones first,
with y up, the floor at y = 0, and time stamps [s], (T,).
"""

from functools import cache
from pathlib import Path

import numpy as np

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array, Singles
from kinefilter.characters.motion import values_at
from kinefilter.characters.rotations import unit
from kinefilter.pipeline.networks import Network, read_networks

_BEFORE = np.array([0.0, 1.0 / 30.0, 0.1, 0.2, 0.3, 0.4])  # s: the frames that count
_OUT = np.array([1.0, -1.0])  # left of the left foot, right of the right one


@cache
def stance_network() -> Network:
    """Return the shipped network."""
    file = Path(__file__).parents[1] / "embedded" / "stances.npz"
    return read_networks(file, "weights of stances")["live"]


def legs_of(skeleton: Skeleton) -> list[int]:
    """Return the indices of both hips and both ankles."""
    return [*skeleton.sides("Hip"), *skeleton.sides("Ankle")]


def described(time: Array, legs: Array, now: Array) -> Singles:
    """Return the inputs of the network at some time stamps [s], shape (N, 2, F).

    Of each foot they are the place relative to its hip, ahead, outward and up, and how
    far from its place now it is, along the floor, ahead and up, in all frames, and the
    height now [m]; then those of the other foot.
    """
    frames = values_at(time, legs, now[:, None] - _BEFORE)
    hips, ankles = frames[:, :, :2], frames[:, :, 2:]
    left = hips[:, :, :1] - hips[:, :, 1:]
    outward = unit(left[..., ::2])
    ahead = outward[..., ::-1] * [-1.0, 1.0]
    place, moved = ankles - hips, (ankles - ankles[:, :1])[:, 1:]
    level, along = place[..., ::2], moved[..., ::2]
    vectors = [
        np.vecdot(level, ahead),
        np.vecdot(level, outward) * _OUT,
        place[..., 1],
        np.hypot(along[..., 0], along[..., 1]),
        np.vecdot(along, ahead[:, :1]),
        moved[..., 1],
        ankles[:, :1, :, 1],
    ]
    own = np.concatenate(vectors, axis=1).swapaxes(1, 2)
    return np.concatenate([own, own[:, ::-1]], axis=2).astype(np.float32)


def stance_odds(time: Array, legs: Array) -> Array:
    """Return the log odds of each foot in the last of some frames, shape (2,)."""
    return stance_network()(described(time, legs, time[-1:]))[0, :, 0].astype(float)
