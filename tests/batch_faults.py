"""Kills batches and Dask workers at random moments, and compares what comes out.

Usage: python tests/batch_faults.py FOLDER [--takes 60] [--frames 100] [--kills 20]

Two of five takes are by two sensors, whose takes become one clip. First a batch runs
undisturbed. Then one is killed (SIGKILL) again and again and begun again, until it is
done; then one runs on a Dask cluster on loopback whose two workers are killed and
replaced in turn. Half of the kills are for each; a batch that is done before they are
is followed by another. Before every third the disk is full for a while, if this user
may mount a small one. Every take must have one row that says done, and every clip the
bytes of the undisturbed run.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import count
from pathlib import Path
from threading import Thread
from typing import Any

from batch_takes import make_takes

_ALONE = {"OPENBLAS_NUM_THREADS": "1"}
_ENOUGH = 1800.0  # s after which a batch of workers that are killed hangs
_DISK = "64m"  # for 60 takes of 100 frames


def batch(takes: Path, out: Path, *options: str) -> list[str]:
    """Return the command that cleans a folder."""
    command = [sys.executable, "-m", "kinefilter.pipeline.cli", "batch", str(takes)]
    return [*command, "-o", str(out), *options]


def begin(command: Sequence[str]) -> subprocess.Popen[bytes]:
    """Run a command in a session of its own, so that it can be ended alone."""
    return subprocess.Popen(
        command,
        env={**os.environ, **_ALONE},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


def rows(out: Path) -> list[dict[str, Any]]:
    """Return the whole rows of a manifest, which may not be there yet."""
    lines = out / "manifest.jsonl"
    text = lines.read_text() if lines.exists() else ""
    return [json.loads(row) for row in text.split("\n")[:-1]]


def rows_done(out: Path) -> list[str]:
    """Return the takes of whole rows that say done."""
    return [row["take"] for row in rows(out) if row["status"] == "done"]


def clip_hashes(out: Path) -> dict[str, str]:
    """Return a hash of each file that is no manifest."""
    return {
        path.relative_to(out).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(out.rglob("*"))
        if path.is_file() and not path.name.startswith("manifest")
    }


@contextmanager
def small_disk(folder: Path) -> Iterator[Path | None]:
    """Yield a folder that is a disk of its own, None where it cannot be mounted."""
    folder.mkdir(parents=True, exist_ok=True)
    mount = ["mount", "-t", "tmpfs", "-o", f"size={_DISK}", "tmpfs", str(folder)]
    try:
        done = subprocess.run(mount, capture_output=True, check=False).returncode == 0
    except FileNotFoundError:
        done = False
    try:
        yield folder if done else None
    finally:
        if done:
            subprocess.run(["umount", "-l", str(folder)], check=True)


@contextmanager
def full(disk: Path) -> Iterator[None]:
    """Fill a disk for a while."""
    filler = disk / "filler"
    with suppress(OSError), filler.open("wb", buffering=0) as file:
        while True:
            file.write(bytes(2**20))
    try:
        yield
    finally:
        filler.unlink()


def killed_until_done(
    command: Sequence[str],
    out: Path,
    count: int,
    kills: int,
    seed: int = 0,
    *,
    disk: Path | None = None,
) -> int:
    """Kill a batch so many times, spread over its takes; return how often it was.

    Args:
        command: The batch.
        out: Where it writes.
        count: How many takes it has.
        kills: How often it is killed.
        seed: Draws the moments.
        disk: What is full before every third kill; it holds ``out``.
    """
    rng = random.Random(seed)
    killed = 0
    for k in range(kills):
        process = begin(command)
        mark = count * (k + 1) / (kills + 1)
        while process.poll() is None and len(rows_done(out)) < mark:
            time.sleep(0.005)
        time.sleep(rng.uniform(0.0, 0.5))
        if disk is not None and k % 3 == 0:
            with full(disk):
                time.sleep(rng.uniform(0.5, 3.0))
        if process.poll() is None:
            process.kill()
            killed += 1
        process.wait()
    assert begin(command).wait() == 0
    return killed


@contextmanager
def scheduler() -> Iterator[str]:
    """Yield the address of a Dask scheduler on loopback.

    It does not blame a take for workers that we kill around it, as often as we do.
    """
    patient = {"DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "1000"}
    command = [sys.executable, "-m", "distributed.cli.dask_scheduler"]
    options = ["--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--no-show"]
    process = subprocess.Popen(
        [*command, *options],
        env=os.environ | _ALONE | patient,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stderr is not None
        address = next(
            found[1]
            for line in process.stderr
            if (found := re.search(r"Scheduler at: +(tcp://\S+)", line))
        )
        # A log that nobody reads on would hold it up.
        Thread(target=process.stderr.read, daemon=True).start()
        yield address
    finally:
        process.terminate()
        process.wait()


def begin_worker(
    address: str, folder: Path, *, nanny: bool = False
) -> subprocess.Popen[bytes]:
    """Start a Dask worker of one thread, which nobody but its nanny starts again."""
    command = [sys.executable, "-m", "distributed.cli.dask_worker", address]
    options = [
        "--nthreads",
        "1",
        f"--{'' if nanny else 'no-'}nanny",
        "--no-dashboard",
        "--host",
        "127.0.0.1",
    ]
    return begin([*command, *options, "--local-directory", str(folder)])


def killed_workers(
    takes: Path,
    out: Path,
    *options: str,
    every: float,
    seed: int = 0,
    kills: int = 1000,
    disk: Path | None = None,
) -> int:
    """Run a batch on two workers, one of which is killed now and then.

    Args:
        takes: Folder of takes.
        out: Folder for the clips.
        options: Those of the batch.
        every: Seconds to wait before a kill, once a take is done since the one before:
            on a busy machine workers start slowly, and those killed first do nothing.
        seed: Draws who is killed.
        kills: How often at most.
        disk: What is full before every third kill; it holds ``out``. The run is begun
            again when that ended it.
    """
    rng = random.Random(seed)
    folder = out.with_name(out.name + "-workers")
    killed = 0
    with scheduler() as address:
        workers = [begin_worker(address, folder) for _ in range(2)]
        command = batch(takes, out, "--scheduler", address, *options)
        run = begin(command)
        try:
            done, until = 0, time.monotonic() + _ENOUGH
            while (code := run.poll()) != 0:
                assert time.monotonic() < until, "the batch does not end"
                if code is not None:
                    assert disk is not None, code  # it was full
                    run = begin(command)
                while run.poll() is None and len(rows_done(out)) <= done:
                    assert time.monotonic() < until, "no take is done any more"
                    time.sleep(0.01)
                time.sleep(every)
                if disk is not None and killed % 3 == 0 and killed < kills:
                    with full(disk):
                        time.sleep(rng.uniform(0.5, 3.0))
                if run.poll() is None and killed < kills:
                    done = len(rows_done(out))
                    victim = rng.randrange(2)
                    workers[victim].kill()
                    workers[victim].wait()
                    workers[victim] = begin_worker(address, folder)
                    killed += 1
        finally:
            for process in (run, *workers):
                process.send_signal(signal.SIGKILL)
                process.wait()
    return killed


def check(out: Path, undisturbed: Path) -> int:
    """Assert that each take was done once and came out as it should.

    Returns how many rows tell of failures before that.
    """
    often = Counter(rows_done(out))
    assert [take for take in often if often[take] != 1] == []  # none done twice
    assert set(often) == set(rows_done(undisturbed))
    assert clip_hashes(out) == clip_hashes(undisturbed)
    return sum(row["status"] == "failed" for row in rows(out))


def batches(
    run: Callable[[Path, int, int], int], folder: Path, undisturbed: Path, kills: int
) -> str:
    """Let batch after batch be killed, check each, and return the counts.

    Args:
        run: Called with a folder for the clips, kills that are left and a seed; returns
            how often it killed.
        folder: Where the clips go, of one batch at a time.
        undisturbed: What each must be like.
        kills: How often in all.
    """
    killed = failed = 0
    for seed in count():
        if killed >= kills:
            takes = len(rows_done(undisturbed))
            return (
                f"{killed} times in {seed} batches of {takes} takes: each take done "
                f"once, the same bytes, {failed} rows of failures"
            )
        out = folder / str(seed)
        more = run(out, kills - killed, seed)
        assert more, "nothing was killed"
        killed += more
        failed += check(out, undisturbed)
        shutil.rmtree(out)
    raise AssertionError


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--takes", type=int, default=60)
    parser.add_argument("--frames", type=int, default=100)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--every", type=float, default=4.0)
    options = parser.parse_args()
    folder: Path = options.folder
    takes, whole = folder / "takes", folder / "undisturbed"
    make_takes(takes, options.takes, options.frames, sessions=True)
    words = ["--sessions", "{name}_{sensor}.csv", "--sensors", "A", "B"]
    assert begin(batch(takes, whole, "--jobs", "2", *words)).wait() == 0
    say, half = sys.stdout.write, options.kills // 2
    say(f"{len(rows_done(whole))} takes undisturbed\n")
    with small_disk(folder / "disk") as disk:

        def kill_runs(out: Path, kills: int, seed: int) -> int:
            command = batch(takes, out, "--jobs", "2", *words)
            return killed_until_done(
                command, out, options.takes, kills, seed, disk=disk
            )

        def kill_workers(out: Path, kills: int, seed: int) -> int:
            every = options.every
            return killed_workers(
                takes, out, *words, every=every, seed=seed, kills=kills, disk=disk
            )

        say("disk filled before every third kill\n" if disk else "no disk: not root\n")
        for what, kill, kills in (
            ("runs", kill_runs, options.kills - half),
            ("workers", kill_workers, half),
        ):
            told = batches(kill, (disk or folder) / what, whole, kills)
            say(f"{what} killed {told}\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
