"""The threshold rule keeps postures that differ, in memory or on a disk."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from kinefilter.pipeline import database
from kinefilter.pipeline.database import filter_postures, filter_to_count

Array = NDArray[np.float64]


def walk(count: int) -> Array:
    steps = np.random.default_rng(3).normal(0.0, 0.02, (count, 20, 3))
    return np.cumsum(steps, axis=0)


def squared_differences(positions: Array) -> Array:
    flat = positions.reshape(len(positions), -1)
    return np.asarray(np.sum((flat[:, None] - flat[None]) ** 2, axis=-1))


def one_by_one(positions: Array, threshold: float) -> list[int]:
    """Keep postures as the paper says it: each against all kept so far."""
    kept: list[int] = []
    for k, posture in enumerate(positions):
        if all(np.sum((posture - positions[m]) ** 2) > threshold for m in kept):
            kept.append(k)
    return kept


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    count=st.integers(1, 60),
    threshold=st.floats(0.01, 20.0),
    block=st.sampled_from([1, 7, 512]),
)
def test_kept_postures_differ_and_dropped_ones_are_near_a_kept_one(
    seed: int, count: int, threshold: float, block: int
) -> None:
    positions = np.random.default_rng(seed).normal(0.0, 0.3, (count, 20, 3))
    positions[count // 2 :] = positions[: count - count // 2] + 1e-3
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(database, "_COMPARED", block)
        kept = filter_postures(positions, threshold)
    assert kept.tolist() == one_by_one(positions, threshold)
    differences = squared_differences(positions)
    among = differences[np.ix_(kept, kept)] + np.where(np.eye(len(kept)), np.inf, 0.0)
    assert among.min() > threshold
    dropped = np.setdiff1d(np.arange(count), kept)
    assert (differences[np.ix_(dropped, kept)].min(axis=1) <= threshold).all()


@pytest.mark.parametrize(("frames", "count"), [(1500, 100), (1500, 400), (300, 50)])
def test_filtering_to_a_count_hits_it_within_two_percent(
    frames: int, count: int
) -> None:
    kept = filter_to_count(walk(frames), count)
    assert abs(len(kept) - count) <= 0.02 * count
    assert (np.diff(kept) > 0).all()
    assert kept[0] == 0


def test_postures_that_lead_one_way_are_filtered_to_two() -> None:
    rising = np.cumsum(np.full((300, 20, 3), 0.01), axis=0)
    assert len(filter_to_count(rising, 2)) == 2


def test_few_postures_are_all_kept() -> None:
    positions = np.random.default_rng(0).normal(size=(30, 20, 3))
    for count in (30, 31):
        np.testing.assert_array_equal(filter_to_count(positions, count), np.arange(30))


def test_only_the_postures_asked_for_may_stay() -> None:
    positions, among = walk(300), np.arange(1, 300, 7)
    kept = filter_postures(positions, 0.1, among=among)
    np.testing.assert_array_equal(
        kept, among[one_by_one(positions[among], threshold=0.1)]
    )


def test_a_threshold_that_keeps_too_many_is_given_up_at_once() -> None:
    positions = walk(5000)
    kept = filter_postures(positions, 0.0, most=100)
    assert 100 < len(kept) <= 100 + database._COMPARED
    np.testing.assert_array_equal(kept, np.arange(len(kept)))


def test_giving_up_thresholds_leaves_the_count_right(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(database, "_TOO_MANY", 0)
    # In sixty dimensions all are about as far apart: from a threshold that keeps few,
    # the next keeps far too many.
    positions = np.random.default_rng(0).normal(size=(3000, 20, 3))
    kept = filter_to_count(positions, 60)
    assert abs(len(kept) - 60) <= 1
    assert kept[-1] > 2500


def test_postures_on_a_disk_are_filtered_as_those_in_memory(tmp_path: Path) -> None:
    positions = walk(3000).astype(np.float32)
    np.save(tmp_path / "walk.npy", positions)
    on_disk = np.load(tmp_path / "walk.npy", mmap_mode="r")
    np.testing.assert_array_equal(
        filter_to_count(on_disk, 200), filter_to_count(positions, 200)
    )
