"""Figures of quality on motions whose figures are known."""

from __future__ import annotations

import warnings
from dataclasses import asdict

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from kinefilter.characters import KINECT_V1, KINECT_V2, Skeleton, standard_body
from kinefilter.characters.humanoid import joint_masses
from kinefilter.pipeline import metrics
from kinefilter.pipeline.metrics import (
    SKATE_HEIGHT,
    SKATE_SPEED,
    acceleration_error,
    amplitude,
    bone_length_cv,
    distances,
    flight_error,
    floating,
    jitter,
    lowest_point,
    measure,
    peak_speed,
    skate,
)
from kinefilter.retarget import positions_from_rotations
from kinefilter.retarget.rotations import normalize

Array = NDArray[np.float64]

BODY = standard_body(KINECT_V1)
FEET = [KINECT_V1.index(f"Foot{side}") for side in ("Left", "Right")]


def stamps(count: int, fps: float = 30.0) -> Array:
    return np.arange(count) / fps


def standing(frames: int, skeleton: Skeleton = KINECT_V1) -> Array:
    return np.tile(standard_body(skeleton).rest_positions, (frames, 1, 1))


def polynomial(time: Array, *vectors: list[float]) -> Array:
    """Return a path with these vectors as coefficients of t^0, t^1, ..., (T, 20, 3)."""
    powers = time[:, None] ** np.arange(len(vectors))
    path = np.asarray(powers @ np.array(vectors, float))
    return np.asarray(standing(len(time)) + path[:, None])


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


# Bone lengths


@pytest.mark.parametrize("skeleton", [KINECT_V1, KINECT_V2], ids=lambda s: s.name)
def test_bones_of_constant_length_do_not_vary_however_they_turn(
    skeleton: Skeleton,
) -> None:
    rng, body = np.random.default_rng(0), standard_body(skeleton)
    rotations = normalize(rng.normal(size=(20, len(skeleton), 4)))
    path = positions_from_rotations(rotations, rng.normal(size=(20, 3)), body)
    assert bone_length_cv(path, body) == pytest.approx(0.0, abs=1e-12)


def test_bone_length_variation_of_a_breathing_body_is_that_of_its_scale() -> None:
    scale = np.tile([0.9, 1.1], 20)
    assert bone_length_cv(standing(40) * scale[:, None, None], BODY) == pytest.approx(
        0.1
    )


def test_one_varying_bone_counts_as_one_of_nineteen() -> None:
    path, hand = standing(40), KINECT_V1.index("HandLeft")
    path[::2, hand] += 0.2 * BODY.rest_offsets[hand]
    path[1::2, hand] -= 0.2 * BODY.rest_offsets[hand]
    assert bone_length_cv(path, BODY) == pytest.approx(0.2 / 19)
    path[::2, hand] = np.nan
    assert bone_length_cv(path, BODY) == pytest.approx(0.0, abs=1e-12)
    path[:, hand] = np.nan
    assert bone_length_cv(path, BODY) == pytest.approx(0.0, abs=1e-12)


def test_bone_length_variation_of_nothing_is_unknown() -> None:
    assert np.isnan(bone_length_cv(np.full((9, 20, 3), np.nan), BODY))
    assert np.isnan(bone_length_cv(standing(1), BODY))


# Feet


@pytest.mark.parametrize(("speed", "share"), [(0.05, 0.0), (0.19, 0.0), (0.3, 1.0)])
@pytest.mark.parametrize("fps", [15.0, 30.0])
def test_feet_that_slide_at_a_known_speed_skate_by_it(
    speed: float, share: float, fps: float
) -> None:
    time = stamps(30, fps)
    path = polynomial(time, [0, 0, 0], [0.6 * speed, 0.0, 0.8 * speed])
    slide, over, fastest = skate(time, path, BODY)
    assert slide == pytest.approx(1e3 * speed / fps)
    assert over == share
    assert fastest == pytest.approx(speed)


def test_one_foot_of_two_makes_half_of_the_mean() -> None:
    time, path = stamps(30), standing(30)
    path[:, FEET[0], 2] += 0.3 * time
    slide, over, fastest = skate(time, path, BODY)
    assert slide == pytest.approx(1e3 * 0.15 / 30.0)
    assert over == 0.5
    assert fastest == pytest.approx(0.3)


def test_lifted_feet_and_vertical_movement_do_not_skate() -> None:
    time, path = stamps(30), standing(30)
    path[:, FEET[0], 0] += time
    path[:, FEET[0], 1] += SKATE_HEIGHT + 0.001
    path[:, FEET[1], 1] += 0.04 * np.abs(np.sin(9.0 * time))
    assert skate(time, path, BODY) == (0.0, 0.0, 0.0)
    path[:, FEET[0], 1] -= 0.002
    assert skate(time, path, BODY)[1] == 0.5


def test_a_foot_counts_only_between_two_frames_on_the_floor() -> None:
    time, path = stamps(4), standing(4)
    path[:, FEET[1], 1] += 1.0
    path[2, FEET[0], 1] += 1.0
    path[1:, FEET[0], 0] += 0.01
    path[2:, FEET[0], 0] += 5.0
    slide, over, fastest = skate(time, path, BODY)
    assert slide == pytest.approx(10.0)
    assert over == float(SKATE_SPEED < 0.3)
    assert fastest == pytest.approx(0.3)


