"""Processes and their threads."""

from __future__ import annotations

import os
import time
from functools import partial

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from kinefilter.pipeline.workers import ProcessDiedError, one_thread, workers


def _most_threads() -> int:
    np.linalg.inv(np.eye(3))
    return max(int(pool["num_threads"]) for pool in threadpool_info())


def test_one_thread_is_used_and_the_environment_is_as_before() -> None:
    before = dict(os.environ)
    with threadpool_limits(2), one_thread():
        assert _most_threads() == 1
        assert os.environ["OPENBLAS_NUM_THREADS"] == "1"
    assert dict(os.environ) == before


def test_workers_are_told_so() -> None:
    with workers(1) as pool:
        assert pool.submit(os.getenv, "OPENBLAS_NUM_THREADS").result() == "1"


def test_a_call_that_fails_hangs_or_kills_its_process_fails_alone() -> None:
    with workers(2) as pool:
        died, failed = pool.submit(os._exit, 1), pool.submit(int, "a")
        hung = pool.submit_within(0.1, partial(time.sleep, 3600.0))
        lengths = list(pool.map(len, ["take", "clip"]))
        with pytest.raises(ProcessDiedError):
            died.result()
        with pytest.raises(ValueError, match="'a'") as error:
            failed.result()
        with pytest.raises(TimeoutError):
            hung.result()
    assert lengths == [4, 4]
    assert "in _serve" in error.value.__notes__[0]  # where it failed
