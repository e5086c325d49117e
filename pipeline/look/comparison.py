"""A clip beside the take that it was made from, and the metrics of both."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from kinefilter.characters import Clip, InputError, State, Take
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.formats import read_take
from kinefilter.pipeline.metrics import Quality, measure
from kinefilter.pipeline.target.feet import feet_of

from .drawing import Drawing, read_finite_clip
from .placing import in_clip_frame, leveled_to_clip, same_stamps

METRICS = {
    "skate": "feet on the floor slide, m per frame",
    "skate_mm_per_frame": "the same, mm per frame",
    "skate_share_over_0p2": "share of their frames over 0.2 m/s",
    "skate_max_m_per_s": "fastest slide of a foot on the floor, m/s",
    "float_mm": "soles of standing feet over the floor, mm",
    "penetration_mm": "deepest point under the floor, mm",
    "penetration_mean_mm": "lowest point under the floor, mean, mm",
    "lowest_point_mm": "height of the lowest point, mm",
    "bone_length_cv": "bone-length variation, share of the length",
    "jitter": "jitter, m/s³",
    "amplitude_kept": "amplitude kept, share of the raw one",
    "peak_hand_speed": "speed of the hands in the fastest 1% of frames, m/s",
    "flight_error": "acceleration in flight off gravity, m/s²",
    "moved_cm": "moved from raw, mean, cm",
}
"""Name and meaning of each metric; names as in ``clean --json``, and ``skate``."""

_TRY = "give the take that the clip was made of"
_SKEW = 1e-6  # s between stamps of the same frames: rounding
_DRIFT = 0.1  # s between stamps and the constant rate of a file without them
_FARTHEST = 1e3  # m from the origin: no sensor and no hall is as large


@dataclass(frozen=True, eq=False, kw_only=True)
class Comparison(Drawing):
    """A clip beside its measurement, with the metrics of both."""

    raw: Array
    """Measured joint positions [m], clip's frame, NaN where missing, (T, J, 3)."""
    before: dict[str, float]
    """Metrics of the measurement, by their name in ``METRICS``, NaN where unknown."""
    after: dict[str, float]
    """Metrics of the clip."""


def read_comparison(
    clip_path: Path, take_path: Path, *, body: int | None = None
) -> Comparison:
    """Read a clip and its take.

    Args:
        clip_path: The clip, in any format that ``write_clip`` writes.
        take_path: The take.
        body: Which person of the take, counted from 1; None: who is seen in most
            frames.

    Raises:
        InputError: One cannot be read, or they do not belong together.
    """
    clip, take = read_finite_clip(clip_path), read_take(take_path, body=body)
    try:
        return compare(clip, take)
    except InputError as error:
        raise InputError(f"{clip_path} with --take {take_path}: {error}") from None


def read_drawing(
    clip_path: Path, take_path: Path | None = None, *, body: int | None = None
) -> Drawing:
    """Read a clip and, if it is given, the take that it was made from.

    Raises:
        InputError: As ``read_comparison``.
    """
    if take_path is None:
        return Drawing(read_finite_clip(clip_path))
    return read_comparison(clip_path, take_path, body=body)


def compare(clip: Clip, take: Take) -> Comparison:
    """Put a take where its clip is and measure both.

    For both, feet stand where the clip has contacts. Repeated time stamps count once.

    Raises:
        InputError: The clip was not made from the take, or does not say where its floor
            was, or has numbers that are not finite, or too few frames to be a motion.
    """
    # BVH and CSV do not keep what was done to the take.
    provenance = bool(np.isfinite(clip.moved_by_correction).any())
    # USD does not keep the sensor's states.
    states = provenance and bool((clip.state != State.TRACKED).any())
    if not states and len(clip) == len(take):
        # USD starts at 0, and BVH has a constant rate.
        off = float(np.ptp(clip.time - take.time))
        if off < (_SKEW if provenance else _DRIFT):
            clip = replace(clip, time=take.time)
    _check(clip, take, states=states)
    raw = (in_clip_frame if provenance else leveled_to_clip)(take, clip)
    distinct = np.concatenate([[True], np.diff(clip.time) > 0])
    time, stands = clip.time[distinct], feet_of(clip.contacts)[distinct]
    seen, positions = raw[distinct], clip.positions[distinct]
    before = measure(time, seen, seen, clip.body, stands)
    after = measure(time, positions, seen, clip.body, stands)
    return Comparison(
        clip=clip, raw=raw, before=_by_name(before), after=_by_name(after)
    )


def _by_name(quality: Quality) -> dict[str, float]:
    figures = asdict(quality)
    figures["skate"] = figures["skate_mm_per_frame"] * 1e-3
    return {name: float(figures[name]) for name in METRICS}


def _check(clip: Clip, take: Take, *, states: bool) -> None:
    if clip.skeleton != take.skeleton:
        raise InputError(
            f"the clip is of {clip.skeleton.name}, the take of {take.skeleton.name}; "
            f"{_TRY}"
        )
    if len(clip) != len(take):
        raise InputError(
            f"the clip has {len(clip)} frames, the take {len(take)}; {_TRY} (and "
            "without --fps)"
        )
    if len(clip) < 2 or clip.time[-1] <= clip.time[0]:
        raise InputError("a motion needs two frames or more at different times")
    if not same_stamps(clip, take):
        raise InputError(
            f"the time stamps of clip and take differ; {_TRY} (and without --fps)"
        )
    if states and not np.array_equal(clip.state, take.state):
        raise InputError(f"the tracking states of clip and take differ; {_TRY}")
    rates = clip.reliability
    if not np.isfinite(clip.positions).all() or (
        np.isnan(rates).any() and not np.isnan(rates).all()  # all: nothing is known
    ):
        raise InputError("the clip has numbers that are not finite; write it again")
    for name, positions in (("clip", clip.positions), ("take", take.positions)):
        if (np.abs(positions) > _FARTHEST).any():
            raise InputError(f"the {name} has joints over {_FARTHEST:g} m away; {_TRY}")
