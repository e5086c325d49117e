"""Live sessions of several sensors: where they stand, what they make of a person."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from live_sensors import alone, error, first_frames, follow, frames, two_sensors, views
from live_session import (
    SAMPLE,
    Sender,
    config,
    do,
    pose,
    reading,
    running,
    sample_frame,
)

from kinefilter import Avatar, read_take
from kinefilter.characters import KINECT_V1, InputError, standard_body
from kinefilter.pipeline.lab.simulation import SimulatedView
from kinefilter.pipeline.live.live_session import Session
from kinefilter.pipeline.live.messages import Frame, format_frame
from kinefilter.pipeline.live.sensors import Sensors, find_alignment
from kinefilter.pipeline.live.tally import Event
from kinefilter.pipeline.merge import align, merge, write_calibration

UDP = "udp://127.0.0.1:0"


def _arrived(*seen: SimulatedView, late: float = 0.0) -> tuple[Sensors, float]:
    """Return sensors with all frames, and when the last one came [s]."""
    sensors, last = two_sensors(seen[0].pair.take), 0.0
    for number, now, frame in frames(*seen, late=late):
        sensors.arrive(number, frame, now)
        last = now
    return sensors, last


def _answer(sensors: Sensors, times: int = 2) -> None:
    """Let sensors find where the second one is, so many times."""
    given = [stream.recording(sensors._skeleton) for stream in sensors.streams]
    found = find_alignment([recording for recording in given if recording is not None])
    for _ in range(times):
        sensors._consider(sensors.streams[1], found)


def _told(sensors: Sensors, now: float) -> list[str]:
    sensors.update_notes(now)
    return sensors.tally.all_notes()


def test_a_sensor_joins_where_two_answers_agree() -> None:
    both = views(3)
    sensors, now = _arrived(*both, late=0.04)
    assert "walk back and forth" in _told(sensors, now)[0]
    _answer(sensors, 1)
    assert not sensors.joined
    _answer(sensors, 1)
    (stream,) = sensors.joined
    (note,) = _told(sensors, now)
    assert note.startswith("sensor 2 joined: -90 degrees, ")
    assert stream.late == pytest.approx(0.04, abs=0.02)
    assert stream.clock is not None
    moment = np.asarray(both[0].clock.at(np.asarray(3.0)))
    assert stream.clock.at(moment) == pytest.approx(
        both[1].clock.at(np.asarray(3.0)), abs=0.01
    )


def test_who_comes_too_late_is_told() -> None:
    sensors, now = _arrived(*views(3), late=0.4)
    _answer(sensors)
    assert "too late to be fused" in _told(sensors, now)[0]


@pytest.mark.parametrize(("seed", "most"), [(200, 0.905), (201, 0.91), (202, 0.97)])
def test_followed_by_both_is_truer_than_by_either(seed: int, most: float) -> None:
    long = views(seed, 60.0)
    found = align(*(view.pair.take for view in long))
    both = first_frames(long, 90)
    pairs = [view.pair for view in both]
    single = [error(alone(pair.take), pair.truth, pair.take) for pair in pairs]
    fused = error(follow(both, found), pairs[0].truth, pairs[0].take)
    assert fused < most * min(single), (fused, single)


@pytest.mark.parametrize(
    ("one", "other", "words"),
    [(3, 3, "are identical (compared"), (3, 6, "at any lag (compared")],
)
def test_what_does_not_fit_is_told(one: int, other: int, words: str) -> None:
    seen = [views(one)[0], views(other)[int(one != other)]]
    sensors, now = _arrived(*seen)
    stream = sensors.streams[1]
    stream.frames.appendleft(replace(stream.frames[0], time=stream.frames[0].time - 20))
    given = [s.recording(sensors._skeleton) for s in _arrived(*seen)[0].streams]
    found = find_alignment([recording for recording in given if recording is not None])
    assert isinstance(found, str)
    sensors._consider(stream, found)
    assert words in _told(sensors, now)[0]
    assert not sensors.joined


def test_a_copy_of_the_stream_that_is_not_to_the_frame_is_told() -> None:
    """Of the same stream twice, one may have a frame more."""
    view = views(3)[0]
    take = view.pair.take
    sensors, _ = _arrived(view, view)
    sensors.streams[1].frames.popleft()
    given = [stream.recording(take.skeleton) for stream in sensors.streams]
    found = find_alignment([recording for recording in given if recording is not None])
    assert found == "it repeats the stream of sensor 1"


@pytest.mark.parametrize("number", [0, 1])
def test_a_clock_that_jumps_is_set_by_when_frames_come(number: int) -> None:
    sensors, now = _arrived(*views(3), late=0.02)
    _answer(sensors)
    stream = sensors.streams[1]
    assert stream.clock is not None
    before = [s.frames[-1].time for s in sensors.streams]
    apart = float(stream.clock.at(np.asarray(before[0]))) - before[0]
    jump = 500.0
    for k in range(1, 40):
        for which in (0, 1):
            last = sensors.streams[which].frames[-1]
            stamp = before[which] + k / 30.0 + jump * (which == number)
            sensors.arrive(which, Frame(stamp, last.bodies), now + k / 30.0)
        assert bool(sensors.joined) == (k >= 15)
    moved = before[0] + 1.0 + jump * (number == 0)
    expected = apart + jump * (1 if number else -1)
    assert float(stream.clock.at(np.asarray(moved))) - moved == pytest.approx(
        expected, abs=0.05
    )
    assert "after a clock jumped" in _told(sensors, now + 40 / 30.0)[0]


def test_sensors_that_see_nobody_or_send_nothing_are_told() -> None:
    first, second = views(3)
    sensors, now = _arrived(first)
    assert _told(sensors, now) == ["sensor 2 sends nothing"]
    nobody = Frame(0.0, ())
    sensors.arrive(1, nobody, now)
    assert _told(sensors, now) == ["sensor 2 sees no one"]
    sensors, now = _arrived(second)  # the other way round
    assert _told(sensors, now + 60.0) == []


def test_the_second_sensor_leads_where_the_first_is_dark_from_the_start() -> None:
    sensors = two_sensors(SAMPLE)
    leads = [sensors.arrive(1, sample_frame(row), row / 30.0) for row in range(90)]
    assert leads == [row / 30.0 > 2.0 for row in range(90)]
    assert not sensors.arrive(0, sample_frame(90), 3.0)


def test_one_sensor_is_followed_as_ever_until_another_is_placed() -> None:
    async def session() -> None:
        avatar = Avatar(standard_body(KINECT_V1, height=1.8))
        async with running(config(source=(UDP, UDP))) as (run, (one, other, out)):
            senders = Sender(one), Sender(other)
            async with reading(out) as stream:
                for row in range(20):
                    frame = sample_frame(row)
                    senders[1].send(sample_frame(row + 20))
                    senders[0].send(frame)
                    found = await pose(stream)
                    (seen,) = frame.bodies
                    wanted = avatar.step(seen.positions, frame.time, seen.state)
                    np.testing.assert_allclose(
                        found["positions"], wanted.positions, atol=1e-4
                    )
            assert run.tally.events[Event.FUSED] == 0

    do(session())


def test_who_leaves_the_first_sensor_goes_on_by_the_second() -> None:
    """In the first one's frame and by its clock, as the same person."""
    long = views(4)
    found = align(*(view.pair.take for view in long))
    both = first_frames(long, 120)
    what = replace(config(source=("-", UDP), height=1.7), skeleton="kinect_v2")
    session, poses = Session(what), []
    assert session.sensors is not None
    send, stream = poses.append, session.sensors.streams[1]
    session._sinks.append(type("Sink", (), {"send": staticmethod(send)})())
    rows = list(frames(*both))
    for k, (number, _, frame) in enumerate(rows):
        if number == 0 and k > len(rows) // 2:
            continue
        for presence in session.crowd._here.values():
            presence.seen_by_lead = np.inf if k <= len(rows) // 2 else -np.inf
        session.receive(format_frame(frame), number)
        stream.clock, stream.placed = found.clock, found.placed
        while (turn := session.crowd.next()) is not None:
            session._pose(turn)
    take, truth = both[0].pair.take, both[0].pair.truth
    assert {live.id for live in poses} == {"1"}
    last = poses[-1].time
    assert last == pytest.approx(take.time[-1], abs=0.1)
    (presence,) = session.crowd._here.values()
    assert presence.person is not None
    place = truth[np.searchsorted(take.time, last) - 1].mean(axis=0)
    np.testing.assert_allclose(presence.person.place, place, atol=0.1)
    assert session.tally.events[Event.FUSED] > 0.8 * len(rows) / 4


