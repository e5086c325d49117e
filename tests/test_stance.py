"""Feet that are held while they stand, and limbs bent to where they have to end."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from rig_motions import bent_to

from kinefilter.retarget.limbs import bent_limb, holding_moves, near_stance

Array = NDArray[np.float64]


def test_a_bent_limb_has_its_lengths_reaches_its_goal_and_bends_where_it_is_told() -> (
    None
):
    rng = np.random.default_rng(0)
    lengths = np.array([0.4, 0.3])
    start, away = rng.normal(size=(2, 200, 3))
    away *= (rng.uniform(0.11, 0.69, 200) / np.linalg.norm(away, axis=1))[:, None]
    toward = rng.normal(size=(200, 3))
    middle, end = bent_limb(start, start + away, toward, lengths)
    np.testing.assert_allclose(end, start + away, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(middle - start, axis=1), 0.4)
    np.testing.assert_allclose(np.linalg.norm(end - middle, axis=1), 0.3)
    limb = np.stack([start, middle, end], axis=1)
    assert (np.sum(bent_to(limb) * toward, axis=1) > 0.0).all()


@pytest.mark.parametrize(("asked", "found"), [(1.0, 0.7), (0.05, 0.1), (0.7, 0.7)])
def test_a_goal_out_of_reach_is_approached(asked: float, found: float) -> None:
    goal, toward = np.array([[0, -asked, 0]]), np.array([[0, 0, 1.0]])
    middle, end = bent_limb(np.zeros((1, 3)), goal, toward, np.array([0.4, 0.3]))
    np.testing.assert_allclose(end, [[0, -found, 0]], atol=1e-12)
    assert np.linalg.norm(middle) == pytest.approx(0.4)


def path_of(stands: list[int], slip: float) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return time, path of a foot and when it stands, by how much it slips a frame."""
    time = np.arange(len(stands)) / 30.0
    path = np.zeros((len(stands), 3))
    path[:, 0] = slip * np.arange(len(stands))
    return time, path, np.array(stands, dtype=bool)


def test_a_held_foot_rests_and_joins_its_path_in_a_sixth_of_a_second() -> None:
    time, path, stands = path_of([0] * 10 + [1] * 10 + [0] * 10, 0.002)
    move = holding_moves(time, path, stands, 0.0, 0.015)
    rests = (path + move)[10:20]
    np.testing.assert_allclose(rests, np.broadcast_to(rests[0], (10, 3)), atol=1e-12)
    assert not move[[0, 5, 24, 29]].any()
    assert np.linalg.norm(np.diff(move, axis=0), axis=1).max() < 0.005


def test_a_foot_that_drifts_is_dragged_along() -> None:
    time, path, stands = path_of([1] * 100, 0.002)
    move = holding_moves(time, path, stands, 0.0, 0.015)
    assert np.linalg.norm(move, axis=1).max() <= 0.015 + 1e-9


def test_a_foot_that_stands_again_at_once_rests_both_times() -> None:
    time, path, stands = path_of([1] * 6 + [0] + [1] * 6, 0.002)
    moved = path + holding_moves(time, path, stands, 0.0, 0.015)
    assert np.abs(np.diff(moved[:6], axis=0)).max() < 1e-12
    assert np.abs(np.diff(moved[7:], axis=0)).max() < 1e-12
    assert moved[5, 0] < moved[6, 0] < moved[7, 0]


def test_a_foot_that_stands_is_as_high_as_it_stands() -> None:
    time, path, stands = path_of([0] * 9 + [1] * 10 + [0] * 9, 0.0)
    path[:, 1] = 0.1 + 0.01 * np.sin(np.arange(28))
    moved = path + holding_moves(time, path, stands, 0.08, 0.015)
    np.testing.assert_allclose(moved[9:19, 1], 0.08)


def test_near_a_stance_counts_less_the_farther_it_is() -> None:
    time, _, stands = path_of([0] * 10 + [1] * 3 + [0] * 13, 0.0)
    share = near_stance(time, stands)
    assert (share[10:13] == 1.0).all()
    assert (np.diff(share[5:11]) > 0.0).all()
    assert (np.diff(share[12:18]) < 0.0).all()
    assert not share[:5].any()
    assert not share[18:].any()
    assert not near_stance(time, np.zeros(26, dtype=bool)).any()


def test_a_step_joins_its_own_path_as_the_stance_gets_farther() -> None:
    time, path, stands = path_of([0] * 12 + [1] * 5 + [0] * 9, 0.0)
    path[:, 1] = 0.1
    move = holding_moves(time, path, stands, 0.08, 0.015)
    np.testing.assert_allclose(move[:, 1], -0.02 * near_stance(time, stands))
