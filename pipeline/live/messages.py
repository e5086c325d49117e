"""Frames that come in and poses that go out, as messages: a line of JSON each.

A frame, for example::

    {"time": 12.034, "bodies": [{"id": "1", "joints": {
        "SpineBase": [0.11, -0.24, 2.31, 2], "SpineMid": [0.12, 0.05, 2.3], ...}}]}

``time`` is the sensor's own [s]. A joint is x, y, z [m] in the sensor's frame, y up,
and its state (0 not tracked, 1 inferred, 2 tracked), which may be left out. Joints that
are not seen are left out, null, or at the origin. Instead of by name, ``joints`` may
list all of the skeleton in the SDK's order: ``[[x, y, z, state], null, ...]``. An
``id`` is a text of up to 32 characters or a whole number, and means the same person
from every sender. A single person may be written short: ``{"time": 12.034, "joints":
...}``, and is body 1.

Poses begin with a line that says what the others mean::

    {"skeleton": "kinect_v2", "joints": ["SpineBase", ...], "parents": [-1, ...]}

Then comes a line a pose: ``time`` is the stamp of its frame [s] and ``body`` the
sender's id; ``root`` is the position of the root joint and ``positions`` those of all
joints, in that order [m], world frame: right-handed, y up, floor at y = 0.
``rotations`` are world rotations wxyz of the segment that ends at each joint, identity
in T-pose facing +z. ``stands`` says whether the left and the right foot stand,
``external_force`` the force that neither muscles nor floor give [body weights],
``latency`` how long the frame has been here [ms]. When a person is gone, one line says
so: ``{"body": "1", "gone": true}``.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np

from kinefilter.characters import Body, KinefilterError, Skeleton, State
from kinefilter.characters.arrays import Array, Codes
from kinefilter.characters.motion import LATEST
from kinefilter.pipeline.formats.recording import missing_marked

from .config import MOST_BODIES

if TYPE_CHECKING:
    from kinefilter.pipeline.avatar import Pose

LARGEST_MESSAGE = 2**15
"""Bytes: twice six bodies of 25 joints with all digits; less than a datagram holds."""

_FARTHEST = 100.0  # m: no sensor of people sees that far
_LONGEST_ID = 32
_LARGEST_ID = 2.0**53  # whole numbers are exact up to it
_STATES = {float(state) for state in State}
_DECIMALS = 5  # 0.01 mm


class Reason(StrEnum):
    """What is wrong with a message."""

    TOO_LONG = "too long"
    NOT_JSON = "not JSON"
    TOO_DEEP = "nested too deep"
    NOT_A_FRAME = "not a frame"
    TIME = "no time"
    NUMBER = "a number out of range"
    JOINT = "an unknown joint"
    BODIES = "bodies or their ids"


class MalformedError(KinefilterError):
    """A message is not a frame; it is counted and left out."""

    def __init__(self, reason: Reason) -> None:
        super().__init__(reason.value)
        self.reason = reason


@dataclass(frozen=True, eq=False)
class SeenBody:
    """A person in a frame."""

    id: str  # the sender's name for the person
    positions: Array  # of joints [m], sensor frame, y up, NaN where missing, (J, 3)
    state: Codes  # tracking states (State), shape (J,)
    carried: bool = False  # another sensor saw it than the one that leads

    @property
    def is_seen(self) -> bool:
        """Whether any joint of the person is seen."""
        return bool((self.state > State.NOT_TRACKED).any())


@dataclass(frozen=True, eq=False)
class Frame:
    """What a sensor saw at one time."""

    time: float  # the sensor's stamp [s]
    bodies: tuple[SeenBody, ...]  # each id once


@dataclass(frozen=True, eq=False)
class LivePose:
    """The character of one person after a frame."""

    id: str  # the sender's name for the person
    slot: int  # the lowest number, from 0, that was free when the person came
    time: float  # the frame's stamp [s]
    body: Body
    pose: Pose
    latency: float  # time since the frame came in [s]


def stacked(frames: Sequence[tuple[float, SeenBody]]) -> tuple[Array, Array, Codes]:
    """Return stamps [s], positions [m] and states of one person's frames."""
    rows = [(time, seen.positions, seen.state) for time, seen in frames]
    time, positions, state = zip(*rows, strict=True)
    return np.array(time), np.array(positions), np.array(state)


