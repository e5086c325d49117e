"""The learned prior of hidden limbs: what people mostly do with them.

Small networks predict how far a limb departs from continuing its motion, from what the
rest of the body does meanwhile and how the limb moved before (and after). They were
trained on takes and mocap in which it was seen (``pipeline.lab.limb_lessons``). Right
limbs are treated as mirror images of left ones, and segments are identified by name, so
the same networks serve all sensors.
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

from . import windows
from .windows import Descriptions, Limb, Stretches

# Hidden segments by the name of their networks.
PARTS = {
    "arm": ("Elbow", "Wrist"),
    "forearm": ("Wrist",),
    "leg": ("Knee", "Ankle"),
    "shin": ("Ankle",),
}
OUTPUT = 0.2  # departure of a direction's component at a network output of 1
_OTHERS = ("Shoulder", "Elbow", "Wrist", "Hip", "Knee", "Ankle")
_LONGEST = 8.0  # longest time among the features: there were no longer gaps in training
_MOVES = 0.3  # change of a direction that corresponds to an input of 1
_MOST = 1.0  # maximum departure of a component, for unusual inputs
_NEAR = 0.2  # s from the ends of a gap within which the departure fades to zero

Network = list[tuple[Array, Array]]


class MotionPrior:
    """Describes hidden limbs as ``windows.describe`` does, plus the learned departure.

    ``networks`` holds, under the names that ``network_name`` gives, the mean of the
    inputs, shape (F,), and the weights and biases of the layers. Without networks every
    limb continues its previous motion.
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
        arrays: dict[str, NDArray[Any]] = {}
        for name, (mean, layers) in self.networks.items():
            arrays[f"{name}_mean"] = mean.astype(np.float32)
            for k, (weights, biases) in enumerate(layers):
                arrays[f"{name}_weights_{k}"] = weights.astype(np.float16)
                arrays[f"{name}_biases_{k}"] = biases.astype(np.float32)
        return arrays

    def change(self, name: str, inputs: Array) -> Array:
        """Return the departure of directions from continued motion, shape (..., 3 H).

        ``name`` is that of the network; ``inputs`` (..., F) come from ``inputs_of``.
        """
        mean, layers = self.networks[name]
        values = np.where(np.isnan(inputs), 0.0, inputs - mean)
        for k, (weights, biases) in enumerate(layers):
            values = values @ weights + biases
            if k < len(layers) - 1:
                values = np.maximum(values, 0.0)
        return np.clip(OUTPUT * values, -_MOST, _MOST)

    def describe(self, hidden: Stretches) -> Descriptions:
        """Describe stretches as ``windows.describe`` does, with the learned base."""
        found = windows.describe(hidden)
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
    """Return the prior that ships with kinefilter."""
    return MotionPrior.load(Path(__file__).parents[1] / "embedded" / "hidden_limbs.npz")


def network_name(part: str, *, ahead: bool) -> str:
    """Return a part's network name; ``ahead`` if frames after the gap are known."""
    return f"{part}_{'between' if ahead else 'before'}"


def part_of(skeleton: Skeleton, limb: Limb) -> tuple[str, bool]:
    """Return the hidden part out of PARTS, "" for none, and True for a right limb."""
    names = [skeleton.joints[j] for j in limb.hidden]
    for mirrored, side in enumerate(SIDES):
        for part, joints in PARTS.items():
            if names == [joint + side for joint in joints]:
                return part, bool(mirrored)
    return "", False


def inputs_of(hidden: Stretches, found: Descriptions) -> Array:
    """Return the inputs of the networks, shape (W, M, F), as for a left limb.

    ``found`` is what ``windows.describe`` returns for the stretches. Segments that are
    hidden as well enter as if they did not move.
    """
    skeleton, limb = hidden.seen.skeleton, hidden.limb
    _, mirrored = part_of(skeleton, limb)
    trunk = (skeleton.parents[skeleton.girdle], skeleton.girdle)
    sides = SIDES[::-1] if mirrored else SIDES
    others = (skeleton.index(name + side) for side in sides for name in _OTHERS)
    body = tuple(j for j in (*trunk, *others) if j not in limb.hidden)
    change, speed, place = windows.visible_motion(hidden, body)
    gone = np.repeat([j not in limb.visible for j in body], 3)
    place[..., gone] -= change[..., gone]
    change[..., gone] = speed[..., gone] = 0.0
    # The features without those of the visible segments, which ``body`` replaces.
    count, times = 3 * len(limb.visible), 1 + hidden.ahead
    root = found.features[..., count : count + 3]
    own = found.features[..., 3 * count + 3 : -times]
    moved = (found.base - found.still).reshape(*own.shape[:2], -1) / _MOVES
    change, speed = change / windows.SEEN_CHANGE, speed / windows.SEEN_SPEED
    parts = [change, root, speed, place / windows.SEEN, own, moved]
    vectors, elapsed = np.concatenate(parts, axis=-1), found.features[..., -times:]
    if mirrored:
        vectors[..., ::3] *= -1.0
    return np.concatenate([vectors, np.minimum(elapsed, _LONGEST)], axis=-1)
