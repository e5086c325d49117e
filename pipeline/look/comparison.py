"""A clip beside the take that it was made from, in one frame, and the metrics of both.

The take is brought to the clip: leveled, its floor at y = 0, frame for frame.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from kinefilter.characters import Clip, InputError, State, Take
from kinefilter.characters.arrays import Array, Flags, Indices
from kinefilter.characters.gaps import long_gaps, told_gaps
from kinefilter.pipeline.failures import (
    find_displaced,
    find_failures,
    told_failures,
    unmirrored,
)
from kinefilter.pipeline.formats import read_recording
from kinefilter.pipeline.metrics import METRICS, measure
from kinefilter.pipeline.progress import Progress, silent
from kinefilter.pipeline.target.feet import feet_of
from kinefilter.pipeline.target.floor import in_world, leveled, to_world
from kinefilter.pipeline.target.upright import find_turn
from kinefilter.retarget import find_yaw

from .drawing import Drawing, read_finite_clip
from .sensors import sensors_of

if TYPE_CHECKING:
    from kinefilter.pipeline.merge import Merged

_TRY = "give the take that the clip was made of"
_SKEW = 1e-6  # s between stamps of the same frames: rounding
_DRIFT = 0.1  # s between stamps and the constant rate of a file without them
_FARTHEST = 1e3  # m from the origin: no sensor and no hall is as large
_ROUNDING = 3e-3  # m: takes and GLB in whole millimeters, and --keys 1
_HALF = 2.0**-11  # relative: USD keeps distances moved in half precision
_APART = 0.1  # s, at most, between a frame and the measurement shown for it
_LEAST_TILT = np.radians(1.5)  # a smaller tilt comes from what cleaning moved
_STEPS = 8  # of Newton's method: each squares the error of the angle


@dataclass(frozen=True, eq=False, kw_only=True)
class Comparison(Drawing):
    """A clip beside its measurement, with the metrics before and after cleaning.

    They are by their name in ``METRICS``, NaN where unknown. ``damage`` says in
    sentences what was wrong with the take, when, and what was done about it, and what
    is unsure of where its sensors are.
    """

    raw: Array
    damage: tuple[str, ...]
    before: dict[str, float]
    after: dict[str, float]


def read_comparison(
    clip_path: Path,
    *take_paths: Path,
    body: int | None = None,
    calibration: Path | None = None,
    progress: Progress = silent,
) -> Comparison:
    """Read a clip and its take, of which ``body`` is the person, counted from 1.

    The takes of several sensors are merged as they were for the clip, with the same
    calibration. Raises an InputError if one cannot be read, or they do not belong
    together.
    """
    clip, merged = read_finite_clip(clip_path), None
    if len(take_paths) > 1:
        from kinefilter.pipeline.merge import merge, read_calibration

        known = read_calibration(calibration)
        takes = [read_recording(path) for path in take_paths]
        merged = merge(takes, body=body, calibration=known, progress=progress)
        take = merged.take
    else:
        take = _read_take(take_paths[0], clip, body)
    try:
        return compare(clip, take, merged)
    except InputError as error:
        given = " ".join(f"--take {path}" for path in take_paths)
        same = "" if merged is None else ", in its order, with its --calibration"
        raise InputError(f"{clip_path} with {given}: {error}{same}") from None


def compare(clip: Clip, take: Take, merged: Merged | None = None) -> Comparison:
    """Put a take, which may be one of several sensors, where its clip is; measure both.

    For both, feet stand where the clip has contacts. Repeated time stamps count once.
    Raises an InputError if the clip was not made from the take, does not say where its
    floor was, has numbers that are not finite, or too few frames to be a motion.
    """
    clip = in_time_of(clip, take)
    _check(clip, take)
    raw = (in_clip_frame if _has_provenance(clip) else leveled_to_clip)(take, clip)
    distinct = np.diff(clip.time, prepend=-np.inf) > 0
    time, stands = clip.time[distinct], feet_of(clip.contacts)[distinct]

    def figures(positions: Array) -> dict[str, float]:
        measured = measure(time, positions[distinct], raw[distinct], clip.body, stands)
        found = asdict(measured) | {"skate": measured.skate_mm_per_frame * 1e-3}
        return {name: float(found[name]) for name in METRICS}

    before, after = figures(raw), figures(clip.positions)
    unsure = () if merged is None else merged.told()
    return Comparison(
        clip=clip,
        raw=raw,
        sensors=() if merged is None else sensors_of(merged, raw),
        damage=(*_damage(clip, raw, distinct, fused=merged is not None), *unsure),
        before=before,
        after=after,
    )


def _damage(clip: Clip, raw: Array, distinct: Flags, *, fused: bool) -> tuple[str, ...]:
    """Return what was wrong with a take, whose joints [m] are in the clip's frame.

    Gross failures of one of several sensors are left out: fusion has put them right.
    """
    time, state, skeleton = clip.time[distinct], clip.state[distinct], clip.skeleton
    take = Take(time, raw[distinct], state, skeleton, clip.source)
    failures, positions = () if fused else find_failures(take), clip.positions[distinct]
    mended = unmirrored(take, failures).positions
    yaw = find_yaw(positions, np.ones(positions.shape[:2]), skeleton)
    late = find_displaced(time, mended, positions, yaw, skeleton)
    told = told_failures([*failures, *late], time[0])
    return (*told_gaps(long_gaps(time), time[0]), *told)


def raw_positions(path: Path, clip: Clip, times: Array) -> Array:
    """Return the joints [m] of a clip's take at times [s] of the clip, in its frame.

    NaN where nothing was measured, shape (T, J, 3). Raises an InputError if the file is
    no take, or not the one that the clip was made from.
    """
    take, own = _read_take(path, clip), clip.time
    try:
        _check_skeletons(clip, take)
        clip = in_time_of(clip, take)
        if clip.time is not own:
            times = np.interp(times, own, clip.time)
        nearest = nearest_frames(take.time, times)
        apart = np.abs(take.time[nearest] - times)
        if np.median(apart) > _APART:
            raise InputError(
                f"the take runs from {take.time[0]:.2f} to {take.time[-1]:.2f} s, but "
                f"the clip from {times[0]:.2f} to {times[-1]:.2f} s; {_TRY}"
            )
        placed = (in_clip_frame if _keeps_frame(clip) else leveled_to_clip)(take, clip)
    except InputError as error:
        raise InputError(f"--compare {path}: {error}") from None
    return np.where((apart > _APART)[:, None, None], np.nan, placed[nearest])


def _read_take(path: Path, clip: Clip, body: int | None = None) -> Take:
    """Read a take, one without time stamps at the clip's, if it has its frames."""
    recording = read_recording(path)
    take = recording.take(body)
    if not recording.timed and len(clip) == len(take):
        return replace(take, time=clip.time)
    return take