def test_each_sensor_is_recorded(tmp_path: Path) -> None:
    what = config(source=(UDP, UDP), record=tmp_path / "take.csv")

    async def session() -> None:
        async with running(what) as (run, (one, other, out)):
            senders = Sender(one), Sender(other)
            async with reading(out) as stream:
                for row in range(10):
                    senders[1].send(sample_frame(row + 100))
                    senders[0].send(sample_frame(row))
                    await pose(stream)
            assert not run.failure

    do(session())
    for number, first in ((1, 0), (2, 100)):
        take = read_take(tmp_path / f"take.sensor{number}.csv")
        there = SAMPLE.positions[first : first + 10]
        np.testing.assert_allclose(take.positions, there, atol=1e-5)


@pytest.mark.parametrize(
    ("sources", "said"),
    [
        (("udp://127.0.0.1:9", "udp://127.0.0.1:9"), "twice"),
        (("-", "-"), "--in - is given twice"),
        ((), "--in is missing"),
    ],
)
def test_sources_that_cannot_be(sources: Sequence[str], said: str) -> None:
    with pytest.raises(InputError, match=said):
        Session(config(source=tuple(sources)))


def test_a_calibration_is_of_as_many_sensors(tmp_path: Path) -> None:
    path = tmp_path / "session.json"
    write_calibration(merge([view.pair.take for view in views(3)]), path)
    with pytest.raises(InputError, match="several --in"):
        Session(config(calibration=path))
    with pytest.raises(InputError, match="covers 2 sensors"):
        Session(config(source=(UDP, UDP, UDP), calibration=path))
    sensors = Session(config(source=(UDP, UDP), calibration=path)).sensors
    assert sensors is not None
    assert sensors.streams[1].placed is not None
