"""Skating feet, the lowest point and floating soles, where they are known."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from known_motions import BODY, FEET, polynomial, stamps, standing

from kinefilter.characters import KINECT_V1, positions_from_rotations
from kinefilter.characters.rotations import normalize
from kinefilter.pipeline.metrics import (
    SKATE_HEIGHT,
    SKATE_SPEED,
    floating,
    lowest_point,
    skate,
)

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
