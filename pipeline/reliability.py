"""The reliability of each joint in each frame, and the person's measurements.

The default scorer, after Shum 2013, section IV; ``pipeline.methods`` names the others.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from kinefilter.characters import Body, Skeleton, State, Take
from kinefilter.characters.arrays import Array, Codes, Flags, chunks
from kinefilter.characters.rotations import unit
from kinefilter.characters.skeleton import SIDES
from kinefilter.retarget import measured_body

_CHUNK = 4096  # frames at a time, to bound the memory
_AVERAGED = 6  # frames over which scores are averaged (eq. 8)
_LATELY = 300  # frames that tell what is usual in live motion. A guess.
_ENOUGH = 16  # frames that tell the length of a segment. A guess.


@dataclass(frozen=True, eq=False)
class Reference:
    """The person's segment lengths and directions, against which frames are judged."""

    lengths: Array  # of the segment to each joint [m], NaN if never seen or root, (J,)
    directions: Array
    """Median direction of trunk, hip and shoulder segments in the trunk's frame (x is
    left, y along the spine), as this sensor sees them, NaN for others, shape (J, 3)."""
    from_reference_posture: bool  # measured in a T-pose or standing, as Shum does


@dataclass(frozen=True, eq=False)
class Scores:
    """Reliability of every joint in every frame."""

    reliability: Array  # R in [0, 1], shape (T, J) (eq. 8)
    term: Codes  # the deciding term (Term) of the frame itself, shape (T, J)
    geometry: Array  # from positions alone, without the tracking state, (T, J)


class UsualScores:
    """The usual scores of joints, for frames in which a hidden limb spoils them.

    A joint that was hidden and reconstructed has no score of its own. It also lowers
    those of the joints beside it, and those of the next frames, as they are averaged.
    """

    def __init__(self, skeleton: Skeleton) -> None:
        ends, starts = skeleton.segments, skeleton.segment_parents
        self._near = np.eye(len(skeleton), dtype=np.bool_)
        self._near[ends, starts] = self._near[starts, ends] = True
        self._usual = np.ones((2, len(skeleton)))
        self._counts = np.zeros(len(skeleton))
        self._since = np.full(len(skeleton), _AVERAGED)

    def step(self, scores: Array, hidden: Flags, tracked: Flags) -> Array:
        """Return the next frame's scores, the usual ones where spoiled, shape (2, J).

        ``scores`` are reliability and geometry (2, J); ``hidden`` and ``tracked`` (J,).
        What is usual is the mean of the last seconds.
        """
        self._since = np.where(self._beside(hidden), 0, self._since + 1)
        spoiled = self._since < _AVERAGED
        good = tracked & ~spoiled
        self._counts[good] = np.minimum(self._counts[good] + 1, _LATELY)
        self._usual[:, good] += (scores - self._usual)[:, good] / self._counts[good]
        known = hidden | spoiled & (self._counts > 0)
        return np.where(known, self._usual, scores)

    def whole(self, scores: Array, hidden: Flags, tracked: Flags) -> Array:
        """Return a take's scores, the usual ones where spoiled, shape (2, T, J).

        Arguments are as for ``step``, with an axis T. What is usual is the median over
        the frames that are good.
        """
        beside, scores = self._beside(hidden), scores.copy()
        spoiled = beside.copy()
        for k in range(1, _AVERAGED):
            spoiled[k:] |= beside[:-k]
        good = tracked & ~spoiled
        for j in np.flatnonzero(spoiled.any(axis=0)):
            if good[:, j].any():
                usual = np.median(scores[:, good[:, j], j], axis=1)
                scores[:, spoiled[:, j], j] = usual[:, None]
            else:
                scores[:, hidden[:, j], j] = 1.0
        return scores

    def _beside(self, hidden: Flags) -> Flags:
        """Return flags (..., J) of hidden joints and those at their segments."""
        return np.asarray(hidden @ self._near)


