"""Pairs Kinect takes with marker mocap of the same movement.

Each has its own clock, frame rate and axes. First the lag is found, then one rigid
transform from the mocap's joints to the take's. All takes of a session share it, and
the clock offset if their lags agree.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from kinefilter.characters import InputError, Skeleton, State, Take
from kinefilter.characters.arrays import Array, Flags
from kinefilter.characters.motion import nominal_step
from kinefilter.pipeline.formats.plain import counted
from kinefilter.pipeline.formats.recording import Mocap
from kinefilter.pipeline.merge.alignment import TwoTakes
from kinefilter.pipeline.merge.lag import Clock, Spline, best_lag, distances, refine_lag
from kinefilter.pipeline.merge.rigid import SIGMA, Placement, placement
from kinefilter.pipeline.pairs import PairedTake, check_same_skeleton
from kinefilter.pipeline.progress import Progress, over, silent
from kinefilter.pipeline.reliability import column_medians, segment_lengths

from .accuracy import LIMBS, mean_of_known
from .marker_sets import MarkerSet, joint_centers

EXPLAINED = 0.55
"""Minimum share of a take's movement that its mocap must explain.

Chosen on s02, s03 and s04 of UI-PRMD. On s06, s07 and s08, with clips of 2.5 s, it
accepts 97 % of the true pairs, 1 % of those with mocap of another exercise, 5 % with
another person's of the same, and 32 % with another repetition
(``tests/pairing_figures.py``)."""

_FEWEST_JOINTS = 6
_SHORTEST_FOR_DRIFT = 40.0  # s: a clock gains less than a tenth of a frame in that
_SHORTEST = 1.0  # s that both recordings must have in common
_SHARE = 0.5  # of the shorter recording that must overlap the other
_ANKLE = 0.06  # m up the shank, where a Kinect places it; from s02, s03 and s04
_LEAST_MOVED = 0.01  # m: minimum standard deviation of joint distances in a movement
_SAME_CLOCK = 0.5  # frames by which lags of the same clock offset may differ
_SAME_PLACE = np.radians(5.0), 0.10
"""Angle, and distance [m] of the body, by which a take's transform may differ from its
session's; within a person of UI-PRMD it is up to 3 degrees. A guess."""
_FEW = 0.2  # share of outlier frames that are ignored in the explained share; a guess
_STRETCHED = 0.25  # relative change of a bone's length that marks its joint as wrong
_LOST_FRAME, _LOST_JOINT = 0.20, 0.30
"""Median distances [m] over a frame, and for a joint over a take, beyond which the
sensor has lost the person: in s02 to s04, 99.9 % are below 0.16 m and 0.25 m."""
_SIZES = 0.20  # log ratio of a person's median bone lengths; up to 14 % in s02 to s04
_RATES = 0.05  # relative difference allowed between frame rates in one file


@dataclass(frozen=True, eq=False)
class Pairing:
    """A take with its mocap in the take's time and frame, and how they were aligned."""

    pair: PairedTake  # at an even rate; NaN where missing or not trusted
    clock: Clock  # converts the take's times to the mocap's
    placed: Placement
    """From the mocap's axes, in meters, to the take's frame. For mocap with joints and
    z up, the source axes are x, z, -y."""
    explained: float  # share of the take's movement that the mocap explains
    notes: tuple[str, ...]  # what was left out or could not be determined

    @property
    def away(self) -> Array:
        """Distance of each joint from the mocap [m], shape (T, J)."""
        apart = self.pair.take.positions - self.pair.truth
        return np.asarray(np.linalg.norm(apart, axis=2))

    @property
    def varying(self) -> Array:
        """The same after subtracting each joint's mean offset over the take."""
        apart = self.pair.take.positions - self.pair.truth
        return np.asarray(np.linalg.norm(apart - mean_of_known(apart), axis=2))


class _Match(NamedTuple):
    """A take, its mocap's joints, and the clock that relates them."""

    clip: str
    take: Take
    mocap: Spline  # all joints, in its own axes
    clock: Clock
    notes: tuple[str, ...]

    def mocap_at_frames(self) -> Array:
        """Return the mocap's joints at the take's frames, in its own axes [m]."""
        return self.mocap.at(self.clock.at(self.take.time))


def pair_session(
    recordings: Sequence[tuple[Take, Mocap]],
    *,
    subject: str,
    table: MarkerSet | None = None,
    least: float = EXPLAINED,
    progress: Progress = silent,
) -> tuple[list[Pairing], list[str]]:
    """Return pairs of a person's takes and mocap, and why the others are left out.

    Neither the sensor nor the mocap system moved between the recordings. Clips are
    named after the takes' files; ``table`` locates joints among markers, see
    ``joint_centers``; ``least`` is the minimum share of a take's movement that its
    mocap must explain. Raises an InputError if no take can be paired, or if the takes
    differ in skeleton or frame rate.
    """
    takes = [take for take, _ in recordings]
    _check_alike(takes)
    clips = [Path(take.source).name.split(".")[0] for take in takes]
    matches: list[_Match] = []
    refused: list[str] = []
    for k, (take, mocap) in enumerate(over(recordings, "pair", progress)):
        try:
            joints = joint_centers(mocap, take.skeleton, table)
            matches.append(_match(clips[k], take, joints, least))
        except InputError as error:
            refused.append(str(error))
    if not matches:
        raise InputError("; ".join(refused))
    matches = _on_one_clock(matches)
    shared = _placed(matches)
    return [_pairing(match, shared, subject) for match in matches], refused


