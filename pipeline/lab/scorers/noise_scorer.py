"""Reliability from noise and segment lengths.

Where a Kinect has to guess a joint, the guess changes from frame to frame, and segments
change their lengths. A person's joint is close to a cubic over five frames, however
fast it is; the rest is noise. Noise and length errors give an estimate of the error.
"""

import numpy as np

from kinefilter.characters import Skeleton, State, Term
from kinefilter.characters.arrays import Array, Codes
from kinefilter.pipeline.reliability import Reference, ReliabilityScorer

FRAME_TIME = 1.0 / 30.0  # s, between frames without time stamps: a Kinect's
SAMPLES = 5  # positions a cubic is subtracted from, one more than it can fit
MEMORY = 0.2
"""Time constant [s] of the means of squared noise and squared length errors: as long as
the window of Shum's reliability. On paired data 0.1 to 1 s do about as well."""
RECOVERY = 0.1  # s, to be reliable once tracked: 0.85 after 0.2 s, as Shum's
MOTION_SHARE = 0.1
"""Part of a person's own motion that a cubic does not explain, relative to the distance
covered per frame. At 30 Hz, nine tenths of marker mocap (CMU: walking, punching, sword
play, dance) are below this between 0.6 and 3 m/s."""
ERROR_PER_NOISE = 7.0
"""Error of a joint relative to its noise along one axis: most of Kinect's errors change
too slowly to be noise. Fitted on six people; 5 to 15 do about as well."""
DOUBTFUL_ERROR = 0.25
"""Estimated error [m] at which reliability falls to 1/e. It is 0.85 at 10 cm and 0.6 at
18 cm; of recorded joints there, three and five in ten vary by over 7 cm."""
LARGEST_ERROR = 2.0 * DOUBTFUL_ERROR  # m, of a frame: a jump is soon forgotten


class NoiseReliabilityScorer(ReliabilityScorer):
    """Scores frame by frame; a whole take gets the same scores.

    Noise is relative to the root, and the root's own to the room. Reliability is a
    Gaussian of the error that noise and length errors suggest. It is 0 while a joint is
    inferred or not tracked, and recovers gradually. The deciding term is the one that
    lowers the reliability most; Term.BEHAVIOR stands for noise. The geometry of a
    tracked joint ignores noise: it is still closer to the truth than a reconstruction.
    """

    def __init__(self, skeleton: Skeleton, reference: Reference) -> None:
        super().__init__(skeleton, reference)  # without the keywords of Shum's scorer

    def start(self) -> None:
        """Reset the state for a new motion."""
        n = len(self.skeleton)
        self._paths = np.full((SAMPLES, n, 3), np.nan)
        self._stamps = np.full((SAMPLES, n), np.nan)
        self._means = np.zeros(n + len(self.skeleton.segments))  # noise, then lengths
        self._counts = np.zeros_like(self._means)
        self._tracked = np.ones(n)
        self._time: float | None = None

    def step(
        self, positions: Array, state: Codes, time: float | None = None
    ) -> tuple[Array, Codes, Array]:
        """Score the next frame; see ``ReliabilityScorer.step``."""
        elapsed = self._elapsed(time)
        noise, lengths = self._square_errors(positions, elapsed)
        noise = ERROR_PER_NOISE**2 * np.maximum(noise, 0.0)
        lost = (state != State.TRACKED) | np.isnan(positions[:, 0])
        self._tracked += (1.0 - np.exp(-elapsed / RECOVERY)) * (1.0 - self._tracked)
        self._tracked[lost] = 0.0
        reliability = np.exp(-(noise + lengths) / DOUBTFUL_ERROR**2)
        term = np.where(noise > lengths, Term.BEHAVIOR, Term.KINEMATICS)
        term = np.where(self._tracked < reliability, Term.TRACKING_STATE, term)
        geometry = np.where(lost, reliability, np.exp(-lengths / DOUBTFUL_ERROR**2))
        return self._tracked * reliability, term.astype(np.uint8), geometry

    def _elapsed(self, time: float | None) -> float:
        before = self._time
        if time is None:
            time = 0.0 if before is None else before + FRAME_TIME
        self._time = time
        return FRAME_TIME if before is None else time - before

    def _square_errors(self, positions: Array, elapsed: float) -> tuple[Array, Array]:
        """Return mean squares of noise along an axis and length errors [m^2], (J,)."""
        root = self.skeleton.root
        relative = positions - positions[root]
        relative[root] = positions[root]
        seen = ~np.isnan(relative[:, 0])
        self._paths[:-1, seen] = self._paths[1:, seen]
        self._stamps[:-1, seen] = self._stamps[1:, seen]
        self._paths[-1, seen], self._stamps[-1, seen] = relative[seen], self._time
        ends, starts = self.skeleton.segments, self.skeleton.segment_parents
        bones = positions[ends] - positions[starts]
        error = np.sqrt(np.sum(bones * bones, axis=1)) - self._lengths
        square_error = np.minimum(error * error, LARGEST_ERROR**2)
        values = np.concatenate([self._square_noise(), square_error])
        known = ~np.isnan(values)
        self._counts += known
        share = 1.0 - np.exp(-elapsed / MEMORY)
        gain = np.maximum(share, 1.0 / np.maximum(self._counts, 1.0))
        self._means += np.where(known, gain * (values - self._means), 0.0)
        noise, lengths = np.split(self._means, [len(self.skeleton)])
        return noise, self._touch @ lengths

    def _square_noise(self) -> Array:
        """Return this frame's squared noise along one axis [m^2], NaN unknown, (J,).

        The divided difference of five positions, at any times, is 0 for every cubic
        (Newton's interpolation); with weights of norm 1 it is as large as the noise.
        The result can be negative, since the person's own motion is subtracted.
        """
        apart = self._stamps[:, None] - self._stamps
        apart[np.arange(SAMPLES), np.arange(SAMPLES)] = 1.0
        weights = 1.0 / np.prod(apart, axis=1)
        weights /= np.sqrt(np.sum(weights * weights, axis=0))
        rest = np.einsum("kj,kjc->jc", weights, self._paths)
        moved = (self._paths[-1] - self._paths[0]) / (SAMPLES - 1)
        square = np.sum(rest * rest / 3.0 - (MOTION_SHARE * moved) ** 2, axis=1)
        square = np.minimum(square, (LARGEST_ERROR / ERROR_PER_NOISE) ** 2)
        return np.where(self._stamps[-1] == self._time, square, np.nan)
