"""Takes replayed to a live session."""

from __future__ import annotations

import asyncio
import json
import socket
from pathlib import Path

import numpy as np
import pytest
from live_session import SAMPLE, config, do, pose, reading, running, sample_frame
from published_layouts import landmarks
from test_keypoints import scripted

from kinefilter import scenes
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.formats.keypoints import BLAZEPOSE
from kinefilter.pipeline.live.endpoints import parse_address
from kinefilter.pipeline.live.messages import format_frame
from kinefilter.pipeline.live.playback import frames_of, open_sender, replay


def test_a_replay_sends_every_frame_at_its_own_stamp_of_everybody() -> None:
    lines: list[str] = []

    async def keep(line: str) -> bool:
        lines.append(line)
        return True

    count = asyncio.run(replay([SAMPLE, SAMPLE], keep, asyncio.Event(), speed=1e6))
    assert count == len(SAMPLE) == len(lines)
    frames = [json.loads(line) for line in lines]
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

    async def note(_: str) -> bool:
        stamps.append(asyncio.get_running_loop().time())
        return True

    with asyncio.Runner(loop_factory=Virtual) as runner:
        runner.run(replay([SAMPLE], note, asyncio.Event(), speed=2.0))
    np.testing.assert_allclose(np.diff(stamps), np.diff(SAMPLE.time) / 2.0, atol=1e-9)


def test_a_replay_round_and_round_goes_on_in_time() -> None:
    frames = frames_of([SAMPLE], loop=True)
    times = [next(frames).time for _ in range(2 * len(SAMPLE) + 5)]
    steps = np.diff(times)
    assert (steps > 0).all()
    assert steps[len(SAMPLE) - 1] == pytest.approx(1 / 30, abs=2e-3)


def test_a_replay_of_another_tracker_tells_that_live_expects_a_kinect(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "a.npy"
    np.save(path, landmarks(scripted(frames=5), BLAZEPOSE))
    for take, told in ((path, True), (scenes.SAMPLE, False)):
        assert main(["replay", str(take), "--out", "-", "--speed", "1e6"]) == 0
        assert ("not from a Kinect" in capsys.readouterr().err) == told


def test_a_replay_connects_again_when_live_comes_back() -> None:
    said: list[str] = []

    async def session(source: str) -> None:
        address = parse_address(source, ("ws",))
        async with open_sender(address, say=said.append) as send:  # nobody is there
            assert not await send("lost")
            await asyncio.sleep(0.5)  # for a second attempt
            assert said == [f"waiting for {address}; frames until then are lost"]
            async with (
                running(config(source=source)) as (_, (_, out)),
                reading(out) as stream,
            ):
                asking = asyncio.ensure_future(pose(stream))
                row = 0
                while not asking.done():
                    await send(format_frame(sample_frame(row % 290, time=row)))
                    row += 1
                    await asyncio.sleep(0.02)
                assert asking.result()["body"] == "1"
                assert len(said) == 1

    with (
        socket.socket() as held
    ):  # so that no other process is given the port meanwhile
        held.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        held.bind(("127.0.0.1", 0))
        do(session(f"ws://127.0.0.1:{held.getsockname()[1]}"))


def test_a_replay_that_is_always_late_can_be_stopped() -> None:
    """Whoever takes frames at once leaves the loop no other moment to hear of it."""
    sent = 0

    async def take(_line: str) -> bool:
        nonlocal sent
        sent += 1
        assert sent < 20_000, "nobody could stop it"
        return False

    async def run() -> None:
        stop = asyncio.Event()
        asyncio.get_running_loop().call_later(0.05, stop.set)
        await replay([SAMPLE], take, stop, speed=1e9, loop=True)

    asyncio.run(run())
    assert sent