def test_skating_over_a_dropped_frame_is_a_speed_and_not_a_step() -> None:
    time = np.delete(stamps(30), [10, 11, 20])
    path = polynomial(time, [0, 0, 0], [0.15, 0.0, 0.0])
    assert skate(time, path, BODY)[0] == pytest.approx(5.0)
    time = np.insert(time, 5, time[5])
    path = polynomial(time, [0, 0, 0], [0.15, 0.0, 0.0])
    assert skate(time, path, BODY)[0] == pytest.approx(5.0)


def test_skating_is_unknown_where_no_foot_stands() -> None:
    path = standing(10)
    path[:, FEET] = np.nan
    assert np.isnan(skate(stamps(10), path, BODY)).all()
    assert np.isnan(skate(stamps(10), standing(10) + 1.0, BODY)).all()


# The lowest point


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_lowest_point_is_that_of_points_sampled_on_the_capsules(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rotations = normalize(rng.normal(size=(20, 4)))
    pose = positions_from_rotations(rotations, rng.normal(size=3), BODY)
    lowest = float(lowest_point(pose[None], BODY)[0])
    ball = rng.normal(size=(4000, 3))
    ball[0] = [0.0, -1.0, 0.0]
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    samples = []
    for joint in KINECT_V1.segments:
        a, b = pose[KINECT_V1.parents[joint]], pose[joint]
        for share in np.linspace(0.0, 1.0, 5):
            points = a + share * (b - a) + BODY.radii[joint] * ball
            samples.append(points[:, 1].min())
    assert lowest == pytest.approx(min(samples), abs=1e-9)


def test_a_tilted_capsule_touches_with_its_lower_end_minus_the_radius() -> None:
    ankle = KINECT_V1.index("AnkleLeft")
    pose = np.full((1, 20, 3), np.nan)
    pose[0, ankle] = [0.3, 0.2, 0.0]
    pose[0, KINECT_V1.parents[ankle]] = [0.0, 0.5, 0.1]
    # The foot's capsule, which starts there too, is thinner.
    assert BODY.radii[ankle] > BODY.radii[KINECT_V1.index("FootLeft")]
    assert lowest_point(pose, BODY)[0] == pytest.approx(0.2 - BODY.radii[ankle])


@pytest.mark.parametrize("lift", [-0.2, 0.0, 0.35])
def test_a_lifted_person_floats_by_the_lift(lift: float) -> None:
    path = standing(5) + np.array([0.0, lift, 0.0])
    np.testing.assert_allclose(lowest_point(path, BODY), lift, atol=1e-12)


def test_a_frame_without_joints_has_no_lowest_point_and_no_warning() -> None:
    path = standing(3)
    path[1] = np.nan
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        low = lowest_point(path, BODY)
    np.testing.assert_array_equal(np.isnan(low), [False, True, False])


# Standing soles


@pytest.mark.parametrize("lift", [-0.03, 0.0, 0.02, 0.4])
def test_standing_soles_float_by_what_the_body_is_lifted(lift: float) -> None:
    path = standing(8) + np.array([0.0, lift, 0.0])
    stands = np.ones((8, 2), dtype=np.bool_)
    assert floating(path, stands, BODY) == pytest.approx(max(lift, 0.0), abs=1e-12)


def test_only_feet_that_stand_and_are_seen_float() -> None:
    path, stands = standing(10), np.zeros((10, 2), dtype=np.bool_)
    path[:, FEET[0], 1] += 0.04
    path[:, FEET[1], 1] += 0.3
    assert np.isnan(floating(path, stands, BODY))
    stands[:5, 0] = True
    assert floating(path, stands, BODY) == pytest.approx(0.04)
    stands[5:, 1] = True
    assert floating(path, stands, BODY) == pytest.approx(0.17)
    path[5:, FEET[1]] = np.nan
    assert floating(path, stands, BODY) == pytest.approx(0.04)


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


@pytest.mark.parametrize("fps", [15.0, 30.0, 120.0])
def test_the_error_of_an_acceleration_is_how_much_it_is_off(fps: float) -> None:
    time = stamps(20, fps)
    truth = polynomial(time, [1, 2, 3], [4, 5, 6], [0.0, -4.9, 0.0])
    found = polynomial(time, [0, 0, 0], [0, 1, 0], [0.3, -4.9, 0.4])
    assert acceleration_error(time, truth, truth) == 0.0
    assert acceleration_error(time, found, truth) == pytest.approx(1.0)
    found[:, 3] = np.nan
    assert acceleration_error(time, found, truth) == pytest.approx(1.0)


def test_the_error_of_accelerations_is_unknown_without_three_frames_or_a_rate() -> None:
    path = standing(9)
    assert np.isnan(acceleration_error(stamps(2), path[:2], path[:2]))
    assert np.isnan(acceleration_error(stamps(9), np.full_like(path, np.nan), path))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert np.isnan(acceleration_error(np.full(9, 7.0), path, path))
        assert np.isnan(skate(stamps(1), path[:1], BODY)).all()


def test_repeated_stamps_do_not_change_the_rate_that_accelerations_go_by() -> None:
    time = np.repeat(stamps(12), 3)
    truth, found = standing(36), standing(36)
    found[18, 5, 1] += 0.01
    expected = 0.01 * 4.0 * 30.0**2 / (34 * 20)
    assert acceleration_error(time, found, truth) == pytest.approx(expected)


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


# Amplitude, distances, all together


def test_amplitude_of_a_sine_is_its_root_mean_square() -> None:
    time, path = stamps(300), standing(300)
    hand = KINECT_V1.index("HandRight")
    path[:, hand, 1] += 0.2 * np.sin(2.0 * np.pi * time)
    path += np.outer(time, [1.0, 0.0, 2.0])[:, None]
    moves = amplitude(path, BODY)
    assert moves[hand] == pytest.approx(0.2 / np.sqrt(2.0))
    assert np.isnan(moves[KINECT_V1.root])
    rest = np.delete(moves, [KINECT_V1.root, hand])
    np.testing.assert_allclose(rest, 0.0, atol=1e-12)


def test_amplitude_skips_missing_frames_and_does_not_know_missing_joints() -> None:
    path, hand = standing(40), KINECT_V1.index("HandRight")
    path[:, hand, 2] += np.tile([0.1, -0.1], 20)
    path[10:20, hand] = np.nan
    path[:, 3] = np.nan
    moves = amplitude(path, BODY)
    assert moves[hand] == pytest.approx(0.1)
    assert np.isnan(moves[3])


def test_distances_are_those_of_numpy_and_nan_where_nothing_was_measured() -> None:
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(2, 6, 20, 3))
    b[2, 4] = np.nan
    away = distances(a, b)
    np.testing.assert_allclose(away, np.linalg.norm(a - b, axis=-1))
    assert np.argwhere(np.isnan(away)).tolist() == [[2, 4]]


