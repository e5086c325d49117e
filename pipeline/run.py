"""The pipeline: a take in, a clip out, as one list of steps."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Body, Clip, InputError, Origin, Skeleton, Take
from kinefilter.retarget.body_size import Standardizer, measured_body
from kinefilter.retarget.bone_lengths import BoneLengths
from kinefilter.retarget.kinematics import positions_from_rotations
from kinefilter.retarget.orientation import rotations_from_positions
from kinefilter.retarget.rotations import continuous, normalize

from .config import CleanConfig
from .correct.hold import Hold
from .correct.interface import Corrector, Observation
from .correct.local_pca import LocalPCA
from .database import PostureDatabase
from .floor import floor_height, put_on_floor
from .library import embedded_database
from .metrics import Quality, measure
from .physics import PhysicsFilter, PhysicsTrace
from .reliability import Reliability, ReliabilityScorer, measure_reference
from .smooth import smooth

__all__ = ["CleanResult", "clean", "make_corrector"]

Array = NDArray[np.float64]
Progress = Callable[[str, int], Iterable[int]]
"""Called with a stage's name and its number of frames; returns their iterator."""

_TWIST_CUTOFF = 3.0  # Hz; neighbors change from frame to frame, forearms do not
_CHUNK = 4096  # frames
_LEAST_WEIGHT = 0.1  # of an invented joint in the smoother, against a measured one's 1


@dataclass(frozen=True)
class CleanResult:
    """A cleaned clip and what happened on the way."""

    clip: Clip
    """The motion."""
    stages: dict[str, Quality]
    """Quality of ``raw``, ``corrected`` and, unless switched off, ``physics``."""
    reliability: Reliability
    """Reliability of every joint and frame."""
    coverage: Array
    """How well the database knows the posture of each frame, in [0, 1], shape (T,)."""
    trace: PhysicsTrace | None
    """What the simulation did, per distinct time stamp; None without physics."""
    notes: tuple[str, ...]
    """What the user should know about this take."""

    @property
    def share_outside(self) -> float:
        """Share of the frames whose posture the database does not hold."""
        return float(np.mean(self.coverage < 0.5))


def clean(
    take: Take, config: CleanConfig | None = None, *, progress: Progress | None = None
) -> CleanResult:
    """Clean a take.

    Args:
        take: The recording.
        config: What to do; by default local PCA, then physics.
        progress: Wraps the frame loops, for a progress bar.

    Raises:
        InputError: The take holds nothing to clean, or the database does not fit it.
    """
    config = config or CleanConfig()
    progress = progress or (lambda _, count: range(count))
    _check(take)
    corrector = make_corrector(take.skeleton, config)
    distinct = np.concatenate([[True], np.diff(take.time) > 0])
    # Which distinct frame each of the take's shows; a slice copies nothing.
    frames = slice(None) if distinct.all() else np.cumsum(distinct) - 1
    source, take = take, _select(take, distinct)

    reference = measure_reference(take)
    body = measured_body(
        take.skeleton,
        reference.lengths,
        reference.directions,
        height=config.height,
        mass=config.mass,
    )
    reliability = ReliabilityScorer(take.skeleton, reference).score(take)
    corrected = _correct(take, body, reliability, corrector, progress)
    target = corrected.positions
    if config.cutoff > 0.0:
        weights = np.maximum(corrected.trust, _LEAST_WEIGHT)
        target = smooth(take.time, target, weights, cutoff=config.cutoff)
    floor = np.array([0.0, floor_height(target, corrected.trust, body), 0.0])
    raw = take.positions - floor
    target = BoneLengths(body).project(target - floor, corrected.trust)
    target = put_on_floor(target, body)
    rotations = _orient(target, body, corrected.twist(take.time))
    positions = _pose(rotations, target[:, take.skeleton.root], body)
    stages = {
        "raw": measure(take.time, raw, raw, body),
        "corrected": measure(take.time, positions, raw, body),
    }
    before_physics, trace, notes = positions, None, []
    if config.physics:
        result = PhysicsFilter(body).run(
            take.time, target, rotations, frames=progress("physics", len(take))
        )
        rotations, positions, trace = result.rotations, result.positions, result.trace
        stages["physics"] = measure(take.time, positions, raw, body)
        if trace.reset.any():
            notes.append(f"physics: {result.status}")
    if not reference.from_reference_posture:
        notes.append(
            "no T-pose or standing frames with every joint tracked: segment lengths "
            "are medians over the take"
        )
    clip = Clip(
        time=source.time,
        positions=positions[frames],
        rotations=rotations[frames],
        skeleton=take.skeleton,
        body=body,
        state=source.state,
        reliability=reliability.rate[frames],
        deciding_term=reliability.term[frames],
        origin=corrected.origin(raw)[frames],
        moved_by_correction=np.linalg.norm(before_physics - raw, axis=-1)[frames],
        moved_by_physics=np.linalg.norm(positions - before_physics, axis=-1)[frames],
        source=source.source,
    )
    coverage = corrected.coverage[frames]
    return CleanResult(clip, stages, reliability, coverage, trace, tuple(notes))


