"""Live sessions through real sockets of loopback."""

from __future__ import annotations

import asyncio
import itertools
import json
import re
import socket
import ssl
import subprocess
from collections.abc import Coroutine
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hostile_messages import hostile_messages
from live_session import (
    PATIENCE,
    SAMPLE,
    UDP,
    WS,
    Sender,
    config,
    pose,
    reading,
    running,
    sample_frame,
)
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed, InvalidStatus

from kinefilter.characters import KINECT_V1, InputError, standard_body
from kinefilter.pipeline import Avatar, read_take
from kinefilter.pipeline.live import (
    LiveConfig,
    OpenConfig,
    Session,
    format_frame,
    open_sender,
    replay,
)
from kinefilter.pipeline.live import broadcast as broadcasting
from kinefilter.pipeline.live.access import Access
from kinefilter.pipeline.live.addresses import Address, read_address
from kinefilter.pipeline.live.broadcast import Broadcast
from kinefilter.pipeline.live.limits import MOST_CONNECTIONS
from kinefilter.pipeline.live.messages import Reason
from kinefilter.pipeline.live.playback import frames_of
from kinefilter.pipeline.live.sources import Datagrams, Intake
from kinefilter.pipeline.live.tally import Event, Tally
from kinefilter.pipeline.live.websocket import open_server


def do(work: Coroutine[Any, Any, None]) -> None:
    """Run a test that waits, for some time at most."""

    async def bounded() -> None:
        async with asyncio.timeout(PATIENCE):
            await work

    asyncio.run(bounded())


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
    port = Datagrams(intake)
    for _ in range(1000):
        port.datagram_received(b"{}", ("127.0.0.1", 1))
    assert 60 <= len(taken) < 500
    assert len(taken) + tally.events[Event.TOO_FAST] == 1000
    for n in range(2, 2 + MOST_CONNECTIONS):
        port.datagram_received(b"{}", ("127.0.0.1", n))
    assert tally.events[Event.REFUSED] == 1


def test_who_never_reads_loses_lines_is_let_go_and_costs_others_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(broadcasting, "_DEAD", 0.2)

    async def session() -> None:
        tally, skeleton = Tally(), KINECT_V1
        lines, most = Broadcast(skeleton, tally), 0
        place = Address("ws", "127.0.0.1", 0)
        async with open_server(
            lines.handle, place, Access(), tally, largest=1000
        ) as out:
            lazy = _lazy_reader(out)
            async with reading(out) as stream:
                await asyncio.get_running_loop().sock_recv(lazy, 1)  # it is there
                for n in itertools.count():
                    line = json.dumps([n, "x" * 50_000])
                    lines.give(line)
                    assert await stream.recv() == line
                    most = max(most, *(len(r.lines) for r in lines.readers))
                    if len(lines.readers) == 1:
                        break
        assert tally.events[Event.SLOW] > 0
        assert most <= 32

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


def test_connections_are_as_many_as_allowed() -> None:
    async def session() -> None:
        async with running(config()) as (run, (_, out)):
            streams = [await connect(str(out)) for _ in range(MOST_CONNECTIONS)]
            with pytest.raises(InvalidStatus, match="503"):
                await connect(str(out))
            assert run.tally.events[Event.REFUSED] == 1
            await streams[0].close()
            async with reading(out):
                pass
            for stream in streams:
                await stream.close()

    do(session())


def test_pages_of_other_sites_are_refused_and_those_of_this_machine_are_not() -> None:
    access = OpenConfig(origin=("https://studio.example",))

    async def session() -> None:
        async with running(config(source=WS), access) as (_, places):
            for address in places:
                for origin in ("https://evil.example", "null", "http://localhost.evil"):
                    with pytest.raises(InvalidStatus, match="403"):
                        await connect(str(address), origin=origin)  # type: ignore[arg-type]
                for origin in ("http://localhost:8000", "https://studio.example"):
                    stream = await connect(str(address), origin=origin)  # type: ignore[arg-type]
                    await stream.close()

    do(session())


