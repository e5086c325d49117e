"""A ball in free flight obeys gravity, and loses in a bounce what it should."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from kinefilter.characters.anthropometry import GRAVITY
from kinefilter.scenes.library.ball import RESTITUTION, flown, launch_speed, rolled


def test_before_the_first_bounce_a_flight_is_a_parabola() -> None:
    time = np.linspace(0.0, 0.6, 50)
    expected = 2.0 + 1.5 * time - 0.5 * 9.81 * time**2
    assert expected.min() > 0.0
    np.testing.assert_allclose(flown(2.0, 1.5, time), expected, atol=1e-12)


def test_energy_is_kept_in_the_air_and_lost_in_a_bounce() -> None:
    time = np.arange(0.0, 3.0, 1e-3)
    height = flown(1.8, 0.0, time)
    speed = np.gradient(height, time)
    energy = 0.5 * speed**2 + GRAVITY * height
    bounces = np.flatnonzero((height[1:-1] < height[:-2]) & (height[1:-1] < height[2:]))
    assert len(bounces) >= 3
    for k, (a, b) in enumerate(zip([0, *bounces[:-1] + 4], bounces - 2, strict=True)):
        expected = GRAVITY * 1.8 * RESTITUTION ** (2 * k)
        np.testing.assert_allclose(energy[a + 1 : b], expected, rtol=2e-3)


def test_a_ball_dropped_as_fiba_says_comes_back_as_fiba_says() -> None:
    fall = np.sqrt(2.0 * 1.8 / GRAVITY)
    radius = 0.121
    after = flown(1.8, 0.0, fall + np.linspace(0.0, 0.8, 2000))
    assert 1.2 < after.max() + 2.0 * radius < 1.4


def test_a_bouncing_ball_comes_to_rest() -> None:
    np.testing.assert_array_equal(flown(1.0, 0.0, np.array([10.0, 60.0])), 0.0)


@settings(max_examples=60, deadline=None)
@given(
    start=st.floats(0.0, 2.5),
    end=st.floats(0.05, 2.5),
    duration=st.floats(0.1, 3.0),
    wish=st.floats(-4.0, 6.0),
)
@example(start=1.0, end=0.0546875, duration=1.0, wish=4.0)
def test_a_launched_ball_arrives(
    start: float, end: float, duration: float, wish: float
) -> None:
    speed = launch_speed(start, end, duration, wish)
    assert flown(start, speed, duration) == pytest.approx(end, abs=1e-6)
    bouncing = launch_speed(start, end, duration, wish, bouncing=True)
    if np.isfinite(bouncing):
        assert flown(start, bouncing, duration) == pytest.approx(end, abs=1e-6)
        land = bouncing + np.sqrt(bouncing**2 + 2.0 * GRAVITY * start)
        assert land <= GRAVITY * duration


def test_the_launch_speed_nearest_to_the_hands_is_found() -> None:
    # From the known flight itself, however many bounces it has.
    for speed in (-3.0, -1.0, 0.5, 2.0):
        end = float(flown(0.8, speed, 0.55))
        found = launch_speed(0.8, end, 0.55, speed + 0.02)
        assert found == pytest.approx(speed, abs=1e-6)


def test_a_ball_flies_level_at_its_speed_until_it_rolls_out() -> None:
    time = np.linspace(0.0, 20.0, 500)
    way = rolled(1.0, 2.0, time)
    land = (2.0 + np.sqrt(4.0 + 2.0 * GRAVITY)) / GRAVITY
    np.testing.assert_allclose(way[time < land], time[time < land])
    assert np.all(np.diff(way) >= 0.0)
    assert way[-1] - way[-2] < 1e-6
