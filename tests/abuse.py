"""A week of abuse: what kinefilter does with what nobody should do to it.

    python tests/abuse.py [--minutes 5] [--only files] [--seed 0] [--json out.json]
    python tests/abuse.py --only files --count 20000

Damaged files of every format, random sets of options, kills, full disks, clocks that
jump, crowds and floods: each part gets its share of the minutes. Every try must end in
success or in a refusal that says why, with nothing half-written; any other end is a
loss, and the exit code 1. With a count there is no limit of time, unless ``--minutes``
gives one. The same seed tries the same things: ``--only files --first 1234 --count 1``
repeats one of them.
"""

from __future__ import annotations

import argparse
import faulthandler
import importlib
import json
import math
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import traceback
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from abused_commands import Attempt, prepare
from rich.console import Console
from rich.table import Table

from kinefilter.characters import InputError

_say = Console(soft_wrap=True, highlight=False, markup=False).print


@dataclass(frozen=True)
class Part:
    """A kind of abuse."""

    function: str  # module:name, called with an Attempt
    share: float  # of the time
    most: int  # tries
    patience: float = 20.0  # s of processor time for one try; see ``_may_wait``
    workers: int = 2


PARTS = {
    "files": Part("abused_commands:abuse_file", 0.35, 20_000),
    "options": Part("abused_options:abuse_options", 0.3, 1000),
    "kills": Part("abused_machine:abuse_by_kills", 0.1, 200, 60.0),
    "disks": Part("abused_machine:abuse_disks", 0.05, 500, 60.0),
    "clocks": Part("abused_machine:abuse_clocks", 0.05, 100),
    "crowds": Part("abused_machine:abuse_by_crowds", 0.1, 20, 3600.0),
    "floods": Part("abused_machine:abuse_by_floods", 0.05, 20, 60.0),
}
_MEMORY = 8 * 2**30  # bytes of address space of a worker


@dataclass
class Tally:
    """What became of the tries of a part."""

    counts: Counter[str] = field(default_factory=Counter)
    kinds: dict[str, Counter[str]] = field(default_factory=dict)
    seconds: Counter[str] = field(default_factory=Counter)
    lost: list[dict[str, Any]] = field(default_factory=list)
    slowest: tuple[float, int] = (0.0, -1)

    def add(self, row: dict[str, Any]) -> None:
        """Count a try."""
        self.counts["tried"] += 1
        self.counts[row["end"]] += 1
        self.kinds.setdefault(row["what"], Counter())[row["end"]] += 1
        self.seconds[row["what"]] += row.get("seconds", 0.0)
        self.slowest = max(self.slowest, (row.get("seconds", 0.0), row["n"]))
        if row["end"] == "lost":
            self.lost.append(row)
            _say(f"lost: {row['part']} {row['n']} {row['what']}: {row['words']}")


# The worker


def work(name: str, asked: argparse.Namespace, first: int, step: int) -> None:
    """Try one after the other, and tell of each on the standard output."""
    told = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    sys.stdin = open(os.devnull, encoding="utf-8")  # noqa: SIM115, PTH123
    part = PARTS[name]
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
    faulthandler.register(signal.SIGPROF, chain=True)
    module, _, function = part.function.partition(":")
    valid = sorted(asked.folder.joinpath("valid").iterdir())
    files = {path.name: path for path in valid}
    function = getattr(importlib.import_module(module), function)
    for n in range(first, asked.first + asked.count, step):
        if time.time() > asked.until:
            break
        told.write(json.dumps({"begin": n}) + "\n")
        folder = asked.folder / f"{name}-{n}"
        folder.mkdir()
        faulthandler.dump_traceback_later(_may_wait(part), exit=True)
        signal.setitimer(signal.ITIMER_PROF, part.patience)
        began = time.perf_counter()
        rng = random.Random(f"{asked.seed} {name} {n}")
        row = tried(function, Attempt(n, rng, files, folder, asked.minutes))
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        faulthandler.cancel_dump_traceback_later()
        seconds = time.perf_counter() - began
        told.write(json.dumps({"part": name, "n": n, "seconds": seconds} | row) + "\n")
        if row["end"] != "lost":
            shutil.rmtree(folder, ignore_errors=True)


def _may_wait(part: Part) -> float:
    """Return how long a try may last [s]: longer the more others use the processors."""
    return 10.0 * part.patience * max(1.0, os.getloadavg()[0] / (os.cpu_count() or 1))


