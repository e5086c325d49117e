"""What batches of a million takes cost, and how many workers one scheduler can feed.

Usage: python tests/scale_figures.py FOLDER [--takes 40] [--rows 10000 ...]
           [--workers 25 50 100 200] [--seconds 0.1 0.5 2 8]

A batch of a tenth of the takes and one of all are cleaned by one process; their
difference is the cost of a take. Batches that are done are begun again, with small
files instead of takes and clips. Then 'kinefilter batch --scheduler' runs as it is, on
workers that sleep instead of cleaning: threads of a few processes, which answer with
the row of a real take. The clock runs from the manifest's creation to its last row.
"""

from __future__ import annotations

import argparse
import asyncio
import os
import shutil
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path, PurePath
from typing import NamedTuple

import psutil
from batch_faults import batch, begin, scheduler
from batch_figures import megabytes_a_file
from batch_takes import make_takes

from kinefilter.pipeline.batch import run, task
from kinefilter.pipeline.batch.manifest import Row, read_rows
from kinefilter.pipeline.batch.plan import Job, find_sources, plan_jobs
from kinefilter.pipeline.batch.store import store_at
from kinefilter.pipeline.settings import Settings

_TOGETHER = 25  # sleeping workers in one process
_MOST, _LONG = 2000, 4.0  # takes of a simulated batch, and s that it takes at least
_LINES = "manifest.jsonl"

say = sys.stdout.write


class Used(NamedTuple):
    """What a batch and its workers used."""

    seconds: float
    busy: float  # s of a processor
    memory: float  # MB, of the largest process
    read: float  # MB, with the files of Python
    written: float  # MB


def used(command: Sequence[str]) -> Used:
    """Run a batch to its end."""
    start, process = time.perf_counter(), begin(command)
    os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)  # keeps its /proc
    seconds = time.perf_counter() - start
    lines = Path(f"/proc/{process.pid}/io").read_text().splitlines()
    moved = {key: int(value) / 1e6 for key, value in (row.split(": ") for row in lines)}
    _, status, usage = os.wait4(process.pid, 0)
    assert status == 0, command
    busy, memory = usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1e3
    return Used(seconds, busy, memory, moved["rchar"], moved["wchar"])


