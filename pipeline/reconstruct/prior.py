"""The learned prior of hidden limbs: what people mostly do with them.

Small networks predict how far a limb departs from continuing its motion, from what the
rest of the body does meanwhile and how the limb moved before (and after). They were
trained on takes and mocap in which it was seen (``pipeline.lab.limb_lessons``). For
limbs that were never seen, others predict it from the posture of the rest of the body
alone, which also tells more and more of one that is hidden for long. Networks of the
gait, of a single layer, tell which foot of a walker swings (``unseen_steps``). Right
limbs are treated as mirror images of left ones, and segments are identified by name, so
the same networks serve all sensors.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import unit
from kinefilter.characters.skeleton import LIMB_PARTS, SIDES
from kinefilter.pipeline.networks import Network, network_arrays, read_networks

from . import windows
from .windows import Descriptions, Stretches

# Hidden segments by the name of their networks.
PARTS = {
    "arm": ("Elbow", "Wrist"),
    "forearm": ("Wrist",),
    "leg": ("Knee", "Ankle"),
    "shin": ("Ankle",),
}
OUTPUT = 0.2  # departure of a direction's component at a network output of 1
HANGING = np.array([0.0, -1.0, 0.0])  # direction from which an unseen limb departs
_LONGEST = 8.0  # longest time among the features: there were no longer gaps in training
_MOVES = 0.3  # change of a direction that corresponds to an input of 1
_MOST = 1.0  # maximum departure of a component, for unusual inputs
_MOST_UNSEEN = 2.0  # the same for an unseen limb, which may point up
_BONE, _LOWER = 0.3, 0.2  # m of a segment, and of the hips' height, for an input of 1
# s from the one end, or the nearer of two ends, of a gap after which the posture of the
# rest of the body tells more than where the limb went; and m that a person moves until
# that holds for their legs. Chosen on s02, s03, s04 and a quarter of the other people.
_FORGOTTEN, _STAYS = (3.0, 6.0), 0.15
# Factors of what networks say of limbs of people who have walked on since. In training
# their outputs were made smaller for movements that they do not know; walking is one
# that they do. Chosen on CMU's 02, 05, 07, 16 and 32 and on walks of p00 to p08.
_WALKING = {"arm": 1.5, "forearm": 1.5, "leg": 1.4, "shin": 2.5}
_STANDING = 95.0  # percentile of the root's height that counts as standing. A guess.
_NEAR = 0.2  # s from the ends of a gap within which the departure fades to zero

Segments = tuple[int, ...]
Mode = Literal["between", "before", "unseen"]
"""What is known of a hidden limb: its motion before and after, before, or nothing."""


class MotionPrior:
    """Describes hidden limbs as ``windows.describe`` does, plus the learned departure.

    ``networks`` are under the names that ``network_name`` gives. Without networks every
    hidden limb continues its previous motion, and unseen ones are left to the method.
    """

    def __init__(self, networks: Mapping[str, Network]) -> None:
        self.networks = networks

    @classmethod
    def load(cls, path: Path) -> MotionPrior:
        """Read the networks from a file of ``network_arrays``."""
        return cls(read_networks(path, "weights of hidden limbs"))

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the networks as named arrays, for a file."""
        return network_arrays(self.networks)

    def change(self, name: str, inputs: Array) -> Array:
        """Return the departure of directions from the base, shape (..., 3 H).

        The ``inputs`` (..., F) come from ``inputs_of`` or ``posture_inputs``.
        """
        values = self.networks[name](inputs)
        most = _MOST_UNSEEN if name.endswith("unseen") else _MOST
        return np.asarray((OUTPUT * values).clip(-most, most))

    def describe(self, hidden: Stretches) -> Descriptions:
        """Describe stretches as ``windows.describe`` does, with the learned base."""
        found = windows.describe(hidden)
        part, mirrored = part_of(hidden.seen.skeleton, hidden.limb.hidden)
        name = network_name(part, "between" if hidden.ahead else "before")
        if name not in self.networks:
            return found
        inputs = inputs_of(hidden, found)
        change = self.change(name, inputs).reshape(found.base.shape)
        near = hidden.time[: 1 + hidden.ahead].min(axis=0)
        change *= np.minimum(near / _NEAR, 1.0)[..., None, None]
        moved = np.linalg.norm(hidden.root_change[..., [0, 2]], axis=-1)
        walks = 1.0 - np.exp(-((moved / _STAYS) ** 2))
        if not hidden.ahead:
            change *= 1.0 + (_WALKING[part] - 1.0) * walks[..., None, None]
        if mirrored:
            change[..., 0] *= -1.0
        base = unit(found.base + change)
        seen, limb, bones = hidden.seen, hidden.limb, hidden.motion[2]
        shown = np.zeros(len(seen.skeleton), dtype=np.bool_)
        shown[list(limb.visible)] = True
        bones = np.where(shown[:, None], bones, np.nan)
        lower = seen.heading.root[hidden.frames, 1] - seen.standing
        likely = self.unseen(seen.skeleton, limb.hidden, bones, lower)
        if likely is not None:
            share = 1.0 - np.exp(-near / _FORGOTTEN[hidden.ahead])
            if limb.leg is not None:  # whoever stays stands where they stood
                share *= walks
            base = unit(base + share[..., None, None] * (likely - base))
        return replace(found, base=base)

    def unseen(
        self, skeleton: Skeleton, hidden: Segments, bones: Array, lower: Array
    ) -> Array | None:
        """Return the likely directions of unseen segments, (..., H, 3), or None.

        ``hidden`` has these, from the trunk outwards; see also ``posture_inputs``.
        """
        part, mirrored = part_of(skeleton, hidden)
        if (name := network_name(part, "unseen")) not in self.networks:
            return None
        inputs = posture_inputs(skeleton, hidden, bones, lower)
        change = self.change(name, inputs)
        directions = unit(HANGING + change.reshape(*inputs.shape[:-1], -1, 3))
        if mirrored:
            directions[..., 0] *= -1.0
        return directions


