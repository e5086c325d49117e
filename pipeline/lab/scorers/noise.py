"""How far each joint of each frame can be trusted, by how much it trembles.

Where a Kinect has to guess a joint, it guesses anew in every frame, and the segments
change their lengths. People do not move like that: over five frames, a joint's path is
all but a cubic, however fast. What is left when the cubic is taken out is the sensor's
noise. Noise and wrong lengths together tell how far a joint may be off.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import State, Term
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.reliability import ReliabilityScorer

FRAME_TIME = 1.0 / 30.0
"""Time [s] between a Kinect's frames, where no stamps are given."""
SAMPLES = 5
"""Positions that a cubic is taken out of: one more than it can pass through."""
MEMORY = 0.2
"""Time constant [s] of the averages of squared noise and squared length errors: as
long as Shum's rate looks back. On paired data 0.1 to 1 s do about as well."""
RECOVERY = 0.1
"""Time constant [s] in which a joint that is tracked again is trusted again: 0.85
after 0.2 s, when Shum's rate is back too."""
HONEST_SHARE = 0.1
"""What a cubic leaves of a person's own movement, as a share of the distance covered
from frame to frame. At 30 Hz, nine tenths of marker mocap (CMU: walking, punching,
sword play, dance) stay under it between 0.6 and 3 m/s."""
ERROR_PER_NOISE = 7.0
"""How far a joint is off, for its noise along one axis: Kinect's errors are mostly too
slow to tremble. Fitted on six people; 5 to 15 do about as well."""
DOUBTFUL_ERROR = 0.25
"""Estimated error [m] at which trust has fallen to 1/e. A rate of 0.85 is then 10 cm
and 0.6 is 18 cm; of recorded joints there, three and five in ten vary by over 7 cm."""
LARGEST_ERROR = 2.0 * DOUBTFUL_ERROR
"""What one frame can add at most [m]: from here on, wrong is wrong, and a jump is
forgotten within a second however wide it was."""


class NoiseReliabilityScorer(ReliabilityScorer):
    """Scores one frame after the other; a whole take goes the same way.

    Noise is measured relative to the root, the root's own in the room. The error that
    noise and lengths let expect lowers the trust as a Gaussian does. A joint that is
    inferred or not tracked has none at once, and gets it back by and by. The deciding
    term is the one that took most; Term.BEHAVIOR stands for noise.

    The rate of the geometry, which says where a measurement is to give way even to a
    posture that nobody knows, is that of the lengths alone while the joint is tracked:
    one that trembles is still nearer to its place than one that is invented. An
    inferred joint that trembles is a guess, and there noise counts too.

    Args:
        skeleton: The joints.
        reference: The person's segment lengths.
    """

    def start(self) -> None:
        """Forget all frames."""
        n = len(self.skeleton)
        self._paths = np.full((SAMPLES, n, 3), np.nan)
        self._stamps = np.full((SAMPLES, n), np.nan)
        self._noise = _Average(n)
        self._length_error = _Average(len(self.skeleton.segments))
        self._tracked = np.ones(n)
        self._time: float | None = None

    def step(
        self,
        positions: Array,
        state: NDArray[np.uint8],
        time: float | None = None,
    ) -> tuple[Array, NDArray[np.uint8], Array]:
        """Score the next frame; see ``ReliabilityScorer.step``."""
        elapsed = self._elapsed(time)
        share = 1.0 - np.exp(-elapsed / MEMORY)
        noise, lengths = self._square_errors(positions, share)
        noise = ERROR_PER_NOISE**2 * np.maximum(noise, 0.0)
        lost = (state != State.TRACKED) | np.isnan(positions[:, 0])
        tracked = self._track(lost, elapsed)
        trust = np.exp(-(noise + lengths) / DOUBTFUL_ERROR**2)
        term = np.where(noise > lengths, Term.BEHAVIOR, Term.KINEMATICS)
        term = np.where(tracked < trust, Term.TRACKING_STATE, term)
        geometry = np.where(lost, trust, np.exp(-lengths / DOUBTFUL_ERROR**2))
        return tracked * trust, term.astype(np.uint8), geometry

    def _square_errors(self, positions: Array, share: float) -> tuple[Array, Array]:
        """Return means of squared noise along an axis and length errors [m^2], (J,).

        Args:
            positions: Of the next frame [m], shape (J, 3).
            share: What it weighs in the means.
        """
        self._remember(positions)
        noise = self._noise.add(self._square_noise(), share)
        lengths = self._length_error.add(self._square_length_error(positions), share)
        return noise, self._touch @ lengths

    def _elapsed(self, time: float | None) -> float:
        """Return the time since the last frame [s], and take this one's down."""
        before = self._time
        if time is None:
            time = 0.0 if before is None else before + FRAME_TIME
        self._time = time
        return FRAME_TIME if before is None else time - before

    def _track(self, lost: NDArray[np.bool_], elapsed: float) -> Array:
        """Return the trust by tracking state, shape (J,): none at once, back slowly."""
        back = 1.0 - np.exp(-elapsed / RECOVERY)
        self._tracked += back * (1.0 - self._tracked)
        self._tracked[lost] = 0.0
        return self._tracked

    def _remember(self, positions: Array) -> None:
        """Add a frame to the paths of the joints that it has."""
        root = self.skeleton.root
        relative = positions - positions[root]
        relative[root] = positions[root]
        seen = ~np.isnan(relative[:, 0])
        self._paths[:-1, seen] = self._paths[1:, seen]
        self._stamps[:-1, seen] = self._stamps[1:, seen]
        self._paths[-1, seen], self._stamps[-1, seen] = relative[seen], self._time

    def _square_noise(self) -> Array:
        """Return this frame's squared noise along one axis [m^2], NaN unknown, (J,).

        The divided difference over five positions, whenever they came, is 0 for every
        cubic (Newton's interpolation); with weights of norm 1 it is as large as the
        noise. People's own share may leave less than nothing.
        """
        apart = self._stamps[:, None] - self._stamps
        apart[np.arange(SAMPLES), np.arange(SAMPLES)] = 1.0
        weights = 1.0 / np.prod(apart, axis=1)
        weights /= np.sqrt(np.sum(weights * weights, axis=0))
        left = np.einsum("kj,kjc->jc", weights, self._paths)
        way = (self._paths[-1] - self._paths[0]) / (SAMPLES - 1)
        square = np.sum(left * left / 3.0 - (HONEST_SHARE * way) ** 2, axis=1)
        square = np.minimum(square, (LARGEST_ERROR / ERROR_PER_NOISE) ** 2)
        return np.where(self._stamps[-1] == self._time, square, np.nan)

    def _square_length_error(self, positions: Array) -> Array:
        """Return this frame's squared length errors [m^2], NaN unknown, (S,)."""
        ends, starts = self.skeleton.segments, self.skeleton.segment_parents
        bones = positions[ends] - positions[starts]
        error = np.sqrt(np.sum(bones * bones, axis=1)) - self._lengths
        return np.asarray(np.minimum(error * error, LARGEST_ERROR**2))


class _Average:
    """Means over all values while they are few, then over the latest."""

    def __init__(self, size: int) -> None:
        self._mean, self._count = np.zeros(size), np.zeros(size)

    def add(self, values: Array, share: float) -> Array:
        """Return the means with new values, which weigh ``share`` or more.

        A value that is NaN changes nothing; before the first one the mean is 0.
        """
        known = ~np.isnan(values)
        self._count += known
        gain = np.maximum(share, 1.0 / np.maximum(self._count, 1.0))
        self._mean += np.where(known, gain * (values - self._mean), 0.0)
        return self._mean