class RecentLengths:
    """A person's segment lengths, measured again and again in live motion.

    Who is followed may have been measured for a second only, or not at all.
    """

    def __init__(self, skeleton: Skeleton) -> None:
        self._skeleton, self._count = skeleton, 0
        self._lengths = np.full((_LATELY, len(skeleton)), np.nan)

    def step(self, positions: Array, state: Codes) -> Array | None:
        """Return median lengths [m] (J,) over the last seconds after some frames.

        A segment counts where both ends are tracked; NaN for one that rarely was.
        """
        tracked, ends = state == State.TRACKED, self._skeleton.segments
        tracked[ends] &= tracked[self._skeleton.segment_parents]
        lengths = segment_lengths(positions, self._skeleton)
        lengths[~tracked | (lengths < 1e-3)] = np.nan  # joints that always coincide
        self._lengths[self._count % _LATELY] = lengths
        self._count += 1
        early = self._count.bit_count() == 1 and self._count >= _ENOUGH
        if not early and self._count % _LATELY:
            return None
        rarely = np.isfinite(self._lengths).sum(axis=0) < _ENOUGH
        return np.where(rarely, np.nan, column_medians(self._lengths))


def segment_lengths(positions: Array, skeleton: Skeleton) -> Array:
    """Return the length [m] of each joint's segment, root 0, shape (..., J)."""
    lengths, ends = np.zeros(positions.shape[:-1]), skeleton.segments
    bones = skeleton.bones(positions)
    lengths[..., ends] = np.sqrt(np.sum(bones * bones, axis=-1))
    return lengths


def measure_reference(take: Take) -> Reference:
    """Measure the person's segments where the sensor sees them best.

    That is in frames in T-pose or standing with every joint tracked (section IV.B). If
    the take has fewer than 5 of these, medians are taken over all frames in which both
    ends of the segment are tracked, or else over all in which both are present.
    """
    skeleton = take.skeleton
    lengths = segment_lengths(take.positions, skeleton)
    lengths[:, skeleton.root] = np.nan
    tracked = take.state == State.TRACKED
    both = tracked.copy()
    both[:, skeleton.segments] &= tracked[:, skeleton.segment_parents]
    ever = tracked.any(axis=0)
    posed = tracked[:, ever].all(axis=1) & _in_reference_posture(take)
    enough = bool(ever.any()) and int(posed.sum()) >= 5
    # The best available for each segment: posed, both ends tracked, both present.
    best = np.full(len(skeleton), np.nan)
    for usable in (both & posed[:, None] & enough, both, np.ones_like(both)):
        medians = column_medians(np.where(usable, lengths, np.nan))
        best = np.where(np.isnan(best), medians, best)
    best = np.where(best > 1e-3, best, np.nan)  # joints that always coincide
    return Reference(best, _trunk_directions(take), enough)


def rest_reference(body: Body) -> Reference:
    """Return the reference of a body that is already known."""
    count = len(body.skeleton)
    still = np.broadcast_to(body.rest_positions, (2, count, 3)).copy()
    state = np.full((2, count), State.TRACKED, dtype=np.uint8)
    return measure_reference(Take(np.array([0.0, 1.0]), still, state, body.skeleton))


def measure_body(
    take: Take,
    reference: Reference | None = None,
    *,
    height: float | None = None,
    mass: float | None = None,
) -> Body:
    """Return the body of the person in a take.

    By default the reference is measured in the take, the height [m] follows from it,
    and the mass [kg] from the height. Raises InputError for an inhuman height or mass.
    """
    found = reference or measure_reference(take)
    sizes: dict[str, Any] = {"height": height, "mass": mass, "source": take.source}
    return measured_body(take.skeleton, found.lengths, found.directions, **sizes)


def _trunk_directions(take: Take) -> Array:
    """Return median directions of trunk segments in the trunk's frame, (J, 3)."""
    skeleton = take.skeleton
    directions = np.full((len(skeleton), 3), np.nan)
    left, right = skeleton.across
    trunk = [*left, *right, *skeleton.ancestors(skeleton.girdle)]
    seen = (take.state[:, [skeleton.root, *trunk]] == State.TRACKED).all(axis=1)
    if not seen.any():
        return directions
    points = take.positions[seen]
    up = points[:, skeleton.girdle] - points[:, skeleton.root]
    front = np.cross((points[:, left] - points[:, right]).sum(axis=1), up)
    frame = np.stack([np.cross(up, front), up, front], axis=1)
    frame /= np.maximum(np.linalg.norm(frame, axis=2, keepdims=True), 1e-9)
    for j in trunk:
        bones = points[:, j] - points[:, skeleton.parents[j]]
        median = np.median((frame @ bones[..., None])[..., 0], axis=0)
        if (norm := np.linalg.norm(median)) > 1e-9:
            directions[j] = median / norm
    return directions


