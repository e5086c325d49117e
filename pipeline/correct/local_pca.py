"""Correction in the natural posture space of the nearest postures (Shum 2013)."""

from collections.abc import Iterable
from itertools import islice
from typing import Literal

import numpy as np

from kinefilter.characters import InputError, standard_body
from kinefilter.characters.arrays import Array, Indices, chunks
from kinefilter.pipeline.database import PostureDatabase

from .hold import Blend, measurement_confidence
from .interface import (
    CORRECTED_CONFIDENCE,
    Correction,
    Corrector,
    Frames,
    Observation,
    joined,
)
from .posture_space import (
    PAPER_WEIGHTS,
    EnergyWeights,
    NaturalSpaces,
    PostureEnergy,
    PostureSpace,
    solve,
    stochastic_search,
)

Search = Literal["solver", "stochastic"]
"""How the posture of least energy is found: the solver, or the paper's sampling."""

_SENSOR_ERROR = 0.05  # m, of a joint that Kinect v2 tracks, on the standard body
_NEIGHBORS = 5
"""Postures that span a posture space. Shum's 30 leave room for unnatural postures where
few joints are reliable: behind a box or a desk, 10 remove 38 % of the error of
simulated takes, 7 remove 40 % and 5 remove 41 %."""
_AS_MEASURED = 0.001  # m: a joint that moves less still counts as measured
_CHUNK = 4096  # frames at a time, to bound the memory
_COVERAGE_MEMORY = 0.8  # weight of the last frame's coverage, against sudden changes


