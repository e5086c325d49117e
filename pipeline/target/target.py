"""The motion that the character is pulled through.

It is what correction found, made smooth, put on the floor and on the person's bones,
with an orientation for every segment.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Body, positions_from_rotations
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import continuous, normalize
from kinefilter.pipeline.correct.take import CorrectedTake
from kinefilter.retarget import (
    BoneLengths,
    Hands,
    rotations_from_positions,
)

from .contacts import ankles_and_toes, feet_of, find_stance
from .floor import floor_height, leveled, put_on_floor, sensor_tilt
from .planting import PLANTED, plant_feet
from .smooth import smooth, smooth_by_speed

Feet = Literal["auto", "always", "never"]
"""When feet stand still."""

_TWIST_CUTOFF = 3.0  # Hz; neighbors change from frame to frame, forearms do not
_LEAST_WEIGHT = 0.1  # of an invented joint in the smoother, against a measured one's 1
_LEAST_FIRMNESS = 0.3  # of an invented joint where bones ask for a move: the same
_BONES_CUTOFF = 2.0  # Hz; lengths are wrong for longer than joints tremble
_CHUNK = 4096  # frames at a time: an hour's take fits a gigabyte


@dataclass(frozen=True, eq=False)
class Target:
    """A motion in the world frame, floor at y = 0."""

    positions: Array
    """Where each joint is pulled [m], shape (T, J, 3)."""
    rotations: Array
    """World segment rotations, wxyz, continuous over time, shape (T, J, 4)."""
    floor: float
    """Height of the floor in the leveled sensor's frame [m]."""
    tilt: float
    """Angle [rad] by which the sensor's frame was leveled (``floor.leveled``)."""
    contacts: NDArray[np.bool_]
    """Which parts of the feet stand on the floor (CONTACTS), shape (T, 4)."""

    @property
    def stands(self) -> NDArray[np.bool_]:
        """Whether each foot stands, left and right, shape (T, 2)."""
        return feet_of(self.contacts)

    def posed(self, body: Body) -> Array:
        """Return joint positions [m] that follow from the rotations, (T, J, 3)."""
        roots = self.positions[:, body.skeleton.root]
        positions = np.empty_like(self.positions)
        for k in _chunks(len(roots)):
            positions[k] = positions_from_rotations(self.rotations[k], roots[k], body)
        return positions


def make_target(
    time: Array,
    corrected: CorrectedTake,
    body: Body,
    *,
    cutoff: float,
    feet: Feet = "auto",
    contacts: NDArray[np.bool_] | None = None,
    floor: float | None = None,
    tilt: float | None = None,
) -> Target:
    """Return the target of a corrected take.

    Args:
        time: Time stamps [s], strictly increasing, shape (T,).
        corrected: What correction found.
        body: The person.
        cutoff: Frequency [Hz] over which movement is smoothed away; 0: none is.
        feet: When feet stand still: where they rest, always, or never.
        contacts: When they do instead (CONTACTS), shape (T, 4).
        floor: Height of the floor in the sensor's frame [m]; by default as found.
        tilt: Angle [rad] that levels the sensor's frame; by default as found.
    """
    skeleton, trust = body.skeleton, corrected.trust
    stands = find_stance(time, corrected.positions, trust, skeleton)
    if tilt is None:
        tilt = sensor_tilt(corrected.positions, trust, stands, body)
    positions = leveled(corrected.positions, tilt)
    if cutoff > 0.0:
        weights = np.maximum(trust, _LEAST_WEIGHT)
        positions = smooth_by_speed(time, positions, weights, cutoff=cutoff)
    if floor is None:
        floor = floor_height(positions, trust, stands, body)
    positions = positions - [0.0, floor, 0.0]
    if feet != "auto":
        stands = np.full_like(stands, feet == "always")
    heels = None
    if contacts is not None:
        stands, heels = feet_of(contacts), contacts[:, ::2]
    planted, heels = plant_feet(time, positions, trust, stands, body, heels)
    firmness = np.maximum(trust, _LEAST_FIRMNESS)
    for part in ankles_and_toes(skeleton):
        firmness[:, part] = np.where(stands, PLANTED, firmness[:, part])
    placed = put_on_floor(planted, body)
    positions = _on_bones(time, placed, firmness, trust, body)
    twist = _smooth_twist(time, corrected.rotations)
    return Target(
        positions,
        _orient(positions, body, twist),
        floor,
        tilt,
        np.stack([heels, stands], axis=2).reshape(-1, 4),
    )


def _on_bones(
    time: Array, positions: Array, firmness: Array, trust: Array, body: Body
) -> Array:
    """Return positions with the body's bone lengths, as smooth as they were before.

    What the lengths ask for trembles with the noise of neighbors, so it is smoothed,
    and the lengths are restored once more by what little is then missing.
    """
    bones = BoneLengths(body)
    moved = Hands(body.skeleton).carried(
        positions, bones.project(positions, firmness), trust, body
    )
    moved -= positions
    moved = smooth(time, moved, np.ones(firmness.shape), cutoff=_BONES_CUTOFF)
    return put_on_floor(bones.project(positions + moved, firmness), body)


def _smooth_twist(
    time: Array, rotations: NDArray[np.float32] | None
) -> NDArray[np.float32] | None:
    """Return the prior rotations without the jumps between sets of neighbors."""
    if rotations is None:
        return None
    smoothed = np.empty_like(rotations)
    weights = np.ones((len(time), 1))
    for j in range(rotations.shape[1]):
        signed = continuous(rotations[:, j, None].astype(float))
        smoothed[:, j] = smooth(time, signed, weights, cutoff=_TWIST_CUTOFF)[:, 0]
    return smoothed


def _orient(positions: Array, body: Body, prior: NDArray[np.float32] | None) -> Array:
    """Return segment rotations of a motion, continuous over time, (T, J, 4)."""
    rotations = np.empty((*positions.shape[:2], 4))
    for k in _chunks(len(positions)):
        twist = None if prior is None else normalize(prior[k].astype(float))
        rotations[k] = rotations_from_positions(positions[k], body, twist)
    return continuous(rotations)


def _chunks(count: int) -> Iterator[slice]:
    return (slice(k, k + _CHUNK) for k in range(0, count, _CHUNK))