def parse_frame(
    message: str | bytes, skeleton: Skeleton, most_bodies: int = MOST_BODIES
) -> Frame:
    """Return the frame in a message; raises MalformedError of anything else."""
    if len(message) > LARGEST_MESSAGE:
        raise MalformedError(Reason.TOO_LONG)
    try:
        text = message.decode("utf-8") if isinstance(message, bytes) else message
        # Singles alone: a whole number of thousands of digits takes long to read.
        data = json.loads(text, parse_int=float, parse_constant=_no_number)
    except RecursionError:
        raise MalformedError(Reason.TOO_DEEP) from None
    except ValueError:
        raise MalformedError(Reason.NOT_JSON) from None
    if not isinstance(data, dict):
        raise MalformedError(Reason.NOT_A_FRAME)
    if set(data) == {"time", "joints"}:
        data = {"time": data["time"], "bodies": [{"id": 1.0, "joints": data["joints"]}]}
    if set(data) != {"time", "bodies"} or not isinstance(data["bodies"], list):
        raise MalformedError(Reason.NOT_A_FRAME)
    time = data["time"]
    if type(time) is not float or not abs(time) < LATEST:
        raise MalformedError(Reason.TIME)
    if len(data["bodies"]) > most_bodies:
        raise MalformedError(Reason.BODIES)
    bodies = tuple(_body(body, skeleton) for body in data["bodies"])
    if len({body.id for body in bodies}) < len(bodies):
        raise MalformedError(Reason.BODIES)
    return Frame(time, bodies)


def _no_number(_: str) -> NoReturn:
    raise MalformedError(Reason.NUMBER)


def _body(data: Any, skeleton: Skeleton) -> SeenBody:
    if not isinstance(data, dict) or set(data) != {"id", "joints"}:
        raise MalformedError(Reason.NOT_A_FRAME)
    joints = data["joints"]
    if isinstance(joints, dict):
        if not joints.keys() <= set(skeleton.joints):
            raise MalformedError(Reason.JOINT)
        joints = [joints.get(name) for name in skeleton.joints]
    if not isinstance(joints, list) or len(joints) != len(skeleton):
        raise MalformedError(Reason.NOT_A_FRAME)
    numbers = np.array([_row(joint) for joint in joints])
    positions, state = missing_marked(numbers[:, :3], numbers[:, 3].astype(np.uint8))
    return SeenBody(_id(data["id"]), positions, state)


def _row(joint: Any) -> tuple[float, float, float, float]:
    """Return x, y, z [m] and state of a joint."""
    if joint is None:
        return math.nan, math.nan, math.nan, 0.0
    numbers = isinstance(joint, list) and all(type(n) is float for n in joint)
    if not numbers or len(joint) not in (3, 4):
        raise MalformedError(Reason.NOT_A_FRAME)
    x, y, z, state = (*joint, float(State.TRACKED))[:4]
    # Infinite numbers, such as 1e999, are beyond it too.
    if not max(abs(x), abs(y), abs(z)) < _FARTHEST or state not in _STATES:
        raise MalformedError(Reason.NUMBER)
    return x, y, z, state


def _id(data: Any) -> str:
    if type(data) is float and data.is_integer() and 0.0 <= data < _LARGEST_ID:
        return str(int(data))
    if isinstance(data, str) and 0 < len(data) <= _LONGEST_ID and data.isprintable():
        return data
    raise MalformedError(Reason.BODIES)


def format_frame(frame: Frame) -> str:
    """Return a frame as a message without a line end, to 0.01 mm, joints in order."""
    bodies = []
    for body in frame.bodies:
        places = np.round(body.positions, _DECIMALS).tolist()
        joints = [
            None if math.isnan(place[0]) else [*place, state]
            for place, state in zip(places, body.state.tolist(), strict=True)
        ]
        bodies.append({"id": body.id, "joints": joints})
    return _line({"time": frame.time, "bodies": bodies})


def skeleton_line(skeleton: Skeleton) -> str:
    """Return the line that names the joints."""
    names = {"skeleton": skeleton.name, "joints": skeleton.joints}
    return _line({**names, "parents": skeleton.parents})


def pose_line(live: LivePose) -> str:
    """Return the line of a pose."""
    pose = live.pose
    positions = pose.positions.round(_DECIMALS).tolist()
    return _line(
        {
            "time": live.time,
            "body": live.id,
            "root": positions[live.body.skeleton.root],
            "positions": positions,
            "rotations": pose.rotations.round(_DECIMALS).tolist(),
            "stands": pose.stands.tolist(),
            "external_force": round(pose.external_force, 3),
            "latency": round(live.latency * 1e3, 2),
        }
    )


def gone_line(body: str) -> str:
    """Return the line that says that a person is gone."""
    return _line({"body": body, "gone": True})


def _line(data: dict[str, Any]) -> str:
    return json.dumps(data, separators=(",", ":"), allow_nan=False)
