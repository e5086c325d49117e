"""How fast batches are, and how much memory their workers take.

Usage: python tests/batch_figures.py FOLDER [--takes 1000] [--frames 300] [--jobs 2]

The takes are made, cleaned by one process alone (before and after), and by a batch; the
memory of the batch's workers is read while it runs, and the sizes of takes and clips at
the end. Where other programs run too, the time means little: then compare seconds of
processors, and how long workers waited.
"""

from __future__ import annotations

import argparse
import os
import shutil
import statistics
import sys
from collections import defaultdict
from pathlib import Path
from resource import RUSAGE_CHILDREN, getrusage
from tempfile import TemporaryDirectory
from threading import Event, Thread
from time import perf_counter, process_time

from batch_faults import batch, rows, rows_done
from batch_takes import make_takes

from kinefilter.pipeline.batch.plan import find_sources, plan_jobs
from kinefilter.pipeline.batch.store import store_at
from kinefilter.pipeline.batch.task import clean_file
from kinefilter.pipeline.settings import Settings

_WARM_UP = 4  # takes until a process has loaded what it needs
_ALONE = 40  # takes that one process cleans


def seconds_a_take(takes: Path) -> tuple[float, float]:
    """Return what one process needs for a take, of time and of a processor [s]."""
    with TemporaryDirectory() as out:
        sources = find_sources([str(takes)], out)
        jobs = plan_jobs(sources, store_at(out), Settings(), ".usdc")
        chosen = jobs[:: max(1, len(jobs) // (_WARM_UP + _ALONE))]
        for job in chosen[:_WARM_UP]:
            clean_file(job)
        count, start, busy = len(chosen) - _WARM_UP, perf_counter(), process_time()
        for job in chosen[_WARM_UP:]:
            clean_file(job)
        return (perf_counter() - start) / count, (process_time() - busy) / count


def seconds_of_children() -> float:
    """Return the seconds of a processor that ended processes took."""
    used = getrusage(RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def megabytes(process: int, key: str) -> float:
    """Return a figure of /proc/PID/status [MB]."""
    for line in Path(f"/proc/{process}/status").read_text().splitlines():
        if line.startswith(key):
            return int(line.split()[1]) / 1e3
    return 0.0


def megabytes_a_file(folder: Path, pattern: str) -> float:
    """Return the mean size of files in the folders of a folder [MB]."""
    return statistics.mean(p.stat().st_size for p in folder.rglob(pattern)) / 1e6


def _workers(parent: int) -> list[int]:
    """Return the processes that a batch works in: those that loaded the engine."""
    found = Path(f"/proc/{parent}/task/{parent}/children").read_text().split()
    return [int(pid) for pid in found if megabytes(int(pid), "VmRSS") > 100]


def _watch(parent: int, done: Event, memory: dict[int, list[float]]) -> None:
    while not done.wait(1.0):
        try:
            for pid in _workers(parent):
                memory[pid].append(megabytes(pid, "VmRSS"))
        except OSError:
            continue  # it ended in between


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--takes", type=int, default=1000)
    parser.add_argument("--frames", type=int, default=300)
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    takes, out = options.folder / "takes", options.folder / "clips"
    shutil.rmtree(options.folder, ignore_errors=True)
    make_takes(takes, options.takes, options.frames)
    say = sys.stdout.write
    before = seconds_a_take(takes)
    say(f"alone, before: {before[0]:.3f} s a take, {before[1]:.3f} of a processor\n")
    memory: dict[int, list[float]] = defaultdict(list)
    done, start, used = Event(), perf_counter(), seconds_of_children()
    command = batch(takes, out, "--jobs", str(options.jobs))
    pid = os.spawnv(os.P_NOWAIT, command[0], command)
    watcher = Thread(target=_watch, args=(pid, done, memory))
    watcher.start()
    code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    seconds, used = perf_counter() - start, seconds_of_children() - used
    done.set()
    watcher.join()
    after = seconds_a_take(takes)
    say(f"alone, after: {after[0]:.3f} s a take, {after[1]:.3f} of a processor\n")
    count = len(rows_done(out))
    alone, busy = statistics.mean([before[0], after[0]]), [before[1], after[1]]
    say(f"exit code {code}, {count} takes in {seconds:.1f} s, start and end too\n")
    share = count / seconds * alone / options.jobs
    say(f"throughput {share:.2f} x {options.jobs} x that of one process alone\n")
    work = sum(row["seconds"] for row in rows(out)) / seconds / options.jobs
    ratio = statistics.mean(busy) * count / used
    say(f"{used / count:.3f} s of a processor a take, start and end too\n")
    say(f"alone over that: {ratio:.2f}; workers cleaned in {work:.1%} of the time\n")
    sizes = megabytes_a_file(takes, "*.*"), megabytes_a_file(out, "*.usdc")
    say(f"a take has {sizes[0]:.2f} MB, its clip {sizes[1]:.2f} MB\n")
    for worker, values in memory.items():
        tenth = max(1, len(values) // 10)
        first, last = values[tenth : 2 * tenth], values[-tenth:]
        say(
            f"worker {worker}: {statistics.mean(first):.0f} MB after a tenth, "
            f"{statistics.mean(last):.0f} MB at the end, {max(values):.0f} MB at most\n"
        )


if __name__ == "__main__":
    main()
