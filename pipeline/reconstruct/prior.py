"""What people mostly do with a limb while it is hidden, as learned from recordings.

Small networks tell how far a limb departs from where it would go on, from what the rest
of the body does meanwhile and how the limb went before (and after). They were learned
from takes and mocap in which it was seen (``pipeline.lab.limb_lessons``). Right limbs
are told as mirror images of left ones, and segments by their names, so that the same
networks serve all sensors.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import unit
from kinefilter.characters.skeleton import SIDES
from kinefilter.pipeline.formats.npz import read_arrays

from .windows import (
    SEEN,
    SEEN_CHANGE,
    SEEN_SPEED,
    Limb,
    Stretches,
    Windows,
    describe,
    visible_motion,
)

PARTS = {
    "arm": ("Elbow", "Wrist"),
    "forearm": ("Wrist",),
    "leg": ("Knee", "Ankle"),
    "shin": ("Ankle",),
}
"""What is hidden, by the name of its networks."""
OUTPUT = 0.2
"""Departure of a direction's component that networks give as 1."""
_OTHERS = ("Shoulder", "Elbow", "Wrist", "Hip", "Knee", "Ankle")
_LONGEST = 8.0  # longest time among the features: what was learned lasts no longer
_MOVES = 0.3  # how much of a direction is worth 1 among the inputs
_MOST = 1.0  # departure of a component that is believed, however odd the inputs
_NEAR = 0.2  # s from the gap's ends in which the limb is about where it goes on

Network = list[tuple[Array, Array]]


class MotionPrior:
    """Describes hidden limbs as ``describe`` does, going on as people mostly do.

    Args:
        networks: Of each part of PARTS, after ``before`` or ``between`` (frames before
            the gap known, or after as well): the inputs' mean, shape (F,), and weights
            and biases of the layers. Without networks all limbs go on as they went.
    """

    def __init__(self, networks: Mapping[str, tuple[Array, Network]]) -> None:
        self.networks = networks

    @classmethod
    def load(cls, path: Path) -> MotionPrior:
        """Read the networks from a file of ``arrays``."""
        arrays = read_arrays(path, "weights of hidden limbs")
        networks = {}
        for name in (key.removesuffix("_mean") for key in arrays if "_mean" in key):
            layers: Network = []
            while (at := f"{name}_weights_{len(layers)}") in arrays:
                bias = arrays[at.replace("weights", "biases")]
                layers.append((arrays[at].astype(float), bias.astype(float)))
            networks[name] = (arrays[f"{name}_mean"].astype(float), layers)
        return cls(networks)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the networks as named arrays, for a file."""
        found: dict[str, NDArray[Any]] = {}
        for name, (mean, layers) in self.networks.items():
            found[f"{name}_mean"] = mean.astype(np.float32)
            for k, (weights, biases) in enumerate(layers):
                found[f"{name}_weights_{k}"] = weights.astype(np.float16)
                found[f"{name}_biases_{k}"] = biases.astype(np.float32)
        return found

    def change(self, name: str, inputs: Array) -> Array:
        """Return how directions depart from where they go on, shape (..., 3 H).

        Args:
            name: The network.
            inputs: What ``inputs_of`` gives, shape (..., F).
        """
        mean, layers = self.networks[name]
        values = np.where(np.isnan(inputs), 0.0, inputs - mean)
        for k, (weights, biases) in enumerate(layers):
            values = values @ weights + biases
            if k < len(layers) - 1:
                values = np.maximum(values, 0.0)
        return np.clip(OUTPUT * values, -_MOST, _MOST)

    def describe(self, hidden: Stretches) -> Windows:
        """Describe stretches as ``windows.describe`` does, with the learned base."""
        found = describe(hidden)
        part, mirrored = part_of(hidden.seen.skeleton, hidden.limb)
        name = network_name(part, ahead=hidden.ahead)
        if name not in self.networks:
            return found
        inputs = inputs_of(hidden, found)
        change = self.change(name, inputs).reshape(found.base.shape)
        near = hidden.time[: 1 + hidden.ahead].min(axis=0)
        change *= np.minimum(near / _NEAR, 1.0)[..., None, None]
        if mirrored:
            change[..., 0] *= -1.0
        return replace(found, base=unit(found.base + change))


@cache
def default_prior() -> MotionPrior:
    """Return the prior that ships."""
    return MotionPrior.load(Path(__file__).parents[1] / "embedded" / "hidden_limbs.npz")


def network_name(part: str, *, ahead: bool) -> str:
    """Return the name of the networks for a part of PARTS."""
    return f"{part}_{'between' if ahead else 'before'}"


def part_of(skeleton: Skeleton, limb: Limb) -> tuple[str, bool]:
    """Return what of PARTS is hidden, "" if none, and whether it is a right limb."""
    names = [skeleton.joints[j] for j in limb.hidden]
    for mirrored, side in enumerate(SIDES):
        for part, joints in PARTS.items():
            if names == [joint + side for joint in joints]:
                return part, bool(mirrored)
    return "", False


def inputs_of(hidden: Stretches, found: Windows) -> Array:
    """Return what the networks are told, shape (W, M, F), as of a left limb.

    ``found`` is what ``describe`` returns for the stretches. Segments that are not
    visible either are told as if they did not move.
    """
    skeleton, limb = hidden.seen.skeleton, hidden.limb
    _, mirrored = part_of(skeleton, limb)
    trunk = (skeleton.parents[skeleton.girdle], skeleton.girdle)
    sides = SIDES[::-1] if mirrored else SIDES
    others = (skeleton.index(name + side) for side in sides for name in _OTHERS)
    body = tuple(j for j in (*trunk, *others) if j not in limb.hidden)
    change, speed, place = visible_motion(hidden, body)
    gone = np.repeat([j not in limb.visible for j in body], 3)
    place[..., gone] -= change[..., gone]
    change[..., gone] = speed[..., gone] = 0.0
    # Of what ``describe`` tells, only what the visible segments do is told otherwise.
    count, times = 3 * len(limb.visible), 1 + hidden.ahead
    root = found.features[..., count : count + 3]
    own = found.features[..., 3 * count + 3 : -times]
    moved = (found.base - found.still).reshape(*own.shape[:2], -1) / _MOVES
    parts = [change / SEEN_CHANGE, root, speed / SEEN_SPEED, place / SEEN, own, moved]
    vectors, elapsed = np.concatenate(parts, axis=-1), found.features[..., -times:]
    if mirrored:
        vectors[..., ::3] *= -1.0
    return np.concatenate([vectors, np.minimum(elapsed, _LONGEST)], axis=-1)
