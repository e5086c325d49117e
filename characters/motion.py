"""What a sensor gave (Take), how a body moves (Motion), what animators get (Clip)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from enum import IntEnum
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from .anthropometry import Body
from .arrays import (
    Array,
    Codes,
    Flags,
    as_number,
    check_arrays,
    check_kind,
    freeze,
    read_only,
)
from .errors import InputError
from .props import Prop
from .rotations import rotate
from .skeleton import Skeleton, check_skeleton

LATEST = 1e12
"""Frames of live motion [s] are earlier: clocks count from 1970, in seconds."""
_NO_TIME = 1e19  # s: a damaged number; less may be in another unit, see check_rate
_MOST = np.finfo(float).max
_UNIT = 1e-3  # by which a quaternion may be longer than 1: single precision, and room

CONTACTS = ("HeelLeft", "ToeLeft", "HeelRight", "ToeRight")
"""Parts of the feet that stand on the floor, in the order of the arrays."""


class State(IntEnum):
    """The sensor's own word on a joint."""

    NOT_TRACKED = 0
    INFERRED = 1
    TRACKED = 2


class Origin(IntEnum):
    """Where a joint's position in a clip came from."""

    MEASURED = 0
    """The sensor's measurement, less the constant offset of that joint where the method
    knows one; smoothed, planted and put on the bones as all joints are."""
    CORRECTED = 1
    """A measurement that the correction method overruled, in part or whole."""
    FILLED = 2
    """Nothing was measured: the posture is invented."""


class Term(IntEnum):
    """The term of a reliability score that was the smallest, and so decided."""

    BEHAVIOR = 0
    KINEMATICS = 1
    TRACKING_STATE = 2
    POSTURE = 3
    """Where in the body this kind of sensor sees the joint: of ``learned`` alone."""
    FAILURE = 4
    """A gross failure of the tracker, whatever the terms: no limb can be there."""

    @property
    def words(self) -> str:
        """What users read."""
        return self.name.lower().replace("_", " ")


_CODES = {"state": State, "deciding_term": Term, "origin": Origin}
_OF_JOINTS = ("reliability", "moved_by_correction", "moved_by_physics", "uncertainty")
"""Numbers of joints that are 0 or more, the reliability at most 1, or NaN."""
_SHAPES = {
    "time": "T",
    "positions": "TJ3",
    "root": "T3",
    "rotations": "TJ4",
    **dict.fromkeys((*_CODES, *_OF_JOINTS), "TJ"),
    "contacts": "T4",
    "external_force": "T",
}
"""Arrays that have a row a frame, and their shapes: T frames, J joints."""


def _shapes(kind: Any, frames: int, joints: int) -> dict[str, tuple[int, ...]]:
    """Return the shapes of the arrays that a kind of motion has, by their names."""
    lengths = {"T": frames, "J": joints, "3": 3, "4": 4}
    names = [field.name for field in fields(kind) if field.name in _SHAPES]
    return {name: tuple(lengths[k] for k in _SHAPES[name]) for name in names}


def _check(motion: Take | Motion) -> None:
    """Make arrays of what somebody gave, or raise an InputError."""
    check_kind(motion.source, str, "the source of a take or clip")
    check_skeleton(motion.skeleton, motion.source)
    of = f" for {motion.skeleton.name}"
    check_arrays(motion, motion.source, {"time": (None,)}, of)
    shapes = _shapes(motion, len(motion.time), len(motion.skeleton))
    check_arrays(motion, motion.source, shapes, of, keep=_CODES)
    for name, known in _CODES.items():
        if name not in shapes:
            continue
        values = getattr(motion, name)
        _refuse(motion, name, values, np.isin(values, list(known)))
        object.__setattr__(motion, name, values.astype(np.uint8, copy=False))
    time = motion.time
    wrong = np.flatnonzero(~(np.abs(time) < _NO_TIME))
    if len(wrong):
        raise InputError(
            f"{motion.source}: frame {wrong[0] + 1} has no time stamp "
            f"({time[wrong[0]]:g}); give every frame one, in seconds"
        )
    check_order(time, lambda k: f"{motion.source}: frame {k + 1}: time", "frames")


def check_order(time: Array, where: Callable[[int], str], what: str) -> None:
    """Raise InputError where time stamps [s] (T,) go backwards."""
    backwards = np.flatnonzero(np.diff(time) < 0)
    if len(backwards):
        k = int(backwards[0]) + 1
        raise InputError(
            f"{where(k)} goes backwards ({time[k - 1]:.4f} s, then {time[k]:.4f} s); "
            f"sort the {what} by time or cut the take there"
        )