def column_medians(values: Array) -> Array:
    """Return medians over axis 0 that ignore NaN; NaN for columns of only NaN."""
    known = np.count_nonzero(~np.isnan(values), axis=0)
    middle = np.maximum([(known - 1) // 2, known // 2], 0)
    ordered = np.sort(values, axis=0)  # NaN at the end
    return np.asarray(np.take_along_axis(ordered, middle, axis=0).mean(axis=0))


def _in_reference_posture(take: Take) -> Flags:
    """Return the frames in T-pose or standing: limbs straight, trunk upright."""
    skeleton = take.skeleton
    trunk = take.positions[:, skeleton.girdle] - take.positions[:, skeleton.root]
    upright = trunk[:, 1] > 0.94 * np.linalg.norm(trunk, axis=1)  # within 20 degrees

    def rise(*ends: str) -> Array:
        """Return the sine of each segment's elevation, (4, T)."""
        joints = [skeleton.index(end + side) for side in SIDES for end in ends]
        starts = [skeleton.parents[j] for j in joints]
        return unit(take.positions[:, joints] - take.positions[:, starts])[..., 1].T

    arms = rise("Elbow", "Wrist")
    down, sideways = (arms < -0.9).all(axis=0), (np.abs(arms) < 0.34).all(axis=0)
    legs = (rise("Knee", "Ankle") < -0.94).all(axis=0)
    return np.asarray(upright & legs & (down | sideways))


class ReliabilityScorer:
    """Scores frame by frame; a whole take gets the same scores.

    Args:
        skeleton: The joints.
        reference: The person's segment lengths.
        smallest_displacement: d_min [m]: smaller displacements have no angle (eq. 3).
        vibration_frames: f_b, number of angles the behavior term averages (eq. 4).
        angle_floor: theta_floor [degrees], up to which the behavior term is 1.
        angle_roof: theta_roof [degrees], from which on it is 0.
        rate_frames: f_total, number of frames the reliability averages (eq. 8).
    """

    def __init__(
        self,
        skeleton: Skeleton,
        reference: Reference,
        *,
        smallest_displacement: float = 0.03,
        vibration_frames: int = 3,
        angle_floor: float = 90.0,
        angle_roof: float = 135.0,
        rate_frames: int = _AVERAGED,
    ) -> None:
        self._least, self._vibration = smallest_displacement, vibration_frames
        self._floor, self._roof = np.radians([angle_floor, angle_roof])
        self.skeleton = skeleton
        self.reference = reference
        n, ends = len(skeleton), skeleton.segments
        # A joint's kinematics term is the mean over the measured segments it touches.
        known = np.isfinite(reference.lengths[ends])
        touch = np.zeros((n, len(ends)))
        for joints in (ends, skeleton.segment_parents):
            touch[joints, np.arange(len(ends))] = known
        self._touch = touch / np.maximum(touch.sum(axis=1, keepdims=True), 1.0)
        self._free = 1.0 - self._touch.sum(axis=1)  # 1 where nothing was measured
        self._lengths = np.where(known, reference.lengths[ends], 1.0)
        age = np.arange(rate_frames)
        # The paper leaves the width unspecified: the oldest frame is at two sigma.
        weights = np.exp(-0.5 * (2.0 * age / max(rate_frames - 1, 1)) ** 2)
        # Row k weights the first k + 1 frames.
        weights = np.tril(np.tile(weights, (rate_frames, 1)))
        self._weights = weights / weights.sum(axis=1, keepdims=True)
        self.start()

    def start(self) -> None:
        """Reset the state for a new motion."""
        n = len(self.skeleton)
        self._frames = 0
        # What is averaged with the next frames, oldest first.
        self._last = np.full((2, n, 3), np.nan)
        self._angles = np.zeros((self._vibration - 1, n))
        self._scores = np.zeros((len(self._weights) - 1, 2, n))

    def remeasure(self, lengths: Array) -> None:
        """Judge the next frames by other segment lengths [m] (J,), where not NaN."""
        lengths = lengths[self.skeleton.segments]
        self._lengths = np.where(np.isnan(lengths), self._lengths, lengths)

    def step(
        self,
        positions: Array,
        state: Codes,
        time: float | None = None,  # noqa: ARG002 - Shum's terms count frames
    ) -> tuple[Array, Codes, Array]:
        """Return reliability, deciding term and geometry of the next frame, (J,).

        Joint positions [m] (J, 3) are NaN where missing; the states (J,) are State's.
        The time stamp [s] is for scorers that need it; without one, they assume 30 Hz.
        """
        reliability, term, geometry = self._next(positions[None], state[None])
        return reliability[0], term[0], geometry[0]

    def score(self, take: Take) -> Scores:
        """Score a whole take, as ``start`` and a ``step`` for each frame do."""
        self.start()
        parts = [
            self._next(take.positions[k], take.state[k], take.time[k])
            for k in chunks(len(take), _CHUNK)
        ]
        reliability, term, geometry = map(np.concatenate, zip(*parts, strict=True))
        return Scores(reliability, term, geometry)

    def _next(
        self,
        positions: Array,
        state: Codes,
        time: Array | None = None,  # noqa: ARG002 - see ``step``
    ) -> tuple[Array, Codes, Array]:
        """Return reliability, deciding term and geometry of the next frames, (T, J)."""
        behavior, kinematics = self._behavior(positions), self._kinematics(positions)
        tracked = (state == State.TRACKED).astype(float)  # eq. 7
        terms = np.array([behavior, kinematics, tracked])
        term = terms.argmin(axis=0).astype(np.uint8)
        geometry = np.minimum(behavior, kinematics)
        scores = np.stack([np.minimum(geometry, tracked), geometry], axis=1)
        scores = np.concatenate([self._scores, scores])
        count, kept = len(positions), len(self._scores)
        # Eq. 8, with weights normalized over the frames so far.
        weights = self._weights[np.minimum(self._frames + np.arange(count), kept)]
        mean = np.zeros((count, *scores.shape[1:]))
        for age, weight in enumerate(weights.T):
            mean += weight[:, None, None] * scores[kept - age :][:count]
        self._frames, self._scores = self._frames + count, scores[count:]
        return mean[:, 0], term, mean[:, 1]

    def _behavior(self, positions: Array) -> Array:
        """Return the behavior term, which sharp turns lower (eq. 1-4)."""
        path = np.concatenate([self._last, positions])
        self._last = path[-2:]
        moved = np.diff(path, axis=0)
        distance = np.sqrt(np.vecdot(moved, moved))
        # False where a position is missing: then there is no angle.
        turned = np.minimum(distance[:-1], distance[1:]) > self._least
        both = np.where(turned, distance[:-1] * distance[1:], 1.0)
        cosine = np.vecdot(moved[:-1], moved[1:]) / both
        # Eq. 3 prints the cosine, but its thresholds are angles.
        angle = np.arccos(np.minimum(np.maximum(cosine, -1.0), 1.0))
        angles = np.concatenate([self._angles, np.where(turned, angle, 0.0)])
        self._angles = angles[len(positions) :]
        some = (angles[k:][: len(positions)] for k in range(self._vibration))
        mean = sum(some, np.zeros(())) / self._vibration
        excess = np.maximum(np.minimum(mean, self._roof) - self._floor, 0.0)
        return np.asarray(1.0 - excess / max(self._roof - self._floor, 1e-9))

    def _kinematics(self, positions: Array) -> Array:
        """Return the segment-length term (eq. 5-6).

        It is the mean over the segments that have both ends; 0 where none has.
        """
        bones = self.skeleton.bones(positions)
        lengths = np.sqrt(np.vecdot(bones, bones))
        right = 1.0 - np.minimum(np.abs(lengths - self._lengths) / self._lengths, 1.0)
        there = np.isfinite(right)
        right[~there] = 0.0
        share = (self._touch @ there[..., None])[..., 0]
        mean = (self._touch @ right[..., None])[..., 0] / np.maximum(share, 1e-9)
        return np.asarray(mean + self._free)
