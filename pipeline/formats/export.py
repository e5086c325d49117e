"""Settings for writing clips, what they do to a clip, and what all formats share."""

from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from math import ceil, inf
from pathlib import Path
from typing import Any, Literal

import numpy as np

from kinefilter.characters import InputError, Prop, Skeleton, standard_body
from kinefilter.characters.arrays import Array, chunks
from kinefilter.characters.gaps import LONG_GAP, describe_gaps, long_gaps
from kinefilter.characters.motion import CONTACTS, Clip, Origin, Term, frames_per_second
from kinefilter.characters.rotations import between, multiply, slerp
from kinefilter.pipeline.field_types import check_fields
from kinefilter.retarget.looping import looped
from kinefilter.retarget.standardize import floor_frame

from .rig import RootMotion
from .rows import MOST_FRAMES

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
"""Provenance stored for each frame: the name in files, and the field of a clip."""
PER_CLIP = {"sensorTilt": "tilt", "floorHeight": "floor", "sensorRoll": "roll"}
"""Provenance stored once: the name in files, and the field of a clip."""
LENGTHS = ("moved_by_correction", "moved_by_physics", "uncertainty")
"""Fields of a clip that are in meters, with a number for each joint and frame."""
GAMMA = 2.2
"""Exponent that turns screen colors into linear ones, roughly that of sRGB."""
SKIN_COLOR = (0.11, 0.24, 0.32)
"""Linear color of the skin: muted, and used by no prop."""
DAMAGED = "its skeleton and animation do not match; export it again"
USD_SUFFIXES = (".usda", ".usdc", ".usd", ".usdz")
WHOLE_CLIPS = (".npz", *USD_SUFFIXES, ".glb")
"""Files that hold a clip's provenance and can be read back."""
_SPAN_AND_RATE = ("begin", "end", "loop", "root", "fps")
_ANY_RIG = (*_SPAN_AND_RATE, "up", "units", "rest", "rig", "target")
# Options that each kind of file supports; without up and units: meters, y up.
_OPTIONS = {
    **dict.fromkeys(USD_SUFFIXES, (*_ANY_RIG, "character")),
    ".usdz": _ANY_RIG,
    ".bvh": (*_ANY_RIG, "rotation_order"),
    ".glb": (*_SPAN_AND_RATE, "keys", "rest", "rig", "target"),
    ".fbx": (*_SPAN_AND_RATE, "rest", "rig", "target", "blender"),
    ".vrma": _SPAN_AND_RATE,
    ".npz": (*_SPAN_AND_RATE, "rig"),
    ".csv": _SPAN_AND_RATE,
}
_RANGES = {"fps": (1.0, 1000.0, "frames/s"), "keys": (0.01, 100.0, "mm")}
"""Lowest and highest value of a number, and its unit; others are taken for typos."""
_RATE_TOLERANCE = 0.005  # relative; time stamps jitter
_END = 1e-6  # of a frame: tolerance, so that rounding does not lose the last frame
_LONGEST_HELD = 600.0  # s of standing still in all; longer is hardly meant. A guess
_INTERPOLATED = ("root", "reliability", *LENGTHS, "external_force")


