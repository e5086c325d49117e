"""Makes training pairs: Kinect takes, and the mocap of the same movement beside them.

A take and its mocap agree in nothing but the movement: clocks, frames and axes are each
their own. The lag is found first (``lags``), then one rigid transform that lays the
mocap's joints onto the take's. Takes of a session share that transform, as neither
sensor nor mocap moved, and the offset of the clocks where their lags say so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from kinefilter.characters import InputError, Skeleton, State, Take
from kinefilter.characters.arrays import Array
from kinefilter.characters.motion import nominal_step
from kinefilter.pipeline.formats.recording import Mocap
from kinefilter.pipeline.merge.lag import Clock, Track
from kinefilter.pipeline.merge.rigid import SIGMA, Placement, placement
from kinefilter.pipeline.pairs import PairedTake
from kinefilter.pipeline.progress import Progress, over, silent
from kinefilter.pipeline.reliability import column_medians, segment_lengths

from .accuracy import LIMBS
from .lags import SHORTEST_FOR_DRIFT, correlated, distances, find_drift, refined
from .marker_sets import MarkerSet, joint_centers

EXPLAINED = 0.55
"""Share of a take's movement that its own mocap explains at least.

Chosen on s02, s03 and s04 of UI-PRMD, of whose true pairs it takes 97 %. On s06, s07
and s08, clips of 2.5 s, it takes 97 % of the true pairs, 1 % of those with the mocap of
another exercise, 5 % with that of another person's same exercise, and 32 % with that of
another repetition by the same person: ``python tests/pairing_figures.py ../shared/data
s06 s07 s08``."""

_FEWEST_JOINTS = 6
_SHORTEST = 1.0  # s that both recordings must have in common
_SHARE = 0.5  # of the shorter recording that must be in the other
_ANKLE = 0.06
"""How far up the shank a Kinect has the ankle [m]; chosen on s02, s03 and s04."""
_LEAST_MOVED = 0.01  # m: standard deviation of distances; nobody moves who has less
_SAME_CLOCK = 0.5  # of a frame that lags of one clock offset may differ
_SAME_PLACE = np.radians(5.0), 0.10
"""Angle, and distance [m] of the body, by which takes of a session may be placed
differently: those of a person in UI-PRMD differ by up to 3 degrees. A guess."""
_FEW = 0.2  # of the frames may be lost; they say nothing of the others. A guess
_STRETCHED = 0.25  # share by which no bone changes its length
_LOST_FRAME, _LOST_JOINT = 0.20, 0.30
"""Medians of distances [m] of a frame, and of a joint over a take, that no sensor gives
that follows the person: 0.16 m and 0.25 m (99.9 %) are the most of s02, s03 and s04."""
_SIZES = 0.20
"""Share by which the bones of one person may differ, in the median: those of s02, s03
and s04 differ by up to 14 %."""
_RATES = 0.05  # share by which frame rates in a file may differ


@dataclass(frozen=True, eq=False)
class Pairing:
    """A take, its mocap in the take's time and frame, and how they were found."""

    pair: PairedTake
    """Take and truth, at an even rate; NaN where there is none or none to trust."""
    clock: Clock
    """What the mocap's clock shows at the take's times."""
    placed: Placement
    """From the mocap's axes, in meters, to the take's frame; where the mocap has joints
    and its z is up, from the axes x, z, -y."""
    explained: float
    """Share of the take's movement that the mocap explains."""
    notes: tuple[str, ...]
    """What was left out or could not be told."""

    @property
    def away(self) -> Array:
        """Distance of each joint from the mocap [m], shape (T, J)."""
        return np.asarray(self._norms(self.pair.take.positions - self.pair.truth))

    @property
    def varying(self) -> Array:
        """The same without each joint's mean difference over the take."""
        apart = self.pair.take.positions - self.pair.truth
        with np.errstate(invalid="ignore"):
            mean = np.nansum(apart, axis=0) / (~np.isnan(apart)).sum(axis=0)
        return np.asarray(self._norms(apart - mean))

    @staticmethod
    def _norms(apart: Array) -> Array:
        return np.asarray(np.linalg.norm(apart, axis=2))


