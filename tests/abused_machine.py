"""Kills, full disks, clocks that jump, crowds and floods around commands."""

from __future__ import annotations

import asyncio
import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from unittest import mock

import numpy as np
from abused_commands import Attempt, LostError, check_file, part, run
from batch_faults import batch, begin, clip_hashes, rows_done
from batch_takes import Here, make_takes
from hostile_messages import hostile_messages
from live_session import Sender, config, pose, reading, running, sample_frame
from published_layouts import ntu_text
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed

from kinefilter import read_take
from kinefilter.characters import InputError, State, Take
from kinefilter.pipeline.formats import write_take_csv
from kinefilter.pipeline.live.messages import format_frame
from kinefilter.scenes import SAMPLE

_CLEAN = "clean {take.csv} -o {out}/o.%s --json {out}/o.json --save-contacts {out}/c"
_SHOWN = {
    "report": "report {clip.npz} --take {take.csv} -o {out}/o.html",
    "render": "render {clip.npz} -o {out}/o%05d.png --size 64x36 --jobs 1",
}
_WRITERS = {
    **{
        f"clean {s}": _CLEAN % s
        for s in ("bvh", "usda", "usdc", "usdz", "glb", "csv", "npz")
    },
    **_SHOWN,
    "video": "render {clip.npz} -o {out}/o.mp4 --size 64x36 --jobs 1",
    "simulate": "simulate basic --motion wave -o {out}/o.csv --pairs {out}/pairs.npz",
    "train": "train {people.npz} -o {out}/o.npz --method joint-offsets",
    "database": "database build {people.npz} -o {out}/o.npz --count 20",
    "character": "character -o {out}/o.xml",
}


# Kills


_known: dict[str, tuple[dict[str, str], float]] = {}


def _undisturbed(template: str, attempt: Attempt) -> tuple[dict[str, str], float]:
    """Return hashes of what a command writes, and how long it takes [s]."""
    if template not in _known:
        out, began = attempt.folder / "undisturbed", time.monotonic()
        out.mkdir()
        if _begin(attempt.command(template, out=out)).wait() != 0:
            raise LostError(f"undisturbed, it fails: {template}")
        _known[template] = clip_hashes(out), time.monotonic() - began
    return _known[template]


def _begin(words: list[str]) -> subprocess.Popen[bytes]:
    return begin([sys.executable, "-m", "kinefilter.pipeline.cli", *words])


def abuse_by_kills(attempt: Attempt) -> None:
    """Kill a command, look at what is left, and let the same command go on."""
    rng, out = attempt.rng, attempt.out
    if rng.random() < 0.25:
        _killed_recording(attempt)
        return
    templates = {
        **{name: words for name, words in _WRITERS.items() if "clean" in name},
        **_SHOWN,
        "batch": "batch {take.csv} {kinect-v2.csv} -o {out} --to bvh --jobs 1",
    }
    name = rng.choice(sorted(templates))
    end = rng.choice((signal.SIGKILL, signal.SIGKILL, signal.SIGTERM))
    attempt.what = f"{name}, {end.name}"
    expected, seconds = _undisturbed(templates[name], attempt)
    attempt.words = words = attempt.command(templates[name])
    process = _begin(words)
    if rng.random() < 0.5:  # as soon as something is there
        until = time.monotonic() + 3 * seconds
        while process.poll() is None and not any(out.iterdir()):
            if time.monotonic() > until:
                break
            time.sleep(0.002)
        time.sleep(rng.choice((0.0, 0.001, 0.01, 0.1)))
    else:
        time.sleep(rng.uniform(0.3, 1.0) * seconds)
    process.send_signal(end)
    code = process.wait()
    left = {k: v for k, v in clip_hashes(out).items() if not _hidden(k)}
    if wrong := [k for k, v in left.items() if expected.get(k) != v]:
        raise LostError(f"{name} killed by {end.name} left {wrong}")
    if end is signal.SIGTERM and code >= 0 and any(map(_hidden, clip_hashes(out))):
        raise LostError(f"{name} ended by SIGTERM left {list(clip_hashes(out))}")
    if _begin(words).wait() != 0:
        raise LostError(f"{name} does not go on after {end.name}")
    found = {k: v for k, v in clip_hashes(out).items() if not _hidden(k)}
    if found != expected:
        raise LostError(f"{name} after {end.name}: {found} is not {expected}")


def _hidden(name: str) -> bool:
    return Path(name).name.startswith(".")


