"""Constant-length Kalman filter: its core, its bones, what it predicts."""

from __future__ import annotations

import numpy as np
import pytest
from known_motions import stamps
from numpy.typing import NDArray
from skeletons import every_skeleton

from kinefilter.characters import KINECT_V1, Skeleton, standard_body
from kinefilter.characters.rotations import unit
from kinefilter.pipeline.correct import Correction, Hold, Observation
from kinefilter.pipeline.lab.methods.filters import (
    ACCELERATION_DENSITY,
    FIRST_SPEED,
    LONGEST_PREDICTION,
    LOST_NOISE,
    SENSOR_NOISE,
    ConstantLengthKalman,
    ConstantVelocity,
    measurement_variance,
)
from kinefilter.pipeline.reliability import segment_lengths

Array = NDArray[np.float64]

FPS, JOINTS = 30.0, len(KINECT_V1)
SHOULDER, ELBOW, WRIST, HAND = (
    KINECT_V1.index(f"{part}Left") for part in ("Shoulder", "Elbow", "Wrist", "Hand")
)
BODY = standard_body(KINECT_V1)
REST = BODY.rest_positions - BODY.rest_positions[KINECT_V1.root]


def swinging(count: int, pace: float = 1.5) -> Array:
    """Return rest postures whose left arm turns forward, pace in rad/s, (T, J, 3)."""
    positions = np.tile(REST, (count, 1, 1))
    angle = pace * stamps(count)[:, None, None]
    arm = positions[:, [ELBOW, WRIST, HAND]] - REST[SHOULDER]
    ahead = np.array([0.0, 0.0, 1.0]) * np.linalg.norm(arm, axis=2, keepdims=True)
    positions[:, [ELBOW, WRIST, HAND]] = (
        REST[SHOULDER] + np.cos(angle) * arm + np.sin(angle) * ahead
    )
    return positions


def observed(positions: Array, reliability: Array, time: float) -> Observation:
    return Observation(positions, reliability, reliability, time)


def run(
    corrector: ConstantLengthKalman | Hold,
    positions: Array,
    *,
    reliability: Array | None = None,
    time: Array | None = None,
) -> list[Correction]:
    time = stamps(len(positions)) if time is None else time
    reliability = np.ones(positions.shape[:2]) if reliability is None else reliability
    corrector.start()
    return [
        corrector.step(observed(p, r, float(t)))
        for p, r, t in zip(positions, reliability, time, strict=True)
    ]


def postures(corrections: list[Correction]) -> Array:
    return np.array([c.positions for c in corrections])


def assert_lengths_exact(positions: Array, skeleton: Skeleton = KINECT_V1) -> None:
    lengths = segment_lengths(positions, skeleton)[..., skeleton.segments]
    expected = standard_body(skeleton).lengths[skeleton.segments]
    np.testing.assert_allclose(
        lengths, np.broadcast_to(expected, lengths.shape), atol=1e-12
    )
    assert (positions[..., skeleton.root, :] == 0.0).all()


# The filter of a point


def dense_kalman(time: Array, measured: Array, variance: Array) -> Array:
    """Track a point in space with six states, as textbooks write it, (T, 6)."""
    see = np.hstack([np.eye(3), np.zeros((3, 3))])
    state = np.concatenate([measured[0], np.zeros(3)])
    spread = np.diag([variance[0]] * 3 + [FIRST_SPEED**2] * 3)
    states = [state]
    for k in range(1, len(time)):
        step = time[k] - time[k - 1]
        move = np.kron([[1.0, step], [0.0, 1.0]], np.eye(3))
        wander = [[step**3 / 3.0, step**2 / 2.0], [step**2 / 2.0, step]]
        state = move @ state
        spread = move @ spread @ move.T
        spread = spread + ACCELERATION_DENSITY * np.kron(wander, np.eye(3))
        if np.isfinite(measured[k]).all():
            total = see @ spread @ see.T + variance[k] * np.eye(3)
            gain = spread @ see.T @ np.linalg.inv(total)
            state = state + gain @ (measured[k] - see @ state)
            rest = np.eye(6) - gain @ see
            # Joseph's form
            spread = rest @ spread @ rest.T + variance[k] * gain @ gain.T
        states.append(state)
    return np.array(states)


def test_a_point_is_tracked_as_the_textbooks_dense_filter_does() -> None:
    rng = np.random.default_rng(0)
    count, points = 120, 4
    time = np.cumsum(rng.uniform(0.01, 0.08, count))
    measured = np.cumsum(rng.normal(0.0, 0.02, (count, points, 3)), axis=0)
    measured[30:50, 1], measured[60, 2] = np.nan, np.nan
    variance = measurement_variance(rng.random((count, points)))
    tracker = ConstantVelocity(points)
    tracker.begin(np.ones(points, dtype=bool), measured[0], variance[0])
    states = [np.hstack([tracker.position, tracker.velocity])]
    for k in range(1, count):
        tracker.predict(float(time[k] - time[k - 1]))
        tracker.update(measured[k], variance[k])
        states.append(np.hstack([tracker.position, tracker.velocity]))
    for j in range(points):
        expected = dense_kalman(time, measured[:, j], variance[:, j])
        np.testing.assert_allclose(np.array(states)[:, j], expected, atol=1e-9)