class _Match(NamedTuple):
    """A take and its mocap's joints, when they lie together, and what was told."""

    take: Take
    mocap: Track  # all joints, in its own axes
    clock: Clock
    notes: tuple[str, ...]

    def seen(self) -> Array:
        """Return the mocap's joints at the take's frames, in its own axes [m]."""
        return self.mocap.at(self.clock.at(self.take.time))


def pair_session(
    recordings: Sequence[tuple[Take, Mocap]],
    *,
    subject: str,
    names: Sequence[str] = (),
    table: MarkerSet | None = None,
    least: float = EXPLAINED,
    progress: Progress = silent,
) -> tuple[list[Pairing], list[str]]:
    """Return pairs of a person's takes and mocap, and why others are left out.

    Args:
        recordings: Takes, each with mocap of the same movement; sensor and mocap stood
            where they stand, all the time.
        subject: Who moves.
        names: Of the clips; by default those of the takes' files.
        table: Where joints lie among markers, see ``joint_centers``.
        least: Share of a take's movement that its mocap has to explain.
        progress: Wraps the loop over takes, for a progress bar.

    Raises:
        InputError: No take can be paired, or they are of different skeletons or rates.
    """
    takes = [take for take, _ in recordings]
    _check_alike(takes)
    clips = names or [Path(take.source).name.split(".")[0] for take in takes]
    matches: list[_Match] = []
    refused: list[str] = []
    kept: list[str] = []
    for k in over(range(len(recordings)), "pair", progress):
        take, mocap = recordings[k]
        try:
            joints = joint_centers(mocap, take.skeleton, table)
            matches.append(_match(take, joints, least))
            kept.append(clips[k])
        except InputError as error:
            refused.append(str(error))
    if not matches:
        raise InputError("; ".join(refused))
    matches = _on_one_clock(matches)
    shared = _placed(matches)
    pairings = [
        _pairing(match, shared, subject, clip)
        for clip, match in zip(kept, matches, strict=True)
    ]
    return pairings, refused


def _check_alike(takes: Sequence[Take]) -> None:
    first = takes[0]
    for take in takes:
        if take.skeleton != first.skeleton:
            raise InputError(
                f"{take.source}: {take.skeleton.name}, but {first.source} is "
                f"{first.skeleton.name}; pair them into files of their own"
            )
        rates = 1.0 / nominal_step(take.time), 1.0 / nominal_step(first.time)
        if not abs(rates[0] / rates[1] - 1.0) < _RATES:
            raise InputError(
                f"{take.source}: {rates[0]:.3g} frames a second, but {first.source} "
                f"has {rates[1]:.3g}; pair them into files of their own"
            )


def _match(take: Take, joints: Mocap, least: float) -> _Match:
    """Find lag, drift and transform, or raise InputError where there are none."""
    both = f"{take.source} and {joints.source}"
    skeleton, notes = take.skeleton, []
    time = np.arange(len(joints.positions), dtype=np.float64) * joints.frame_time
    positions, stretched = _trusted(joints.positions, skeleton)
    if stretched > 0.0:
        notes.append(
            f"{stretched:.1%} of the mocap's joints are left out, as bones changed "
            f"their lengths by over {_STRETCHED:.0%} there"
        )
    _check_size(take, positions, both)
    common = [
        j
        for j in [skeleton.index(joint) for joint in LIMBS]
        if not np.isnan(take.positions[:, j]).all()
        and not np.isnan(positions[:, j]).all()
    ]
    if len(common) < _FEWEST_JOINTS:
        raise InputError(
            f"{both}: have {len(common)} joints of the limbs in common, expected "
            f"{_FEWEST_JOINTS} or more"
        )
    seen = Track(take.time, take.positions[:, common])
    there = Track(time, positions[:, common])
    length = min(float(track.time[-1] - track.time[0]) for track in (seen, there))
    if length < _SHORTEST:
        raise InputError(
            f"{both}: {length:.2g} s are too short; expected {_SHORTEST:g} s or more"
        )
    apart = [distances(track) for track in (seen, there)]
    for values, source in zip(apart, (take.source, joints.source), strict=True):
        if not np.nanstd(values - column_medians(values)) > _LEAST_MOVED:
            raise InputError(
                f"{source}: nobody moves, so nothing tells when its frames were "
                "recorded; pair takes with movement in them"
            )
    common_time = max(_SHORTEST, _SHARE * length)
    found = correlated(apart[0], apart[1], common_time)
    if found is None:
        raise InputError(
            f"{both}: at no lag do both know for {common_time:.2g} s where the joints "
            "are; give recordings of the same time"
        )
    clock = Clock(float(take.time[0]), found.seconds)
    if length >= SHORTEST_FOR_DRIFT:
        clock = find_drift(apart[0], apart[1], clock) or clock
    else:
        notes.append(f"{length:.1f} s are too short to tell whether the clocks drift")
    clock = refined(seen, there, clock)
    match = _Match(take, Track(time, positions), clock, tuple(notes))
    explained = _explained(match, _placed([match]))
    if not explained >= least:
        raise InputError(
            f"{both}: at the best lag, {clock.lag:.2f} s, the mocap explains "
            f"{max(explained, 0.0):.0%} of the movement, expected {least:.0%} or more: "
            "is it another movement, another person, or another time? If it is not, "
            "lower --least"
        )
    return match


