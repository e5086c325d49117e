"""A clip beside the take it was made from, and the metrics of both."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from kinefilter.characters import Clip, InputError, State, Take
from kinefilter.characters.arrays import Array, Flags
from kinefilter.characters.gaps import describe_gaps, long_gaps
from kinefilter.characters.motion import distinct_stamps, nearest_frames
from kinefilter.pipeline.failures import (
    describe_damage,
    find_displaced,
    find_failures,
    repaired,
)
from kinefilter.pipeline.formats import read_recording
from kinefilter.pipeline.formats.recording import FARTHEST, far_joints
from kinefilter.pipeline.metrics import METRICS, distances, measure
from kinefilter.pipeline.progress import Progress, silent
from kinefilter.pipeline.target.feet import planted_feet
from kinefilter.pipeline.target.floor import in_world, leveled, to_world

from .drawing import Drawing, read_finite_clip, sensors_of

if TYPE_CHECKING:
    from kinefilter.pipeline.merge import Merged

_LEAST_TILT = np.radians(1.5)  # a smaller tilt is an effect of cleaning
_TRY = "give the take that the clip was made from"
_SKEW = 1e-6  # s between time stamps of the same frames: rounding
_DRIFT = 0.1  # s between time stamps and the constant rate of a file without them
_MEAN = 1e-4  # relative: a frame time that another program rounded
_ROUNDING = 3e-3  # m: takes and GLB in whole millimeters, USD in half precision
_SAME_LENGTH = 0.2  # s by which two clips of one take may differ in length
_APART = 0.1  # s, at most, between a frame and the measurement shown for it


@dataclass(frozen=True, eq=False, kw_only=True)
class Comparison(Drawing):
    """A clip beside its take, with the metrics before and after cleaning."""

    raw: Array
    damage: tuple[str, ...]
    """What was wrong with the take, when, what was done about it, and what is uncertain
    about the place of its sensors, in sentences."""
    before: dict[str, float]  # metrics of the take (``METRICS``), NaN where unknown
    after: dict[str, float]  # metrics of the clip, likewise


def read_comparison(
    clip_path: Path,
    *take_paths: Path,
    body: int | None = None,
    calibration: Path | None = None,
    progress: Progress = silent,
) -> Comparison:
    """Read a clip and its take, in which ``body`` is the person, counted from 1.

    Takes of several sensors are merged as they were for the clip, so their order and
    the calibration must be the same. Raises an InputError if a file cannot be read or
    the clip was not made from the takes.
    """
    clip, merged = read_finite_clip(clip_path), None
    if len(take_paths) > 1:
        from kinefilter.pipeline.merge import merge, read_calibration

        known = read_calibration(calibration)
        takes = [read_recording(path) for path in take_paths]
        merged = merge(takes, body=body, calibration=known, progress=progress)
    take = merged.take if merged else _read_take(take_paths[0], clip, body)
    try:
        return compare(clip, take, merged)
    except InputError as error:
        given = " ".join(f"--take {path}" for path in take_paths)
        same = "" if merged is None else ", in the same order, with its --calibration"
        raise InputError(f"{clip_path} with {given}: {error}{same}") from None


def compare(clip: Clip, take: Take, merged: Merged | None = None) -> Comparison:
    """Bring a take, possibly a merged one, into its clip's frame and measure both.

    Both are measured with the clip's contacts. Repeated time stamps count once. Raises
    an InputError if the clip was not made from the take, does not store its floor, is
    not finite, or has too few frames.
    """
    clip = _with_stamps_of(take, clip)
    take = take.without(far_joints(take.positions))
    _check(clip, take)
    raw = (in_clip_frame if _has_provenance(clip) else laid_onto_clip)(take, clip)
    distinct = distinct_stamps(clip.time)
    time, stands = clip.time[distinct], planted_feet(clip.contacts)[distinct]

    def figures(positions: Array) -> dict[str, float]:
        measured = measure(time, positions[distinct], raw[distinct], clip.body, stands)
        values = asdict(measured) | {"skate": measured.skate_mm_per_frame * 1e-3}
        return {name: float(values[name]) for name in METRICS}

    uncertain = () if merged is None else merged.all_notes()
    return Comparison(
        clip=clip,
        raw=raw,
        sensors=() if merged is None else sensors_of(merged, raw),
        damage=(*_damage(clip, raw, distinct, fused=merged is not None), *uncertain),
        before=figures(raw),
        after=figures(clip.positions),
    )


def _damage(clip: Clip, raw: Array, distinct: Flags, *, fused: bool) -> tuple[str, ...]:
    time, state, skeleton = clip.time[distinct], clip.state[distinct], clip.skeleton
    take = Take(time, raw[distinct], state, skeleton, clip.source)
    # Fusion has corrected gross failures of single sensors.
    failures = () if fused else find_failures(take)
    mended = take if fused else repaired(take, failures)
    displaced = find_displaced(mended, clip.positions[distinct])
    return describe_damage(time, (*failures, *displaced))


def same_times(other: Clip, clip: Clip, path: Path) -> Clip:
    """Return the frames of another clip at the times of a clip, counted from its first.

    Raises an InputError that names ``path`` if they do not last equally long.
    """
    lasts, other_lasts = (c.time[-1] - c.time[0] for c in (clip, other))
    if abs(lasts - other_lasts) > _SAME_LENGTH:
        raise InputError(
            f"{path}: lasts {other_lasts:.2f} s, the motion {lasts:.2f} s; give a clip "
            "of the same take"
        )
    since, wanted = other.time - other.time[0], clip.time - clip.time[0]
    return other.at(nearest_frames(since, wanted))


def raw_positions(path: Path, clip: Clip, times: Array) -> Array:
    """Return the joints [m] of a clip's take at times [s] of the clip, in its frame.

    NaN where nothing was measured, shape (T, J, 3). Raises an InputError if the file is
    not a take, or not the one that the clip was made from.
    """
    take, stored = _read_take(path, clip), clip.time
    try:
        _check_skeletons(clip, take)
        clip = _with_stamps_of(take, clip)
        if clip.time is not stored:
            stamps = clip.time
            if len(stamps) > len(stored):  # USD kept one of repeated stamps
                stamps = stamps[distinct_stamps(stamps)]
            times = np.interp(times, stored, stamps)
        nearest = nearest_frames(take.time, times)
        apart = np.abs(take.time[nearest] - times)
        if np.median(apart) > _APART:
            raise InputError(
                f"the take runs from {take.time[0]:.2f} to {take.time[-1]:.2f} s, "
                f"the clip from {times[0]:.2f} to {times[-1]:.2f} s; {_TRY}, or the "
                "clip as .npz or .glb, which keep the time stamps"
            )
        placed = (in_clip_frame if _has_leveling(clip) else laid_onto_clip)(take, clip)
    except InputError as error:
        raise InputError(f"--compare {path}: {error}") from None
    return np.where((apart > _APART)[:, None, None], np.nan, placed[nearest])


def _read_take(path: Path, clip: Clip, body: int | None = None) -> Take:
    """Read a take; if it has no time stamps but the clip's frames, use the clip's."""
    recording = read_recording(path)
    take = recording.take(body)
    if not recording.timed and len(clip) == len(take):
        return replace(take, time=clip.time)
    return take


def _with_stamps_of(take: Take, clip: Clip) -> Clip:
    """Return the clip with the time stamps of its take, if its file lost them.

    USD starts at 0; BVH has a constant rate as well, the mean of the take's. A part of
    the take is where distances between joints change alike. A clip that has its own
    time stamps, or does not match the take's, is returned unchanged.
    """
    if _has_states(clip):
        return clip
    frames = np.cumsum(np.diff(take.time, prepend=take.time[0]) > 0)
    if len(clip) == frames[-1] + 1 < len(take):  # USD keeps one of repeated stamps
        clip = clip.at(frames)
    if len(clip) == len(take):
        spread = float(np.ptp(clip.time - take.time))
        if spread < (_SKEW if _has_provenance(clip) else _DRIFT) or (
            _has_mean_rate(clip, take)
        ):
            return replace(clip, time=take.time)
    begin, shorter = 0.0, np.ptp(take.time) - np.ptp(clip.time) > _SAME_LENGTH
    if len(clip) < 2 or clip.time[0] or (_has_provenance(clip) and not shorter):
        return clip
    if shorter:
        from kinefilter.pipeline.merge import lag

        one, other = (  # a third of the joints is enough, and hours fit into memory
            lag.distances(lag.Spline(motion.time, motion.positions[:, ::3]))
            for motion in (clip, take)
        )
        begin = lag.best_lag(one, other, float(np.ptp(clip.time)) - _APART) or 0.0
    return replace(clip, time=clip.time + take.time[0] + begin)


def _has_provenance(clip: Clip) -> bool:  # BVH and CSV files have none
    return bool(np.isfinite(clip.moved_by_correction).any())


def _has_states(clip: Clip) -> bool:  # USD files have none
    return _has_provenance(clip) and bool((clip.state != State.TRACKED).any())


def _has_mean_rate(clip: Clip, take: Take) -> bool:  # BVH: frames one by one
    lasts, steps = np.ptp(take.time), np.diff(clip.time)
    same = abs(np.ptp(clip.time) - lasts) <= _MEAN * lasts
    even = len(steps) > 0 and np.ptp(steps) < _SKEW
    return bool(clip.time[0] == 0.0 and even and same)


def _has_leveling(clip: Clip) -> bool:
    return bool(np.isfinite([clip.tilt, clip.floor]).all())


def _check_skeletons(clip: Clip, take: Take) -> None:
    if clip.skeleton != take.skeleton:
        names = f"the clip has {clip.skeleton.name}, the take {take.skeleton.name}"
        raise InputError(f"the skeletons differ: {names}; {_TRY}")


def _check(clip: Clip, take: Take) -> None:
    _check_skeletons(clip, take)
    if len(clip) != len(take):
        counts = f"the clip has {len(clip)} frames, the take {len(take)}"
        hint = "of several people with --body; and without --fps, --begin or --end"
        if gaps := describe_gaps(long_gaps(take.time), take.time[0]):
            hint += (
                f"; the take has {gaps[0]}: there BVH gets frames of its own, and "
                "--gaps split writes parts, so clean it with --gaps hold to .npz, "
                ".usdc or .glb"
            )
        raise InputError(f"{counts}; {_TRY} ({hint})")
    if len(clip) < 2 or clip.time[-1] <= clip.time[0]:
        raise InputError("a motion needs at least two frames at different times")
    if not same_stamps(clip, take):
        raise InputError(f"their time stamps differ; {_TRY} (and without --fps)")
    rates = clip.reliability
    if not np.isfinite(clip.positions).all() or (
        np.isnan(rates).any() and not np.isnan(rates).all()  # all NaN: unknown
    ):
        raise InputError("the clip is not finite everywhere; clean the take again")
    for name, positions in (("clip", clip.positions), ("take", take.positions)):
        if (np.abs(positions) > FARTHEST).any():
            raise InputError(f"the {name} has joints over {FARTHEST:g} m away; {_TRY}")


def same_stamps(clip: Clip, take: Take) -> bool:
    """Return True if a clip and a take have frames at the same times."""
    return len(clip) == len(take) and np.allclose(
        clip.time, take.time, rtol=0.0, atol=_SKEW
    )


def in_clip_frame(take: Take, clip: Clip) -> Array:
    """Return joint positions [m] of a take, leveled as its clip was, shape (T, J, 3).

    If both have the same frames, the take must match the distances stored in the clip.
    Raises an InputError if it does not, or if the clip does not store tilt and floor.
    """
    if not _has_leveling(clip):
        raise InputError(
            "the clip does not store where its floor was, as older versions wrote it; "
            "clean the take again"
        )
    positions = in_world(take, clip)
    if same_stamps(clip, take):
        _check_made_from(clip, positions)
    return positions


def laid_onto_clip(take: Take, clip: Clip | Take) -> Array:
    """Return joint positions [m] of a take in its clip's frame, shape (T, J, 3).

    For clips that do not store tilt and floor (BVH, CSV): the rigid transform that lays
    the take onto them says which way is up. Raises an InputError if the take has no
    joint at their times.
    """
    from kinefilter.pipeline.merge.rigid import placement

    frames = nearest_frames(take.time, clip.time)
    raw = take.positions[frames]
    if not np.isfinite(raw).any():
        raise InputError("the take has no joint at the times of the clip")
    place = placement(raw, clip.positions)
    left, up, ahead = (place.apply(np.eye(3)) - place.apply(np.zeros(3)))[:, 1]
    angles = np.arctan2([-ahead, left], [np.hypot(left, up), up])
    tilt, roll = np.where(np.abs(angles) > _LEAST_TILT, angles, 0.0).tolist()
    off = leveled(raw, tilt, roll)[..., 1] - clip.positions[..., 1]
    return to_world(take.positions, tilt, float(np.nanmedian(off)), roll)


def _check_made_from(clip: Clip, raw: Array) -> None:
    """Raise an InputError if a take's joints (T, J, 3) contradict most of its clip.

    A joint that correction moved by c and physics by p is c - p to c + p away.
    """
    off = []
    for seen in (raw, raw[:, clip.skeleton.mirror]):  # edits and cleaning swap sides
        beyond = np.abs(distances(clip.positions, seen) - clip.moved_by_correction)
        beyond -= np.nan_to_num(clip.moved_by_physics)
        known = beyond[np.isfinite(beyond)]
        off.append(np.median(known) if len(known) else np.inf)
    if min(off) > _ROUNDING:
        raise InputError(
            "most joints of the take are not where the clip says they were measured; "
            f"{_TRY}, the same --body, and a clip written without --root"
        )