def test_constant_velocity_is_tracked_without_lag_and_predicted_exactly() -> None:
    velocity = np.array([[1.0, -2.0, 0.5]])
    tracker, variance = ConstantVelocity(1), np.array([SENSOR_NOISE**2])
    tracker.begin(np.array([True]), np.zeros((1, 3)), variance)
    for k in range(1, 100):
        tracker.predict(1.0 / FPS)
        tracker.update(velocity * k / FPS, variance)
    np.testing.assert_allclose(tracker.position, velocity * 99.0 / FPS, atol=1e-8)
    np.testing.assert_allclose(tracker.velocity, velocity, atol=1e-7)
    tracker.predict(0.4)
    expected = velocity * (99.0 / FPS + 0.4)
    np.testing.assert_allclose(tracker.position, expected, atol=1e-7)


def test_a_constraint_leaves_the_most_likely_velocity_given_the_position() -> None:
    tracker = ConstantVelocity(2)
    start, variance = np.zeros((2, 3)), np.full(2, 1e-3)
    tracker.begin(np.ones(2, dtype=bool), start, variance)
    tracker.predict(0.1)
    before = tracker.covariance.copy()
    goal = np.tile([0.1, -0.2, 0.3], (2, 1))
    tracker.constrain(np.array([True, False]), goal)
    np.testing.assert_array_equal(tracker.position, [goal[0], [0.0, 0.0, 0.0]])
    # Minimize the Mahalanobis distance over the velocity, the position being fixed.
    precision = np.linalg.inv(before[0])
    expected = -precision[0, 1] / precision[1, 1] * goal[0]
    np.testing.assert_allclose(tracker.velocity[0], expected, rtol=1e-9)
    np.testing.assert_array_equal(tracker.velocity[1], 0.0)
    np.testing.assert_array_equal(tracker.covariance, before)


def test_measurement_noise_falls_with_reliability_by_equal_factors() -> None:
    deviation = np.sqrt(measurement_variance(np.array([0.0, 0.25, 0.5, 0.75, 1.0])))
    assert deviation[0] == pytest.approx(LOST_NOISE)
    assert deviation[-1] == pytest.approx(SENSOR_NOISE)
    ratios = deviation[1:] / deviation[:-1]
    np.testing.assert_allclose(ratios, ratios[0])
    assert ratios[0] < 1.0


# The posture


@every_skeleton
def test_bone_lengths_are_the_standard_bodys_in_every_frame(skeleton: Skeleton) -> None:
    body, rng = standard_body(skeleton), np.random.default_rng(1)
    rest = body.rest_positions - body.rest_positions[skeleton.root]
    for deviation in (0.02, 0.2):
        positions = rest + rng.normal(0.0, deviation, (40, len(skeleton), 3))
        positions[:, skeleton.root] = 0.0
        positions[rng.random(positions.shape[:2]) < 0.2] = np.nan
        reliability = rng.random(positions.shape[:2])
        result = run(ConstantLengthKalman(skeleton), positions, reliability=reliability)
        assert_lengths_exact(postures(result), skeleton)


def test_a_skeleton_at_a_point_and_one_with_nothing_get_bones() -> None:
    for value in (0.0, np.nan):
        nothing = np.full((3, JOINTS, 3), value)
        result = postures(run(ConstantLengthKalman(KINECT_V1), nothing))
        assert_lengths_exact(result)
    np.testing.assert_allclose(result, np.tile(REST, (3, 1, 1)), atol=1e-9)


def test_a_person_at_rest_stays() -> None:
    result = run(ConstantLengthKalman(KINECT_V1), np.tile(REST, (40, 1, 1)))
    np.testing.assert_allclose(postures(result), np.tile(REST, (40, 1, 1)), atol=1e-9)


def test_an_arm_that_swings_trails_little_and_noise_falls() -> None:
    truth = swinging(90)
    clean = postures(run(ConstantLengthKalman(KINECT_V1), truth))
    # The hand is at 0.9 m/s, 3 cm a frame.
    assert np.linalg.norm(clean - truth, axis=2)[15:].max() < 0.01
    noise = np.random.default_rng(2).normal(0.0, 0.01, truth.shape)
    noise[:, KINECT_V1.root] = 0.0
    noisy = postures(run(ConstantLengthKalman(KINECT_V1), truth + noise))
    before = np.linalg.norm(noise[15:], axis=2).mean()
    assert np.linalg.norm(noisy - truth, axis=2)[15:].mean() < 0.75 * before


