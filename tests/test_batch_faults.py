"""Batches whose processes die, are killed, or are told to end."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import Future
from importlib.util import find_spec
from pathlib import Path
from unittest.mock import Mock

import pytest
from batch_faults import (
    batch,
    begin,
    begin_worker,
    check,
    clip_hashes,
    killed_until_done,
    killed_workers,
    rows_done,
    scheduler,
)
from batch_takes import Here, short_take, write_session
from dying import clean_or_die

from kinefilter import CleanConfig
from kinefilter.pipeline.batch import run as batch_run
from kinefilter.pipeline.batch.manifest import Row
from kinefilter.pipeline.batch.run import clean_files
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.formats import write_take_csv
from kinefilter.pipeline.settings import Settings

TOGETHER = ("--sessions", "{name}_{sensor}.csv", "--sensors", "A", "B")
QUICK = ("--method", "none", "--no-physics", "--to", "bvh")
needs_dask = pytest.mark.skipif(
    find_spec("distributed") is None, reason="Dask, of the extra cluster, is not here"
)


def _takes(folder: Path, *names: str, pairs: int = 0) -> Path:
    """Return a folder of takes, the first of which two sensors recorded."""
    folder.mkdir()
    for k, name in enumerate(names):
        if k < pairs:
            write_session(folder, name, short_take(100, seed=k))
        else:
            write_take_csv(short_take(100, seed=k), folder / f"{name}.csv")
    return folder


def test_a_take_that_kills_its_process_fails_and_the_others_are_cleaned(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    takes = _takes(tmp_path / "takes", "deadly", "one", "two", "unlucky")
    monkeypatch.setattr(batch_run, "clean_file", clean_or_die)
    monkeypatch.setattr(sys, "path", [*sys.path, str(Path(__file__).parent)])
    settings = Settings(CleanConfig(method="none", physics=False))
    outcome = clean_files(
        [str(takes)], str(tmp_path / "clips"), settings, suffix=".bvh", jobs=2
    )
    assert {row.take: row.status for row in outcome.rows} == {
        "deadly.csv": "failed",
        "one.csv": "done",
        "two.csv": "done",
        "unlucky.csv": "done",
    }
    assert len(outcome.rows) == 4
    assert "died" in outcome.failed[0].error


@pytest.mark.usefixtures("here")
def test_a_run_that_is_killed_goes_on_where_it_was(tmp_path: Path) -> None:
    names = [f"take_{k}" for k in range(6)]
    takes, words = _takes(tmp_path / "takes", *names, pairs=3), (*QUICK, *TOGETHER)
    command = batch(takes, tmp_path / "clips", *words, "--jobs", "2")
    killed = killed_until_done(command, tmp_path / "clips", len(names), 1, seed=1)
    assert main(["batch", str(takes), "-o", str(tmp_path / "whole"), *words]) == 0
    assert killed >= 1
    assert len(clip_hashes(tmp_path / "clips")) == len(names)
    check(tmp_path / "clips", tmp_path / "whole")


def test_a_run_that_is_told_to_end_says_so_and_leaves_its_table(tmp_path: Path) -> None:
    takes = _takes(tmp_path / "takes", "short")
    for k in range(4):
        write_take_csv(short_take(298, seed=k), takes / f"long_{k}.csv")
    out = tmp_path / "clips"
    process = begin(batch(takes, out, "--jobs", "1"))
    while process.poll() is None and not rows_done(out):
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGTERM)  # as a batch system does
    assert process.wait() == 130
    assert (out / "manifest.csv").exists()
    assert 1 <= len(rows_done(out)) < 5
    assert set(clip_hashes(out)) >= {
        take.replace(".csv", ".usdc") for take in rows_done(out)
    }


@needs_dask
def test_a_cluster_whose_workers_die_does_every_take_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    takes = _takes(tmp_path / "takes", *(f"take_{k}" for k in range(4)), pairs=1)
    options = ("--method", "low-rank", "--to", "bvh", *TOGETHER)
    killed = killed_workers(takes, tmp_path / "clips", *options, every=0.0, kills=2)
    assert killed >= 1
    monkeypatch.setattr("kinefilter.pipeline.batch.run.open_crew", Here)
    assert main(["batch", str(takes), "-o", str(tmp_path / "whole"), *options]) == 0
    check(tmp_path / "clips", tmp_path / "whole")


@needs_dask
def test_a_row_that_arrives_while_its_worker_dies_is_no_failure() -> None:
    from distributed import cfexecutor

    class Lost:
        status = "lost"  # the worker died after it had sent its row

        async def _result(self, *, raiseit: bool) -> Row:
            assert not raiseit
            return Row("take_1.csv", "done", "take_1.bvh", "")

    async def arrive() -> None:
        await cfexecutor._cascade_future(Lost(), future)

    future, job, cluster = Future[Row](), Mock(), object.__new__(batch_run._Cluster)
    asyncio.run(arrive())
    assert cluster._row(future, job) is None  # so that it is cleaned again
    other = Future[Row]()
    other.set_exception(TypeError("Job() got an unexpected keyword argument"))
    assert cluster._row(other, job) is job.row.return_value


@needs_dask
def test_who_waits_for_a_worker_is_told_so(tmp_path: Path) -> None:
    takes = _takes(tmp_path / "takes", "one")
    with scheduler() as address:
        command = batch(takes, tmp_path / "clips", *QUICK, "--scheduler", address)
        run = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        assert run.stderr is not None
        assert f"dask worker {address}" in run.stderr.readline()
        worker = begin_worker(address, tmp_path / "worker")
        try:
            assert run.communicate()[1] == ""  # once
            assert run.returncode == 0
        finally:
            worker.kill()
            worker.wait()
    assert rows_done(tmp_path / "clips") == ["one.csv"]
