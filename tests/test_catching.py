"""Hands that wait for a ball which flies to them catch it, and no other hands do."""

import numpy as np
import pytest
from caught_balls import thrown


@pytest.mark.parametrize("seed", range(1000, 1006))
def test_hands_that_wait_for_a_ball_catch_it(seed: int) -> None:
    ball = thrown(seed)
    assert ball.held
    assert ball.away < 0.6
    assert np.ptp(ball.heights[-10:]) < 0.1  # carried by hands that hardly move


@pytest.mark.parametrize("seed", [1000, 1001])
def test_a_ball_that_goes_by_is_left_alone(seed: int) -> None:
    ball = thrown(seed, aside=1.2)
    assert not ball.held
    assert ball.away < 0.01


@pytest.mark.parametrize("seed", [1000, 1001])
def test_hands_far_apart_wait_for_no_ball(seed: int) -> None:
    assert not thrown(seed, apart=0.4).held
