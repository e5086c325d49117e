"""How clips are written: the axes, unit, rate and rest pose that others expect."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from math import inf
from pathlib import Path
from typing import Any, Literal

import numpy as np

from kinefilter.characters import (
    CONTACTS,
    Clip,
    InputError,
    Origin,
    Prop,
    Skeleton,
    Term,
    standard_body,
)
from kinefilter.characters.arrays import Array, chunks
from kinefilter.characters.gaps import LONG_GAP, long_gaps, told_gaps
from kinefilter.characters.motion import frames_per_second
from kinefilter.characters.rotations import between, multiply, slerp
from kinefilter.pipeline.field_types import check_fields

from .recording import FRAMES_AT_ONCE, MOST_FRAMES
from .rig import Travel

RotationOrder = Literal["xyz", "xzy", "yxz", "yzx", "zxy", "zyx"]

PER_FRAME = {
    "reliability": "reliability",
    "movedByCorrection": "moved_by_correction",
    "movedByPhysics": "moved_by_physics",
    "uncertainty": "uncertainty",
    "decidingTerm": "deciding_term",
    "origin": "origin",
    "contacts": "contacts",
}
"""What clips keep of each frame, by the name in files and in a clip."""
ONCE = {"sensorTilt": "tilt", "floorHeight": "floor", "sensorRoll": "roll"}
"""What they keep once, by the name in files and in a clip."""

LINEAR = 2.2
"""Exponent from a screen's colors to light, about that of sRGB."""
COLOR = (0.11, 0.24, 0.32)
"""Of the skin, linear; a quiet color that no prop has."""

_RATE_TOLERANCE = 0.005  # stamps jitter; a rate this near to a whole number is one
_SLOWEST, _FASTEST = 1.0, 1000.0  # frames/s: beyond, somebody mistyped
_FINEST, _COARSEST = 0.01, 100.0  # mm, likewise
USD_SUFFIXES = (".usda", ".usdc", ".usd", ".usdz")
WHOLE_CLIPS = (".npz", *USD_SUFFIXES, ".glb")
"""Files that say where joints came from, and are read back."""
_MOVE = ("begin", "end", "loop", "root", "fps")
_RIGGED = (*_MOVE, "up", "units", "rest", "rig", "target")
# What each kind of file can follow; kinefilter's own are in meters, y up.
_FOLLOWED = {
    **dict.fromkeys(USD_SUFFIXES, (*_RIGGED, "character")),
    ".usdz": _RIGGED,
    ".bvh": (*_RIGGED, "rotation_order"),
    ".glb": (*_MOVE, "keys", "rest", "rig", "target"),
    ".fbx": (*_MOVE, "rest", "rig", "target", "blender"),
    ".vrma": _MOVE,
    ".npz": (*_MOVE, "rig"),
    ".csv": _MOVE,
}
_END = 1e-6  # of a frame: the last one is not lost to rounding
_MOVED = ("moved_by_correction", "moved_by_physics", "uncertainty")
_ON_A_LINE = ("root", "reliability", *_MOVED, "external_force")
_NEAREST = ("state", "deciding_term", "contacts")
_LONGEST_HELD = 600.0  # s in which nothing moves: who animates that? A guess