def in_time_of(clip: Clip, take: Take) -> Clip:
    """Return the clip with the time stamps of its take, if it has lost them.

    USD starts at 0, and BVH has a constant rate besides. A clip that has its own time
    stamps, or does not fit those of the take, is returned as it is.
    """
    if _has_states(clip):
        return clip
    shown = np.cumsum(np.diff(take.time, prepend=take.time[0]) > 0)
    if len(clip) == shown[-1] + 1 < len(take):  # of repeated stamps USD keeps one
        clip = clip.at(shown)
    if len(clip) == len(take):
        off = float(np.ptp(clip.time - take.time))
        if off < (_SKEW if _has_provenance(clip) else _DRIFT):
            return replace(clip, time=take.time)
    return clip


def _has_provenance(clip: Clip) -> bool:
    """Return whether a clip says how far its joints moved; BVH and CSV do not."""
    return bool(np.isfinite(clip.moved_by_correction).any())


def _has_states(clip: Clip) -> bool:
    """Return whether a clip keeps the sensor's states; USD does not."""
    return _has_provenance(clip) and bool((clip.state != State.TRACKED).any())


def _keeps_frame(clip: Clip) -> bool:
    """Return whether a clip says how its take was leveled."""
    return bool(np.isfinite([clip.tilt, clip.floor]).all())


def _check_skeletons(clip: Clip, take: Take) -> None:
    if clip.skeleton != take.skeleton:
        raise InputError(
            f"the clip is of {clip.skeleton.name}, the take of {take.skeleton.name}; "
            f"{_TRY}"
        )


def _check(clip: Clip, take: Take) -> None:
    _check_skeletons(clip, take)
    if len(clip) != len(take):
        counts = f"the clip has {len(clip)} frames, the take {len(take)}"
        raise InputError(f"{counts}; {_TRY} (and without --fps, --begin or --end)")
    if len(clip) < 2 or clip.time[-1] <= clip.time[0]:
        raise InputError("a motion needs two frames or more at different times")
    if not same_stamps(clip, take):
        raise InputError(
            f"the time stamps of clip and take differ; {_TRY} (and without --fps)"
        )
    if _has_states(clip) and not np.array_equal(clip.state, take.state):
        raise InputError(f"the tracking states of clip and take differ; {_TRY}")
    rates = clip.reliability
    if not np.isfinite(clip.positions).all() or (
        np.isnan(rates).any() and not np.isnan(rates).all()  # all: nothing is known
    ):
        raise InputError("the clip has numbers that are not finite; write it again")
    for name, positions in (("clip", clip.positions), ("take", take.positions)):
        if (np.abs(positions) > _FARTHEST).any():
            raise InputError(f"the {name} has joints over {_FARTHEST:g} m away; {_TRY}")