def make_corrector(skeleton: Skeleton, config: CleanConfig) -> Corrector:
    """Return the correction method that a config names, for a skeleton.

    Raises:
        InputError: The database is of another skeleton.
    """
    if config.method == "none":
        return Hold(skeleton)
    if config.database is None:
        database = embedded_database(skeleton)
    else:
        database = PostureDatabase.load(config.database)
    if database.skeleton.name != skeleton.name:
        raise InputError(
            f"{config.database}: a database of {database.skeleton.name} postures, but "
            f"the take is {skeleton.name}; build one with 'kinefilter database build "
            f"--skeleton {skeleton.name}'"
        )
    return LocalPCA(database, search=config.search, seed=config.seed)


def _check(take: Take) -> None:
    present = ~np.isnan(take.positions[..., 0])
    if not present.any():
        raise InputError(
            f"{take.source}: every joint is missing in every frame; nothing to clean"
        )
    if take.time[-1] <= take.time[0]:
        raise InputError(
            f"{take.source}: the take has one distinct time stamp; "
            "a motion needs two frames or more"
        )


def _select(take: Take, kept: NDArray[np.bool_]) -> Take:
    return Take(
        take.time[kept],
        take.positions[kept],
        take.state[kept],
        take.skeleton,
        take.source,
    )


@dataclass(frozen=True)
class _Corrected:
    """A corrected take, on the person's body in the sensor's frame."""

    positions: Array
    rotations: NDArray[np.float32] | None
    trust: Array
    coverage: Array

    def twist(self, time: Array) -> NDArray[np.float32] | None:
        """Return the prior rotations, smoothed, that twist is taken from."""
        if self.rotations is None:
            return None
        smoothed = np.empty_like(self.rotations)
        weights = np.ones((len(time), 1))
        for j in range(smoothed.shape[1]):
            signed = continuous(self.rotations[:, j, None].astype(float))
            smoothed[:, j] = smooth(time, signed, weights, cutoff=_TWIST_CUTOFF)[:, 0]
        return smoothed

    def origin(self, raw: Array) -> NDArray[np.uint8]:
        """Return where each joint came from (Origin), shape (T, J)."""
        origin = np.where(self.trust >= 1.0, Origin.MEASURED, Origin.CORRECTED)
        filled = np.isnan(raw[..., 0])
        return np.where(filled, Origin.FILLED, origin).astype(np.uint8)


def _orient(positions: Array, body: Body, prior: NDArray[np.float32] | None) -> Array:
    """Return segment rotations of a motion, continuous over time, (T, J, 4)."""
    rotations = np.empty((*positions.shape[:2], 4))
    for part in _chunks(len(positions)):
        twist = None if prior is None else normalize(prior[part].astype(float))
        rotations[part] = rotations_from_positions(positions[part], body, twist)
    return continuous(rotations)


def _pose(rotations: Array, root: Array, body: Body) -> Array:
    """Return the joint positions of a motion [m], shape (T, J, 3)."""
    positions = np.empty((*rotations.shape[:2], 3))
    for part in _chunks(len(rotations)):
        positions[part] = positions_from_rotations(rotations[part], root[part], body)
    return positions


def _chunks(count: int) -> Iterator[slice]:
    """Yield slices that cover ``count`` frames: an hour's take fits a gigabyte."""
    return (slice(k, k + _CHUNK) for k in range(0, count, _CHUNK))


def _correct(
    take: Take,
    body: Body,
    reliability: Reliability,
    corrector: Corrector,
    progress: Progress,
) -> _Corrected:
    count, joints = take.state.shape
    positions, trust = np.empty((count, joints, 3)), np.empty((count, joints))
    coverage = np.empty(count)
    rotations: NDArray[np.float32] | None = None
    standardizer = Standardizer(body)
    corrector.start()
    for k in progress("correct", count):
        rate = reliability.rate[k]
        standard, view = standardizer.step(take.positions[k], rate)
        result = corrector.step(Observation(standard, rate, reliability.geometry[k]))
        positions[k] = standardizer.undo(result.positions, view)
        trust[k], coverage[k] = result.trust, result.coverage
        if result.rotations is not None:
            if rotations is None:
                rotations = np.empty((count, joints, 4), dtype=np.float32)
            rotations[k] = view.restore_rotations(result.rotations)
    return _Corrected(positions, rotations, trust, coverage)