def _check_size(take: Take, positions: Array, both: str) -> None:
    """Raise InputError where the two are of bodies of different size."""
    lengths = [
        column_medians(segment_lengths(side, take.skeleton))[take.skeleton.segments]
        for side in (take.positions, positions)
    ]
    ratios = lengths[0] / lengths[1]
    ratios = ratios[np.isfinite(ratios)]
    ratio = float(np.median(ratios)) if len(ratios) else 1.0
    if abs(np.log(ratio)) > _SIZES:
        raise InputError(
            f"{both}: the take's bones are {ratio:.2f} times as long as the mocap's; "
            "they are of two people, or of a table that does not fit the markers"
        )


def _trusted(positions: Array, skeleton: Skeleton) -> tuple[Array, float]:
    """Return mocap without joints whose bones change their lengths, and their share."""
    lengths = segment_lengths(positions, skeleton)
    lengths[:, skeleton.root] = 1.0  # has no bone
    with np.errstate(divide="ignore", invalid="ignore"):
        wrong = np.abs(lengths / column_medians(lengths) - 1.0) > _STRETCHED
    return np.where(wrong[..., None], np.nan, positions), float(wrong.mean())


def _placed(matches: Sequence[_Match]) -> Placement:
    """Return the transform that lays the mocap of all matches onto their takes."""
    skeleton = matches[0].take.skeleton
    used = [*(skeleton.index(joint) for joint in LIMBS), skeleton.girdle]
    seen, there = [], []
    for match in matches:
        joints = match.seen()
        knees, ankles = skeleton.sides("Knee"), skeleton.sides("Ankle")
        shanks = joints[:, knees] - joints[:, ankles]
        lengths = np.linalg.norm(shanks, axis=2, keepdims=True)
        joints[:, ankles] += _ANKLE * shanks / lengths
        seen.append(joints[:, used])
        there.append(match.take.positions[:, used])
    return placement(np.concatenate(seen), np.concatenate(there))


def _explained(match: _Match, placed: Placement) -> float:
    """Return the share of the take's movement that its mocap explains.

    Each joint's constant difference is a matter of what is called that joint. Squared
    distances count as lag and transform count them, by the logarithm: a limb that the
    sensor loses for a while tells little of whether the recordings belong together.
    """
    skeleton = match.take.skeleton
    limbs = [skeleton.index(joint) for joint in LIMBS]
    joints = match.take.positions[:, limbs]
    apart = placed.apply(match.seen()[:, limbs]) - joints
    lost = column_medians(np.linalg.norm(apart, axis=2).T) > _LOST_FRAME
    if lost.mean() < _FEW:
        apart[lost] = np.nan
    joints = np.where(np.isnan(apart), np.nan, joints)
    left, moved = (
        np.log1p(np.sum((v - _median(v)) ** 2, axis=2) / SIGMA**2)
        for v in (apart, joints)
    )
    return 1.0 - float(np.nansum(left) / np.nansum(moved))