def _check_alike(takes: Sequence[Take]) -> None:
    first = takes[0]
    for take in takes:
        check_same_skeleton(take, first, "pair them into files of their own")
        rates = 1.0 / nominal_step(take.time), 1.0 / nominal_step(first.time)
        if not abs(rates[0] / rates[1] - 1.0) < _RATES:
            raise InputError(
                f"{take.source}: {rates[0]:.3g} frames a second, but {first.source} "
                f"has {rates[1]:.3g}; pair them into files of their own"
            )


def _match(clip: str, take: Take, joints: Mocap, least: float) -> _Match:
    both = f"{take.source} and {joints.source}"
    skeleton, notes = take.skeleton, []
    time = joints.stamps
    changed = changed_bones(joints.positions, skeleton)
    positions = np.where(changed[..., None], np.nan, joints.positions)
    if changed.any():
        notes.append(
            f"{changed.mean():.1%} of the mocap's joints are left out, as the lengths "
            f"of their bones change by over {_STRETCHED:.0%}"
        )
    _check_size(take, positions, both)
    sides = take.positions, positions
    known = np.all([~np.isnan(side).all(axis=(0, 2)) for side in sides], axis=0)
    common = [j for j in map(skeleton.index, LIMBS) if known[j]]
    if len(common) < _FEWEST_JOINTS:
        raise InputError(
            f"{both}: have {len(common)} joints of the limbs in common, expected "
            f"{_FEWEST_JOINTS} or more"
        )
    if absent := [name for name in LIMBS if not known[skeleton.index(name)]]:
        notes.append(
            f"{', '.join(absent)}: not in both recordings, so left out; are markers "
            "missing, or labeled otherwise?"
        )
    mocap_spline = Spline(time, positions[:, common])
    splines = Spline(take.time, take.positions[:, common]), mocap_spline
    length = min(float(spline.time[-1] - spline.time[0]) for spline in splines)
    if length < _SHORTEST:
        raise InputError(
            f"{both}: {length:.2g} s is too short; expected {_SHORTEST:g} s or more"
        )
    apart = [distances(spline) for spline in splines]
    for values, source in zip(apart, (take.source, joints.source), strict=True):
        if not np.nanstd(values - column_medians(values)) > _LEAST_MOVED:
            raise InputError(
                f"{source}: the person does not move, so the recordings cannot be "
                "aligned in time; pair takes with movement in them"
            )
    common_time = max(_SHORTEST, _SHARE * length)
    lag = best_lag(apart[0], apart[1], common_time)
    if lag is None:
        raise InputError(
            f"{both}: at no lag do both have joint positions for {common_time:.2g} s; "
            "give recordings of the same time"
        )
    clock = Clock(float(take.time[0]), lag)
    if length >= _SHORTEST_FOR_DRIFT:
        state = np.full(positions.shape[:2], State.TRACKED, dtype=np.uint8)
        two = TwoTakes(take, Take(time, positions, state, skeleton, joints.source))
        clock = two.find_drift(clock, two.place(clock)[0])
    else:
        notes.append(f"{length:.1f} s is too short to tell whether the clocks drift")
    clock = refine_lag(*splines, clock)
    match = _Match(clip, take, Spline(time, positions), clock, tuple(notes))
    explained = _explained(match, _placed([match]))
    if not explained >= least:
        raise InputError(
            f"{both}: at the best lag, {clock.lag:.2f} s, the mocap explains "
            f"{max(explained, 0.0):.0%} of the movement, expected {least:.0%} or more: "
            "is it another movement, another person, or another time? If not, lower "
            "--least"
        )
    return match


def _check_size(take: Take, positions: Array, both: str) -> None:
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
            "they show two people, or the marker table does not fit the markers"
        )


def changed_bones(positions: Array, skeleton: Skeleton) -> Flags:
    """Return the joints whose bone is not of its usual length, shape (T, J)."""
    lengths = segment_lengths(positions, skeleton)
    lengths[:, skeleton.root] = 1.0  # has no bone
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.abs(lengths / column_medians(lengths) - 1.0) > _STRETCHED


