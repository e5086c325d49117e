"""The three reliability terms and their reliability (Shum 2013, eq. 1-8), by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scored_takes import (
    HAND,
    Array,
    average,
    blind,
    moved,
    score,
    still_take,
    with_state,
)
from skeletons import every_skeleton

from kinefilter import Cleaner
from kinefilter.characters import KINECT_V1, Skeleton, State, Term, standard_body

JOINTS = len(KINECT_V1)
# The newest frame weighs most; the oldest of six is at two sigma.
WEIGHTS = np.exp(-0.5 * (np.arange(6) * 2.0 / 5.0) ** 2)
WEIGHTS /= WEIGHTS.sum()


def unwound(reliability: Array) -> Array:
    """Return each frame's own score, by taking the Gaussian average of eq. 8 apart."""
    scores: list[float] = []
    for k, value in enumerate(reliability):
        weights = WEIGHTS[: k + 1] / WEIGHTS[: k + 1].sum()
        past = sum(w * s for w, s in zip(weights[1:], scores[::-1], strict=False))
        scores.append((value - past) / weights[0])
    return np.array(scores)


# Behavior, eq. 1-4


@every_skeleton
def test_a_still_tracked_person_scores_one(skeleton: Skeleton) -> None:
    take = still_take(12, skeleton)
    result = score(take, average(skeleton))
    np.testing.assert_allclose(result.reliability, 1.0)
    np.testing.assert_allclose(result.geometry, 1.0)