def tried(function: Callable[[Attempt], None], attempt: Attempt) -> dict[str, str]:
    """Try once; return what it was, how it ended and what was said."""
    here, end, words = Path.cwd(), "survived", ""
    try:
        function(attempt)
    except InputError as error:
        end, words = "refused", str(error)
        if not 0 < len(words) < 5000:
            end, words = "lost", f"a message of {len(words)} characters: {words[:300]}"
    except BaseException as error:  # whatever it is
        last = traceback.extract_tb(error.__traceback__)[-3:]
        where = " < ".join(f"{Path(f.filename).name}:{f.lineno}" for f in last[::-1])
        words = f"{type(error).__name__}: {str(error)[:400]} at {where}; "
        end, words = "lost", words + " ".join(attempt.words)
    finally:
        os.chdir(here)
    return {"what": attempt.what, "end": end, "words": words}


# The watch


def watch(name: str, asked: argparse.Namespace, tally: Tally, first: int) -> None:
    """Run a worker, and another where it dies, until the tries or the time are over."""
    step = min(PARTS[name].workers, asked.count)
    options = ["--only", name, "--seed", str(asked.seed), "--folder", str(asked.folder)]
    options += ["--until", str(asked.until), "--count", str(asked.count)]
    options += ["--minutes", str(asked.minutes)]
    while first < asked.first + asked.count and time.time() < asked.until:
        command = [*_room(name, asked), sys.executable, __file__, "--worker", str(step)]
        command += [*options, "--first", str(asked.first), "--from", str(first)]
        with (
            tempfile.TemporaryFile("w+") as said,
            subprocess.Popen(
                command, stdout=subprocess.PIPE, stderr=said, text=True
            ) as process,
        ):
            assert process.stdout is not None
            began = None
            for line in process.stdout:
                row = json.loads(line)
                if "begin" in row:
                    began = row["begin"]
                else:
                    tally.add(row)
                    first, began = began + step, None
            process.wait()
            if began is None and process.returncode == 0:
                return
            said.seek(0)
            text = said.read()  # the thread that ran the command comes last
            words = f"worker ended with {process.returncode}: {text[:200]}"
            words += f" ... {text[-2500:]}" if len(text) > 200 else ""
        row = {"part": name, "n": began, "what": "death", "end": "lost"}
        tally.add(row | {"words": words})
        if began is None:
            return  # it does not even begin
        first = began + step


def _room(name: str, asked: argparse.Namespace) -> list[str]:
    """Return what begins a command that sees a small disk, where that can be had."""
    if name != "disks" or os.geteuid() != 0 or shutil.which("unshare") is None:
        return []
    disk = asked.folder / "disk"
    disk.mkdir(exist_ok=True)
    mount = f'mount -t tmpfs -o size=1m none {disk} && exec "$@"'
    return ["unshare", "--mount", "sh", "-c", mount, "sh"]


def run_part(name: str, asked: argparse.Namespace) -> Tally:
    """Try a part in several workers at once."""
    tally = Tally()
    threads = [
        threading.Thread(target=watch, args=(name, asked, tally, asked.first + k))
        for k in range(min(PARTS[name].workers, asked.count))
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return tally


def arguments() -> argparse.Namespace:
    """Return what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float)
    parser.add_argument("--only", choices=PARTS)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--folder", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--until", type=float, help=argparse.SUPPRESS)
    parser.add_argument("--worker", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--from", type=int, dest="begin", help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.minutes is None:
        asked.minutes = 5.0 if asked.count is None else math.inf
    return asked


def main() -> int:
    """Abuse, print the table, and return the exit code."""
    asked = arguments()
    if asked.worker:
        work(asked.only, asked, asked.begin, asked.worker)
        return 0
    names = [asked.only] if asked.only else list(PARTS)
    whole, count = sum(PARTS[name].share for name in names), asked.count
    tallies = {}
    with tempfile.TemporaryDirectory(prefix="abuse-") as folder:
        asked.folder = Path(folder)
        prepare(asked.folder / "valid")
        for name in names:
            seconds = 60.0 * asked.minutes * PARTS[name].share / whole
            asked.until = time.time() + seconds
            asked.count = count or PARTS[name].most
            tallies[name] = run_part(name, asked)
    table = Table("", "tried", "refused", "survived", "lost", "slowest, s")
    for name, tally in tallies.items():
        cells = [str(tally.counts[k]) for k in ("tried", "refused", "survived", "lost")]
        table.add_row(name, *cells, f"{tally.slowest[0]:.1f} (try {tally.slowest[1]})")
    _say(table)
    if asked.json is not None:
        found = {name: vars(tally) for name, tally in tallies.items()}
        asked.json.write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")
    return int(any(tally.lost for tally in tallies.values()))


if __name__ == "__main__":
    sys.exit(main())