def _killed_recording(attempt: Attempt) -> None:
    """Kill live while it records, and clean what it left."""
    rng, out = attempt.rng, attempt.out
    attempt.what = "live --record, SIGKILL"
    words = ["live", "--in", "-", "--out", "-", "--record", str(out / "take.csv")]
    command = [sys.executable, "-m", "kinefilter.pipeline.cli", *words]
    process = subprocess.Popen(
        [*command, "--skeleton", "kinect_v1", "--height", "1.8"],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    assert process.stdin is not None
    kill = threading.Timer(rng.uniform(1.5, 6.0), process.kill)
    kill.start()
    try:
        for k in range(100_000):
            line = format_frame(sample_frame(k % 290, time=k / 30.0))
            process.stdin.write(line.encode() + b"\n")
            process.stdin.flush()
    except BrokenPipeError:
        pass
    process.wait()
    kill.cancel()
    for file in out.iterdir():
        if file.read_bytes().count(b"\n") > 3:
            ran = run(["info", str(file)])
            if ran.code != 0:
                raise LostError(f"a killed recording is refused: {ran.said[-300:]}")


# Disks


def abuse_disks(attempt: Attempt) -> None:
    """Let a command write where there is no room, or no folder any more."""
    rng, disk = attempt.rng, attempt.folder.with_name("disk")
    name = rng.choice(sorted(_WRITERS))
    kinds = ("full", "full", "limit", "removed", "read-only")
    # Limited, video's processes cannot even begin.
    kind = rng.choice(kinds[:2] + kinds[3:] if "render" in _WRITERS[name] else kinds)
    attempt.what = f"{name}, {kind}"
    small = kind == "full" and disk.is_mount()
    out = disk / attempt.folder.name if small else attempt.out
    out.mkdir(exist_ok=True)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    room = int(10 ** rng.uniform(0.0, 5.5))  # bytes
    attempt.words = attempt.command(
        _WRITERS[name], out=Path("/proc/self") if kind == "read-only" else out
    )
    try:
        if small:
            free = shutil.disk_usage(disk).free - room
            (disk / "filler").write_bytes(b"\0" * max(free, 0))
        elif kind in ("full", "limit"):
            resource.setrlimit(resource.RLIMIT_FSIZE, (room, before[1]))
        elif kind == "removed":
            wait = rng.choice((0.0, 0.01, 0.05, 0.2))
            threading.Timer(wait, shutil.rmtree, (out, True)).start()
        ran = run(attempt.words)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        (disk / "filler").unlink(missing_ok=True)
    for path in sorted(out.iterdir()) if kind != "removed" else ():
        if path.name.startswith("."):
            raise LostError(f"left {path.name}")
        if path.is_file():
            check_file(path, attempt.words)
    shutil.rmtree(out, ignore_errors=True)
    if ran.code == 2:
        raise InputError(ran.said.strip())


# Clocks


def abuse_clocks(attempt: Attempt) -> None:
    """Let the clock jump while a batch or a live session runs."""
    rng = attempt.rng
    real = time.time

    def jumping() -> float:
        return real() + rng.choice((0.0, -1e9, 1e9, -3600.0, 3600.0))

    def jumping_ns() -> int:
        return int(jumping() * 1e9)

    with mock.patch("time.time", jumping), mock.patch("time.time_ns", jumping_ns):
        if rng.random() < 0.5:
            attempt.what = "live"
            asyncio.run(_followed(5))
            return
        attempt.what = "batch"
        takes, out = attempt.folder / "takes", attempt.out
        make_takes(takes, 3, 8)
        for path in takes.rglob("*.csv"):
            stamp = rng.choice((0.0, -1e9, 1e8, 1e10, jumping()))
            os.utime(path, (stamp, stamp))
        words = ["batch", str(takes), "-o", str(out), "--to", "npz", "--method", "none"]
        with mock.patch("kinefilter.pipeline.batch.run.open_crew", Here):
            attempt.run(words)
            hashes = clip_hashes(out)
            for _ in range(2):
                attempt.run(words)
    if len(rows_done(out)) != 3 or clip_hashes(out) != hashes:
        raise LostError(f"batch again: {rows_done(out)}")


async def _followed(frames: int) -> None:
    async with running(config()) as (_, (source, place)), reading(place) as stream:
        sender = Sender(source)
        for row in range(frames):
            sender.send(sample_frame(row))
            await asyncio.wait_for(pose(stream), 30.0)


# Crowds


def abuse_by_crowds(attempt: Attempt) -> None:
    """Clean very many takes, a very long one, or very many people in one."""
    rng, folder, out = attempt.rng, attempt.folder, attempt.out
    kind = ("takes", "hours", "people")[attempt.n] if attempt.n < 3 else "people"
    take = read_take(SAMPLE)
    if kind == "takes":
        count = 2000 if attempt.minutes >= 30 else 200
        attempt.what = f"{count} takes"
        make_takes(folder / "takes", count, 4)
        words = ["--to", "csv", "--method", "none", "--no-physics", "--no-reconstruct"]
        run(words := [*batch(folder / "takes", out, *words)[3:]])
        done = len(rows_done(out))
        if done != count:
            raise LostError(f"{done} of {count} takes done")
        return
    if kind == "hours":
        count = 1_000_000 if attempt.minutes >= 60 else 108_000
        attempt.what = f"{count} frames"
        there = np.arange(count) % (2 * len(take) - 2)
        rows = np.where(there < len(take), there, 2 * len(take) - 2 - there)
        stamps = np.arange(count) / 30.0
        long = Take(stamps, take.positions[rows], take.state[rows], take.skeleton)
        write_take_csv(long, folder / "long.csv")
        words = ["clean", str(folder / "long.csv"), "-o", str(out / "o.csv")]
        attempt.run([*words, "--no-physics"])
        return
    count, frames = rng.choice((2, 7, 30, 100)), rng.choice((6, 30))
    attempt.what = f"{count} people"
    people = [_one_of_many(take, k, frames, rng) for k in range(count)]
    text = ntu_text(people, range(72_057_594_037_927_936, 2**57))
    (folder / "crowd.skeleton").write_text(text, encoding="utf-8")
    words = ["clean", str(folder / "crowd.skeleton"), "-o", str(out / "o.npz")]
    attempt.run([*words, "--body", "all", "--method", "none"])


def _one_of_many(take: Take, number: int, frames: int, rng: random.Random) -> Take:
    """Return somebody of Kinect v2 beside others, who comes and goes."""
    from kinefilter.characters import KINECT_V2, standard_body

    some = part(take, rng.randrange(200), frames)
    rest = standard_body(KINECT_V2, height=rng.uniform(1.2, 2.0)).rest_positions
    root = some.positions[:, :1] + np.array([0.7 * number, 0.0, 0.0])
    state = np.full((frames, len(KINECT_V2)), State.TRACKED, dtype=np.uint8)
    for _ in range(rng.randrange(3)):
        first = rng.randrange(frames)
        state[first : first + rng.randrange(1, frames)] = State.NOT_TRACKED
    positions = np.where(state[..., None] > 0, root + rest, np.nan)
    return Take(some.time, positions, state, KINECT_V2)


# Floods


def abuse_by_floods(attempt: Attempt) -> None:
    """Send live far too much, most of it nonsense; afterwards it must still follow."""
    attempt.what = attempt.rng.choice(("udp", "ws"))
    asyncio.run(_flooded(attempt.what, attempt.rng.randrange(2**31)))


async def _flooded(kind: str, seed: int) -> None:
    count = 3000
    source = f"{kind}://127.0.0.1:0"
    async with (
        running(config(source=source)) as (session, (place, out)),
        reading(out) as stream,
    ):
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        messages = list(hostile_messages(count, seed=seed))
        good = [format_frame(sample_frame(k % 290)).encode() for k in range(count)]
        if kind == "udp":
            sender = Sender(place)
            for k, (bad, fine) in enumerate(zip(messages, good, strict=True)):
                sender.send(bad)
                sender.send(fine)
                if k % 50 == 0:
                    await asyncio.sleep(0)
        else:
            for chunk in range(0, count, 500):
                async with connect(str(place)) as socket:
                    with suppress(ConnectionClosed, AttributeError):  # it may hang up
                        for k in range(chunk, chunk + 500):
                            await socket.send(messages[k])
                            await socket.send(good[k].decode())
        await asyncio.sleep(1.5)  # its sender may speak again
        told = session.tally.as_json()
        json.dumps(told, allow_nan=False)
        if kind == "udp":
            for k in range(60):
                sender.send(sample_frame(k % 290, time=1e6 + k / 30.0))
                await asyncio.sleep(0.01)
        else:
            async with connect(str(place)) as socket:
                for k in range(300):
                    frame = sample_frame(k % 290, time=1e6 + k / 30.0)
                    await socket.send(format_frame(frame))
                    await asyncio.sleep(0.01)
        async with asyncio.timeout(20.0):
            while (await pose(stream)).get("time", 0.0) < 1e6:
                pass
        grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
        if grown > 200.0:
            raise LostError(f"a flood costs {grown:.0f} MB")