def test_a_straight_path_and_a_right_angle_cost_no_trust() -> None:
    frames = 20
    straight = np.outer(np.arange(frames), [0.1, 0.0, 0.0])
    stairs = np.zeros((frames, 3))
    stairs[:, 0] = 0.1 * ((np.arange(frames) + 1) // 2)
    stairs[:, 1] = 0.1 * (np.arange(frames) // 2)
    for path in (straight, stairs):
        result = score(moved(still_take(frames), HAND, path), blind())
        np.testing.assert_allclose(result.reliability, 1.0)


@pytest.mark.parametrize("way", [[1.0, 0.0, 0.0], [0.0, -0.6, 0.8]])
def test_a_zigzag_over_three_centimeters_loses_trust_as_the_equations_say(
    way: list[float],
) -> None:
    frames = 10
    path = np.outer(0.031 * (np.arange(frames) % 2), way)
    result = score(moved(still_take(frames), HAND, path), blind())
    # Means of three angles of 0, 0, 180 then 0, 180, 180 then 180 degrees, between 90
    # and 135 degrees.
    expected = [1.0, 1.0, 1.0, 1.0 - (120.0 - 90.0) / 45.0, *[0.0] * (frames - 4)]
    np.testing.assert_allclose(
        unwound(result.reliability[:, HAND]), expected, atol=1e-12
    )
    # Reliability itself, where its six frames are 1, 1, 1, 1/3, 0, 0 from the oldest.
    by_hand = WEIGHTS[5] + WEIGHTS[4] + WEIGHTS[3] + WEIGHTS[2] / 3.0
    assert result.reliability[5, HAND] == pytest.approx(by_hand)
    assert result.reliability[-1, HAND] == pytest.approx(0.0)
    np.testing.assert_array_equal(result.term[3:, HAND], Term.BEHAVIOR)
    np.testing.assert_allclose(np.delete(result.reliability, HAND, axis=1), 1.0)


def test_a_zigzag_under_three_centimeters_is_a_joint_at_rest() -> None:
    path = np.outer(0.0299 * (np.arange(10) % 2), [1.0, 0.0, 0.0])
    result = score(moved(still_take(10), HAND, path), blind())
    np.testing.assert_allclose(result.reliability, 1.0)


def test_one_long_and_one_short_displacement_make_no_angle() -> None:
    # 10 cm there in one frame, back in 2.5 cm steps.
    cycle = np.array([0.0, 0.1, 0.075, 0.05, 0.025])
    path = np.outer(np.tile(cycle, 4), [0.0, 1.0, 0.0])
    result = score(moved(still_take(20), HAND, path), blind())
    np.testing.assert_allclose(result.reliability, 1.0)


@pytest.mark.parametrize("degrees", [80.0, 90.0, 100.0, 120.0, 134.0, 136.0, 170.0])
def test_a_steady_angle_is_trusted_linearly_between_floor_and_roof(
    degrees: float,
) -> None:
    turns = np.radians(degrees) * np.arange(15)
    steps = 0.05 * np.stack([np.cos(turns), np.sin(turns), np.zeros(15)], axis=1)
    result = score(moved(still_take(15), HAND, np.cumsum(steps, axis=0)), blind())
    expected = 1.0 - np.clip((degrees - 90.0) / 45.0, 0.0, 1.0)
    assert result.reliability[-1, HAND] == pytest.approx(expected, abs=1e-9)


def test_a_gap_makes_no_angle() -> None:
    path = np.outer(0.1 * (np.arange(9) % 2), [1.0, 0.0, 0.0])
    path[2::3] = np.nan
    result = score(moved(still_take(9), HAND, path), blind())
    np.testing.assert_allclose(result.reliability, 1.0)


# Kinematics, eq. 5-6


@pytest.mark.parametrize("factor", [1.2, 0.8])
def test_a_segment_off_by_a_fifth_lowers_its_joints_by_the_mean_over_their_segments(
    factor: float,
) -> None:
    take, body = still_take(8), standard_body(KINECT_V1)
    wrist = KINECT_V1.index("WristLeft")
    positions = take.positions.copy()
    stretch = (factor - 1.0) * body.rest_offsets[wrist]
    positions[:, [wrist, HAND]] += stretch
    result = score(replace(take, positions=positions), average())
    expected = np.ones(JOINTS)
    # Elbow and wrist each end two segments, one of which is wrong.
    expected[[KINECT_V1.parents[wrist], wrist]] = 1.0 - 0.2 / 2.0
    np.testing.assert_allclose(result.reliability, np.tile(expected, (8, 1)))
    assert (result.term[:, wrist] == Term.KINEMATICS).all()


def test_the_joint_of_three_segments_shares_an_error_by_three() -> None:
    take, body = still_take(8), standard_body(KINECT_V1)
    head, girdle = KINECT_V1.index("Head"), KINECT_V1.index("ShoulderCenter")
    result = score(moved(take, head, 0.2 * body.rest_offsets[head]), average())
    # Spine, head and two shoulders meet at the shoulder center: four segments.
    assert result.reliability[-1, girdle] == pytest.approx(1.0 - 0.2 / 4.0)
    assert result.reliability[-1, head] == pytest.approx(1.0 - 0.2)
    foot, ankle = KINECT_V1.index("FootLeft"), KINECT_V1.index("AnkleLeft")
    hip = KINECT_V1.index("HipLeft")
    result = score(moved(take, hip, 1e3 * body.rest_offsets[hip]), average())
    # A segment counts as wrong once at most; the hips' center ends three.
    assert result.reliability[-1, hip] == pytest.approx(0.0)
    assert result.reliability[-1, KINECT_V1.root] == pytest.approx(1.0 - 1.0 / 3.0)
    np.testing.assert_allclose(result.reliability[-1, [foot, ankle]], 1.0)


def test_a_missing_joint_says_nothing_about_its_neighbors() -> None:
    take = moved(still_take(8), HAND, np.full(3, np.nan))
    take = with_state(take, slice(None), HAND, State.NOT_TRACKED)
    result = score(take, average())
    np.testing.assert_allclose(result.reliability[:, HAND], 0.0)
    np.testing.assert_allclose(result.geometry[:, HAND], 0.0)
    np.testing.assert_allclose(np.delete(result.reliability, HAND, axis=1), 1.0)


def test_live_lengths_are_soon_those_that_the_sensor_shows() -> None:
    """A hand of twice the length is this sensor's, and no reason for doubt."""
    body = standard_body(KINECT_V1)
    hand = body.rest_positions[HAND] - body.rest_positions[KINECT_V1.parents[HAND]]
    take = moved(still_take(40), HAND, hand)
    cleaner = Cleaner().until("reliability")
    cleaner.start(body)
    frames = zip(take.positions, take.time.tolist(), take.state, strict=True)
    reliability = np.array([cleaner.step(*frame).reliability for frame in frames])
    np.testing.assert_allclose(reliability[:15, HAND], 0.0, atol=1e-9)
    np.testing.assert_allclose(reliability[25:], 1.0)


def test_a_segment_never_measured_has_no_say() -> None:
    reference = average()
    reference.lengths[HAND] = np.nan
    take = moved(still_take(8), HAND, np.array([0.5, 0.0, 0.0]))
    np.testing.assert_allclose(score(take, reference).reliability, 1.0)
    take = moved(still_take(8), HAND, np.full(3, np.nan))
    np.testing.assert_allclose(
        np.delete(score(take, reference).reliability, HAND, 1), 1.0
    )


# Tracking state and reliability, eq. 7-8


def test_a_joint_that_is_inferred_scores_zero_and_recovers_over_six_frames() -> None:
    bad = slice(10, 20)
    take = with_state(still_take(40), bad, HAND, State.INFERRED)
    result = score(take, average())
    reliability = result.reliability[:, HAND]
    np.testing.assert_allclose(reliability[:10], 1.0)
    np.testing.assert_allclose(
        reliability[9:16], 1.0 - np.cumsum([0, *WEIGHTS]), atol=1e-12
    )
    np.testing.assert_allclose(reliability[15:20], 0.0, atol=1e-12)
    np.testing.assert_allclose(reliability[19:26], np.cumsum([0, *WEIGHTS]), atol=1e-12)
    np.testing.assert_allclose(reliability[25:], 1.0)
    assert (np.diff(reliability[19:26]) > 0).all()
    assert (np.diff(reliability[19:26], n=2) < 0).all()
    assert (result.term[bad, HAND] == Term.TRACKING_STATE).all()
    np.testing.assert_allclose(result.geometry, 1.0)
    np.testing.assert_allclose(np.delete(result.reliability, HAND, axis=1), 1.0)


def test_a_joint_that_is_not_tracked_scores_as_one_that_is_missing() -> None:
    take = with_state(still_take(40), slice(10, 20), HAND, State.NOT_TRACKED)
    assert np.isnan(take.positions[10:20, HAND]).all()
    reliability = score(take, average()).reliability[:, HAND]
    np.testing.assert_allclose(reliability[15:20], 0.0, atol=1e-12)


def test_the_first_frames_are_averages_over_the_frames_there_are() -> None:
    take = with_state(still_take(4), slice(0, 1), HAND, State.INFERRED)
    reliability = score(take, average()).reliability[:, HAND]
    for k in range(4):
        expected = WEIGHTS[:k].sum() / WEIGHTS[: k + 1].sum()
        assert reliability[k] == pytest.approx(expected, abs=1e-12)


def test_the_smallest_term_decides_and_gives_the_score() -> None:
    take, wrist = still_take(10), KINECT_V1.index("WristLeft")
    zigzag = np.outer(0.1 * (np.arange(10) % 2), [0.0, 1.0, 0.0])
    shaking = moved(take, HAND, zigzag)
    result = score(shaking, average())
    assert result.term[-1, HAND] == Term.BEHAVIOR
    assert result.term[-1, wrist] == Term.KINEMATICS
    both = with_state(shaking, slice(None), wrist, State.INFERRED)
    result = score(both, average())
    assert result.term[-1, wrist] == Term.TRACKING_STATE
    assert result.reliability[-1, wrist] == 0.0
    assert result.geometry[-1, wrist] > 0.5
