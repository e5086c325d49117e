"""Low-rank and sparse recovery: its kernels, its optimum, and what it takes out."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from kinefilter.characters import InputError
from kinefilter.pipeline.correct import Observation
from kinefilter.pipeline.lab.methods.baselines import (
    Decomposition,
    LowRank,
    decompose,
    threshold_singular_values,
)

Array = NDArray[np.float64]

JOINTS, CORRUPTED = 21, 0.2  # m


def movement(frames: int, rank: int, seed: int = 0) -> Array:
    """Return swinging joints whose matrix (3 T, J) has a rank, (T, J, 3)."""
    rng = np.random.default_rng(seed)
    time = np.arange(frames)[:, None, None] / 30.0
    pace = rng.uniform(0.1, 1.0, (1, 3, rank))
    swing = np.sin(2.0 * np.pi * pace * time + rng.uniform(0.0, 6.0, (1, 3, rank)))
    shapes = 0.3 * rng.normal(size=(rank, JOINTS))
    return np.asarray((swing @ shapes).transpose(0, 2, 1))


def corrupted(truth: Array, share: float = 0.05, seed: int = 1) -> Array:
    rng = np.random.default_rng(seed)
    wrong = rng.random(truth.shape) < share
    errors = rng.choice(np.array([-CORRUPTED, CORRUPTED]), truth.shape)
    return truth + np.where(wrong, errors, 0.0)


def take_of(positions: Array) -> Observation:
    time = np.arange(len(positions)) / 30.0
    ones = np.ones(positions.shape[:2])
    return Observation(positions, ones, ones, time)


def recovered(corrector: LowRank, positions: Array) -> Array:
    return corrector.whole(take_of(positions)).positions


def matrix_of(positions: Array) -> Array:
    return positions.transpose(0, 2, 1).reshape(-1, positions.shape[1])


def error(result: Array, truth: Array) -> float:
    return float(np.linalg.norm(result - truth, axis=2).mean())


def decomposed(positions: Array, sparsity: float) -> tuple[Decomposition, Array, float]:
    matrix = matrix_of(positions)
    price = sparsity / np.sqrt(len(matrix))
    return decompose(matrix, np.full(matrix.shape, price)), matrix, price


@settings(max_examples=40, deadline=None)
@given(
    rows=st.integers(1, 80),
    columns=st.integers(1, 21),
    seed=st.integers(0, 2**32 - 1),
    share=st.floats(1e-3, 1.2),
)
def test_thresholding_through_the_gram_matrix_is_that_of_the_full_decomposition(
    rows: int, columns: int, seed: int, share: float
) -> None:
    matrix = np.random.default_rng(seed).normal(size=(rows, columns))
    left, values, right = np.linalg.svd(matrix, full_matrices=False)
    threshold = share * float(values[0])
    expected = (left * np.maximum(values - threshold, 0.0)) @ right
    result = threshold_singular_values(matrix, threshold)
    np.testing.assert_allclose(result, expected, atol=1e-8)


@pytest.mark.parametrize("sparsity", [1.0, 2.0])
@pytest.mark.parametrize("rank", [2, 5])
def test_what_is_found_fulfills_the_optimality_conditions(
    rank: int, sparsity: float
) -> None:
    found, matrix, price = decomposed(corrupted(movement(150, rank)), sparsity)
    clean, sparse, dual = found.low_rank, found.sparse, found.multiplier
    assert found.converged
    size = np.linalg.norm(matrix)
    assert np.linalg.norm(matrix - clean - sparse) < 2e-7 * size
    # The multiplier is a subgradient of the error's price ...
    assert np.abs(dual).max() <= price * (1.0 + 1e-12)
    wrong = np.abs(sparse) > 1e-6
    assert 0.01 < wrong.mean() < 0.8
    np.testing.assert_allclose(dual[wrong], price * np.sign(sparse[wrong]), rtol=1e-9)
    # ... and, but for the growing mu, of the nuclear norm.
    assert np.linalg.norm(dual, 2) < 1.02
    nuclear = np.linalg.norm(clean, "nuc")
    assert np.sum(dual * clean) == pytest.approx(nuclear, rel=2e-3)


def test_the_objective_is_not_above_that_of_the_truth() -> None:
    truth = movement(150, 5)
    found, matrix, price = decomposed(corrupted(truth), 1.0)

    def objective(clean: Array) -> float:
        sparse = np.abs(matrix - clean).sum()
        return float(np.linalg.norm(clean, "nuc") + price * sparse)

    assert objective(found.low_rank) < objective(matrix_of(truth))
    nudge = np.random.default_rng(0).normal(0.0, 1e-3, matrix.shape)
    for other in (found.low_rank + nudge, 0.99 * found.low_rank, matrix):
        assert objective(found.low_rank) < objective(other)


@pytest.mark.parametrize("sparsity", [1.0, 2.0])
@pytest.mark.parametrize("rank", [2, 5])
@pytest.mark.parametrize("frames", [200, 600])
def test_five_percent_of_corrupted_entries_are_recovered(
    frames: int, rank: int, sparsity: float
) -> None:
    truth = movement(frames, rank)
    seen = corrupted(truth)
    corrector = LowRank(sparsity=sparsity)
    result = recovered(corrector, seen)
    assert corrector.converged_
    assert error(seen, truth) > 0.025
    assert error(result, truth) < 0.02
    assert error(result, truth) < 0.4 * error(seen, truth)


@pytest.mark.parametrize("rank", [1, 3, 5])
def test_clean_low_rank_movement_comes_back_unchanged(rank: int) -> None:
    truth = movement(300, rank, seed=3)
    result = recovered(LowRank(), truth)
    np.testing.assert_allclose(result, truth, atol=1e-6)


def test_gaps_are_filled_from_the_joints_that_were_seen() -> None:
    truth = movement(200, 3)
    seen = truth.copy()
    seen[50:80, 4], seen[:20, 7], seen[180:, 9] = np.nan, np.nan, np.nan
    gap = np.isnan(seen[..., 0])
    result = recovered(LowRank(), seen)
    assert np.isfinite(result).all()
    filled = np.linalg.norm(result - truth, axis=2)
    assert filled[~gap].mean() < 0.005
    bridged = np.linalg.norm(truth[:20, 7] - truth[20, 7], axis=1).mean()
    assert filled[:20, 7].mean() < 0.2 * bridged
    assert filled[gap].mean() < 0.02


def test_the_error_of_what_was_not_observed_is_free() -> None:
    matrix = matrix_of(movement(100, 2))
    penalty = np.full(matrix.shape, 2.0 / np.sqrt(len(matrix)))
    open_entries = np.random.default_rng(0).random(matrix.shape) < 0.1
    penalty[open_entries] = 0.0
    wild = np.where(open_entries, matrix + 1.0, matrix)
    found = decompose(wild, penalty)
    assert found.converged
    np.testing.assert_array_equal(found.multiplier[open_entries], 0.0)
    np.testing.assert_allclose(found.low_rank, matrix, atol=1e-4)


def test_joints_never_seen_stay_open_and_do_not_matter() -> None:
    truth = movement(100, 3)
    seen = corrupted(truth)
    seen[:, [2, 5]] = np.nan
    result = recovered(LowRank(), seen)
    assert np.isnan(result[:, [2, 5]]).all()
    alone = recovered(LowRank(), np.delete(seen, [2, 5], axis=1))
    np.testing.assert_allclose(np.delete(result, [2, 5], axis=1), alone, atol=1e-12)
    nothing = recovered(LowRank(), np.full((5, JOINTS, 3), np.nan))
    assert np.isnan(nothing).all()


@pytest.mark.parametrize("frames", [1, 2, 30])
def test_takes_of_any_length_and_of_zeros_are_finite(frames: int) -> None:
    corrector = LowRank()
    with pytest.raises(InputError, match="cannot correct it frame by frame"):
        corrector.step(take_of(movement(frames, 2)).at(0))
    assert np.isfinite(recovered(corrector, movement(frames, 2))).all()
    zeros = np.zeros((frames, JOINTS, 3))
    np.testing.assert_array_equal(recovered(corrector, zeros), zeros)
    assert corrector.converged_
    assert corrector.iterations_ == 0


def test_recovery_scales_with_the_take_and_leaves_it_alone() -> None:
    seen = corrupted(movement(100, 3))
    before = seen.copy()
    result = recovered(LowRank(), seen)
    np.testing.assert_array_equal(seen, before)
    doubled = recovered(LowRank(), 2.0 * seen)
    np.testing.assert_allclose(doubled, 2.0 * result, atol=1e-9)


def test_running_out_of_iterations_is_reported() -> None:
    corrector = LowRank(sparsity=1.0, iterations=3)
    recovered(corrector, corrupted(movement(50, 3)))
    assert not corrector.converged_
    assert corrector.iterations_ == 3
