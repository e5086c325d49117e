"""The motion that the character is pulled through.

It is what correction found, made smooth, put on the floor and on the person's bones,
with an orientation for every segment.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Body
from kinefilter.retarget import (
    BoneLengths,
    positions_from_rotations,
    rotations_from_positions,
)
from kinefilter.retarget.rotations import continuous, normalize

from .correct.take import CorrectedTake
from .floor import floor_height, put_on_floor
from .smooth import smooth

__all__ = ["Target", "make_target"]

Array = NDArray[np.float64]

_TWIST_CUTOFF = 3.0  # Hz; neighbors change from frame to frame, forearms do not
_LEAST_WEIGHT = 0.1  # of an invented joint in the smoother, against a measured one's 1
_CHUNK = 4096  # frames at a time: an hour's take fits a gigabyte


@dataclass(frozen=True)
class Target:
    """A motion in the world frame, floor at y = 0."""

    positions: Array
    """Where each joint is pulled [m], shape (T, J, 3)."""
    rotations: Array
    """World segment rotations, wxyz, continuous over time, shape (T, J, 4)."""
    floor: float
    """Height of the floor in the sensor's frame [m]."""

    def posed(self, body: Body) -> Array:
        """Return joint positions [m] that follow from the rotations, (T, J, 3)."""
        roots = self.positions[:, body.skeleton.root]
        positions = np.empty_like(self.positions)
        for k in _chunks(len(roots)):
            positions[k] = positions_from_rotations(self.rotations[k], roots[k], body)
        return positions


def make_target(
    time: Array, corrected: CorrectedTake, body: Body, *, cutoff: float
) -> Target:
    """Return the target of a corrected take.

    Args:
        time: Time stamps [s], strictly increasing, shape (T,).
        corrected: What correction found.
        body: The person.
        cutoff: Frequency [Hz] over which movement is smoothed away; 0: none is.
    """
    positions, trust = corrected.positions, corrected.trust
    if cutoff > 0.0:
        weights = np.maximum(trust, _LEAST_WEIGHT)
        positions = smooth(time, positions, weights, cutoff=cutoff)
    floor = floor_height(positions, trust, body)
    positions = BoneLengths(body).project(positions - [0.0, floor, 0.0], trust)
    positions = put_on_floor(positions, body)
    twist = _smooth_twist(time, corrected.rotations)
    return Target(positions, _orient(positions, body, twist), floor)


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