def test_where_others_may_connect_a_token_is_needed(tmp_path: Path) -> None:
    token = "0123456789abcdef"
    (tmp_path / "token").write_text(f"{token}\n", encoding="utf-8")
    access = OpenConfig(bind="127.0.0.1", token_file=tmp_path / "token")
    bearer = {"Authorization": f"Bearer {token}"}

    async def session() -> None:
        async with running(config(source=WS), access) as (run, (source, out)):
            for address in (source, out):
                for wrong in ("", "?token=", "?token=0123456789abcdeF", "?x=y"):
                    with pytest.raises(InvalidStatus, match="401"):
                        await connect(f"{address}/{wrong}")
            assert run.tally.events[Event.REFUSED] == 8
            async with connect(f"{out}/?token={token}") as stream:
                await stream.recv()
                async with open_sender(source, token_file=tmp_path / "token") as sender:
                    assert await sender.send(format_frame(sample_frame(0)))
                    assert (await pose(stream))["body"] == "1"
            async with reading(out, additional_headers=bearer):
                pass
            with pytest.raises(InputError, match="--token-file"):
                async with open_sender(source):
                    pass

    do(session())


def test_a_new_token_is_made_where_others_may_connect_and_none_was_given() -> None:
    tokens = [
        Session(config(source=WS), OpenConfig(bind="0.0.0.0")).places.access.token
        for _ in range(2)
    ]
    assert all(token is not None and len(token) >= 32 for token in tokens)
    assert tokens[0] != tokens[1]
    assert Session(config(source=WS)).places.access.token is None


def test_tokens_too_short_to_hold_are_refused(tmp_path: Path) -> None:
    for text in ("", "secret", "a b " * 10, "é" * 20):
        (tmp_path / "token").write_text(text, encoding="utf-8")
        with pytest.raises(InputError, match="expected a token"):
            Session(config(), OpenConfig(token_file=tmp_path / "token"))


def test_with_a_certificate_connections_are_encrypted(tmp_path: Path) -> None:
    files = _certificate(tmp_path)
    access = OpenConfig(certificate=files[0], key=files[1])

    async def session() -> None:
        async with running(config(source=WS), access) as (_, (source, out)):
            assert source.scheme == out.scheme == "wss"
            trusted = ssl.create_default_context(cafile=files[0])
            async with (
                reading(out, ssl=trusted) as stream,
                open_sender(source, certificate=files[0]) as sender,
            ):
                assert await sender.send(format_frame(sample_frame(0)))
                assert (await pose(stream))["time"] == 0.0
            with pytest.raises(ssl.SSLCertVerificationError):
                await connect(str(out))

    do(session())


def _certificate(folder: Path) -> tuple[Path, Path]:
    certificate, key = folder / "certificate.pem", folder / "key.pem"
    subject = ["-subj", "/CN=localhost", "-addext", "subjectAltName=IP:127.0.0.1"]
    curve = ["-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1"]
    command = ["openssl", "req", "-x509", *curve, "-noenc", "-days", "1", *subject]
    try:
        subprocess.run(
            [*command, "-keyout", str(key), "-out", str(certificate)],
            check=True,
            capture_output=True,
        )
    except FileNotFoundError:
        pytest.skip("openssl, which makes the certificate, is not installed")
    return certificate, key


def test_what_is_no_certificate_is_refused(tmp_path: Path) -> None:
    (tmp_path / "c.pem").write_text("nothing", encoding="utf-8")
    for path in (tmp_path / "c.pem", tmp_path / "absent.pem"):
        with pytest.raises(InputError, match="PEM"):
            Session(config(), OpenConfig(certificate=path))


@pytest.mark.parametrize(
    ("what", "words"),
    [
        (LiveConfig("udp://0.0.0.0:1", ("-",)), "--bind 0.0.0.0"),
        (LiveConfig("http://x:1", ("-",)), "udp://HOST:PORT"),
        (LiveConfig("vmc://127.0.0.1:1", ("-",)), "udp://HOST:PORT"),
        (LiveConfig("-", ("udp://127.0.0.1:1",)), "vmc://HOST:PORT"),
        (LiveConfig("-", ("wss://127.0.0.1:1",)), "--certificate"),
        (LiveConfig("-", ()), "--out"),
        (LiveConfig("-", ("-",), bodies=0), "--bodies 0"),
        (LiveConfig("-", ("-",), height=175.0), "outside 0.3 to 3 m"),
        (LiveConfig("-", ("-",), mass=1e9), "mass"),
        (LiveConfig("-", ("-",), scene="nowhere"), "nowhere"),
    ],
)
def test_what_cannot_run_is_refused_before_anything_listens(
    what: LiveConfig, words: str
) -> None:
    with pytest.raises(InputError, match=words):
        asyncio.run(Session(what).run(asyncio.Event()))