def _refuse(
    motion: Take | Motion, what: str, values: NDArray[Any], good: Flags
) -> None:
    if not good.all():
        frame, column = np.argwhere(~good)[0]
        columns = CONTACTS if what == "contacts" else motion.skeleton.joints
        raise InputError(
            f"{motion.source}: frame {frame + 1}, {columns[column]}: "
            f"{what} {values[frame, column]:g} is not valid; correct it"
        )


def nominal_step(time: Array) -> float:
    """Return the median time between frames that differ in time [s], or NaN."""
    steps = np.diff(time)
    steps = steps[steps > 0]
    return float(np.median(steps)) if len(steps) else float("nan")


def frames_per_second(time: Array) -> float:
    """Return the nominal frame rate [1/s]: one over the nominal step, or 30."""
    step = nominal_step(time)
    return 1.0 / step if step > 0.0 else 30.0


def positions_from_rotations(rotations: Array, root: Array, body: Body) -> Array:
    """Return joint positions [m] of a body, world frame, shape (..., J, 3).

    Segments have world rotations, unit quaternions wxyz, identity in the T-pose, shape
    (..., J, 4); the root joint is at ``root`` [m], shape (..., 3).
    """
    bones = rotate(rotations, body.rest_offsets)
    positions = np.empty_like(bones)
    skeleton = body.skeleton
    positions[..., skeleton.root, :] = root
    for j, p in zip(skeleton.segments, skeleton.segment_parents, strict=True):
        positions[..., j, :] = positions[..., p, :] + bones[..., j, :]
    return positions


class _Frames:
    """What takes and motions share: arrays of frames, by their time stamps."""

    time: Array

    def __len__(self) -> int:
        return len(self.time)

    @property
    def fps(self) -> float:
        """Nominal frame rate [1/s]: one over the median time step."""
        return frames_per_second(self.time)

    def at(self, frames: Any) -> Self:
        """Return some of the frames, in their order: a slice, indices or flags."""
        # Takes and motions are dataclasses.
        return replace(self, **self._at(frames))  # type: ignore[type-var]

    def _at(self, frames: Any) -> dict[str, Any]:
        names = _shapes(self, 0, 0)
        return {name: getattr(self, name)[frames] for name in names}


@dataclass(frozen=True, eq=False)
class Take(_Frames):
    """A recording as the sensor gave it; arrays are read-only."""

    time: Array
    """Time stamps [s], shape (T,), never decreasing; repeats and gaps are normal."""
    positions: Array
    """Joint positions [m], sensor frame with y up, shape (T, J, 3); NaN: missing, as
    are joints that are not tracked."""
    state: Codes
    """Tracking state per joint (State), shape (T, J)."""
    skeleton: Skeleton
    """The joints, in the order of the arrays."""
    source: str = "take"
    """Where the take came from, for messages."""
    by_kinect: bool = True
    """Whether a Kinect's tracker put the joints where they are, with its offsets."""

    def __post_init__(self) -> None:
        _check(self)
        known = np.isfinite(self.positions)
        lost = ~known.all(axis=-1) | (self.state == State.NOT_TRACKED)
        if (known.any(axis=-1) & lost).any() or np.isinf(self.positions).any():
            whole = np.where(lost[..., None], np.nan, self.positions)
            object.__setattr__(self, "positions", whole)
        freeze(self)

    def exchanged(self, frames: Any = np.s_[:]) -> Take:
        """Return the take with left and right exchanged, in some of its frames."""
        positions, state = self.positions.copy(), self.state.copy()
        for values in (positions, state):
            values[frames] = values[frames][:, self.skeleton.mirror]
        return replace(self, positions=positions, state=state)


