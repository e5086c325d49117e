"""The nearest postures: those of a plain loop, however many there are."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from sklearn.neighbors import NearestNeighbors

from kinefilter.pipeline import database
from kinefilter.pipeline.database import PostureIndex

Array = NDArray[np.float64]


def made_up(count: int, joints: int = 20, seed: int = 0) -> NDArray[np.float32]:
    """A walk through postures: neighbors in time are neighbors in space."""
    rng = np.random.default_rng(seed)
    steps = rng.normal(0.0, 0.03, (count, joints, 3))
    return np.cumsum(steps, axis=0).astype(np.float32)


def brute_force(
    positions: NDArray[np.float32], posture: Array, weights: Array
) -> Array:
    """Add up eq. 9 joint by joint, over the joints that have a weight."""
    distances = np.zeros(len(positions))
    for j in np.flatnonzero(weights):
        distances += weights[j] * np.sum((positions[:, j] - posture[j]) ** 2, axis=1)
    return distances


@pytest.fixture
def blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Look at few postures as an index looks at many."""
    monkeypatch.setattr(database, "_AT_ONCE", 10)
    monkeypatch.setattr(database, "_BLOCK", 8)
    monkeypatch.setattr(database, "_FIRST", 2)


def test_a_whole_database_is_in_order_of_its_distances() -> None:
    positions, rng = made_up(40), np.random.default_rng(1)
    posture, weights = rng.normal(size=(20, 3)), rng.random(20)
    posture[3:6], weights[3:6] = np.nan, 0.0
    nearest, distances = PostureIndex(positions).nearest(posture, weights, 40)
    expected = brute_force(positions, posture, weights)
    np.testing.assert_array_equal(nearest, np.argsort(expected, kind="stable"))
    np.testing.assert_allclose(distances, np.sort(expected))


@pytest.mark.usefixtures("blocks")
@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    size=st.integers(1, 200),
    count=st.integers(1, 12),
    far=st.sampled_from([0.0, 0.05, 3.0]),
    hidden=st.integers(0, 19),
)
def test_blocks_hide_none_of_the_nearest(
    seed: int, size: int, count: int, far: float, hidden: int
) -> None:
    positions, rng = made_up(size, seed=seed % 7), np.random.default_rng(seed)
    posture = positions[rng.integers(size)] + rng.normal(0.0, far, (20, 3))
    weights = rng.random(20) * (rng.permutation(20) >= hidden)
    count = min(count, size)
    nearest, distances = PostureIndex(positions).nearest(posture, weights, count)
    expected = brute_force(positions, posture, weights)
    np.testing.assert_allclose(distances, np.sort(expected)[:count], atol=1e-12)
    np.testing.assert_allclose(distances, expected[nearest], atol=1e-12)
    assert len(set(nearest.tolist())) == count


def test_most_of_many_postures_are_not_looked_at(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    positions = made_up(40_000)
    index, looked_at = PostureIndex(positions), 0
    rows = PostureIndex._rows

    def counted(self: PostureIndex, some: NDArray[np.intp]) -> NDArray[np.intp]:
        nonlocal looked_at
        found = rows(self, some)
        looked_at += len(found)
        return found

    monkeypatch.setattr(PostureIndex, "_rows", counted)
    for k in range(0, 40_000, 4_000):
        nearest, _ = index.nearest(positions[k].astype(float), np.ones(20), 5)
        assert nearest[0] == k
    assert looked_at < 0.05 * 10 * 40_000


@pytest.mark.usefixtures("blocks")
@pytest.mark.parametrize("count", [1, 7, 60])
def test_neighbors_are_those_of_scikit_learn_on_scaled_coordinates(count: int) -> None:
    rng = np.random.default_rng(2)
    positions = rng.normal(0.0, 0.3, (60, 20, 3)).astype(np.float32)
    index = PostureIndex(positions)
    flat = positions.reshape(60, -1).astype(float)
    for _ in range(10):
        posture, weights = rng.normal(0.0, 0.3, (20, 3)), rng.random(20)
        scale = np.sqrt(np.repeat(weights, 3))
        reference = NearestNeighbors(n_neighbors=count).fit(flat * scale)
        away, nearest = reference.kneighbors((posture.ravel() * scale)[None])
        found, distances = index.nearest(posture, weights, count)
        np.testing.assert_array_equal(found, nearest[0])
        np.testing.assert_allclose(distances, away[0] ** 2)


@pytest.mark.usefixtures("blocks")
@pytest.mark.parametrize("seed", range(10))
def test_what_single_precision_cannot_tell_apart_is_told_apart(seed: int) -> None:
    # Three meters away, single precision knows D to a part in ten million.
    rng = np.random.default_rng(seed)
    positions = rng.normal(-1.5, 1e-6, (64, 20, 3)).astype(np.float32)
    posture = rng.normal(1.5, 0.01, (20, 3))
    nearest, _ = PostureIndex(positions).nearest(posture, np.ones(20), 5)
    expected = brute_force(positions.astype(float), posture, np.ones(20))
    np.testing.assert_array_equal(nearest, np.argsort(expected)[:5])


@pytest.mark.usefixtures("blocks")
def test_without_any_weight_all_are_as_near() -> None:
    nearest, distances = PostureIndex(made_up(50)).nearest(
        np.full((20, 3), np.nan), np.zeros(20), 4
    )
    assert len(set(nearest.tolist())) == 4
    np.testing.assert_array_equal(distances, 0.0)


@pytest.mark.usefixtures("blocks")
def test_postures_that_are_all_the_same_are_found_in_their_order() -> None:
    positions = np.tile(made_up(1), (100, 1, 1))
    nearest, distances = PostureIndex(positions).nearest(
        positions[0].astype(float), np.ones(20), 3
    )
    assert nearest.tolist() == [0, 1, 2]
    np.testing.assert_array_equal(distances, 0.0)