def test_a_port_in_use_is_told() -> None:
    async def session() -> None:
        async with running(config(source=WS)) as (_, (source, _)):
            again = config(source=str(source))
            with pytest.raises(InputError, match="cannot listen there"):
                await Session(again).run(asyncio.Event())

    do(session())


def test_a_missing_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    for out in (WS, "vmc://127.0.0.1:1"):
        with pytest.raises(InputError, match=re.escape("kinefilter[live]")):
            Session(config(out, source=UDP))


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


def test_a_replay_sends_every_frame_at_its_own_stamp_of_everybody() -> None:
    class Kept:
        """Keeps what is sent."""

        def __init__(self) -> None:
            self.lines: list[str] = []

        async def send(self, line: str) -> bool:
            self.lines.append(line)
            return True

    kept = Kept()
    count = asyncio.run(replay([SAMPLE, SAMPLE], kept, asyncio.Event(), speed=1e6))
    assert count == len(SAMPLE) == len(kept.lines)
    frames = [json.loads(line) for line in kept.lines]
    assert [frame["time"] for frame in frames] == SAMPLE.time.tolist()
    assert [body["id"] for body in frames[0]["bodies"]] == ["1", "2"]


def test_a_replay_takes_as_long_as_the_take_over_the_speed() -> None:
    """By the loop's own clock, which the test moves."""

    class Virtual(asyncio.SelectorEventLoop):
        now = 0.0

        def time(self) -> float:
            return self.now

        def _run_once(self) -> None:
            if not self._ready and self._scheduled:  # type: ignore[attr-defined]
                self.now = max(self.now, self._scheduled[0].when())  # type: ignore[attr-defined]
            super()._run_once()  # type: ignore[misc]

    stamps: list[float] = []

    class Timed:
        """Notes when frames are sent."""

        async def send(self, line: str) -> bool:  # noqa: ARG002 - as all senders
            stamps.append(asyncio.get_running_loop().time())
            return True

    with asyncio.Runner(loop_factory=Virtual) as runner:
        runner.run(replay([SAMPLE], Timed(), asyncio.Event(), speed=2.0))
    np.testing.assert_allclose(np.diff(stamps), np.diff(SAMPLE.time) / 2.0, atol=1e-9)


def test_a_replay_round_and_round_goes_on_in_time() -> None:
    frames = frames_of([SAMPLE], loop=True)
    times = [next(frames).time for _ in range(2 * len(SAMPLE) + 5)]
    steps = np.diff(times)
    assert (steps > 0).all()
    assert steps[len(SAMPLE) - 1] == pytest.approx(1 / 30, abs=2e-3)


def test_a_replay_connects_again_when_live_comes_back() -> None:
    async def session() -> None:
        async with running(config(source=WS)) as (_, (source, _)):
            pass
        address = read_address(str(source), ("ws",))
        async with open_sender(address) as sender:  # nobody is there
            assert not await sender.send("lost")
            again = config(source=str(source))
            async with running(again) as (_, (_, out)), reading(out) as stream:
                asking = asyncio.ensure_future(pose(stream))
                row = 0
                while not asking.done():
                    await sender.send(format_frame(sample_frame(row % 290, time=row)))
                    row += 1
                    await asyncio.sleep(0.02)
                assert asking.result()["body"] == "1"

    do(session())


def test_tokens_are_compared_whole() -> None:
    from websockets.datastructures import Headers

    access = Access(token="0123456789abcdef")
    right = Headers(Authorization="Bearer 0123456789abcdef")
    assert access.grants("/", right)
    for wrong in ("Bearer 0123456789abcde", "Basic 0123456789abcdef", "", "Bearer é"):
        assert not access.grants("/", Headers(Authorization=wrong))
