"""Processes and their threads."""

from __future__ import annotations

import os

import numpy as np
from threadpoolctl import threadpool_info

from kinefilter.pipeline.workers import one_thread, workers


def _most_threads() -> int:
    np.linalg.inv(np.eye(3))
    return max(int(pool["num_threads"]) for pool in threadpool_info())


def test_one_thread_is_used_and_the_environment_is_as_before() -> None:
    before = dict(os.environ)
    with one_thread():
        assert _most_threads() == 1
        assert os.environ["OPENBLAS_NUM_THREADS"] == "1"
    assert dict(os.environ) == before


def test_workers_are_told_so() -> None:
    with workers(1) as pool:
        assert pool.submit(os.getenv, "OPENBLAS_NUM_THREADS").result() == "1"
