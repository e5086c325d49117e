"""What senders may say: read exactly, bounded, and counted where it is no frame."""

from __future__ import annotations

import asyncio
import json

import numpy as np
import pytest
from hostile_messages import good, hostile_messages
from hypothesis import given, settings
from hypothesis import strategies as st

from kinefilter.characters import KINECT_V1, KINECT_V2, InputError, State
from kinefilter.pipeline.live.crowd import Stamps
from kinefilter.pipeline.live.endpoints import (
    MAX_CONNECTIONS,
    Address,
    listening_host,
    parse_address,
)
from kinefilter.pipeline.live.messages import (
    Frame,
    MalformedError,
    Reason,
    SeenBody,
    format_frame,
    parse_message,
)
from kinefilter.pipeline.live.sources import Intake, Rate, Receiver
from kinefilter.pipeline.live.tally import Event, Tally
from kinefilter.pipeline.loopback import is_loopback

STATES = [int(state) for state in State]
_NO_FRAME = Reason.NOT_A_FRAME


def _line(**changes: object) -> str:
    return json.dumps({**good(), **changes})


@settings(max_examples=50, deadline=None)
@given(
    time=st.floats(-1e9, 1e9),
    seed=st.integers(0, 2**31),
    ids=st.lists(st.text("aZ9 é雪", min_size=1, max_size=8), max_size=6, unique=True),
)
def test_a_frame_written_reads_back_the_same(
    time: float, seed: int, ids: list[str]
) -> None:
    rng = np.random.default_rng(seed)
    bodies = []
    for body in ids:
        state = rng.choice(STATES, len(KINECT_V2)).astype(np.uint8)
        places = rng.uniform(-9.0, 9.0, (len(KINECT_V2), 3)).round(5)
        places[state == State.NOT_TRACKED] = np.nan
        bodies.append(SeenBody(body, places, state))
    read = parse_message(format_frame(Frame(time, tuple(bodies))), KINECT_V2)
    assert read.time == time
    assert [body.id for body in read.bodies] == ids
    for one, other in zip(bodies, read.bodies, strict=True):
        np.testing.assert_array_equal(one.positions, other.positions)
        np.testing.assert_array_equal(one.state, other.state)


def test_joints_by_name_in_order_and_alone_say_the_same() -> None:
    named = good(2.5)
    joints = named["bodies"][0]["joints"]
    listed = {**named, "bodies": [{"id": 1, "joints": list(joints.values())}]}
    alone = {"time": 2.5, "joints": joints}
    frames = [
        parse_message(json.dumps(data), KINECT_V1) for data in (named, listed, alone)
    ]
    for frame in frames:
        (body,) = frame.bodies
        assert (frame.time, body.id) == (2.5, "1")
        np.testing.assert_array_equal(body.positions, frames[0].bodies[0].positions)


def test_a_joint_left_out_null_or_at_the_origin_is_missing() -> None:
    frame = good()
    joints = frame["bodies"][0]["joints"]
    del joints["Head"]
    joints["HandLeft"], joints["HandRight"] = None, [0, 0, 0, 2]
    joints["Spine"] = [0.1, 0.2, 0.3]
    (body,) = parse_message(json.dumps(frame), KINECT_V1).bodies
    missing = [KINECT_V1.index(name) for name in ("Head", "HandLeft", "HandRight")]
    assert np.isnan(body.positions[missing]).all()
    assert (body.state[missing] == State.NOT_TRACKED).all()
    assert body.state[KINECT_V1.index("Spine")] == State.TRACKED
    assert np.isnan(body.positions).sum() == 9


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        ("", Reason.NOT_JSON),
        ("\x00\x01", Reason.NOT_JSON),
        (b"\xff\xfe{}", Reason.NOT_JSON),
        ("[" * 30_000, Reason.TOO_DEEP),
        (" " * 40_000, Reason.TOO_LONG),
        ("[]", Reason.NOT_A_FRAME),
        ("{}", Reason.NOT_A_FRAME),
        (_line(extra=1), Reason.NOT_A_FRAME),
        (_line(time=True), Reason.TIME),
        (_line(time=1e300), Reason.TIME),
        ('{"time": NaN, "bodies": []}', Reason.NUMBER),
        ('{"time": 1e999, "bodies": []}', Reason.TIME),
        (_line(bodies=[{"id": "1"}]), Reason.NOT_A_FRAME),
        (_line(bodies=[{"id": 0.5, "joints": {}}]), Reason.BODIES),
        (_line(bodies=[{"id": "x" * 33, "joints": {}}]), Reason.BODIES),
        (_line(bodies=[{"id": "a\n", "joints": {}}]), Reason.BODIES),
        (_line(bodies=[{"id": 1, "joints": {}}] * 2), Reason.BODIES),
        (_line(bodies=[{"id": n, "joints": {}} for n in range(33)]), Reason.BODIES),
        (_line(bodies=[{"id": 1, "joints": {"Tail": [1, 1, 1]}}]), Reason.JOINT),
        (_line(bodies=[{"id": 1, "joints": [None] * 25}]), Reason.JOINTS),
        (_line(bodies=[{"id": 1, "joints": {"Head": [1, 1, 101]}}]), Reason.NUMBER),
        (_line(bodies=[{"id": 1, "joints": {"Head": [1, 1, 1, 3]}}]), Reason.NUMBER),
        (_line(bodies=[{"id": 1, "joints": {"Head": ["1", 1, 1]}}]), _NO_FRAME),
    ],
)
def test_what_is_no_frame_has_a_reason(message: str | bytes, reason: Reason) -> None:
    with pytest.raises(MalformedError) as caught:
        parse_message(message, KINECT_V1)
    assert caught.value.reason is reason


