"""Messages of a live session: a line of JSON each; see *Streams* in CONVENTIONS.md."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn

import numpy as np

from kinefilter.characters import (
    SKELETONS,
    Body,
    KinefilterError,
    Prop,
    Skeleton,
    State,
)
from kinefilter.characters.arrays import Array, Codes, shown
from kinefilter.characters.motion import LATEST_TIME_STAMP
from kinefilter.pipeline.formats.plain import counted
from kinefilter.pipeline.formats.recording import mark_missing

if TYPE_CHECKING:
    from kinefilter.pipeline.avatar import Pose
    from kinefilter.pipeline.physics.shared_scene import Contact

MAX_MESSAGE = 2**15  # bytes: fits a datagram, and twice six bodies with all digits
_MAX_DISTANCE = 100.0  # m: no sensor that tracks people sees that far
_MOST_BODIES = 32  # in a frame, however many of them are followed
_MAX_ID_LENGTH = 32
_MAX_ID = 2.0**53  # a float holds whole numbers exactly up to here
_STATES = {float(state) for state in State}
_DECIMALS = 5  # 0.01 mm


class Reason(StrEnum):
    """What is wrong with a message that is ignored."""

    TOO_LONG = "too long"
    NOT_JSON = "not JSON"
    TOO_DEEP = "nested too deeply"
    NOT_A_FRAME = "not a frame"
    TIME = "invalid time stamp"
    NUMBER = "number out of range"
    JOINT = "unknown joint"
    JOINTS = "wrong number of joints"
    BODIES = "invalid bodies or ids"
    COMMAND = "not a push, throw or place"
    UNKNOWN = "no such person, joint or prop"


class MalformedError(KinefilterError):
    """A message is neither a frame nor a command; it is counted and ignored."""

    def __init__(self, reason: Reason, note: str = "") -> None:
        super().__init__(reason.value)
        self.reason, self.note = reason, note  # a note says more than the reason


@dataclass(frozen=True, eq=False)
class SeenBody:
    """A person in a frame."""

    id: str  # the sender's name for the person
    positions: Array  # joints [m], sensor frame, y up, NaN where missing, shape (J, 3)
    state: Codes  # tracking states (State), shape (J,)
    from_other_sensor: bool = False  # seen by a sensor that is not the leading one

    @property
    def is_seen(self) -> bool:
        """True if any joint of the person is visible."""
        return bool((self.state > State.NOT_TRACKED).any())

    @property
    def place(self) -> Array:
        """Mean of the visible joints [m], shape (3,)."""
        return np.asarray(np.nanmean(self.positions, axis=0))


@dataclass(frozen=True, eq=False)
class Frame:
    """What a sensor saw at one time."""

    time: float  # the sensor's time stamp [s]
    bodies: tuple[SeenBody, ...]  # each id once


class Push(NamedTuple):
    """Command to push a person, as in ``Avatar.push``."""

    body: str  # the sender's name for the person
    joint: str
    force: Array  # [N], shape (3,)
    seconds: float


class Throw(NamedTuple):
    """Command to throw a ball into the shared scene."""

    position: Array  # [m], shape (3,)
    velocity: Array  # [m/s], shape (3,)


class Place(NamedTuple):
    """Command to put a prop of the shared scene somewhere, at rest."""

    prop: str
    position: Array  # [m], shape (3,)
    rotation: Array  # wxyz, shape (4,)


Command = Push | Throw | Place
# The fields of each command, with how many numbers, and the largest. Names have none.
_COMMANDS: dict[str, tuple[type[Command], dict[str, tuple[int, float]]]] = {
    "push": (
        Push,
        {"body": (0, 0), "joint": (0, 0), "force": (3, 1e5), "seconds": (1, 10.0)},
    ),
    "throw": (Throw, {"position": (3, _MAX_DISTANCE), "velocity": (3, 100.0)}),
    "place": (
        Place,
        {"prop": (0, 0), "position": (3, _MAX_DISTANCE), "rotation": (4, 1.0)},
    ),
}


class LivePose(NamedTuple):
    """The character of one person after a frame."""

    id: str  # the sender's name for the person
    slot: int  # the lowest number, from 0, that was free when the person appeared
    time: float  # the frame's time stamp [s]
    body: Body
    pose: Pose
    latency: float  # time since the frame arrived [s]
    contacts: tuple[Contact, ...] | None = None  # None without a shared scene
    holds: str | None = None  # the prop in the character's hands


def as_arrays(frames: Sequence[tuple[float, SeenBody]]) -> tuple[Array, Array, Codes]:
    """Return stamps [s], positions [m] and states of one person's frames."""
    rows = [(time, seen.positions, seen.state) for time, seen in frames]
    time, positions, state = map(np.array, zip(*rows, strict=True))
    return time, positions, state