def _placed(matches: Sequence[_Match]) -> Placement:
    skeleton = matches[0].take.skeleton
    used = [*(skeleton.index(joint) for joint in LIMBS), skeleton.girdle]
    knees, ankles = skeleton.sides("Knee"), skeleton.sides("Ankle")
    points, onto = [], []
    for match in matches:
        joints = match.mocap_at_frames()
        shanks = joints[:, knees] - joints[:, ankles]
        lengths = np.linalg.norm(shanks, axis=2, keepdims=True)
        joints[:, ankles] += _ANKLE * shanks / lengths
        points.append(joints[:, used])
        onto.append(match.take.positions[:, used])
    return placement(np.concatenate(points), np.concatenate(onto))


def _explained(match: _Match, placed: Placement) -> float:
    """Return the share of the take's movement that its mocap explains.

    Each joint's constant offset is ignored: it only reflects how the joint is defined.
    Squared distances are compressed by the logarithm, because a limb that the sensor
    loses for a while says little about whether the recordings belong together.
    """
    limbs = [match.take.skeleton.index(joint) for joint in LIMBS]
    joints = match.take.positions[:, limbs]
    apart = placed.apply(match.mocap_at_frames()[:, limbs]) - joints
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
    return column_medians(values.reshape(len(values), -1)).reshape(values.shape[1:])


def _on_one_clock(matches: list[_Match]) -> list[_Match]:
    """Return matches with one clock offset, if their lags agree and none drifts."""
    offsets = np.array([m.clock.lag - m.clock.start for m in matches])
    spread = np.ptp(offsets)
    drifts = any(match.clock.drift for match in matches)
    step = nominal_step(matches[0].take.time)
    if len(matches) < 2 or drifts or spread > _SAME_CLOCK * step:
        return matches
    offset = float(np.median(offsets))
    note = (
        "the takes share one clock offset; estimated separately, their offsets differ "
        f"by {spread * 1e3:.0f} ms"
    )
    return [
        m._replace(
            clock=m.clock._replace(lag=offset + m.clock.start), notes=(*m.notes, note)
        )
        for m in matches
    ]


def _pairing(match: _Match, shared: Placement, subject: str) -> Pairing:
    """Return a pair at an even rate, without frames and joints that are not trusted."""
    take, notes, placed = match.take, list(match.notes), shared
    own, joints = _placed([match]), match.mocap_at_frames()
    body = joints[:, take.skeleton.hips].reshape(-1, 3)
    body = body[~np.isnan(body).any(axis=1)].mean(axis=0)
    angle = float((own.turn * shared.turn.inv()).magnitude())
    apart = float(np.linalg.norm(own.apply(body) - shared.apply(body)))
    if angle > _SAME_PLACE[0] or apart > _SAME_PLACE[1]:
        placed = own
        notes.append(
            f"this take has a transform of its own, {np.degrees(angle):.1f} degrees "
            f"and {100 * apart:.0f} cm from the session's: did the sensor move?"
        )
    truth = placed.apply(joints)
    away = np.linalg.norm(take.positions - truth, axis=2)
    lost = column_medians(away.T) > _LOST_FRAME
    truth[lost] = np.nan
    far = column_medians(np.where(lost[:, None], np.nan, away)) > _LOST_JOINT
    truth[:, far] = np.nan
    if lost.any():
        notes.append(
            f"{lost.sum()} frames are left out, because half of their joints are over "
            f"{100 * _LOST_FRAME:.0f} cm from the mocap"
        )
    for j in np.flatnonzero(far):
        notes.append(
            f"{take.skeleton.joints[j]} is left out, because it is mostly over "
            f"{100 * _LOST_JOINT:.0f} cm from the mocap; are its markers labeled "
            "correctly?"
        )
    rows = np.flatnonzero(~np.isnan(truth).all(axis=(1, 2)))
    if len(rows) * nominal_step(take.time) < _SHORTEST:
        raise InputError(
            f"{take.source}: only {len(rows)} frames can be trusted; "
            + "; ".join(notes)
        )
    inside = slice(rows[0], rows[-1] + 1)
    if outside := len(take) - (inside.stop - inside.start):
        left_out = counted(int(outside), "frame")
        notes.append(f"{left_out} before or after the mocap left out")
    pair = PairedTake(*_even(take, truth, inside), subject, match.clip)
    return Pairing(pair, match.clock, placed, _explained(match, placed), tuple(notes))


def _even(take: Take, truth: Array, rows: slice) -> tuple[Take, Array]:
    """Return frames at the take's nominal rate, as pairs files have no time stamps."""
    step, time = nominal_step(take.time), take.time[rows]
    rounded = np.round((time - time[0]) / step).astype(int)
    steps, first = np.unique(rounded, return_index=True)
    frames = np.full(steps[-1] + 1, -1)
    frames[steps] = first + rows.start
    positions, true, state = take.positions[frames], truth[frames], take.state[frames]
    positions[frames < 0] = true[frames < 0] = np.nan
    state[frames < 0] = State.NOT_TRACKED
    stamps = np.arange(len(frames), dtype=np.float64) * step
    return Take(stamps, positions, state, take.skeleton, take.source), true