@dataclass(frozen=True)
class Export:
    """How a clip is written."""

    up: Literal["y", "z"] = "y"
    """Up axis of USD and BVH. The character faces +z, or -y if z is up; its left is
    +x."""
    units: Literal["m", "cm"] = "m"
    """Unit of length of USD and BVH."""
    fps: float | None = None
    """Frame rate of the clip, resampled from the take's. By default the clip has the
    take's own frames and time stamps; BVH and FBX, whose frames are evenly spaced, have
    the take's mean rate. Blender keeps its own rate when it imports USD or GLB: set
    that to the clip's."""
    begin: float | None = None
    """Where the clip begins, in seconds after the take's first frame. The whole take is
    cleaned all the same."""
    end: float | None = None
    """Where the clip ends, in seconds after the take's first frame."""
    loop: bool = False
    """Blend the end of the clip into its beginning: the last frame has the posture of
    the first, wherever the person stands and faces by then. Planted feet stay put."""
    root: Travel = "travel"
    """Root motion: travel keeps all of it (on a rig with a root bone on the floor, such
    as unreal's, that bone travels and turns); in-place keeps only turns, for games that
    move the character themselves; none keeps the hips over the origin, facing +z."""
    keys: float | None = None
    """Thin out the keys of GLB, with smooth curves between those that are left: no
    joint is off by more than this [mm], or by more than half a degree for each mm."""
    rest: Literal["own", "t"] = "own"
    """Rest pose of USD, GLB, FBX and BVH: own is a T-pose with this person's own trunk,
    shoulders and hips; t is a strict T-pose, upright and square."""
    rotation_order: RotationOrder = "zyx"
    """Rotation order of BVH's Euler angles, intrinsic: about the first axis, then the
    rotated second, then the rotated third."""
    character: Path | None = None
    """USD layer with the skeleton and mesh, which the USD clip references; made if it
    does not exist. By default the clip holds both itself."""
    rig: str | None = None
    """Skeleton to retarget to, in USD, GLB, FBX, BVH and npz: mixamo, unreal (Manny,
    Quinn), unreal4, unity, vrm, smpl, smplx, lafan1, rigify, or your own map (.toml)
    like those in retarget/rigs; default: the sensor's joints. Hands and feet keep their
    place relative to limb length, and planted feet stay still. There is no skin and no
    prop; bones that the map does not name, such as fingers, keep their rest pose."""
    target: Path | None = None
    """File (.bvh or USD) with your own character's skeleton at rest, its joints named
    as in --rig; default: an average skeleton as tall as the person. Axes and units are
    still those of --up and --units."""
    blender: str | None = None
    """Blender (4.2 or later) that writes FBX, or a Python that has its bpy; default:
    the blender on the PATH."""

    def __post_init__(self) -> None:
        check_fields(self)
        if self.fps is not None and not _SLOWEST <= self.fps <= _FASTEST:
            known = f"{_SLOWEST:g} to {_FASTEST:g} frames/s"
            raise InputError(f"--fps {self.fps:g}: expected {known}")
        if not 0.0 <= (self.begin or 0.0) < (inf if self.end is None else self.end):
            raise InputError(
                f"--begin {self.begin or 0.0:g} --end {self.end or 0.0:g}: expected "
                "seconds after the take's first frame, the end after the beginning"
            )
        if self.keys is not None and not _FINEST <= self.keys <= _COARSEST:
            known = f"{_FINEST:g} to {_COARSEST:g} mm"
            raise InputError(f"--keys {self.keys:g}: expected {known}")
        if self.target is not None and self.rig is None:
            raise InputError(f"--target {self.target}: name its joints with --rig")
        if self.rig is not None and (self.rest != "own" or self.character is not None):
            flag = "--character" if self.rest == "own" else "--rest"
            raise InputError(
                f"{flag} is about kinefilter's own skeleton; leave it or --rig out"
            )

    @property
    def meters_per_unit(self) -> float:
        """Length of the unit [m]."""
        return 0.01 if self.units == "cm" else 1.0

    def check(self, suffix: str) -> None:
        """Raise InputError for an option that files of a suffix (``.usda``) ignore."""
        for field in fields(self):
            chosen = getattr(self, field.name) != field.default
            if chosen and field.name not in _FOLLOWED[suffix]:
                known = [s for s, names in _FOLLOWED.items() if field.name in names]
                raise InputError(
                    f"--{field.name.replace('_', '-')} means nothing to a {suffix} "
                    f"file; leave it out, or write {', '.join(known)}"
                )

    def points(self, meters: Array) -> Array:
        """Return positions or vectors [m], y up, in the file's axes and unit."""
        return self.axes(meters) / self.meters_per_unit

    def axes(self, values: Array) -> Array:
        """Return directions (..., 3) or rotations wxyz (..., 4) in the file's axes."""
        if self.up == "y":
            return values
        turned = values.copy()
        turned[..., -2], turned[..., -1] = -values[..., -1], values[..., -2]
        return turned


def with_y_up(values: Array) -> Array:
    """Return directions (..., 3) or rotations wxyz (..., 4) that were given z up."""
    turned = values.copy()
    turned[..., -2], turned[..., -1] = values[..., -1], -values[..., -2]
    return turned


def even_frames(time: Array, fps: float, source: str) -> int:
    """Return how many frames ``fps`` a second are between time stamps [s] (T,).

    Raises InputError for more than a recording has, and for long gaps that take too
    long to hold still in.
    """
    count = int((time[-1] - time[0]) * fps + _END) + 1
    gaps = long_gaps(time)
    held = sum(end - start for start, end in gaps)
    if held > _LONGEST_HELD:
        raise InputError(
            f"{source}: {told_gaps(gaps, time[0])[0]}; at {fps:g} frames a second, a "
            f"character that holds still for {held:.4g} s in all would take "
            f"{held * fps:.3g} frames, expected {_LONGEST_HELD:g} s at most; split it "
            "with --gaps split"
        )
    if count > MOST_FRAMES:
        raise InputError(
            f"{source}: {count:,} frames at {fps:g} a second, expected "
            f"{MOST_FRAMES:,} at most; choose a lower --fps or cut the take"
        )
    return count


def whole_rate(rate: float) -> float:
    """Return the whole frame rate [1/s] that is meant by one near to it, or itself."""
    near = abs(rate - round(rate)) <= _RATE_TOLERANCE * rate
    return float(round(rate)) if near else rate


