"""Live sessions between pipes: the standard input waits, the output is waited for."""

from __future__ import annotations

import asyncio
import io
import json
import os
import threading
from typing import Any

import pytest
from hostile_messages import hostile_messages
from live_session import PATIENCE, SAMPLE, config, sample_frame

from kinefilter.pipeline.live import background
from kinefilter.pipeline.live.endpoints import Address
from kinefilter.pipeline.live.live_session import Session
from kinefilter.pipeline.live.messages import format_frame
from kinefilter.pipeline.live.playback import open_sender, replay
from kinefilter.pipeline.live.tally import Event


class Pipes:
    """Takes the place of the standard input and output."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, text: bytes) -> None:
        self._text, self.read = text, b""
        self._input, self._fed = os.pipe()
        self._out, self.output = os.pipe()
        monkeypatch.setattr(background, "_STDIN", self._input)
        monkeypatch.setattr(background, "_STDOUT", self.output)
        self._threads = [threading.Thread(target=w) for w in (self._feed, self._drain)]

    def _feed(self) -> None:
        with os.fdopen(self._fed, "wb") as file:
            file.write(self._text)

    def _drain(self) -> None:
        with os.fdopen(self._out, "rb") as file:
            self.read = file.read()

    def run(self) -> tuple[Session, list[dict[str, Any]]]:
        """Run a session to the end of its input; return it and what it wrote."""
        session = Session(config("-", source="-"))
        for thread in self._threads:
            thread.start()
        asyncio.run(asyncio.wait_for(session.run(asyncio.Event()), PATIENCE))
        os.close(self.output)
        for thread in self._threads:
            thread.join(PATIENCE)
        os.close(self._input)
        return session, [json.loads(line) for line in self.read.splitlines()]


def test_every_frame_of_a_pipe_has_its_pose_however_fast_they_come(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    lines = [format_frame(sample_frame(row)) for row in range(100)]
    session, said = Pipes(monkeypatch, "\n".join(lines).encode()).run()
    names, *poses = said
    assert names["skeleton"] == "kinect_v1"
    assert [pose["time"] for pose in poses] == [row / 30.0 for row in range(100)]
    assert session.tally.events[Event.DROPPED] == 0
    assert session.tally.events[Event.SLOW] == 0


def test_lines_that_are_no_frames_are_counted_and_the_last_frame_has_its_pose(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    hostile = [m.replace(b"\n", b"") for m in hostile_messages(160, seed=7)]
    lines = [*hostile, b"x" * 200_000, format_frame(sample_frame(0)).encode(), b" "]
    session, said = Pipes(monkeypatch, b"\n".join(lines)).run()
    assert len(said) == 2
    assert session.tally.malformed.total() == len([m for m in hostile if m.strip()]) + 1


def test_who_stops_reading_the_output_ends_the_session(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    lines = [format_frame(sample_frame(row)) for row in range(50)]
    pipes = Pipes(monkeypatch, b"")
    os.close(pipes._out)
    with os.fdopen(pipes._fed, "wb") as file:
        file.write("\n".join(lines[:20]).encode() + b"\n")
        file.flush()  # and the input goes on, as far as anybody knows
        session = Session(config("-", source="-"))
        asyncio.run(asyncio.wait_for(session.run(asyncio.Event()), PATIENCE))
    assert session.tally.events[Event.POSES] <= 20
    os.close(pipes.output)


def test_a_replay_writes_a_line_a_frame_and_waits_for_the_reader(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    out, into = os.pipe()
    monkeypatch.setattr(background, "_STDOUT", into)
    read = io.BytesIO()

    def drain() -> None:
        with os.fdopen(out, "rb") as file:
            read.write(file.read())

    thread = threading.Thread(target=drain)
    thread.start()

    async def send() -> int:
        async with open_sender(Address("-")) as sender:
            return await replay([SAMPLE], sender, asyncio.Event(), speed=1e6)

    assert asyncio.run(send()) == len(SAMPLE)
    os.close(into)
    thread.join(PATIENCE)
    assert len(read.getvalue().splitlines()) == len(SAMPLE)