def test_a_missing_stretch_is_predicted_better_than_it_is_held() -> None:
    truth = swinging(40)
    seen = truth.copy()
    gap = slice(25, 33)
    seen[gap, ELBOW : HAND + 1] = np.nan
    predicted = run(ConstantLengthKalman(KINECT_V1), seen)
    held = postures(run(Hold(KINECT_V1), seen))

    def worst(positions: Array) -> float:
        return float(np.linalg.norm(positions - truth, axis=2)[gap, WRIST].max())

    assert worst(held) > 0.15
    assert worst(postures(predicted)) < 0.3 * worst(held)
    assert_lengths_exact(postures(predicted))
    for k, correction in enumerate(predicted):
        missing = np.isnan(seen[k, :, 0])
        np.testing.assert_array_equal(
            correction.confidence, np.where(missing, 0.0, 1.0)
        )
        assert np.isnan(correction.coverage)


def test_what_is_missing_longer_comes_to_rest_and_begins_anew() -> None:
    # A flat hand on a turning arm, on a body that stays.
    truth = swinging(80)
    seen = truth.copy()
    seen[20:60, HAND] = np.nan
    result = postures(run(ConstantLengthKalman(KINECT_V1), seen))
    bone = result[:, HAND] - result[:, WRIST]
    longest = int(LONGEST_PREDICTION * FPS)
    hung = bone[20 + longest + 2 : 60]
    assert len(hung) > 20
    np.testing.assert_allclose(hung, np.tile(hung[0], (len(hung), 1)), atol=0.01)
    assert np.linalg.norm(result[60, HAND] - truth[60, HAND]) < 0.02


def test_what_was_never_seen_goes_on_as_at_rest_and_begins_where_it_appears() -> None:
    seen = swinging(30)
    length = np.linalg.norm(REST[HAND] - REST[WRIST])
    seen[:, HAND] = seen[:, WRIST] + length * unit(seen[:, WRIST] - seen[:, ELBOW])
    truth = seen[:, HAND].copy()
    seen[:20, HAND] = np.nan
    result = postures(run(ConstantLengthKalman(KINECT_V1), seen))
    np.testing.assert_allclose(result[:20, HAND], truth[:20], atol=0.01)
    np.testing.assert_allclose(result[20, HAND], truth[20], atol=0.01)


def test_an_unreliable_outlier_moves_a_joint_far_less_than_a_reliable_one() -> None:
    positions = np.tile(REST, (40, 1, 1))
    positions[30:33, WRIST] += [0.0, 0.0, 0.2]
    reliability = np.ones(positions.shape[:2])
    trusting = postures(
        run(ConstantLengthKalman(KINECT_V1), positions, reliability=reliability)
    )
    reliability[30:33, WRIST] = 0.0
    doubting = postures(
        run(ConstantLengthKalman(KINECT_V1), positions, reliability=reliability)
    )
    away = np.linalg.norm([trusting[32] - REST, doubting[32] - REST], axis=2)
    assert away[0, WRIST] > 0.05
    assert away[1, WRIST] < 0.01


def test_the_less_certain_joint_gives_way_to_bone_lengths() -> None:
    positions = np.tile(REST, (30, 1, 1))
    positions[:, [WRIST, HAND]] += 0.4 * (REST[WRIST] - REST[ELBOW])

    def elbow_moved(rate_of_wrist: float) -> float:
        reliability = np.ones(positions.shape[:2])
        reliability[:, [WRIST, HAND]] = rate_of_wrist
        result = postures(
            run(ConstantLengthKalman(KINECT_V1), positions, reliability=reliability)
        )
        return float(np.linalg.norm(result[-1, ELBOW] - REST[ELBOW]))

    assert elbow_moved(1.0) > 0.002
    assert elbow_moved(0.2) < 0.2 * elbow_moved(1.0)


def test_a_trunk_of_the_wrong_length_does_not_move_the_legs() -> None:
    positions = np.tile(REST, (30, 1, 1))
    legs = [
        KINECT_V1.index(part + side)
        for part in ("Hip", "Knee", "Ankle", "Foot")
        for side in ("Left", "Right")
    ]
    upper = np.setdiff1d(np.arange(JOINTS), [KINECT_V1.root, *legs])
    positions[:, upper] += [0.0, 0.05, 0.0]
    result = postures(run(ConstantLengthKalman(KINECT_V1), positions))
    np.testing.assert_allclose(result[-1, legs], REST[legs], atol=1e-4)


def test_only_differences_of_the_stamps_matter_and_start_forgets() -> None:
    positions = swinging(30)
    positions[:5, HAND] = np.nan
    corrector = ConstantLengthKalman(KINECT_V1)
    first = postures(run(corrector, positions))
    np.testing.assert_array_equal(postures(run(corrector, positions)), first)
    later = postures(run(corrector, positions, time=stamps(30) + 64.0))
    np.testing.assert_allclose(later, first, atol=1e-9)
    slow = postures(run(corrector, positions, time=4.0 * stamps(30)))
    assert np.abs(slow - first).max() > 1e-3
    repeated = postures(run(corrector, positions, time=np.zeros(30)))
    assert_lengths_exact(repeated)