def test_measuring_collects_the_figures_with_their_units() -> None:
    time, raw = stamps(60), standing(60)
    hand = KINECT_V1.index("HandLeft")
    raw[:, hand, 1] += 0.2 * np.sin(2.0 * np.pi * time)
    raw += np.outer(time, [0.3, 0.0, 0.0])[:, None]
    clean = raw.copy()
    clean[:, hand, 1] = standing(60)[:, hand, 1] + 0.1 * np.sin(2.0 * np.pi * time)
    clean += [0.0, -0.03, 0.04]
    stands = np.ones((60, 2), dtype=np.bool_)
    quality = measure(time, clean, raw, BODY, stands)
    assert quality.jitter == pytest.approx(jitter(time, clean))
    assert quality.bone_length_cv == pytest.approx(bone_length_cv(clean, BODY))
    assert quality.skate_mm_per_frame == pytest.approx(10.0)
    assert quality.skate_share_over_0p2 == 1.0
    assert quality.skate_max_m_per_s == pytest.approx(0.3)
    assert quality.penetration_mm == pytest.approx(30.0)
    assert quality.penetration_mean_mm == pytest.approx(30.0)
    assert quality.lowest_point_mm == pytest.approx(-30.0)
    assert quality.float_mm == 0.0
    assert quality.amplitude_kept == pytest.approx(0.5)
    off = distances(clean, raw)
    assert quality.moved_cm == pytest.approx(100.0 * off.mean())
    assert np.delete(off, hand, axis=1).mean() == pytest.approx(0.05)
    assert quality.peak_hand_speed == pytest.approx(0.3)
    assert np.isnan(quality.flight_error)
    higher = measure(time, clean + np.array([0.0, 0.08, 0.0]), raw, BODY, stands)
    assert higher.penetration_mm == higher.penetration_mean_mm == 0.0
    assert higher.float_mm == pytest.approx(50.0)
    flying = measure(time, clean + np.array([0.0, 0.5, 0.0]), raw, BODY, ~stands)
    assert np.isnan(flying.float_mm)
    assert flying.flight_error == pytest.approx(
        flight_error(time, clean + np.array([0.0, 0.5, 0.0]), ~stands, BODY)
    )


def test_raw_beside_itself_keeps_all_and_empty_frames_do_not_count() -> None:
    time, raw = stamps(60), standing(60)
    raw[:, :4, 0] += 0.1 * np.sin(7.0 * time)[:, None]
    raw[20:25] = np.nan
    raw[:, 7] = np.nan
    quality = measure(time, raw, raw, BODY, np.ones((60, 2), dtype=np.bool_))
    assert quality.amplitude_kept == pytest.approx(1.0)
    assert quality.moved_cm == 0.0
    assert quality.penetration_mm == pytest.approx(0.0, abs=1e-9)
    figures = asdict(quality)
    assert np.isnan(figures.pop("flight_error"))  # no foot ever left the floor
    assert all(np.isfinite(value) for value in figures.values())


def test_all_names_are_sorted_and_there() -> None:
    assert sorted(metrics.__all__) == list(metrics.__all__)
    for name in metrics.__all__:
        assert hasattr(metrics, name)