def same_stamps(clip: Clip, take: Take) -> bool:
    """Return whether a clip and a take have frames at the same times."""
    return len(clip) == len(take) and np.allclose(
        clip.time, take.time, rtol=0.0, atol=_SKEW
    )


def nearest_frames(stamps: Array, times: Array) -> Indices:
    """Return which of some time stamps [s] is nearest to each time, shape (T,)."""
    return np.searchsorted(0.5 * (stamps[:-1] + stamps[1:]), times)


def in_clip_frame(take: Take, clip: Clip) -> Array:
    """Return joint positions [m] of a take, leveled as its clip was, shape (T, J, 3).

    Where both have the same frames, the distances that the clip keeps show whether it
    was made from this take. Raises an InputError if it was not, or if it does not keep
    its tilt and floor.
    """
    if not _keeps_frame(clip):
        raise InputError(
            "the clip does not say where its floor was (older versions of kinefilter "
            "did not keep it); clean the take again"
        )
    positions = in_world(take, clip)
    if same_stamps(clip, take):
        _check_made_from(clip, positions)
    return positions


def leveled_to_clip(take: Take, clip: Clip | Take) -> Array:
    """Return joint positions [m] of a take in its clip's frame, shape (T, J, 3).

    For clips that do not keep their tilt and floor (BVH, CSV): both are estimated from
    the heights of the joints. Raises an InputError if the take has none at their time.
    """
    frames = nearest_frames(take.time, clip.time)
    turn = find_turn(take.positions, take.skeleton)
    positions = leveled(take.positions, turn.tilt, turn.roll)
    raw, clean = positions[frames].reshape(-1, 3), clip.positions.reshape(-1, 3)
    known = np.isfinite(raw).all(axis=1)
    if not known.any():
        raise InputError("the take holds no joint in the time of the clip")
    return to_world(positions, *_tilt_and_floor(raw[known], clean[known]))


def _tilt_and_floor(raw: Array, clean: Array) -> tuple[float, float]:
    """Return the tilt [rad] and the floor's height [m] between points (N, 3).

    Robust least squares of the heights, by Newton's method.
    """
    tilt, used = 0.0, np.ones(len(raw), dtype=np.bool_)
    for _ in range(_STEPS):
        turned = leveled(raw, tilt)
        rise = clean[:, 1] - turned[:, 1]
        columns = np.stack([-turned[:, 2], np.ones(len(raw))], axis=1)
        step = np.linalg.lstsq(columns[used], rise[used], rcond=None)[0]
        tilt += float(step[0])
        off = np.abs(rise - columns @ step)
        used = off <= 3.0 * np.median(off) + 1e-9
    if abs(tilt) < _LEAST_TILT:
        tilt = 0.0
    turned = leveled(raw, tilt)
    return tilt, float(np.median(turned[:, 1] - clean[:, 1]))


def _check_made_from(clip: Clip, measured: Array) -> None:
    """Raise an InputError unless joints (T, J, 3) were measured where a clip says."""
    beyond = _disagreement(clip, measured)
    if np.isnan(beyond).all():
        raise InputError("the take holds no joint that the clip was made of")
    # Where the tracker took left for right, cleaning put them back.
    exchanged = _disagreement(clip, measured[:, clip.skeleton.mirror])
    most = np.minimum(*(np.nan_to_num(b).max(axis=1) for b in (beyond, exchanged)))
    wrong = np.flatnonzero(most > _ROUNDING)
    if len(wrong):
        worst = int(most.argmax())
        joint = clip.skeleton.joints[int(np.nanargmax(beyond[worst]))]
        raise InputError(
            f"in {len(wrong)} of {len(clip)} frames joints are not where the clip says "
            f"that they were measured: {joint} in frame {worst + 1} is "
            f"{most[worst] * 100:.1f} cm or more from there; give the take, and the "
            "person in it, that the clip was made of, and a clip without --loop, "
            "--root and coarse --keys"
        )


def _disagreement(clip: Clip, measured: Array) -> Array:
    """Return how far joints are from where a clip allows them to be [m], shape (T, J).

    A joint that correction moved by c and then physics by p is c - p to c + p away from
    its measurement. NaN where nothing was measured, and in frames that repeat a time
    stamp, of which only the first was used.
    """
    away = np.linalg.norm(clip.positions - measured, axis=2)
    off = np.abs(away - clip.moved_by_correction)
    off -= np.nan_to_num(clip.moved_by_physics) + _HALF * away
    off[1:][np.diff(clip.time) == 0.0] = np.nan
    return np.asarray(off)