@dataclass(frozen=True)
class Export:
    """Settings for writing a clip."""

    up: Literal["y", "z"] = "y"
    """Up axis of USD and BVH. The character faces +z, or -y if z is up; its left is
    +x."""
    units: Literal["m", "cm"] = "m"
    """Unit of length in USD and BVH."""
    fps: float | None = None
    """Frame rate of the clip, which is then resampled. By default the clip keeps the
    take's frames and time stamps; BVH and FBX, whose frames are evenly spaced, get the
    take's mean rate. Blender keeps its own rate when it imports USD or GLB: set it to
    the clip's."""
    begin: float | None = None
    """Start of the clip, in seconds after the take's first frame. The whole take is
    cleaned in any case."""
    end: float | None = None
    """End of the clip, in seconds after the take's first frame; at the latest, and by
    default, the take's end."""
    loop: bool = False
    """Blend the end of the clip into its beginning: the last frame has the posture of
    the first, wherever the person has gone and faces by then. Planted feet stay put."""
    root: RootMotion = "travel"
    """Root motion: travel keeps all of it (on a rig with a root bone on the floor, such
    as unreal's, that bone travels and turns); in-place keeps only turns, for games that
    move the character themselves; none keeps the hips over the origin, facing +z."""
    keys: float | None = None
    """Keep only the keyframes of GLB that smooth curves need to put every joint within
    this distance [mm] of its place, and within half a degree per mm of its rotation."""
    rest: Literal["own", "t"] = "own"
    """Rest pose of USD, GLB, FBX and BVH: own is a T-pose with this person's own trunk,
    shoulders and hips; t is a strict T-pose, upright and square."""
    rotation_order: RotationOrder = "zyx"
    """Order of BVH's Euler angles, which are intrinsic: about the first axis, then the
    rotated second, then the rotated third."""
    character: Path | None = None
    """USD layer with the skeleton and mesh, which the USD clip references; it is made
    if it does not exist. By default the clip contains both itself."""
    rig: str | None = None
    """Skeleton to retarget to, in USD, GLB, FBX, BVH and npz: mixamo, unreal (Manny,
    Quinn), unreal4, unity, vrm, smpl, smplx, lafan1, rigify, or your own map (.toml)
    like those in retarget/rigs. By default it is the sensor's joints. Hands and feet
    keep their place relative to limb length, and planted feet stay still. There is no
    skin or prop; bones that the map does not name, such as fingers, stay at rest."""
    target: Path | None = None
    """File (.bvh or USD) with your own character's skeleton at rest, whose joints have
    the names of --rig. By default it is an average skeleton as tall as the person. Axes
    and units remain those of --up and --units."""
    blender: str | None = None
    """Blender (4.2 or later) that writes FBX, or a Python that has its bpy module. By
    default it is $KINEFILTER_BLENDER, or the blender on the PATH."""

    def __post_init__(self) -> None:
        check_fields(self)
        for name, (low, high, unit) in _RANGES.items():
            value = getattr(self, name)
            if value is not None and not low <= value <= high:
                raise InputError(
                    f"--{name} {value:g}: expected {low:g} to {high:g} {unit}"
                )
        if not 0.0 <= (self.begin or 0.0) < (inf if self.end is None else self.end):
            ends = (("--begin", self.begin), ("--end", self.end))
            given = " ".join(f"{k} {v:g}" for k, v in ends if v is not None)
            raise InputError(
                f"{given}: expected seconds after the take's first frame, the end "
                "later than the beginning"
            )
        if self.target is not None and self.rig is None:
            raise InputError(f"--target {self.target}: needs --rig for its joint names")
        if self.rig is not None and (self.rest != "own" or self.character is not None):
            flag = "--character" if self.rest == "own" else "--rest"
            raise InputError(f"{flag} is only for kinefilter's own skeleton, not --rig")

    @property
    def meters_per_unit(self) -> float:
        """Length of the unit [m]."""
        return 0.01 if self.units == "cm" else 1.0

    def check(self, suffix: str) -> None:
        """Raise InputError if an option is set that ``.usda`` or another file lacks."""
        for field in fields(self):
            known = [kind for kind, names in _OPTIONS.items() if field.name in names]
            if suffix not in known and getattr(self, field.name) != field.default:
                raise InputError(
                    f"--{field.name.replace('_', '-')} does not apply to {suffix} "
                    f"files; leave it out, or write {', '.join(known)}"
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


def from_z_up(values: Array) -> Array:
    """Convert directions (..., 3) or rotations wxyz (..., 4) from z up to y up."""
    turned = values.copy()
    turned[..., -2], turned[..., -1] = values[..., -1], -values[..., -2]
    return turned


def even_frames(time: Array, fps: float, source: str) -> int:
    """Return the number of frames at ``fps`` between time stamps [s] (T,).

    Raises InputError for more frames than a recording may have, and for long gaps, in
    which the character holds still, of more than 10 minutes in all.
    """
    count = int((time[-1] - time[0]) * fps + _END) + 1
    gaps = long_gaps(time)
    held = sum(end - start for start, end in gaps)
    if held > _LONGEST_HELD:
        most = f"expected {_LONGEST_HELD:g} s at most"
        raise InputError(
            f"{source}: {describe_gaps(gaps, time[0])[0]}; the character would hold "
            f"still for {ceil(10.0 * held) / 10.0:.1f} s in all, {most}; split the "
            "take with --gaps split"
        )
    if count > MOST_FRAMES:
        raise InputError(
            f"{source}: {count:,} frames at {fps:g} frames/s, expected "
            f"{MOST_FRAMES:,} at most; choose a lower --fps or cut the take"
        )
    return count


def whole_rate(rate: float) -> float:
    """Round a frame rate [1/s] if it is within 0.5 % of a whole number."""
    near = abs(rate - round(rate)) <= _RATE_TOLERANCE * rate
    return float(round(rate)) if near else rate


def span_of(export: Export, time: Array, source: str) -> slice:
    """Return an export's span of times [s] (T,) as frames, or raise InputError."""
    since, duration = time - time[0], float(time[-1] - time[0])
    begin, end = export.begin or 0.0, duration if export.end is None else export.end
    slack = 1.0 / frames_per_second(time)
    first, stop = np.searchsorted(since, [begin - _END * slack, end + _END * slack])
    if 0 < first == stop < len(time):
        raise InputError(
            f"{source}: no frames from {since[first - 1]:.4g} to {since[first]:.4g} s; "
            "choose --begin and --end outside of this gap"
        )
    if first >= stop:
        raise InputError(
            f"{source}: its {len(time)} frames end at {duration:.4g} s; --begin "
            f"{begin:g} is after that"
        )
    return slice(int(first), int(stop))


def with_frame_rate(export: Export, suffix: str, time: Array, source: str) -> Export:
    """Return the settings with the frame rate that a file needs.

    FBX, and npz of a rig, always have even frames; so does BVH, which has no time
    stamps, if there are long gaps. Time stamps [s] have shape (T,). Raises InputError
    as ``span_of`` and ``even_frames``.
    """
    time = time[span_of(export, time, source)]
    rate = frames_per_second(time)
    if export.fps is None:
        if suffix == ".fbx" or (suffix == ".npz" and export.rig is not None):
            export = replace(export, fps=whole_rate(rate))
        elif suffix == ".bvh" and long_gaps(time):
            export = replace(export, fps=rate)
    if export.fps is not None or export.keys is not None:
        even_frames(time, export.fps or rate, source)
    return export


def timing_notes(export: Export, suffix: str, clips: Iterable[Clip]) -> list[str]:
    """Return a note if frames of BVH are over a frame off the clips' time stamps."""
    late, rates = [0.0], [30.0]  # s, frames/s
    for clip in clips if suffix == ".bvh" else ():
        time = clip.time[span_of(export, clip.time, clip.source)]
        if with_frame_rate(export, suffix, clip.time, clip.source).fps is None:
            even = np.linspace(time[0], time[-1], len(time))
            late.append(float(np.abs(time - even).max()))
            rates.append(frames_per_second(time))
    worst, rate = max(zip(late, rates, strict=True))
    if worst * rate <= 1.0:
        return []
    return [
        "BVH has a constant frame rate: as frames are missing or repeated, its motion "
        f"is up to {worst:.2f} s off the take's time stamps; with --fps "
        f"{whole_rate(rate):.4g} it keeps to them"
    ]


def resampled(clip: Clip, fps: float) -> Clip:
    """Return a clip resampled to ``fps`` frames/s, from its first frame to its last.

    Positions and numbers are interpolated linearly, rotations along the shortest arc;
    anything that cannot be interpolated, such as contacts, is the nearest frame's. Of
    frames with the same time, the last one counts. In long gaps everything holds still,
    and joints count as filled. Raises InputError as ``even_frames``.
    """
    known = np.flatnonzero(np.append(np.diff(clip.time) > 0.0, True))
    stamps, end = clip.time[known], len(known) - 1
    count = even_frames(stamps, fps, clip.source)
    time = stamps[0] + np.arange(count) / fps
    last = np.clip(np.searchsorted(stamps, time, "right"), min(1, end), end)
    first = np.maximum(last - 1, 0)
    still = stamps[last] - stamps[first] > LONG_GAP
    # The move to the next place takes the time of one frame, right before it.
    begins = np.where(still, stamps[last] - 1.0 / clip.fps, stamps[first])
    step = np.maximum(stamps[last] - begins, 1e-12)
    share = np.clip((time - begins) / step, 0.0, 1.0)
    held = still & (share < 1.0) & (time > stamps[first])
    before, after = known[first], known[last]

    def line(values: Array) -> Array:
        part = share.reshape(-1, *[1] * (values.ndim - 1))
        start = values[before]
        between = start + part * (values[after] - start)
        # A frame that exists already stays as it is, even next to a missing one.
        return np.asarray(np.where(part == 0.0, start, between))

    def arc(rotations: Array) -> Array:
        part = share.reshape(-1, *[1] * (rotations.ndim - 2))
        turned = np.empty((count, *rotations.shape[1:]))
        for some in chunks(count):
            start, end = rotations[before[some]], rotations[after[some]]
            turned[some] = slerp(start, end, part[some])
        return turned

    def moved(prop: Prop) -> Prop:
        places, turns = line(prop.positions), arc(prop.rotations)
        return replace(prop, positions=places, rotations=turns)

    nearest = clip.at(np.where(share < 0.5, before, after))
    lines: dict[str, Any] = {name: line(getattr(clip, name)) for name in _INTERPOLATED}
    return replace(
        nearest,
        time=time,
        rotations=arc(clip.rotations),
        origin=np.where(held[:, None], np.uint8(Origin.FILLED), nearest.origin),
        props=tuple(moved(p) if p.moves else p for p in clip.props),
        **lines,
    )


def in_strict_t(clip: Clip) -> Clip:
    """Return the same motion with a strict T-pose, upright and square, as rest pose."""
    body = clip.body
    square = standard_body(body.skeleton).directions
    rotations = multiply(clip.rotations, between(square, body.directions))
    return replace(clip, rotations=rotations, body=replace(body, directions=square))


def shaped(clip: Clip, export: Export) -> Clip:
    """Return a clip with the span, frame rate, loop and rest pose of an export.

    The root motion is that of the export, too, unless a rig has its own. Raises
    InputError as ``span_of``, ``even_frames`` and ``looped``.
    """
    if (export.begin, export.end) != (None, None):
        clip = clip.at(span_of(export, clip.time, clip.source))
    if export.fps is not None:
        clip = resampled(clip, export.fps)
    if export.loop:
        clip = looped(clip)
    clip = in_strict_t(clip) if export.rest == "t" else clip
    return with_root_motion(clip, export.root) if export.rig is None else clip


def with_root_motion(clip: Clip, travel: RootMotion) -> Clip:
    """Return a clip with only the root motion of ``travel``; props follow the root."""
    if travel == "travel":
        return clip
    left = np.array([1.0, 0.0, 0.0])
    frame = floor_frame(clip.root, clip.rotations[:, clip.skeleton.root], left)
    if travel == "in-place":
        frame = frame.unturned
    props = []
    for prop in clip.props:
        places = frame.remove(prop.positions[:, None])[:, 0]
        turns = frame.remove_rotations(prop.rotations[:, None])[:, 0]
        props.append(replace(prop, positions=places, rotations=turns))
    return replace(
        clip,
        root=frame.remove(clip.root[:, None])[:, 0],
        rotations=frame.remove_rotations(clip.rotations),
        props=tuple(props),
    )


def name_tables(skeleton: Skeleton) -> dict[str, list[str]]:
    """Return the meaning of each index in the provenance, by the table's file name."""
    return {
        "joints": list(skeleton.joints),
        "decidingTermNames": [term.name.lower() for term in Term],
        "originNames": [origin.name.lower() for origin in Origin],
        "contactNames": list(CONTACTS),
    }