def span_of(export: Export, time: Array, source: str) -> slice:
    """Return which frames, by their time stamps [s] (T,), a clip is to have.

    Raises InputError where the take has none.
    """
    since, lasts = time - time[0], float(time[-1] - time[0])
    begin, end = export.begin or 0.0, lasts if export.end is None else export.end
    slack = 1.0 / frames_per_second(time)
    first, stop = np.searchsorted(since, [begin - _END * slack, end + _END * slack])
    if first >= stop or end > lasts + slack:
        raise InputError(
            f"{source}: no frames from {begin:g} to {end:g} s, it has {len(time)} in "
            f"{lasts:.4g} s; choose --begin and --end among these"
        )
    return slice(int(first), int(stop))


def paced(export: Export, suffix: str, time: Array, source: str) -> Export:
    """Return how a motion with time stamps [s] (T,) is written, with its frame rate.

    FBX and npz of a rig have even frames, and so has BVH, which has no time stamps,
    where it must hold still in a long gap. Raises InputError as ``span_of`` and
    ``even_frames``.
    """
    time = time[span_of(export, time, source)]
    rate = frames_per_second(time)
    for_rig = suffix == ".npz" and export.rig is not None
    if export.fps is None and (suffix == ".fbx" or for_rig):
        export = replace(export, fps=whole_rate(rate))
    if export.fps is None and suffix == ".bvh" and long_gaps(time):
        export = replace(export, fps=rate)
    if export.fps is not None:
        even_frames(time, export.fps, source)
    elif export.keys is not None:
        even_frames(time, frames_per_second(time), source)
    return export


def resampled(clip: Clip, fps: float) -> Clip:
    """Return a clip with ``fps`` frames a second, from its first to its last.

    Positions and numbers between frames are interpolated on a line, rotations on the
    shortest arc; what has no middle, such as contacts, is the nearest frame's. Of
    frames with the same time, the last counts. In long gaps everything holds still, and
    joints count as filled. Raises InputError as ``even_frames``.
    """
    known = np.flatnonzero(np.append(np.diff(clip.time) > 0.0, True))
    stamps = clip.time[known]
    count = even_frames(stamps, fps, clip.source)
    time = stamps[0] + np.arange(count) / fps
    last = np.clip(np.searchsorted(stamps, time, "right"), 1, max(len(known) - 1, 1))
    last = np.minimum(last, len(known) - 1)
    first = np.maximum(last - 1, 0)
    still = stamps[last] - stamps[first] > LONG_GAP
    # The way to the next place takes the time of a frame, right before it.
    begins = np.where(still, stamps[last] - 1.0 / clip.fps, stamps[first])
    step = np.maximum(stamps[last] - begins, 1e-12)
    share = np.clip((time - begins) / step, 0.0, 1.0)
    held = still & (share < 1.0) & (time > stamps[first])
    before, after = known[first], known[last]

    def line(values: Array) -> Array:
        part = share.reshape(-1, *[1] * (values.ndim - 1))
        start = values[before]
        between = start + part * (values[after] - start)
        # A frame that is there already is kept as it is, also beside a missing one.
        return np.asarray(np.where(part == 0.0, start, between))

    def arc(rotations: Array) -> Array:
        part = share.reshape(-1, *[1] * (rotations.ndim - 2))
        found = np.empty((count, *rotations.shape[1:]))
        for some in chunks(count, FRAMES_AT_ONCE):
            start, end = rotations[before[some]], rotations[after[some]]
            found[some] = slerp(start, end, part[some])
        return found

    def moved(prop: Prop) -> Prop:
        places, turns = line(prop.positions), arc(prop.rotations)
        return replace(prop, positions=places, rotations=turns)

    nearest = np.where(share < 0.5, before, after)
    found: dict[str, Any] = {
        **{name: line(getattr(clip, name)) for name in _ON_A_LINE},
        **{name: getattr(clip, name)[nearest] for name in _NEAREST},
        "rotations": arc(clip.rotations),
        "origin": np.where(
            held[:, None], np.uint8(Origin.FILLED), clip.origin[nearest]
        ),
        "props": tuple(moved(p) if p.moves else p for p in clip.props),
    }
    return replace(clip, time=time, **found)


def in_strict_t(clip: Clip) -> Clip:
    """Return the same motion with a rest posture in which every bone is square."""
    body = clip.body
    square = standard_body(body.skeleton).directions
    rotations = multiply(clip.rotations, between(square, body.directions))
    return replace(clip, rotations=rotations, body=replace(body, directions=square))


def name_tables(skeleton: Skeleton) -> dict[str, list[str]]:
    """Return what the indices in provenance mean, by the name in files."""
    return {
        "joints": list(skeleton.joints),
        "decidingTermNames": [term.name.lower() for term in Term],
        "originNames": [origin.name.lower() for origin in Origin],
        "contactNames": list(CONTACTS),
    }