def parse_message(message: str | bytes, skeleton: Skeleton) -> Frame | Command:
    """Return the frame or command in a message; raise MalformedError if it is none."""
    data = _parsed(message)
    if len(data) == 1 and (kind := next(iter(data))) in _COMMANDS:
        return _parse_command(kind, data[kind])
    return _parse_frame(data, skeleton)


def _parsed(message: str | bytes) -> dict[str, Any]:
    if len(message) > MAX_MESSAGE:
        raise MalformedError(Reason.TOO_LONG)
    try:
        text = message.decode("utf-8") if isinstance(message, bytes) else message
        # Floats only: parsing an integer of thousands of digits takes long.
        data = json.loads(text, parse_int=float, parse_constant=_reject_constant)
    except RecursionError:
        raise MalformedError(Reason.TOO_DEEP) from None
    except ValueError:
        raise MalformedError(Reason.NOT_JSON) from None
    if not isinstance(data, dict):
        raise MalformedError(Reason.NOT_A_FRAME)
    return data


def _parse_frame(data: dict[str, Any], skeleton: Skeleton) -> Frame:
    if set(data) == {"time", "joints"}:
        data = {"time": data["time"], "bodies": [{"id": 1.0, "joints": data["joints"]}]}
    if set(data) != {"time", "bodies"} or not isinstance(data["bodies"], list):
        raise MalformedError(Reason.NOT_A_FRAME)
    time = data["time"]
    if type(time) is not float or not abs(time) < LATEST_TIME_STAMP:
        told = f"{time:g}" if type(time) is float else "not a number"
        note = f"the time stamp of a frame is {told}: send times in seconds"
        raise MalformedError(Reason.TIME, note)
    if len(data["bodies"]) > _MOST_BODIES:
        raise MalformedError(Reason.BODIES)
    bodies = tuple(_parse_body(body, skeleton) for body in data["bodies"])
    if len({body.id for body in bodies}) < len(bodies):
        raise MalformedError(Reason.BODIES)
    return Frame(time, bodies)


def _parse_command(kind: str, data: Any) -> Command:
    command, fields = _COMMANDS[kind]
    note = f"a {kind} has {', '.join(fields)}; CONVENTIONS.md shows one"
    wrong = MalformedError(Reason.COMMAND, note)
    if not isinstance(data, dict) or set(data) != set(fields):
        raise wrong
    values: list[Any] = []
    for name, (count, most) in fields.items():
        value = data[name]
        if count:
            numbers = value if isinstance(value, list) else [value]
            if [type(number) for number in numbers] != [float] * count:
                raise wrong
            least = 0.0 if name == "seconds" else -most
            if not all(least <= number <= most for number in numbers):
                high = f"{name} of a {kind}: expected {least:g} to {most:g}"
                raise MalformedError(Reason.NUMBER, high)
            value = np.array(value)
        elif name == "body":
            value = _parse_id(value)
        elif not isinstance(value, str):
            raise wrong
        values.append(value)
    return command(*values)


def _reject_constant(_: str) -> NoReturn:
    raise MalformedError(Reason.NUMBER)


def _parse_body(data: Any, skeleton: Skeleton) -> SeenBody:
    if not isinstance(data, dict) or set(data) != {"id", "joints"}:
        raise MalformedError(Reason.NOT_A_FRAME)
    joints = data["joints"]
    if isinstance(joints, dict):
        if unknown := joints.keys() - set(skeleton.joints):
            others = [s for s in SKELETONS.values() if joints.keys() <= set(s.joints)]
            wrong = f"no joint {shown(min(unknown))} in {skeleton.name}"
            raise MalformedError(Reason.JOINT, _advice(wrong, others))
        joints = [joints.get(name) for name in skeleton.joints]
    if not isinstance(joints, list):
        raise MalformedError(Reason.NOT_A_FRAME)
    if len(joints) != len(skeleton):
        others = [s for s in SKELETONS.values() if len(joints) == len(s)]
        wrong = (
            f"{counted(len(joints), 'joint')}, but {skeleton.name} has {len(skeleton)}"
        )
        raise MalformedError(Reason.JOINTS, _advice(wrong, others))
    rows = np.array([_parse_joint(joint) for joint in joints])
    positions, state = mark_missing(rows[:, :3], rows[:, 3].astype(np.uint8))
    return SeenBody(_parse_id(data["id"]), positions, state)