@pytest.mark.parametrize(
    ("joints", "note"),
    [
        ([None] * 20, "20 joints, but kinect_v2 has 25: give --skeleton kinect_v1"),
        ([None] * 17, "17 joints, but kinect_v2 has 25"),
        ({"Spine": None}, "no joint 'Spine' in kinect_v2: give --skeleton kinect_v1"),
        ({"Tail\n": None}, "no joint 'Tail\\n' in kinect_v2"),
    ],
)
def test_joints_of_another_skeleton_are_told(joints: object, note: str) -> None:
    with pytest.raises(MalformedError) as caught:
        parse_message(_line(bodies=[{"id": 1, "joints": joints}]), KINECT_V2)
    assert caught.value.note == note


@pytest.mark.parametrize(
    ("time", "told"), [(1.7e12, "is 1.7e+12: send times in seconds"), ("1", "a number")]
)
def test_stamps_that_are_no_seconds_are_told(time: object, told: str) -> None:
    with pytest.raises(MalformedError) as caught:
        parse_message(_line(time=time), KINECT_V1)
    assert told in caught.value.note


def test_what_a_command_has_is_told() -> None:
    for message, note in (
        ({"push": {"part": "Head"}}, "a push has body, joint, force, seconds"),
        ({"throw": {"position": [0, 0, 1e9], "velocity": [0, 0, 0]}}, "-100 to 100"),
    ):
        with pytest.raises(MalformedError) as caught:
            parse_message(json.dumps(message), KINECT_V1)
        assert note in caught.value.note


def test_no_hostile_message_is_taken_for_a_frame_and_none_raises_anything_else() -> (
    None
):
    reasons = set()
    for message in hostile_messages(2000, seed=3):
        with pytest.raises(MalformedError) as caught:
            parse_message(message, KINECT_V1)
        reasons.add(caught.value.reason)
    assert reasons == set(Reason) - {Reason.UNKNOWN}
    assert parse_message(json.dumps(good()), KINECT_V1).bodies[0].is_seen


def test_a_rate_lets_a_kinect_and_a_burst_pass_and_no_flood() -> None:
    rate = Rate(0.0)
    assert all(rate.allows(k / 30.0) for k in range(300))
    assert sum(rate.allows(10.0) for _ in range(1000)) <= 60
    flood = [rate.allows(20.0 + k * 1e-4) for k in range(10_000)]
    assert 240 <= sum(flood) <= 301


def test_silent_senders_make_room_for_others() -> None:
    peers = Receiver(Intake(print, asyncio.Event().wait, print, Tally()))
    assert all(peers.rate(n, 0.0) for n in range(MAX_CONNECTIONS))
    assert peers.rate("late", 5.0) is None
    assert peers.rate(0, 5.0) is not None
    assert peers.rate("late", 11.0) is not None


def test_time_stamps_tell_late_repeated_missing_and_new_clocks() -> None:
    stamps = Stamps()
    assert all(stamps.arrive(k / 30.0) == (None, 0) for k in range(30))
    assert stamps.arrive(29 / 30.0) == (Event.REPEATED, 0)
    assert stamps.arrive(27 / 30.0) == (Event.LATE, 0)
    assert stamps.arrive(33 / 30.0) == (None, 3)
    assert stamps.arrive(100.0) == (None, 0)
    assert stamps.arrive(0.0) == (Event.RESTARTED, 0)
    assert stamps.arrive(1 / 30.0) == (None, 0)


@pytest.mark.parametrize(
    "text",
    [
        *("udp://127.0.0.1", "udp://:9000", "http://127.0.0.1:80", "127.0.0.1:9000"),
        *("udp://127.0.0.1:70000", "ws://a@b:1", "ws://h:1/../x", "ws://h:1?token=x"),
        *("", "--", "udp://[::1:9"),
    ],
)
def test_what_is_no_address_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="expected one of"):
        parse_address(text, ("udp", "ws", "-"))


def test_addresses_read_as_they_are_written() -> None:
    for text in ("udp://127.0.0.1:9000", "ws://[::1]:0", "-"):
        assert str(parse_address(text, ("udp", "ws", "-"))) == text


def test_nothing_listens_to_other_machines_unless_it_is_said() -> None:
    for host in ("0.0.0.0", "192.168.0.7", "::", "studio.example"):
        assert not is_loopback(host)
        with pytest.raises(InputError, match="--bind"):
            listening_host(Address("ws", host, 1), None)
    for host in ("127.0.0.1", "127.8.8.8", "::1", "localhost"):
        assert listening_host(Address("ws", host, 1), None) == host
    assert listening_host(Address("ws", "127.0.0.1", 1), "0.0.0.0") == "0.0.0.0"
