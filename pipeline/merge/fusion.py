"""One skeleton of what several sensors see of a person at a moment.

Each joint is the weighted mean of where the sensors put it. A sensor counts by the
reliability of the joint, and the less the more it sees the person from the side, least
of all for the limbs behind the body. Each sensor's own constant misplacement of a joint
is learned on the way and taken off. Errors along the line of sight are no larger than
across it, on UI-PRMD's people as in the virtual Kinect.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from kinefilter.characters import Skeleton, State
from kinefilter.characters.arrays import Array, Codes, Flags
from kinefilter.characters.skeleton import SIDES
from kinefilter.retarget import HeadingFrame, find_yaw

from .facing import Facing
from .sides import Sides

# Chosen on simulated people (seeds 40 to 55 and 140 to 153) and on p00 to p08 of
# two-kinects; hardly anything depends on them but the first two.
_BESIDE = 2.0  # exponent by which a sensor at right angles to the person counts less
_BEHIND = 2.0  # and by which it counts less again for a limb behind the body
_INFERRED = 0.3  # reliability at most of what a sensor only guesses
_LEAST = 1e-3  # reliability of what a sensor gives at all
_BLEND = 0.08  # s in which weights follow
_LEARNING = 30.0  # s in which misplacements are learned
_LARGEST = 0.15  # m of a misplacement
_COUNTS = 0.2  # share from which on a sensor's state is that of the joint


class Sight(NamedTuple):
    """What a sensor sees of a person at a moment."""

    positions: Array
    """Joints [m] in the merged frame, NaN where missing, (J, 3)."""
    reliability: Array
    """Of each joint, in [0, 1], (J,)."""
    state: Codes
    """Tracking states (State), (J,)."""
    sensor: Array
    """Where the sensor is [m], (3,)."""


class Fused(NamedTuple):
    """A person as all sensors see them together."""

    positions: Array
    """Joints [m], NaN where no sensor has any, (J, 3)."""
    state: Codes
    """The best state among the sensors that count, (J,)."""
    reliability: Array
    """Mean reliability of the sensors that count, in [0, 1], (J,)."""
    shares: Array
    """How much of each joint is of which sensor, adding up to 1 or 0, (S, J)."""
    exchanged: Flags
    """Which sensors had left and right exchanged, (S,)."""


class Fusion:
    """Merges one frame after the other of so many sensors."""

    def __init__(self, skeleton: Skeleton, sensors: int) -> None:
        self._skeleton = skeleton
        self._sides, self._facing = Sides(skeleton, sensors), Facing()
        left, right = np.array(
            [[joint.endswith(side) for joint in skeleton.joints] for side in SIDES]
        )
        self._side = left.astype(float) - right
        unknown, joints = np.full(3, np.nan), len(skeleton)
        nobody = np.tile(unknown, (joints, 1))
        state = np.zeros(joints, dtype=np.uint8)
        self._nothing = Sight(nobody, np.zeros(joints), state, unknown)
        self._known = np.zeros((sensors, joints))
        self._offsets = np.zeros((sensors, joints, 3))
        self.start()

    def start(self) -> None:
        """Forget all frames, but not where sensors misplace joints."""
        self._weights = np.zeros_like(self._known)
        self._sides.start()
        self._facing.start()

    def ahead(
        self, frames: Sequence[Sequence[Sight | None]], elapsed: Array
    ) -> tuple[Flags, Array]:
        """Return what only all frames together tell, for ``step``.

        Which sensors have left and right exchanged, (T, S), and which way the person
        faces [rad], (T,), 0 along +z.

        Args:
            frames: What each sensor sees, frame by frame.
            elapsed: Time since the frame before [s], (T,).
        """
        gathered = [self._gathered(sights) for sights in frames]
        sides = self._sides.whole((seen.positions, _sure(seen)) for seen in gathered)
        for seen, exchanged in zip(gathered, sides, strict=True):
            self._exchange(seen, exchanged)
        headings = self._facing.whole(
            (self._yaws(seen), self._angles(seen), float(since))
            for seen, since in zip(gathered, elapsed, strict=True)
        )
        return sides, headings

    def _gathered(self, sights: Sequence[Sight | None]) -> Sight:
        """Return what all sensors see, arrays with a leading axis S."""
        each = (self._nothing if sight is None else sight for sight in sights)
        return Sight(*map(np.array, zip(*each, strict=True)))

    def _exchange(self, seen: Sight, exchanged: Flags) -> None:
        """Exchange left and right of what some sensors see."""
        for part in seen[:3]:
            part[exchanged] = part[exchanged][:, self._skeleton.mirror]

    def _yaws(self, seen: Sight) -> Array:
        """Return which way sensors see the person face [rad], NaN if unknown, (S,)."""
        return find_yaw(seen.positions, seen.reliability, self._skeleton)

    def _angles(self, seen: Sight) -> Array:
        """Return where sensors are from the person [rad], NaN where unknown, (S,)."""
        x, _, z = (seen.sensor - seen.positions[:, self._skeleton.root]).T
        return np.asarray(np.arctan2(x, z))

    def step(
        self,
        sights: Sequence[Sight | None],
        elapsed: float,
        exchanged: Flags | None = None,
        heading: float | None = None,
    ) -> Fused:
        """Merge the next frame.

        Args:
            sights: What each sensor sees, None where it sees nobody.
            elapsed: Time since the last frame [s].
            exchanged: Which sensors have left and right exchanged, (S,).
            heading: Which way the person faces [rad]; both by default as the frames so
                far tell.
        """
        all_seen = self._gathered(sights)
        if exchanged is None:
            exchanged, _ = self._sides.step(all_seen.positions, _sure(all_seen))
        self._exchange(all_seen, exchanged)
        angles = self._angles(all_seen)
        if heading is None:
            heading, _ = self._facing.step(self._yaws(all_seen), angles, elapsed)
        seen, given, state, _ = all_seen
        missing = np.isnan(seen[..., 0])
        most = np.where(state == State.INFERRED, _INFERRED, 1.0)
        reliability = np.where(missing, 0.0, np.clip(given, _LEAST, most))
        seen = np.where(missing[..., None], 0.0, seen)
        across = np.sin(np.nan_to_num(angles - heading))[:, None]
        doubt = _BESIDE * np.abs(across) + _BEHIND * np.maximum(-across * self._side, 0)
        frame = HeadingFrame(np.zeros(3), np.array(heading))
        placed = seen - frame.restore(self._offsets)
        weights = reliability * np.exp(-doubt)
        share = 1.0 - np.exp(-elapsed / _BLEND)
        both = (self._weights > 0.0) & (weights > 0.0)
        weights = np.where(
            both, self._weights + share * (weights - self._weights), weights
        )
        self._weights = weights
        whole = weights.sum(axis=0)
        shares = np.divide(
            weights, whole, out=np.zeros_like(weights), where=whole > 0.0
        )
        fused = np.einsum("sj,sji->ji", shares, placed)
        self._learn(frame.remove(seen - fused), reliability, elapsed)
        fused[whole == 0.0] = np.nan
        best = np.where(shares > _COUNTS, state, 0).max(axis=0).astype(np.uint8)
        return Fused(fused, best, (shares * given).sum(axis=0), shares, exchanged)

    def _learn(self, away: Array, reliability: Array, elapsed: float) -> None:
        """Learn where sensors misplace joints that several of them see.

        How far they are away [m] is in the heading frame.
        """
        several = (reliability > _INFERRED).sum(axis=0) > 1
        use = several & (reliability > _INFERRED)
        size = np.linalg.norm(away, axis=2)
        away = away * np.minimum(1.0, _LARGEST / np.maximum(size, 1e-9))[..., None]
        self._known += np.where(use, elapsed, 0.0)
        share = np.where(use, elapsed, 0.0) / np.clip(self._known, 1e-9, _LEARNING)
        self._offsets += share[..., None] * (away - self._offsets)


def _sure(seen: Sight) -> Array:
    """Return how much joints tell of the sides, (S, J)."""
    return np.where(seen.state == State.TRACKED, seen.reliability, 0.0) + _LEAST
