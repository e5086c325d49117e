"""Live sessions through real sockets of loopback."""

from __future__ import annotations

import asyncio
import itertools
import json
import socket
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hostile_messages import hostile_messages
from live_session import (
    SAMPLE,
    WS,
    Sender,
    config,
    do,
    pose,
    reading,
    running,
    sample_frame,
)
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed

from kinefilter import Avatar, read_take
from kinefilter.characters import KINECT_V1, standard_body
from kinefilter.pipeline.commands.live import summary
from kinefilter.pipeline.live import sinks
from kinefilter.pipeline.live.endpoints import (
    MAX_CONNECTIONS,
    Access,
    Address,
    open_server,
)
from kinefilter.pipeline.live.live_session import Session
from kinefilter.pipeline.live.messages import Reason, format_frame, skeleton_line
from kinefilter.pipeline.live.sinks import Broadcast, Kind
from kinefilter.pipeline.live.sources import Intake, Receiver
from kinefilter.pipeline.live.tally import Event, Tally


def test_poses_are_those_of_an_avatar_given_the_same_frames() -> None:
    async def session() -> None:
        avatar = Avatar(standard_body(KINECT_V1, height=1.8))
        async with running(config()) as (_, (source, out)):
            sender = Sender(source)
            async with reading(out) as stream:
                for row in range(20):
                    frame = sample_frame(row)
                    sender.send(frame)
                    found = await pose(stream)
                    (seen,) = frame.bodies
                    wanted = avatar.step(seen.positions, frame.time, seen.state)
                    assert (found["time"], found["body"]) == (frame.time, "1")
                    np.testing.assert_allclose(
                        found["positions"], wanted.positions, atol=1e-4
                    )
                    np.testing.assert_allclose(
                        found["rotations"], wanted.rotations, atol=1e-4
                    )
                    assert found["root"] == found["positions"][KINECT_V1.root]
                    assert found["stands"] == wanted.stands.tolist()
                    assert 0.0 < found["latency"] < 1e4

    do(session())


def test_a_sensor_upside_down_and_impossible_bodies_are_told() -> None:
    async def session() -> None:
        async with running(config()) as (run, (source, out)):
            sender = Sender(source)
            async with reading(out) as stream:
                for row in range(6):
                    frame = sample_frame(row)
                    (seen,) = frame.bodies
                    away = [50.0 * (row == 5), 0.0, 0.0]
                    over = replace(seen, positions=seen.positions * [-1, -1, 1] + away)
                    sender.send(replace(frame, bodies=(over,)))
                    await pose(stream)
            (note,) = run.tally.as_json()["notes"]
            assert "upside down" in note
            assert run.tally.as_json()["impossible"] == 1
            rows = [str(cell) for cell in summary(run.tally).columns[1].cells]
            assert note in rows

    do(session())


def test_frames_come_by_websocket_and_several_read_the_poses() -> None:
    async def session() -> None:
        async with (
            running(config(source=WS)) as (_, (source, out)),
            reading(out) as one,
            reading(out) as other,
        ):
            for row in range(2):  # a sender that comes back
                async with connect(str(source)) as sender:
                    await sender.send(format_frame(sample_frame(row)))
                    found = await pose(one)
                    assert found["time"] == row / 30.0
                    assert await pose(other) == found

    do(session())


def test_malformed_messages_are_counted_and_the_next_frame_has_its_pose() -> None:
    async def session() -> None:
        async with running(config(source=WS)) as (run, (source, out)):
            async with reading(out) as stream, connect(str(source)) as sender:
                for message in hostile_messages(50, seed=5):
                    if len(message) < 2**15:
                        await sender.send(message)
                await sender.send(format_frame(sample_frame(0)))
                assert (await pose(stream))["time"] == 0.0
            longer = sum(len(m) >= 2**15 for m in hostile_messages(50, seed=5))
            assert run.tally.malformed.total() == 50 - longer
            assert run.tally.events[Event.FRAMES] == 1
            assert 0 < longer < 20

    do(session())


def test_people_beyond_those_followed_leave_them_their_poses() -> None:
    session = Session(config(source="-", bodies=1))
    for row in range(3):
        others = () if row == 0 else tuple(f"passer-by {n}" for n in range(7))
        session.receive(format_frame(sample_frame(row, *others, "1")))
        turn = session.crowd.next()
        assert turn is not None
        assert (turn[0].id, turn[1].time) == ("1", row / 30.0)
    assert session.tally.events[Event.CROWDED] == 14
    assert not session.tally.malformed


def test_a_sender_that_starts_again_is_followed_from_its_first_frame() -> None:
    async def session() -> None:
        async with (
            running(config()) as (run, (source, out)),
            reading(out) as stream,
        ):
            sender = Sender(source)
            for time in (1000.0, 1000.033, 0.0, 0.033):
                sender.send(sample_frame(0, time=time))
                assert (await pose(stream))["time"] == time
            assert run.tally.events[Event.RESTARTED] == 1
            assert run.tally.events[Event.FAILED] == 0

    do(session())


