"""Joints that leave their path for a moment count less in smoothing."""

import numpy as np
import pytest
from known_motions import stamps

from kinefilter.pipeline.target.smooth import smooth_by_speed, weights_of_outliers


@pytest.mark.parametrize("frames", [1, 2])
def test_a_joint_counts_less_the_farther_it_leaves_its_path(
    frames: int,
) -> None:
    time = stamps(120)
    still = np.random.default_rng(0).normal(0.0, 0.005, (120, 2, 3))
    weights, paths = [], []
    for away in (0.0, 0.1, 0.3):
        values = still.copy()
        values[60 : 60 + frames, 0, 1] += away
        weights.append(weights_of_outliers(time, values))
        paths.append(smooth_by_speed(time, values, weights[-1], cutoff=6.0))
    assert weights[0].min() > 0.8
    assert weights[1][60, 0] < 0.3
    assert weights[2][60, 0] < 0.05
    assert np.abs(paths[2] - paths[0]).max() < 0.02  # m of 0.3
    np.testing.assert_allclose(weights[2][:40], weights[0][:40])


def test_hands_that_shake_all_the_time_are_no_outliers() -> None:
    time = stamps(150)
    shaken = np.zeros((150, 1, 3))
    shaken[:, 0, 0] = 0.1 * np.sin(2.0 * np.pi * 5.0 * time)
    assert weights_of_outliers(time, shaken).mean() > 0.9


def test_whoever_moves_steadily_is_no_outlier() -> None:
    time = stamps(90)
    path = 4.0 * time[:, None, None] * [0.6, 0.0, 0.8]
    np.testing.assert_allclose(weights_of_outliers(time, path), 1.0)
