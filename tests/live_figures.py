"""Measures ``kinefilter live`` through loopback, in a process of its own.

    python tests/live_figures.py long [--minutes 60] [--speed 1]
    python tests/live_figures.py bodies [--seconds 60]
    python tests/live_figures.py malformed [--count 10000]
    python tests/live_figures.py slow [--seconds 60]

Frames of the sample take go round and round, at their own rate. Latencies are from the
sending of a frame here to its pose's coming back by WebSocket, this process included;
how late the machine wakes who sleeps, other work on it included, is told beside them.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import os
import re
import socket
import sys
import tempfile
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from hostile_messages import hostile_messages
from rich.console import Console
from websockets.asyncio.client import connect

from kinefilter import read_take
from kinefilter.characters import Take
from kinefilter.pipeline.live.messages import Frame, format_frame
from kinefilter.pipeline.live.playback import frames_of
from kinefilter.scenes import SAMPLE

_say = Console(soft_wrap=True, highlight=False).print
_REMEMBERED = 1000  # frames whose poses are waited for


@dataclass
class Live:
    """A running ``kinefilter live``."""

    process: asyncio.subprocess.Process
    udp: int
    ws: int
    report: Path

    @property
    def memory(self) -> float:
        """Resident memory [MB]."""
        status = Path(f"/proc/{self.process.pid}/status").read_text(encoding="utf-8")
        found = re.search(r"VmRSS:\s+(\d+)", status)
        assert found is not None
        return int(found[1]) / 1024

    @property
    def seconds(self) -> float:
        """Processor time used [s]."""
        fields = Path(f"/proc/{self.process.pid}/stat").read_text(encoding="utf-8")
        used = fields.rpartition(")")[2].split()[11:13]
        return sum(map(int, used)) / 100

    async def finish(self) -> dict[str, Any]:
        """End it as Ctrl-C does and return its own counts."""
        self.process.terminate()
        await self.process.wait()
        found: dict[str, Any] = json.loads(self.report.read_text(encoding="utf-8"))
        return found


@asynccontextmanager
async def live(folder: Path, *flags: str) -> AsyncIterator[Live]:
    """Run ``kinefilter live`` with UDP in and WebSocket out on free ports."""
    report = folder / "live.json"
    command = [sys.executable, "-m", "kinefilter.pipeline.cli", "live"]
    command += ["--in", "udp://127.0.0.1:0", "--out", "ws://127.0.0.1:0"]
    command += ["--skeleton", "kinect_v1", "--json", str(report), *flags]
    process = await asyncio.create_subprocess_exec(
        *command, stderr=asyncio.subprocess.PIPE
    )
    assert process.stderr is not None
    said = (await process.stderr.readline()).decode()
    udp, ws = re.findall(r":(\d+)", said)[:2]
    try:
        yield Live(process, int(udp), int(ws), report)
    finally:
        with contextlib.suppress(ProcessLookupError):
            process.kill()


def people(count: int) -> list[Take]:
    """Return the sample take for some people side by side, each in another frame."""
    take = read_take(SAMPLE)
    return [
        Take(
            take.time,
            np.roll(take.positions, 40 * n, axis=0) + np.array([1.5 * n, 0.0, 0.0]),
            np.roll(take.state, 40 * n, axis=0),
            take.skeleton,
        )
        for n in range(count)
    ]


class Stopwatch:
    """Sends frames when they are due, and times the poses that come back."""

    def __init__(self, running: Live) -> None:
        self.live = running
        self.sent: dict[float, float] = {}
        self.times: list[float] = []
        self.late: list[float] = []
        self.memory: list[float] = []
        self._out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._place = ("127.0.0.1", running.udp)

    async def listen(self) -> None:
        """Read poses for ever."""
        async with connect(f"ws://127.0.0.1:{self.live.ws}") as stream:
            async for line in stream:
                pose = json.loads(line)
                sent = self.sent.get(pose.get("time", -1.0))
                if sent is not None:
                    self.times.append(time.perf_counter() - sent)

    async def send(self, frames: Iterator[Frame], seconds: float, speed: float) -> None:
        """Send frames for some time [s] of the stream."""
        began, first = time.perf_counter(), None
        for frame in frames:
            first = frame.time if first is None else first
            passed = frame.time - first
            if passed > seconds:
                return
            due = began + passed / speed
            await asyncio.sleep(due - time.perf_counter())
            self.late.append(time.perf_counter() - due)
            line = format_frame(frame).encode()
            if len(self.sent) > _REMEMBERED:
                del self.sent[next(iter(self.sent))]
            self.sent[frame.time] = time.perf_counter()
            self._out.sendto(line, self._place)
            if len(self.memory) <= passed / 10.0:
                self.memory.append(self.live.memory)


@asynccontextmanager
async def watched(*flags: str) -> AsyncIterator[tuple[Live, Stopwatch]]:
    """Run ``kinefilter live`` while poses are read; the caller is to end it."""
    with tempfile.TemporaryDirectory() as folder:
        async with live(Path(folder), *flags) as running:
            watch = Stopwatch(running)
            listening = asyncio.ensure_future(watch.listen())
            yield running, watch
            listening.cancel()
            await asyncio.gather(listening, return_exceptions=True)


def told(watch: Stopwatch, counts: dict[str, Any]) -> None:
    """Print what was measured."""
    times = np.array(watch.times) * 1e3
    _say(
        f"{len(times)} poses; ms from sent to received: median {np.median(times):.1f}, "
        f"99 % {np.percentile(times, 99):.1f}, most {times.max():.1f}; "
        f"over 15 ms: {np.mean(times > 15):.3%}"
    )
    if watch.late:
        late = np.array(watch.late) * 1e3
        _say(
            "ms by which this machine woke the sender late: median "
            f"{np.median(late):.1f}, 99 % {np.percentile(late, 99):.1f}, "
            f"most {late.max():.1f}; load {os.getloadavg()[0]:.1f}"
        )
    memory = watch.memory
    middle = memory[len(memory) // 2]
    _say(f"memory MB: {memory[1]:.1f}, midway {middle:.1f}, end {memory[-1]:.1f}")
    _say(json.dumps(counts))


async def stream(seconds: float, speed: float, count: int, *flags: str) -> None:
    """Stream people, and print latencies and memory."""
    async with watched(*flags) as (running, watch):
        await watch.send(frames_of(people(count), loop=True), seconds, speed)
        await asyncio.sleep(1.0)
        used = running.seconds
        counts = await running.finish()
    told(watch, counts)
    _say(f"{used / (seconds / speed):.0%} of a core")


async def malformed(count: int) -> None:
    """Send what is no frame, good frames in between, and print the counts."""
    async with watched("--height", "1.8") as (running, watch):
        out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        good = frames_of(people(1), loop=True)
        sent = 0
        for k, message in enumerate(hostile_messages(count, seed=1)):
            out.sendto(message, ("127.0.0.1", running.udp))
            if k % 100 == 0:
                frame = next(good)
                watch.sent[frame.time] = time.perf_counter()
                out.sendto(format_frame(frame).encode(), ("127.0.0.1", running.udp))
                sent += 1
                watch.memory.append(running.memory)
            await asyncio.sleep(1 / 200)  # under the rate that is allowed
        await asyncio.sleep(1.0)
        counts = await running.finish()
    _say(f"{count} malformed, {sent} good sent")
    _say(f"counted as malformed: {sum(counts['malformed'].values())}")
    told(watch, counts)


async def slow(seconds: float) -> None:
    """Let somebody connect who never reads, and print what that costs."""
    async with watched("--height", "1.8") as (running, watch):
        lazy = socket.create_connection(("127.0.0.1", running.ws))
        lazy.sendall(
            b"GET / HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\n"
            b"Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
            b"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"
        )
        await watch.send(frames_of(people(4), loop=True), seconds, 1.0)
        counts = await running.finish()
    told(watch, counts)


def main() -> None:
    """Measure what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("long", "bodies", "malformed", "slow"))
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--speed", type=float, default=1.0)
    parser.add_argument("--count", type=int, default=10_000)
    asked = parser.parse_args()
    vmc = ("--out", "vmc://127.0.0.1:39539")
    if asked.what == "long":
        with tempfile.TemporaryDirectory() as folder:
            record = ("--record", f"{folder}/take.csv")
            work = stream(60.0 * asked.minutes, asked.speed, 1, *vmc, *record)
            asyncio.run(work)
    elif asked.what == "bodies":
        asyncio.run(stream(asked.seconds, asked.speed, 4, *vmc))
    elif asked.what == "malformed":
        asyncio.run(malformed(asked.count))
    else:
        asyncio.run(slow(asked.seconds))


if __name__ == "__main__":
    main()