@dataclass(frozen=True, eq=False, kw_only=True)
class Motion(_Frames):
    """How a body moves; arrays are read-only.

    World frame: right-handed, y up, floor at y = 0, meters, seconds. Joint positions
    follow from root and rotations: ``p[j] = p[parent] + R[j] @ body.rest_offsets[j]``.
    """

    time: Array
    """Time stamps [s], never decreasing, shape (T,)."""
    body: Body
    """The body that moves: skeleton, segment lengths and rest posture."""
    root: Array
    """Position of the root joint [m], world frame, shape (T, 3)."""
    rotations: Array
    """World rotation of the segment that ends at each joint, unit quaternions wxyz,
    shape (T, J, 4), identity in the rest posture; the root's row is the pelvis."""
    source: str = "motion"
    """Where the motion came from, for messages."""

    def __post_init__(self) -> None:
        check_kind(self.body, Body, "the body of a motion")
        _check(self)
        if not np.isfinite(self.root).all():
            raise InputError(
                f"{self.source}: root is not finite; leave such frames out"
            )
        with np.errstate(over="ignore"):  # of a damaged file
            lengths = np.sqrt(np.vecdot(self.rotations, self.rotations))
        _refuse(self, "rotation of length", lengths, np.abs(lengths - 1.0) < _UNIT)
        freeze(self)

    @property
    def skeleton(self) -> Skeleton:
        """The joints, in the order of the arrays."""
        return self.body.skeleton

    @cached_property
    def positions(self) -> Array:
        """Joint positions [m], world frame, shape (T, J, 3)."""
        found = positions_from_rotations(self.rotations, self.root, self.body)
        return read_only(found)


@dataclass(frozen=True, eq=False, kw_only=True)
class Clip(Motion):
    """A cleaned motion and, per joint and frame, where it came from.

    Time stamps are those of the take.
    """

    state: Codes
    """The sensor's tracking state (State), shape (T, J): as it was recorded, also in
    frames where left and right were put back."""
    reliability: Array
    """Reliability in [0, 1], NaN where unknown, shape (T, J)."""
    deciding_term: Codes
    """Which reliability term decided (Term), shape (T, J)."""
    origin: Codes
    """Where each joint came from (Origin), shape (T, J)."""
    moved_by_correction: Array
    """Distance from the measurement to the corrected joint [m], NaN where nothing was
    measured, shape (T, J); where left and right were put back, from the other side's
    measurement."""
    moved_by_physics: Array
    """Distance from the corrected to the final joint [m], shape (T, J)."""
    uncertainty: Array
    """How far the joint may be off, relative to the hips: standard deviation of each
    coordinate [m], NaN where unknown, shape (T, J)."""
    contacts: Flags
    """Which parts of the feet stand on the floor (CONTACTS), shape (T, 4)."""
    external_force: Array
    """Force on the body that no muscle and no floor gives [body weights], shape (T,);
    NaN where nothing was simulated."""
    props: tuple[Prop, ...] = ()
    """What was around the character in the simulation."""
    tilt: float = float("nan")
    """Angle [rad] about x by which the take was turned about the sensor, from y to z:
    ``y cos(tilt) - z sin(tilt)`` is up. Positive where the floor rises away from the
    sensor, which then looks down; NaN where the clip's file does not keep it."""
    floor: float = float("nan")
    """Height [m] of the floor in the take so leveled, which was then taken off; NaN as
    for ``tilt``."""
    roll: float = 0.0
    """Angle [rad] about z by which the take was turned before that, from x to y: half a
    turn where the sensor was upside down."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_kind(self.props, tuple, f"{self.source}: its props")
        for prop in self.props:
            check_kind(prop, Prop, f"{self.source}: a prop")
            if len(prop.positions) not in (1, len(self)):
                raise InputError(
                    f"{self.source}: prop {prop.name} has {len(prop.positions)} "
                    f"places, expected 1 or {len(self)}, one a frame"
                )
        for name in _OF_JOINTS:
            values, most = getattr(self, name), 1.0 if name == "reliability" else _MOST
            _refuse(self, name, values, ~((values < 0.0) | (values > most)))
        contacts = self.contacts
        _refuse(self, "contacts", contacts, np.isin(contacts, (0, 1)))
        object.__setattr__(self, "contacts", read_only(contacts.astype(np.bool_)))
        for name in ("tilt", "floor", "roll"):
            what = f"{self.source}: {name}"
            object.__setattr__(self, name, as_number(getattr(self, name), what))

    def _at(self, frames: Any) -> dict[str, Any]:
        props = tuple(prop.at(frames) for prop in self.props)
        return {**super()._at(frames), "props": props}

    @classmethod
    def of(cls, motion: Motion, **known: Any) -> Self:
        """Return a clip of a motion of which nothing but ``known`` fields is known.

        Joints count as tracked and measured, feet as lifted; numbers are NaN.
        """
        tracked = {"state": State.TRACKED, "origin": Origin.MEASURED}
        usual: dict[str, Any] = tracked | {"deciding_term": 0, "contacts": 0}
        unknown = {
            name: np.full(shape, usual.get(name, np.nan))
            for name, shape in _shapes(cls, *motion.rotations.shape[:2]).items()
        }
        moves = {field.name: getattr(motion, field.name) for field in fields(Motion)}
        return cls(**unknown | moves | known)