def _median(values: Array) -> Array:
    """Return each joint's median over frames, NaN where it is never known, (J, 3)."""
    flat = column_medians(values.reshape(len(values), -1))
    return np.asarray(flat.reshape(values.shape[1:]))


def _on_one_clock(matches: list[_Match]) -> list[_Match]:
    """Return matches with one clock offset, if their lags agree and none drifts."""
    offsets = np.array([m.clock.lag - m.clock.start for m in matches])
    step = nominal_step(matches[0].take.time)
    spread = np.ptp(offsets)
    if len(matches) < 2 or spread > _SAME_CLOCK * step:
        return matches
    if any(match.clock.drift for match in matches):
        return matches
    offset, apart = float(np.median(offsets)), f"{spread * 1e3:.0f} ms"
    note = f"the takes share one clock offset; alone they differ by {apart}"
    clocks = [m.clock._replace(lag=offset + m.clock.start) for m in matches]
    return [
        m._replace(clock=clock, notes=(*m.notes, note))
        for m, clock in zip(matches, clocks, strict=True)
    ]


def _pairing(match: _Match, shared: Placement, subject: str, clip: str) -> Pairing:
    """Return a pair at an even rate, without what cannot be trusted."""
    take, notes = match.take, list(match.notes)
    skeleton, placed = take.skeleton, shared
    own, seen = _placed([match]), match.seen()
    body = seen[:, skeleton.hips].reshape(-1, 3)
    body = body[~np.isnan(body).any(axis=1)].mean(axis=0)
    angle = float((own.turn * shared.turn.inv()).magnitude())
    apart = float(np.linalg.norm(own.apply(body) - shared.apply(body)))
    if angle > _SAME_PLACE[0] or apart > _SAME_PLACE[1]:
        placed = own
        notes.append(
            f"lies {np.degrees(angle):.1f} degrees and {100 * apart:.0f} cm from where "
            "the session's transform lays it, so it has its own: did the sensor move?"
        )
    truth = placed.apply(seen)
    away = np.linalg.norm(take.positions - truth, axis=2)
    lost = column_medians(away.T) > _LOST_FRAME
    truth[lost] = np.nan
    far = column_medians(np.where(lost[:, None], np.nan, away)) > _LOST_JOINT
    truth[:, far] = np.nan
    if lost.any():
        notes.append(
            f"{lost.sum()} frames are left out, as half of the joints are over "
            f"{100 * _LOST_FRAME:.0f} cm from the mocap"
        )
    for j in np.flatnonzero(far):
        notes.append(
            f"{skeleton.joints[j]} is left out, as it is mostly over "
            f"{100 * _LOST_JOINT:.0f} cm from the mocap; are its markers named right?"
        )
    rows = np.flatnonzero(~np.isnan(truth).all(axis=(1, 2)))
    if len(rows) * nominal_step(take.time) < _SHORTEST:
        raise InputError(
            f"{take.source}: {len(rows)} frames are left that can be trusted; "
            + "; ".join(notes)
        )
    inside = slice(rows[0], rows[-1] + 1)
    if outside := len(take) - (inside.stop - inside.start):
        notes.append(f"{outside} frames are before or after the mocap")
    even, truth = _even(take, truth, inside)
    return Pairing(
        PairedTake(even, truth, subject, clip),
        match.clock,
        placed,
        _explained(match, placed),
        tuple(notes),
    )


def _even(take: Take, truth: Array, rows: slice) -> tuple[Take, Array]:
    """Return frames at the take's nominal rate, as pairs files have no time stamps.

    Each is as it was recorded, at most half a step from its place; of frames in one
    place the first is kept, and a place without any is a frame in which nobody is seen.
    """
    step = nominal_step(take.time)
    time = take.time[rows]
    places, first = np.unique(
        np.round((time - time[0]) / step).astype(int), return_index=True
    )
    shape = (places[-1] + 1, len(take.skeleton))
    positions, there = (np.full((*shape, 3), np.nan) for _ in range(2))
    state = np.full(shape, State.NOT_TRACKED, dtype=np.uint8)
    positions[places] = take.positions[rows][first]
    there[places] = truth[rows][first]
    state[places] = take.state[rows][first]
    stamps = np.arange(shape[0]) * step
    return Take(stamps, positions, state, take.skeleton, take.source), there