def _advice(wrong: str, others: Sequence[Skeleton]) -> str:
    names = " or ".join(other.name for other in others)
    return f"{wrong}: give --skeleton {names}" if names else wrong


def _parse_joint(joint: Any) -> tuple[float, float, float, float]:
    """Return x, y, z [m] and state of a joint."""
    if joint is None:
        return math.nan, math.nan, math.nan, 0.0
    numbers = isinstance(joint, list) and all(type(n) is float for n in joint)
    if not numbers or len(joint) not in (3, 4):
        raise MalformedError(Reason.NOT_A_FRAME)
    x, y, z, state = (*joint, float(State.TRACKED))[:4]
    far = max(abs(x), abs(y), abs(z))
    if not far < _MAX_DISTANCE:  # or infinite, such as 1e999
        note = f"a joint is {far:g} m away from the sensor: send positions in meters"
        raise MalformedError(Reason.NUMBER, note)
    if state not in _STATES:
        raise MalformedError(Reason.NUMBER)
    return x, y, z, state


def _parse_id(data: Any) -> str:
    if type(data) is float and data.is_integer() and 0.0 <= data < _MAX_ID:
        return str(int(data))
    if isinstance(data, str) and 0 < len(data) <= _MAX_ID_LENGTH and data.isprintable():
        return data
    raise MalformedError(Reason.BODIES)


def format_frame(frame: Frame) -> str:
    """Return a frame as a message without a line end, to 0.01 mm, joints in order."""
    bodies = []
    for body in frame.bodies:
        positions = np.round(body.positions, _DECIMALS).tolist()
        joints = [
            None if math.isnan(position[0]) else [*position, state]
            for position, state in zip(positions, body.state.tolist(), strict=True)
        ]
        bodies.append({"id": body.id, "joints": joints})
    return _to_json({"time": frame.time, "bodies": bodies})


def skeleton_line(skeleton: Skeleton) -> str:
    """Return the line that names the joints."""
    joints, parents = skeleton.joints, skeleton.parents
    return _to_json({"skeleton": skeleton.name, "joints": joints, "parents": parents})


def pose_line(live: LivePose) -> str:
    """Return the line of a pose."""
    pose, joints = live.pose, live.body.skeleton.joints
    positions = _rounded(pose.positions)
    data: dict[str, Any] = {
        "time": live.time,
        "body": live.id,
        "root": positions[live.body.skeleton.root],
        "positions": positions,
        "rotations": _rounded(pose.rotations),
        "stands": pose.stands.tolist(),
        "external_force": round(pose.external_force, 3),
        "latency": round(live.latency * 1e3, 2),
    }
    if live.contacts is not None:
        data["holds"] = live.holds
        data["contacts"] = [
            {
                "joint": joints[contact.joint],
                "with": contact.other,
                "position": _rounded(contact.position),
                "force": round(contact.force, 1),
            }
            for contact in live.contacts
        ]
    return _to_json(data)


def scene_line(scene: str, props: Sequence[Prop]) -> str:
    """Return the line that describes a shared scene: its props, and where they are."""
    described = [
        {
            "name": prop.name,
            "position": _rounded(prop.positions[-1]),
            "rotation": _rounded(prop.rotations[-1]),
            "shapes": [
                {
                    "kind": shape.kind,
                    "size": _rounded(shape.size),
                    "position": _rounded(shape.position),
                    "rotation": _rounded(shape.rotation),
                    "color": _rounded(shape.color),
                    "points": _rounded(shape.points),
                    "triangles": shape.triangles.tolist(),
                }
                for shape in prop.shapes
            ],
        }
        for prop in props
    ]
    return _to_json({"scene": scene, "props": described})


def props_line(time: float, poses: Mapping[str, Array]) -> str:
    """Return the line of props that moved, each x, y, z [m] and w, x, y, z."""
    moved = {name: _rounded(pose) for name, pose in poses.items()}
    return _to_json({"time": time, "props": moved})


def gone_line(body: str) -> str:
    """Return the line that reports that a person has left."""
    return _to_json({"body": body, "gone": True})


def _rounded(values: Array) -> Any:
    return values.round(_DECIMALS).tolist()


def _to_json(data: dict[str, Any]) -> str:
    return json.dumps(data, separators=(",", ":"), allow_nan=False)