def cost_of_a_take(folder: Path, count: int) -> Row:
    """Print what one more take costs; return the row of one."""
    out, runs = folder / "clips", []
    for part in (count // 10, count):
        shutil.rmtree(out, ignore_errors=True)
        make_takes(folder / "takes", part, 300)
        runs.append(used(batch(folder / "takes", out, "--jobs", "1")))
    few, many = runs
    busy, read, written = (
        (getattr(many, key) - getattr(few, key)) / (count - count // 10)
        for key in ("busy", "read", "written")
    )
    lines = (out / _LINES).stat().st_size / count
    say(f"a take: {busy:.2f} s of a processor, {many.memory:.0f} MB at most, ")
    say(f"reads {read:.2f} MB, writes {written:.2f} MB, ")
    clip = megabytes_a_file(out, "*.usdc")
    say(f"of which the clip {clip:.2f} MB, row {lines:.0f} bytes\n")
    return read_rows(out)[0]


def small_files(folder: Path, count: int) -> Path:
    """Write files with the names of takes, a thousand in a folder."""
    shutil.rmtree(folder, ignore_errors=True)
    for k in range(count):
        path = folder / f"day_{k // 1000:03d}" / f"take_{k:07d}.csv"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("asleep")
    return folder


def resume(folder: Path, count: int, row: Row) -> None:
    """Print how long a batch takes that has nothing left to do."""
    takes, out = small_files(folder / "many", count), folder / "many-clips"
    store, lines = store_at(str(out)), list[str]()
    for job in plan_jobs(
        find_sources([str(takes)], str(out)), store, Settings(), ".usdc"
    ):
        store.put(job.output, b"clip")
        file = store.find(job.output)
        assert file is not None
        clips = (replace(row.clips[0], output=job.output, stamp=file.stamp),)
        lines.append(replace(answer(row, job), clips=clips).as_json() + "\n")
    store.put(_LINES, "".join(lines).encode())
    again = used(batch(takes, out))
    assert len((out / _LINES).read_bytes().splitlines()) == count  # nothing was cleaned
    say(f"resume of {count} rows: {again.seconds:.1f} s, {again.busy:.1f} s of a ")
    say(f"processor, {again.memory:.0f} MB, reads {again.read:.1f} MB, writes ")
    say(f"{again.written:.1f} MB\n")
    for path in (takes, out):
        shutil.rmtree(path)


def answer(row: Row, job: Job) -> Row:
    """Return a row as if another take had become it."""
    named = {"take": job.take, "output": job.output, "stamp": job.stamp}
    return replace(row, **named, settings=job.fingerprint)


def sleep_for(address: str, folder: Path) -> None:
    """Be some workers of a cluster; they sleep as long as the folder of takes says."""
    import dask
    from distributed import Worker

    row = read_rows(folder)[0]

    def asleep(job: Job) -> Row:
        time.sleep(float(PurePath(job.sources[0].store.root).name))
        return answer(row, job)

    async def work() -> None:
        place = {"local_directory": str(folder / "workers"), "memory_limit": 0}
        made = [
            Worker(
                address, nthreads=1, dashboard=False, name=f"{os.getpid()}-{k}", **place
            )
            for k in range(_TOGETHER)
        ]
        await asyncio.gather(*made)
        await asyncio.gather(*(worker.finished() for worker in made))

    # What a batch sends to its workers is found by name, and one process is many here.
    task.clean_file = asleep
    run._one_at_a_time = threading.Semaphore(_TOGETHER)  # type: ignore[assignment]
    # Each worker would look at all threads of the process a hundred times a second.
    with dask.config.set({"distributed.worker.profile.enabled": False}):
        asyncio.run(work())


@contextmanager
def sleepers(address: str, folder: Path) -> Iterator[None]:
    """Add workers that sleep."""
    command = [sys.executable, __file__, str(folder), "--sleep-for", address]
    process = begin(command)
    try:
        yield
    finally:
        process.kill()
        process.wait()


def throughput(address: str, folder: Path, workers: int, seconds: float) -> None:
    """Print how many takes a second a batch does on workers that sleep."""
    count = workers * round(max(2, min(_LONG / seconds, _MOST / workers)))
    takes, out = small_files(folder / str(seconds), count), folder / "slept"
    shutil.rmtree(out, ignore_errors=True)
    process = begin(batch(takes, out, "--scheduler", address))
    both = [psutil.Process(process.pid), _scheduler()]
    while not (out / _LINES).exists():
        time.sleep(0.01)
    start, before = time.perf_counter(), [sum(p.cpu_times()[:2]) for p in both]
    done = 0
    with (out / _LINES).open("rb") as lines:
        while done < count:
            time.sleep(0.02)
            done += lines.read().count(b"\n")
    took = time.perf_counter() - start
    cpu = [sum(p.cpu_times()[:2]) - was for p, was in zip(both, before, strict=True)]
    assert process.wait() == 0
    batch_ms, scheduler_ms = (1e3 * spent / count for spent in cpu)
    say(f"{workers:4} x {seconds:4} s: {count / took:6.1f} takes/s of ")
    say(f"{workers / seconds:6.1f} ({count / took * seconds / workers:.0%}), ms of a ")
    say(f"processor a take: scheduler {scheduler_ms:.2f}, batch {batch_ms:.2f}\n")
    sys.stdout.flush()
    shutil.rmtree(takes)


def _scheduler() -> psutil.Process:
    children = psutil.Process().children()
    return next(p for p in children if any("dask_scheduler" in w for w in p.cmdline()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--takes", type=int, default=40)
    parser.add_argument("--rows", type=int, nargs="+", default=[10_000])
    parser.add_argument("--workers", type=int, nargs="*", default=[25, 50, 100, 200])
    parser.add_argument("--seconds", type=float, nargs="*", default=[0.1, 0.5, 2, 8])
    parser.add_argument("--sleep-for", metavar="ADDRESS", help=argparse.SUPPRESS)
    options = parser.parse_args()
    folder: Path = options.folder
    if options.sleep_for:
        sleep_for(options.sleep_for, folder)
        return
    from distributed import Client

    shutil.rmtree(folder, ignore_errors=True)
    row = cost_of_a_take(folder, options.takes)
    for count in options.rows:
        resume(folder, count, row)
    with scheduler() as address, Client(address) as client, ExitStack() as working:
        running = 0
        for workers in options.workers:
            for _ in range(running, workers, _TOGETHER):
                working.enter_context(sleepers(address, folder / "clips"))
            client.wait_for_workers(workers)
            running = workers
            for seconds in options.seconds:
                throughput(address, folder, workers, seconds)


if __name__ == "__main__":
    main()
