"""Takes as recorded, motions of a body, and clips with their provenance."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from enum import IntEnum
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .anthropometry import Body, positions_from_rotations
from .arrays import (
    Array,
    Codes,
    Flags,
    Indices,
    as_number,
    check_arrays,
    check_kind,
    freeze,
    read_only,
)
from .errors import InputError
from .props import Prop
from .skeleton import Skeleton, check_skeleton

LATEST_TIME_STAMP = 1e12
"""Bound on time stamps in live mode [s]; clocks count seconds from 1970."""
_DAMAGED = 1e19  # s: no clock shows this; less may be in another unit (check_rate)
_UNIT = 1e-3  # tolerance for the length of quaternions in single precision

CONTACTS = ("HeelLeft", "ToeLeft", "HeelRight", "ToeRight")
"""Parts of the feet that touch the floor, in the order of arrays of contacts."""


class State(IntEnum):
    """Tracking state of a joint, as reported by the sensor."""

    NOT_TRACKED = 0
    INFERRED = 1
    TRACKED = 2


class Origin(IntEnum):
    """Source of a joint's position in a clip."""

    MEASURED = 0
    """The sensor's measurement, less the joint's constant offset if the method knows
    one; like all joints, it is smoothed, planted and moved to fit the bone lengths."""
    CORRECTED = 1
    """A measurement that the correction method replaced, in part or entirely."""
    FILLED = 2
    """A reconstruction: nothing was measured."""


class Term(IntEnum):
    """Smallest term of a reliability, which decides it."""

    BEHAVIOR = 0
    KINEMATICS = 1
    TRACKING_STATE = 2
    POSTURE = 3
    """Where in the body this kind of sensor sees the joint; only of ``learned``."""
    FAILURE = 4
    """A gross failure of the tracker, which overrides the other terms."""

    @property
    def words(self) -> str:
        """Name as users see it."""
        return self.name.lower().replace("_", " ")


_CODES = {"state": State, "deciding_term": Term, "origin": Origin}
_LARGEST = dict.fromkeys(
    ("reliability", "moved_by_correction", "moved_by_physics", "uncertainty"),
    np.finfo(float).max,
) | {"reliability": 1.0}
"""Largest valid value of each quantity of joints; the smallest is 0."""
_SHAPES = {
    "time": "T",
    "positions": "TJ3",
    "root": "T3",
    "face": "T3",
    "rotations": "TJ4",
    **dict.fromkeys((*_CODES, *_LARGEST), "TJ"),
    "contacts": "T4",
    "external_force": "T",
}
"""Shapes of the arrays with a row per frame: T frames, J joints."""


def _shapes(kind: Any, frames: int, joints: int) -> dict[str, tuple[int, ...]]:
    lengths = {"T": frames, "J": joints, "3": 3, "4": 4}
    names = [field.name for field in fields(kind) if field.name in _SHAPES]
    if getattr(kind, "face", None) is None:  # most sensors see none
        names = [name for name in names if name != "face"]
    return {name: tuple(lengths[k] for k in _SHAPES[name]) for name in names}


def _check(motion: Take | Motion) -> None:
    """Convert the fields to arrays, or raise an InputError."""
    check_kind(motion.source, str, "the source of a take or clip")
    check_skeleton(motion.skeleton, motion.source)
    of = f" for {motion.skeleton.name}"
    check_arrays(motion, motion.source, {"time": (None,)}, of)
    shapes = _shapes(motion, len(motion.time), len(motion.skeleton))
    check_arrays(motion, motion.source, shapes, of, keep=_CODES)
    for name, known in _CODES.items():
        if name in shapes:
            values = getattr(motion, name)
            codes = [int(code) for code in known]
            _check_values(motion, name, values, np.isin(values, codes), f"in {codes}")
            object.__setattr__(motion, name, values.astype(np.uint8, copy=False))
    time = motion.time
    wrong = np.flatnonzero(~(np.abs(time) < _DAMAGED))
    if len(wrong):
        raise InputError(
            f"{motion.source}: frame {wrong[0] + 1} has no valid time stamp "
            f"({time[wrong[0]]:g}); every frame needs one in seconds"
        )
    check_order(time, lambda k: f"{motion.source}: frame {k + 1}: time", "frames")


def check_order(time: Array, where: Callable[[int], str], what: str) -> None:
    """Raise an InputError if time stamps [s] (T,) go backwards."""
    backwards = np.flatnonzero(np.diff(time) < 0)
    if len(backwards):
        k = int(backwards[0]) + 1
        raise InputError(
            f"{where(k)} goes backwards ({time[k - 1]:.4f} s, then {time[k]:.4f} s); "
            f"sort the {what} by time or cut the take there"
        )


def _check_values(
    motion: Take | Motion, what: str, values: NDArray[Any], valid: Flags, allowed: str
) -> None:
    if not valid.all():
        frame, column = np.argwhere(~valid)[0]
        columns = CONTACTS if what == "contacts" else motion.skeleton.joints
        raise InputError(
            f"{motion.source}: frame {frame + 1}, {columns[column]}: {what} must be "
            f"{allowed}, got {values[frame, column]:g}"
        )