def standing_height(heights: Array) -> float:
    """Return the height of the root [m] of a standing person, given many, (T,)."""
    return float(np.percentile(heights, _STANDING))


@cache
def default_prior() -> MotionPrior:
    """Return the prior that ships with kinefilter."""
    return MotionPrior.load(Path(__file__).parents[1] / "embedded" / "hidden_limbs.npz")


def network_name(part: str, mode: Mode) -> str:
    """Return the name of the network for a part."""
    return f"{part}_{mode}"


@cache
def part_of(skeleton: Skeleton, hidden: Segments) -> tuple[str, bool]:
    """Return the hidden part out of PARTS, "" for none, and True for a right limb."""
    kinds = tuple(skeleton.kinds[j] for j in hidden)
    part = next((part for part, joints in PARTS.items() if joints == kinds), "")
    return part, bool(part) and skeleton.joints[hidden[0]].endswith("Right")


def inputs_of(hidden: Stretches, found: Descriptions) -> Array:
    """Return the inputs of the networks, shape (W, M, F), as for a left limb.

    ``found`` is what ``windows.describe`` returns for the stretches. Segments that are
    hidden as well enter as if they did not move.
    """
    skeleton, limb = hidden.seen.skeleton, hidden.limb
    body, mirrored = _rest_of_body(skeleton, limb.hidden)
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


def posture_inputs(
    skeleton: Skeleton, hidden: Segments, bones: Array, lower: Array
) -> Array:
    """Return the inputs of the networks for unseen limbs, (..., F), as for a left one.

    ``bones`` are all segments as vectors [m] in the heading frame, (..., J, 3), NaN
    where not seen, and ``lower`` is the root's height [m] relative to standing, (...).
    """
    body, mirrored = _rest_of_body(skeleton, hidden)
    vectors = bones[..., list(body), :] / _BONE
    if mirrored:
        vectors = vectors * [-1.0, 1.0, 1.0]
    flat = vectors.reshape(*lower.shape, -1)
    return np.concatenate([flat, lower[..., None] / _LOWER], axis=-1)


@cache
def _rest_of_body(skeleton: Skeleton, hidden: Segments) -> tuple[Segments, bool]:
    """Return the segments that are inputs, and True if they are mirror images."""
    _, mirrored = part_of(skeleton, hidden)
    trunk = (skeleton.parents[skeleton.girdle], skeleton.girdle)
    sides = SIDES[::-1] if mirrored else SIDES
    others = (skeleton.index(name + side) for side in sides for name in LIMB_PARTS)
    return tuple(j for j in (*trunk, *others) if j not in hidden), mirrored