class LocalPCA(Corrector):
    """Finds the natural posture that fits the reliable joints, and follows it.

    Reliable joints stay where they are, except where a database of recorded postures
    shows that no person has such a posture.

    Args:
        neighbors: K, the number of postures that span the natural posture space.
        dimensions: Maximum number of dimensions of that space.
        search: How the posture of least energy is found.
        steps: Maximum number of steps of the stochastic search.
        samples: Samples per step.
        memory: Weight of the last posture in the query, against a reliability of 1.
        control, style, kinematics, continuity: Weights as in ``EnergyWeights``.
        seed: Seed of the stochastic search.
    """

    def __init__(
        self,
        database: PostureDatabase,
        *,
        neighbors: int = _NEIGHBORS,
        dimensions: int = 20,
        search: Search = "solver",
        steps: int = 20,
        samples: int = 100,
        memory: float = 0.05,
        control: float = PAPER_WEIGHTS.control,
        style: float = PAPER_WEIGHTS.style,
        kinematics: float = PAPER_WEIGHTS.kinematics,
        continuity: float = PAPER_WEIGHTS.continuity,
        seed: int = 0,
    ) -> None:
        if neighbors < 2:
            raise InputError(
                f"neighbors={neighbors}: a posture space needs two or more"
            )
        self.database, self.neighbors = database, neighbors
        self.dimensions, self.memory = dimensions, memory
        self.search, self.steps, self.samples, self.seed = search, steps, samples, seed
        self.weights = EnergyWeights(control, style, kinematics, continuity)
        self._body = standard_body(database.skeleton)
        self._blend = Blend(database.skeleton)
        # Scripted motions are invented: how they vary says little about people.
        self._spaces = NaturalSpaces(database) if database.recorded else None
        self.start()

    def start(self) -> None:
        """Reset the state for a new motion."""
        self._generator = np.random.default_rng(self.seed)
        self._last: list[Array] = []
        self._nearest: Indices | None = None
        self.energy: PostureEnergy
        self._spanned: frozenset[int] | None = None
        self._coverage: float | None = None

    def step(self, observation: Observation) -> Correction:
        """Correct the next frame."""
        return self._correct(observation.at(None), range(1)).at(0)

    def whole(self, take: Observation, frames: Frames = None) -> Correction:
        """Correct a whole take; only the search goes from frame to frame."""
        self.start()
        count = len(take.positions)
        steps = iter(range(count) if frames is None else frames)
        parts = map(take.at, chunks(count, _CHUNK))
        rows = [self._correct(one, islice(steps, len(one.positions))) for one in parts]
        return joined(rows)

    def _correct(self, take: Observation, frames: Iterable[int]) -> Correction:
        measured, missing = take.positions, np.isnan(take.positions[..., 0])
        reliability = np.where(missing, 0.0, take.reliability)
        priors, nearest = self._synthesize_each(measured, reliability, frames)
        coverage = self._cover(measured, reliability, nearest)
        confidence = measurement_confidence(
            reliability, take.geometry, missing, coverage[:, None]
        )
        postures = self._blend(priors, measured, confidence)
        if self._spaces is not None:
            shifts = np.array([self._spaces.shift(posture) for posture in postures])
            postures = postures + shifts
            moved = np.vecdot(shifts, shifts) > _AS_MEASURED**2
            most = np.where(moved, CORRECTED_CONFIDENCE, 1.0)
            confidence = np.minimum(confidence, most)
        return Correction(postures, confidence, coverage)

    def _synthesize_each(
        self, measured: Array, reliability: Array, frames: Iterable[int]
    ) -> tuple[Array, Indices]:
        """Return what ``synthesize`` finds for each of the next frames."""
        rows = zip(measured, reliability, frames, strict=True)
        found = [self.synthesize(posture, weights) for posture, weights, _ in rows]
        priors, nearest = zip(*found, strict=True)
        return np.array(priors), np.array(nearest)

    def synthesize(self, measured: Array, reliability: Array) -> tuple[Array, Indices]:
        """Return the natural posture of least energy [m], (J, 3), and its neighbors.

        ``measured`` positions [m] (J, 3) may be NaN where the reliability (J,) is 0.
        """
        nearest = self._neighbors(measured, reliability)
        steady = 2.0 * self._last[1] - self._last[0] if self._last else None  # eq. 14
        observed, spanned = (measured, reliability, steady), frozenset(nearest.tolist())
        if spanned == self._spanned:  # as in four of ten frames
            self.energy.aim(*observed)
        else:
            postures = self.database.flat[nearest].astype(float)
            space, self._spanned = PostureSpace(postures, self.dimensions), spanned
            self.energy = PostureEnergy(space, self._body, *observed, self.weights)
        space = self.energy.space
        last = self._last[-1] if self._last else self.database.flat[nearest[0]]
        start = space.project(last)
        if self.search == "solver":
            latent = solve(self.energy, start)
        else:
            limits = {"steps": self.steps, "samples": self.samples}
            latent = stochastic_search(self.energy, start, self._generator, **limits)
        posture = space.posture(latent)
        self._last = [self._last[1] if self._last else posture, posture]
        return posture.reshape(-1, 3), nearest

    def _neighbors(self, measured: Array, reliability: Array) -> Indices:
        """Return the database postures nearest to the reliable joints (eq. 9).

        The last posture also counts a little: unreliable joints must not wander.
        """
        query, weights = measured, reliability
        if self._last:
            seen = np.where(reliability[:, None] > 0.0, measured, 0.0)
            weights = reliability + self.memory
            last = self.memory * self._last[-1].reshape(-1, 3)
            query = reliability[:, None] * seen + last
            query = query / np.maximum(weights, 1e-12)[:, None]
        found = self.database.neighbors(query, weights, self.neighbors, self._nearest)
        self._nearest = found[0]
        return found[0]

    def _cover(self, measured: Array, reliability: Array, nearest: Indices) -> Array:
        """Return how well the database knows each of the next postures, in [0, 1].

        It is 1 up to a distance (root mean square over the reliable joints) that the
        spacing of the database and the sensor's error explain, and 0 from twice that.
        """
        seen = np.where(reliability[..., None] > 0.0, measured, 0.0)
        apart = self.database.positions[nearest] - seen[:, None]
        squares = (np.vecdot(apart, apart) @ reliability[..., None])[..., 0].min(axis=1)
        distance = np.sqrt(squares / np.maximum(reliability.sum(axis=1), 1e-9))
        near = np.hypot(self.database.spacing, _SENSOR_ERROR)
        coverage: Array = (2.0 - distance / near).clip(0.0, 1.0)
        for k, now in enumerate(coverage.tolist()):
            before = now if self._coverage is None else self._coverage
            self._coverage = before * _COVERAGE_MEMORY + now * (1.0 - _COVERAGE_MEMORY)
            coverage[k] = self._coverage
        return coverage