def nominal_step(time: Array) -> float:
    """Return the median of the nonzero time steps between frames [s], or NaN."""
    steps = np.diff(time)
    steps = steps[steps > 0]
    return float(np.median(steps)) if len(steps) else float("nan")


def values_at(time: Array, values: Array, wanted: ArrayLike) -> Array:
    """Return values (T, ...) interpolated at other times; outside, the ends are held.

    Time stamps [s] (T,) increase. The result has the shape of ``wanted`` [s], followed
    by that of a frame's values.
    """
    wanted = np.asarray(wanted)
    if len(time) < 2:
        return np.asarray(values[np.zeros(wanted.shape, dtype=np.intp)])
    after = np.searchsorted(time, wanted).clip(1, len(time) - 1)
    apart = np.maximum(time[after] - time[after - 1], 1e-9)
    share = ((wanted - time[after - 1]) / apart).clip(0.0, 1.0)
    share = share.reshape(*wanted.shape, *(1,) * (values.ndim - 1))
    return np.asarray(values[after - 1] * (1.0 - share) + values[after] * share)


def distinct_stamps(time: Array) -> Flags:
    """Return flags of the first frame with each time stamp [s], shape (T,)."""
    return np.diff(time, prepend=-np.inf) > 0.0


def nearest_frames(stamps: Array, times: Array) -> Indices:
    """Return the index of the time stamp [s] nearest to each time, shape (T,)."""
    return np.searchsorted(0.5 * (stamps[:-1] + stamps[1:]), times)


def frames_per_second(time: Array) -> float:
    """Return the nominal frame rate [1/s], 30 if there is no nominal step."""
    step = nominal_step(time)
    return 1.0 / step if step > 0.0 else 30.0


class _Frames:
    """Base of takes and motions: arrays with a row per frame."""

    time: Array

    def __len__(self) -> int:
        return len(self.time)

    def __repr__(self) -> str:
        own: Any = self  # a dataclass, whose arrays would fill the screen
        kind, of = type(self).__name__, own.skeleton.name
        return f"<{kind} {own.source!r}: {len(self)} frames of {of}>"

    @property
    def fps(self) -> float:
        """Nominal frame rate [1/s]: one over the median time step."""
        return frames_per_second(self.time)

    def at(self, frames: Any) -> Self:
        """Return some of the frames: a slice, indices or flags."""
        some = {name: getattr(self, name)[frames] for name in _shapes(self, 0, 0)}
        if props := getattr(self, "props", ()):
            some["props"] = tuple(prop.at(frames) for prop in props)
        # Takes and motions are dataclasses.
        return replace(self, **some)  # type: ignore[type-var] # a dataclass