def test_who_is_no_human_is_measured_anew_and_others_go_on() -> None:
    async def session() -> None:
        async with (
            running(config(height=None)) as (run, (_, out)),
            reading(out) as stream,
        ):
            for row in range(50):
                frame = sample_frame(row, "in meters", "in whatever")
                frame.bodies[1].positions[:] *= 30.0
                run.receive(format_frame(frame))
                await run._done()
            last = {"time": -1.0}
            while last["time"] < 49 / 30.0:
                last = await pose(stream)
                assert last["body"] == "in meters"
            assert run.tally.events[Event.FAILED] >= 1

    do(session())


def test_a_message_too_long_ends_the_connection_and_is_counted() -> None:
    async def session() -> None:
        async with (
            running(config(source=WS)) as (run, (source, _)),
            connect(str(source)) as sender,
        ):
            await sender.send("x" * 10**6)
            with pytest.raises(ConnectionClosed):
                await sender.recv()
        assert run.tally.malformed == {Reason.TOO_LONG: 1}

    do(session())


def test_a_flood_is_cut_to_the_rate_and_counted() -> None:
    async def session() -> None:
        async with (
            running(config(source=WS)) as (run, (source, _)),
            connect(str(source)) as sender,
        ):
            for _ in range(2000):
                await sender.send("{}")
        taken = run.tally.malformed[Reason.NOT_A_FRAME]
        assert taken + run.tally.events[Event.TOO_FAST] == 2000
        assert 60 <= taken < 1500

    do(session())


def test_a_flood_of_datagrams_is_cut_for_each_sender() -> None:
    taken, tally = [], Tally()

    async def done() -> None:
        """Nothing to wait for."""

    intake = Intake(taken.append, done, lambda: None, tally)
    port = Receiver(intake)
    for _ in range(1000):
        port.datagram_received(b"{}", ("127.0.0.1", 1))
    assert 60 <= len(taken) < 500
    assert len(taken) + tally.events[Event.TOO_FAST] == 1000
    for n in range(2, 2 + MAX_CONNECTIONS):
        port.datagram_received(b"{}", ("127.0.0.1", n))
    assert tally.events[Event.REFUSED] == 1


def test_who_never_reads_loses_lines_is_let_go_and_costs_others_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sinks, "_DEAD", 0.2)

    async def session() -> None:
        tally, most = Tally(), 0
        intake = Intake(print, asyncio.Event().wait, print, tally)
        lines = Broadcast(lambda: [skeleton_line(KINECT_V1)], intake)
        place = Address("ws", "127.0.0.1", 0)
        async with open_server(
            lines.handle, place, Access(), tally, largest=1000
        ) as out:
            lazy = _lazy_reader(out)
            async with reading(out) as stream:
                await asyncio.get_running_loop().sock_recv(lazy, 1)  # it is there
                for n in itertools.count():
                    line = json.dumps([n, "x" * 50_000])
                    lines.put(line, Kind.POSE)
                    assert await stream.recv() == line
                    most = max(most, *(waiting.qsize() for waiting in lines.readers))
                    if len(lines.readers) == 1:
                        break
        assert tally.events[Event.SLOW] > 0
        assert most <= 32

    do(session())


def test_slow_readers_lose_only_poses() -> None:
    async def session() -> None:
        tally, scene, read = Tally(), "no props", list[str]()
        intake = Intake(print, asyncio.Event().wait, print, tally)
        lines, gate = Broadcast(lambda: ["joints", scene], intake), asyncio.Event()

        async def write(line: str) -> None:
            await gate.wait()
            read.append(line)

        reader = asyncio.ensure_future(lines.serve(write))
        await asyncio.sleep(0)
        lines.put("1 is gone", Kind.OTHER)
        for n in range(100):
            lines.put(f"pose {n}", Kind.POSE)
            lines.put(scene := f"props {n}")
        lines.put("2 is gone", Kind.OTHER)
        gate.set()
        while not read or read[-1] != "2 is gone":
            await asyncio.sleep(0)
        assert len(read) <= 33
        assert read[:2] == ["joints", "1 is gone"]
        assert scene in read
        assert not any(line.startswith("pose 0") for line in read)
        lost = 100 - sum(line.startswith("pose") for line in read)
        assert tally.events[Event.SLOW] == lost > 0

        gate.clear()
        for n in range(40):
            lines.put(f"{n} is gone", Kind.OTHER)
        assert not lines.readers
        gate.set()
        await reader

    do(session())


def _lazy_reader(out: Address) -> socket.socket:
    lazy = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    lazy.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
    lazy.connect((out.host, out.port))
    lazy.sendall(
        b"GET / HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\n"
        b"Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
        b"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"
    )
    lazy.setblocking(False)
    return lazy


def test_a_recording_is_there_when_the_session_ends(tmp_path: Path) -> None:
    async def session() -> None:
        what = config(record=tmp_path / "take.csv")
        async with running(what) as (run, (source, out)):
            sender = Sender(source)
            async with reading(out) as stream:
                for row in range(10):
                    sender.send(sample_frame(row, "a", "b"))
                    await pose(stream)
                    await pose(stream)
        assert [path.name for path in run.recorded] == ["take.1.csv", "take.2.csv"]

    do(session())
    for n in (1, 2):
        take = read_take(tmp_path / f"take.{n}.csv")
        np.testing.assert_allclose(take.positions, SAMPLE.positions[:10], atol=1e-5)
