"""Batches with takes that hang: they are given up, and Ctrl-C ends the run."""

from __future__ import annotations

import math
import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from batch_faults import begin_worker, scheduler
from batch_folders import rows_of, table_of
from hanging import HALF_A_CLIP, done_or_hang

from kinefilter.pipeline.batch import run as batch_run
from kinefilter.pipeline.batch.plan import find_sources, plan_jobs
from kinefilter.pipeline.batch.run import clean_files
from kinefilter.pipeline.batch.store import store_at
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.settings import Settings
from kinefilter.pipeline.workers import Workers

QUICK = {"one.csv", "two.csv", "three.csv"}


@pytest.fixture
def hanging(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Yield a folder of takes, of which the first hangs; no process may be left."""
    others = {*multiprocessing.active_children()}  # another test's cluster
    takes = tmp_path / "takes"
    takes.mkdir()
    (takes / "hangs.csv").write_text("the longest is begun first")
    for name in QUICK:
        (takes / name).write_text("a take")
    tests = str(Path(__file__).parent)
    monkeypatch.setattr(batch_run, "clean_file", done_or_hang)
    monkeypatch.setattr(sys, "path", [*sys.path, tests])
    monkeypatch.setenv("PYTHONPATH", tests)
    yield takes
    assert {*multiprocessing.active_children()} <= others


def test_a_take_that_hangs_is_given_up_and_the_others_are_done(
    hanging: Path, tmp_path: Path
) -> None:
    out = tmp_path / "clips"
    outcome = clean_files([str(hanging)], str(out), jobs=1, take_timeout=0.5)
    assert {row.take for row in outcome.rows if row.status == "done"} == QUICK
    (failed,) = outcome.failed
    assert failed.take == "hangs.csv"
    assert "after 0.5 s" in failed.error
    assert "--take-timeout" in failed.error
    assert {path.stem for path in out.iterdir()} == {"manifest"}


@pytest.mark.skipif(os.name == "nt", reason="a process cannot send itself Ctrl-C there")
@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize("second", ["never", "before the end", "within the end"])
def test_ctrl_c_ends_a_batch_whose_worker_hangs(
    hanging: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, second: str
) -> None:
    out = tmp_path / "clips"
    ending = threading.Event()

    def interrupt() -> None:
        while not (out / HALF_A_CLIP).exists() or len(rows_of(out)) < len(QUICK):
            ending.wait(0.01)
        os.kill(os.getpid(), signal.SIGINT)
        if second == "within the end" and ending.wait(60.0):
            os.kill(os.getpid(), signal.SIGINT)

    end_workers = Workers.end

    def end(workers: Workers) -> None:
        if second == "never" or ending.is_set():
            return end_workers(workers)
        ending.set()
        if second == "before the end":
            raise KeyboardInterrupt
        return end_workers(workers, 30.0)  # which the second one ends

    monkeypatch.setattr(Workers, "end", end)
    thread = threading.Thread(target=interrupt)
    thread.start()
    with pytest.raises(KeyboardInterrupt):
        clean_files([str(hanging)], str(out), jobs=2)
    ending.set()
    thread.join()
    assert {path.stem for path in out.iterdir()} == {"manifest"}
    assert {row["take"] for row in table_of(out)} == QUICK


@pytest.mark.skipif(find_spec("distributed") is None, reason="Dask is not here")
def test_a_cluster_gives_a_take_that_hangs_up(hanging: Path, tmp_path: Path) -> None:
    out = tmp_path / "clips"
    with scheduler() as address, ExitStack() as ending:
        worker = begin_worker(address, tmp_path / "worker", nanny=True)
        ending.callback(worker.wait)
        ending.callback(os.killpg, worker.pid, signal.SIGKILL)
        outcome = clean_files(
            [str(hanging)], str(out), scheduler=address, take_timeout=0.5
        )
    expected = dict.fromkeys(QUICK, "done") | {"hangs.csv": "failed"}
    assert {row.take: row.status for row in rows_of(out)} == expected
    assert "after 0.5 s" in outcome.failed[0].error


@pytest.mark.skipif(find_spec("distributed") is None, reason="Dask is not here")
@pytest.mark.parametrize("limit", [5e16, math.inf])
def test_a_limit_that_no_clock_reaches_is_no_limit(
    limit: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("distributed.get_worker", lambda: None)
    monkeypatch.setattr(batch_run, "_one_at_a_time", threading.Lock())
    job: Any = SimpleNamespace(limit=limit)
    assert batch_run._clean_in_time(lambda _: "a row", job) == "a row"
    assert not batch_run._one_at_a_time.locked()


def test_a_longer_take_may_need_longer(tmp_path: Path) -> None:
    out = store_at(str(tmp_path / "clips"))
    for name, size in (("short.csv", 10), ("long.csv", 2_000_000)):
        (tmp_path / name).write_bytes(b"1" * size)
    sources = find_sources([str(tmp_path)], out.root)
    long, short = plan_jobs(sources, out, Settings(), ".usdc")
    assert short.limit == pytest.approx(3600.0, abs=0.1)
    assert long.limit == pytest.approx(3720.0, abs=0.1)
    long, short = plan_jobs(sources, out, Settings(), ".usdc", take_timeout=9.0)
    assert long.limit == short.limit == 9.0


@pytest.mark.parametrize("seconds", ["0", "-1", "nan"])
def test_a_time_limit_is_more_than_nothing(
    hanging: Path, seconds: str, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--take-timeout", seconds, "-o", str(hanging / "out")]
    assert main(["batch", str(hanging), *words]) == 2
    assert "--take-timeout" in capsys.readouterr().err


@pytest.mark.skipif(os.name == "nt", reason="no signal reaches one process alone there")
def test_ctrl_c_does_not_end_a_worker_that_is_still_starting() -> None:
    workers = Workers(1)
    length = workers.submit(len, "take")
    while not workers._processes:
        time.sleep(0.001)
    pid = workers._processes[0].pid
    assert pid is not None
    os.kill(pid, signal.SIGINT)
    assert length.result() == 4
    workers.end()