@dataclass(frozen=True, eq=False, repr=False)
class Take(_Frames):
    """A recording of one person, as the sensor delivered it; arrays are read-only.

    Attributes:
        time: Time stamps [s], shape (T,), never decreasing; repeats and gaps are
            normal.
        positions: Joint positions [m], sensor frame, y up, shape (T, J, 3); NaN if not
            tracked.
        state: Tracking state per joint (State), shape (T, J).
        skeleton: The joints, in the order of the arrays.
        source: Origin of the take, for messages.
        by_kinect: True if the joints have the constant offsets of a Kinect's tracker.
        face: Unit vectors to where the face looks, sensor frame, shape (T, 3), NaN
            where unknown; None if the sensor does not see faces.
    """

    time: Array
    positions: Array
    state: Codes
    skeleton: Skeleton
    source: str = "take"
    by_kinect: bool = True
    face: Array | None = None

    def __post_init__(self) -> None:
        _check(self)
        known = np.isfinite(self.positions)
        lost = ~known.all(axis=-1) | (self.state == State.NOT_TRACKED)
        if (known.any(axis=-1) & lost).any() or np.isinf(self.positions).any():
            whole = np.where(lost[..., None], np.nan, self.positions)
            object.__setattr__(self, "positions", whole)
        freeze(self)

    def swapped(self, frames: Any = np.s_[:]) -> Take:
        """Return the take with sides swapped in frames, which then have no face."""
        positions, state = self.positions.copy(), self.state.copy()
        for values in (positions, state):
            values[frames] = values[frames][:, self.skeleton.mirror]
        face = self.face
        if face is not None:
            face = face.copy()
            face[frames] = np.nan
        return replace(self, positions=positions, state=state, face=face)

    def without(self, joints: Flags) -> Take:
        """Return the take with the flagged joints (T, J) not tracked."""
        if not joints.any():
            return self
        state = np.where(joints, np.uint8(State.NOT_TRACKED), self.state)
        return replace(self, state=state)  # which has no position there either


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Motion(_Frames):
    """Motion of a body; arrays are read-only.

    World frame: right-handed, y up, floor at y = 0, meters, seconds. Joint positions
    follow from root and rotations: ``p[j] = p[parent] + R[j] @ body.rest_offsets[j]``.

    Attributes:
        time: Time stamps [s], never decreasing, shape (T,).
        body: Skeleton, segment lengths and rest pose.
        root: Position of the root joint [m], world frame, shape (T, 3).
        rotations: World rotation of the segment that ends at each joint, unit
            quaternions wxyz, shape (T, J, 4), identity in the rest pose; the root's row
            is the pelvis.
        source: Origin of the motion, for messages.
    """

    time: Array
    body: Body
    root: Array
    rotations: Array
    source: str = "motion"

    def __post_init__(self) -> None:
        check_kind(self.body, Body, "the body of a motion")
        _check(self)
        if not np.isfinite(self.root).all():
            raise InputError(f"{self.source}: root is not finite; omit such frames")
        with np.errstate(over="ignore"):  # damaged files hold huge numbers
            lengths = np.sqrt(np.vecdot(self.rotations, self.rotations))
        unit = np.abs(lengths - 1.0) < _UNIT
        _check_values(self, "length of the rotation", lengths, unit, "1")
        freeze(self)

    @property
    def skeleton(self) -> Skeleton:
        """The joints, in the order of the arrays."""
        return self.body.skeleton

    @cached_property
    def positions(self) -> Array:
        """Joint positions [m], world frame, shape (T, J, 3)."""
        return read_only(positions_from_rotations(self.rotations, self.root, self.body))


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Clip(Motion):
    """A cleaned motion with the provenance of each joint; its times are the take's.

    Attributes, besides those of ``Motion``:
        state: Recorded tracking state (State), shape (T, J), even where sides were
            swapped.
        reliability: Reliability in [0, 1], NaN where unknown, shape (T, J).
        deciding_term: Reliability term that decided (Term), shape (T, J).
        origin: Source of each joint's position (Origin), shape (T, J).
        moved_by_correction: Distance from the measurement, with swapped sides restored,
            to the corrected one [m], NaN where nothing was measured, shape (T, J).
        moved_by_physics: Distance from the corrected to the final joint [m], shape
            (T, J).
        uncertainty: Expected error of each joint relative to the hips: standard
            deviation of each coordinate [m], NaN where unknown, shape (T, J).
        contacts: Contacts of heels and toes with the floor (CONTACTS), shape (T, 4).
        external_force: Force on the body that comes from neither muscles nor floor
            [body weights], shape (T,); NaN where nothing was simulated.
        props: Objects around the character in the simulation.
        tilt: Angle [rad] about x, from y to z, by which the take was rotated about the
            sensor: ``y cos(tilt) - z sin(tilt)`` is up. Positive if the floor rises
            away from the sensor, which then looks down; NaN if the clip's file does not
            store it.
        floor: Height [m] of the floor in the leveled take, now subtracted; NaN as
            ``tilt``.
        roll: Angle [rad] about z, from x to y, by which the take was rotated before
            that: half a turn if the sensor was upside down.
    """

    state: Codes
    reliability: Array
    deciding_term: Codes
    origin: Codes
    moved_by_correction: Array
    moved_by_physics: Array
    uncertainty: Array
    contacts: Flags
    external_force: Array
    props: tuple[Prop, ...] = ()
    tilt: float = float("nan")
    floor: float = float("nan")
    roll: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        check_kind(self.props, tuple, f"{self.source}: its props")
        for prop in self.props:
            check_kind(prop, Prop, f"{self.source}: a prop")
            if len(prop.positions) not in (1, len(self)):
                raise InputError(
                    f"{self.source}: prop {prop.name} has {len(prop.positions)} "
                    f"positions, expected 1 or {len(self)}, one per frame"
                )
        for name, most in _LARGEST.items():
            values = getattr(self, name)
            valid = ~((values < 0.0) | (values > most))
            allowed = "in [0, 1]" if most == 1.0 else "finite and at least 0"
            _check_values(self, name, values, valid, f"{allowed}, or NaN")
        contacts = self.contacts
        _check_values(self, "contacts", contacts, np.isin(contacts, (0, 1)), "0 or 1")
        object.__setattr__(self, "contacts", read_only(contacts.astype(np.bool_)))
        for name in ("tilt", "floor", "roll"):
            what = f"{self.source}: {name}"
            object.__setattr__(self, name, as_number(getattr(self, name), what))

    @classmethod
    def of(cls, motion: Motion, **known: Any) -> Self:
        """Return a clip of a motion, with defaults for all fields but ``known``.

        Joints are tracked and measured, feet are lifted, and other values are NaN.
        """
        tracked = {"state": State.TRACKED, "origin": Origin.MEASURED}
        defaults: dict[str, Any] = tracked | {"deciding_term": 0, "contacts": 0}
        unknown = {
            name: np.full(shape, defaults.get(name, np.nan))
            for name, shape in _shapes(cls, *motion.rotations.shape[:2]).items()
        }
        moves = {field.name: getattr(motion, field.name) for field in fields(Motion)}
        return cls(**unknown | moves | known)
