"""Jitter, speed, acceleration and flight of motions whose figures are known."""

from __future__ import annotations

import numpy as np
import pytest
from known_motions import BODY, Array, polynomial, stamps, standing

from kinefilter.characters import KINECT_V1
from kinefilter.characters.anthropometry import joint_masses
from kinefilter.pipeline.metrics import flight_error, jitter, peak_speed

# Jitter


@pytest.mark.parametrize("fps", [15.0, 30.0, 120.0])
def test_jitter_of_a_cubic_is_its_third_derivative(fps: float) -> None:
    time = 3.0 + stamps(40, fps)
    path = polynomial(time, [1, 2, 3], [1, 0, 1], [-2, 1, 0], [0.3, 0.0, 0.4])
    assert jitter(time, path) == pytest.approx(6.0 * 0.5, rel=1e-6)


def test_constant_acceleration_has_no_jitter() -> None:
    time = stamps(40)
    path = polynomial(time, [1, 2, 3], [5, 0, 1], [-2, -9.81, 0])
    assert jitter(time, path) == pytest.approx(0.0, abs=1e-7)


def test_jitter_of_a_slow_sine_is_that_of_its_derivative() -> None:
    time, omega = stamps(3001, 120.0), 2.0 * np.pi
    path = standing(len(time))
    path[:, :, 0] += 0.1 * np.sin(omega * time)[:, None]
    expected = 0.1 * omega**3 * 2.0 / np.pi
    assert jitter(time, path) == pytest.approx(expected, rel=1e-3)


def test_jitter_leaves_out_gaps_and_missing_joints() -> None:
    time = stamps(60)
    time[30:] += 0.5
    path = polynomial(time, [0, 0, 0], [1, 0, 0])
    assert jitter(time, path) == pytest.approx(0.0, abs=1e-7)
    path[10, 5] = np.nan
    path[10:, 7] += 0.3
    path[8:13, 7] = np.nan
    assert jitter(time, path) == pytest.approx(0.0, abs=1e-7)


def test_jitter_counts_one_jump_as_the_third_differences_do() -> None:
    path = standing(40)
    path[20:, 3, 1] += 0.1
    expected = 0.1 * (1 + 2 + 1) * 30.0**3 / (20 * 37)
    assert jitter(stamps(40), path) == pytest.approx(expected)


def test_repeated_stamps_do_not_count_as_motion() -> None:
    time = stamps(40)
    path = polynomial(time, [0, 0, 0], [1, 0, 0])
    time = np.insert(time, 20, time[20])
    assert jitter(time, np.insert(path, 20, path[20], axis=0)) == pytest.approx(
        0.0, abs=1e-7
    )


@pytest.mark.parametrize("frames", [1, 2, 3])
def test_jitter_of_less_than_four_frames_is_unknown(frames: int) -> None:
    assert np.isnan(jitter(stamps(frames), standing(frames)))


# Speed and acceleration


@pytest.mark.parametrize("fps", [15.0, 30.0, 120.0])
def test_the_peak_speed_of_a_sine_is_that_of_its_fastest_hundredth(fps: float) -> None:
    time = stamps(4000, fps)
    path = standing(len(time))
    path[:, 7, 0] += 0.2 * np.sin(1.7 * time)
    expected = 0.2 * 1.7 * np.cos(np.pi / 2.0 * 0.01)
    assert peak_speed(time, path, [7]) == pytest.approx(expected, rel=2e-3)
    assert peak_speed(time, path, [8]) == 0.0


def test_one_leap_among_hundreds_of_frames_is_no_peak_but_gaps_and_repeats_count() -> (
    None
):
    time = np.delete(stamps(500), [100, 101, 300])
    time = np.insert(time, 50, time[50])
    path = polynomial(time, [0, 0, 0], [0.3, 0.0, 0.4])
    path[200, 7] += 9.0
    path[400, 7] = np.nan
    assert peak_speed(time, path, [7]) == pytest.approx(0.5)
    assert np.isnan(peak_speed(time, np.full_like(path, np.nan), [7]))
    assert np.isnan(peak_speed(time[:1], path[:1], [7]))


# Flight


def leap(frames: int, acceleration: float, fps: float = 30.0) -> tuple[Array, Array]:
    """Return stamps and the path of a body a meter up with this acceleration."""
    time = stamps(frames, fps)
    path = polynomial(time, [0, 1, 0], [0.5, 2.0, -1.0], [0, 0.5 * acceleration, 0])
    return time, path


@pytest.mark.parametrize("fps", [15.0, 30.0, 120.0])
@pytest.mark.parametrize(
    ("acceleration", "error"), [(-9.81, 0.0), (0.0, 9.81), (-4.0, 5.81), (2.0, 11.81)]
)
def test_flight_is_off_by_the_acceleration_that_gravity_does_not_give(
    acceleration: float, error: float, fps: float
) -> None:
    time, path = leap(10, acceleration, fps)
    nowhere = np.zeros((10, 2), dtype=np.bool_)
    assert flight_error(time, path, nowhere, BODY) == pytest.approx(error, abs=1e-6)


def test_turning_limbs_about_the_center_of_mass_leaves_a_flight_free() -> None:
    time, path = leap(10, -9.81)
    masses = joint_masses(BODY)
    hand, foot = KINECT_V1.index("HandLeft"), KINECT_V1.index("KneeRight")
    swing = np.random.default_rng(0).normal(0.0, 0.2, (10, 3))
    path[:, hand] += swing / masses[hand]
    path[:, foot] -= swing / masses[foot]
    path[:, :, 1] += 3.0
    nowhere = np.zeros((10, 2), dtype=np.bool_)
    assert flight_error(time, path, nowhere, BODY) == pytest.approx(0.0, abs=1e-6)


def test_only_flights_of_five_frames_off_the_floor_without_a_stance_count() -> None:
    time, path = leap(10, 0.0)
    nowhere = np.zeros((10, 2), dtype=np.bool_)
    assert np.isnan(flight_error(time[:4], path[:4], nowhere[:4], BODY))
    standing_on_one = nowhere.copy()
    standing_on_one[[2, 6], [0, 1]] = True
    assert np.isnan(flight_error(time, path, standing_on_one, BODY))
    assert np.isnan(flight_error(time, path - [0.0, 1.6, 0.0], nowhere, BODY))
    repeated = time.copy()
    repeated[4] = repeated[3]
    assert np.isnan(flight_error(repeated, path, nowhere, BODY))


def test_longer_flights_weigh_more() -> None:
    falling, hovering = leap(10, -9.81), leap(20, 0.0)
    time = stamps(31)
    stands = np.zeros((31, 2), dtype=np.bool_)
    stands[10] = True
    path = np.concatenate([falling[1], standing(1), hovering[1]])
    assert flight_error(time, path, stands, BODY) == pytest.approx(9.81 * 2.0 / 3.0)


def test_joints_that_are_missing_in_a_flight_have_no_mass() -> None:
    time, path = leap(10, -5.81)
    nowhere = np.zeros((10, 2), dtype=np.bool_)
    path[:, 7] = np.nan
    path[4, 3] = np.nan
    assert flight_error(time, path, nowhere, BODY) == pytest.approx(4.0)
    path[2] = np.nan
    assert flight_error(time, path, nowhere, BODY) == pytest.approx(4.0)
    assert np.isnan(flight_error(time, np.full_like(path, np.nan), nowhere, BODY))
