"""Reliability by noise and segment lengths: what people do is trusted, tremor not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from real_data import PAIRS, TAKES, paired, recorded
from scored_takes import average, blind, still_take
from skeletons import every_skeleton

from kinefilter import CleanConfig, clean, read_take
from kinefilter.characters import KINECT_V1, Skeleton, State, Take, Term, standard_body
from kinefilter.characters.rotations import about_y, rotate
from kinefilter.pipeline.lab.accuracy import Accuracy
from kinefilter.pipeline.lab.scorers import (
    DOUBTFUL_ERROR,
    ERROR_PER_NOISE,
    NoiseReliabilityScorer,
)
from kinefilter.pipeline.pairs import read_pairs
from kinefilter.pipeline.reliability import (
    Reference,
    ReliabilityScorer,
    Scores,
    measure_reference,
)
from kinefilter.scenes.library import perform
from kinefilter.scenes.sensor import sample_take

Array = NDArray[np.float64]


JOINTS = len(KINECT_V1)
HAND, WRIST = KINECT_V1.index("HandLeft"), KINECT_V1.index("WristLeft")
RELIABLE = 0.85  # correction moves such joints little
UNRELIABLE = 0.6  # correction moves such joints much


def moved(path: Array, joint: int = HAND, fps: float = 30.0) -> Take:
    """Return a still take with one joint displaced, path (T, 3)."""
    take = still_take(len(path), fps=fps)
    positions = take.positions.copy()
    positions[:, joint] += path
    return replace(take, positions=positions)


def score(take: Take, reference: Reference) -> Scores:
    return NoiseReliabilityScorer(take.skeleton, reference).score(take)


def sway(time: Array, frequency: float, amplitude: float) -> Array:
    """Return a sinusoid along x [m], shape (T, 3)."""
    return np.outer(amplitude * np.sin(2 * np.pi * frequency * time), [1.0, 0.0, 0.0])


def reach(time: Array, start: float, seconds: float, distance: float) -> Array:
    """Return a movement of least jerk along z [m], shape (T, 3) (Flash & Hogan)."""
    s = np.clip((time - start) / seconds, 0.0, 1.0)
    return np.outer(distance * s**3 * (10.0 - 15.0 * s + 6.0 * s * s), [0.0, 0.0, 1.0])


# What people do


@every_skeleton
def test_a_still_tracked_person_scores_one(skeleton: Skeleton) -> None:
    result = score(still_take(12, skeleton), average(skeleton))
    np.testing.assert_allclose(result.reliability, 1.0)
    np.testing.assert_allclose(result.geometry, 1.0)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_cubic_keeps_full_trust_at_any_speed_and_any_stamps(seed: int) -> None:
    rng = np.random.default_rng(seed)
    take = still_take(30)
    time = np.cumsum(rng.uniform(0.01, 0.3, len(take)))
    speed, bend, turn = rng.normal(0.0, [[10.0], [10.0], [3.0]], (3, 3))
    path = time[:, None] * speed + time[:, None] ** 2 * bend + time[:, None] ** 3 * turn
    positions = take.positions.copy()
    positions[:, HAND] += path
    result = score(replace(take, time=time, positions=positions), blind())
    np.testing.assert_allclose(result.reliability, 1.0, atol=1e-6)


def test_a_person_who_walks_through_the_room_keeps_full_trust() -> None:
    take = still_take(60)
    walk = np.outer(take.time, [1.5, 0.0, -4.0])
    walking = replace(take, positions=take.positions + walk[:, None])
    np.testing.assert_allclose(score(walking, average()).reliability, 1.0, atol=1e-9)


@pytest.mark.parametrize(
    ("frequency", "amplitude"), [(0.5, 0.6), (1.0, 0.5), (2.0, 0.3), (3.0, 0.1)]
)
def test_waving_as_people_can_keeps_trust(frequency: float, amplitude: float) -> None:
    path = sway(still_take(90).time, frequency, amplitude)
    assert score(moved(path), blind()).reliability.min() > 0.99


@pytest.mark.parametrize("seconds", [0.15, 0.2, 0.3])
def test_a_punch_out_and_back_keeps_trust(seconds: float) -> None:
    time = still_take(60).time
    path = reach(time, 0.7, seconds, 0.6) - reach(time, 0.8 + seconds, seconds, 0.6)
    assert score(moved(path), blind()).reliability.min() > RELIABLE


def test_frames_that_were_dropped_cost_a_movement_nothing() -> None:
    path = sway(still_take(120).time, 1.0, 0.4)
    take = moved(path)
    kept = np.random.default_rng(0).random(len(take)) > 0.15
    dropped = Take(
        take.time[kept], take.positions[kept], take.state[kept], KINECT_V1, "dropped"
    )
    assert score(dropped, blind()).reliability.min() > 0.98


@pytest.mark.parametrize("fps", [15.0, 60.0])
def test_a_movement_is_trusted_at_other_frame_rates(fps: float) -> None:
    path = sway(np.arange(90) / fps, 1.0, 0.4)
    assert score(moved(path, fps=fps), blind()).reliability.min() > 0.97


@pytest.mark.parametrize("motion", ["punch", "kick", "clap", "wave", "swing"])
def test_fast_motion_that_is_tracked_well_is_doubted_no_more_than_by_shum(
    motion: str,
) -> None:
    performance = perform(motion, standard_body(KINECT_V1), seed=3)
    noise = np.random.default_rng(0).normal(0.0, 0.004, performance.positions.shape)
    state = np.full(noise.shape[:2], State.TRACKED, dtype=np.uint8)
    seen = performance.positions + noise
    take = Take(performance.time, seen, state, KINECT_V1)
    reference = measure_reference(take)
    shum = ReliabilityScorer(KINECT_V1, reference).score(take)
    doubted = score(take, reference).reliability < RELIABLE
    assert doubted.mean() <= (shum.reliability < RELIABLE).mean()
    assert doubted.mean() < 0.05


# What sensors do


def test_white_noise_costs_what_the_constants_say() -> None:
    sigma = 0.02
    noise = np.random.default_rng(0).normal(0.0, sigma, (3000, 3))
    reliability = score(moved(noise), blind()).reliability
    expected = (ERROR_PER_NOISE * sigma / DOUBTFUL_ERROR) ** 2
    # The distance covered by noise, over four frames, counts for the person.
    expected *= 1.0 - 3.0 * 2.0 * (0.1 / 4.0) ** 2
    assert -np.log(reliability[30:, HAND]).mean() == pytest.approx(expected, rel=0.05)
    np.testing.assert_array_equal(np.delete(reliability, HAND, axis=1), 1.0)


@pytest.mark.parametrize(
    ("frequency", "limit"), [(9.0, RELIABLE), (12.0, UNRELIABLE), (15.0, UNRELIABLE)]
)
def test_a_joint_that_vibrates_by_centimeters_loses_trust(
    frequency: float, limit: float
) -> None:
    time = np.arange(60) / 30.0
    path = np.outer(0.05 * np.cos(2 * np.pi * frequency * time), [0.0, 1.0, 0.0])
    result = score(moved(path), blind())
    assert (result.reliability[10:, HAND] < limit).all()
    assert (result.term[10:, HAND] == Term.BEHAVIOR).all()
    np.testing.assert_array_equal(result.geometry, 1.0)


def test_trembling_speaks_against_the_position_of_an_inferred_joint_only() -> None:
    noise = np.random.default_rng(2).normal(0.0, 0.05, (60, 3))
    tracked = moved(noise)
    inferred = replace(tracked, state=np.full_like(tracked.state, State.INFERRED))
    reliability = score(tracked, blind()).reliability
    assert (reliability[30:, HAND] < UNRELIABLE).all()
    np.testing.assert_array_equal(score(tracked, blind()).geometry, 1.0)
    np.testing.assert_array_equal(score(inferred, blind()).geometry, reliability)


def test_a_spike_of_one_frame_is_doubted_in_the_next_and_forgotten_in_a_second() -> (
    None
):
    path = np.zeros((60, 3))
    path[20] = [0.0, 0.0, 0.4]
    reliability = score(moved(path), blind()).reliability[:, HAND]
    np.testing.assert_array_equal(reliability[:20], 1.0)
    assert reliability[20] < 0.95
    assert (reliability[21:30] < UNRELIABLE).all()
    assert (reliability[50:] > RELIABLE).all()


@pytest.mark.parametrize("change", [0.2, -0.2])
def test_a_stretched_or_shrunken_segment_costs_what_the_constants_say(
    change: float,
) -> None:
    take = still_take(8)
    positions = take.positions.copy()
    shift = np.array([change, 0.0, 0.0])  # the left arm lies along x
    positions[:, [WRIST, HAND]] += shift
    result = score(replace(take, positions=positions), average())
    length = standard_body(KINECT_V1).lengths[WRIST]
    error = abs(length + change) - length
    expected = np.ones(JOINTS)
    # Each end touches one more segment, which is right: half of the square is left.
    both = [KINECT_V1.parents[WRIST], WRIST]
    expected[both] = np.exp(-0.5 * (error / DOUBTFUL_ERROR) ** 2)
    np.testing.assert_allclose(result.reliability, np.tile(expected, (8, 1)))
    np.testing.assert_allclose(result.geometry, result.reliability)
    np.testing.assert_array_equal(result.term[:, WRIST], Term.KINEMATICS)


@pytest.mark.parametrize("state", [State.INFERRED, State.NOT_TRACKED])
def test_what_is_not_tracked_is_zero_and_comes_back_within_six_frames(
    state: State,
) -> None:
    take = still_take(40)
    states = take.state.copy()
    states[10:20, HAND] = state
    result = score(replace(take, state=states), average())
    reliability = result.reliability[:, HAND]
    np.testing.assert_array_equal(reliability[:10], 1.0)
    np.testing.assert_array_equal(reliability[10:20], 0.0)
    np.testing.assert_allclose(reliability[20:], 1.0 - np.exp(-np.arange(1, 21) / 3.0))
    assert reliability[25] > RELIABLE
    assert (result.term[10:20, HAND] == Term.TRACKING_STATE).all()
    np.testing.assert_array_equal(result.geometry, 1.0)


def test_a_joint_that_was_away_comes_back_without_doubt() -> None:
    take = moved(sway(still_take(90).time, 1.0, 0.3))
    positions, states = take.positions.copy(), take.state.copy()
    positions[30:50, HAND], states[30:50, HAND] = np.nan, State.NOT_TRACKED
    reliability = score(
        replace(take, positions=positions, state=states), blind()
    ).reliability
    np.testing.assert_array_equal(reliability[30:50, HAND], 0.0)
    assert (reliability[60:, HAND] > 0.9).all()
    np.testing.assert_array_equal(np.delete(reliability, HAND, axis=1), 1.0)


# Interface


def test_position_and_heading_in_the_room_do_not_matter() -> None:
    take = sample_take()
    turned = rotate(about_y(2.0), take.positions) + np.array([3.0, -1.0, 5.0])
    there = replace(take, positions=turned)
    reference = measure_reference(take)
    here, away = score(take, reference), score(there, reference)
    np.testing.assert_allclose(here.reliability, away.reliability, atol=1e-9)
    np.testing.assert_allclose(here.geometry, away.geometry, atol=1e-9)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_rates_are_shares_and_never_above_the_geometry(seed: int) -> None:
    rng = np.random.default_rng(seed)
    take = still_take(20)
    scale = rng.choice([0.01, 1.0, 1e6], take.state.shape)[..., None]
    positions = take.positions + scale * rng.normal(size=take.positions.shape)
    state = rng.integers(0, 3, take.state.shape).astype(np.uint8)
    positions[state == State.NOT_TRACKED] = np.nan
    result = score(replace(take, positions=positions, state=state), average())
    for values in (result.reliability, result.geometry):
        assert ((values >= 0.0) & (values <= 1.0)).all()
    assert (result.reliability <= result.geometry).all()
    np.testing.assert_array_equal(result.reliability[state != State.TRACKED], 0.0)
    assert np.isin(result.term, [0, 1, 2]).all()


def test_steps_equal_the_score_bit_for_bit_and_start_forgets() -> None:
    take = sample_take()
    reference = measure_reference(take)
    scorer = NoiseReliabilityScorer(take.skeleton, reference)
    whole, buffer = scorer.score(take), np.empty_like(take.positions[0])
    for _ in range(2):
        scorer.start()
        for k in range(len(take)):
            buffer[:] = take.positions[k]
            reliability, term, geometry = scorer.step(
                buffer, take.state[k], float(take.time[k])
            )
            np.testing.assert_array_equal(reliability, whole.reliability[k])
            np.testing.assert_array_equal(term, whole.term[k])
            np.testing.assert_array_equal(geometry, whole.geometry[k])


def test_without_stamps_there_are_thirty_frames_a_second() -> None:
    noise = np.random.default_rng(1).normal(0.0, 0.01, (30, 3))
    take, scorer = moved(noise), NoiseReliabilityScorer(KINECT_V1, average())
    whole = scorer.score(take)
    scorer.start()
    for k in range(len(take)):
        reliability, _, geometry = scorer.step(take.positions[k], take.state[k])
        np.testing.assert_allclose(reliability, whole.reliability[k], rtol=1e-9)
        np.testing.assert_allclose(geometry, whole.geometry[k], rtol=1e-9)


def test_a_take_is_cleaned_with_it() -> None:
    take = sample_take()
    config = CleanConfig(method="none", physics=False, scoring="noise")
    expected = score(take, measure_reference(take)).reliability
    np.testing.assert_array_equal(clean(take, config).clip.reliability, expected)


# Recordings


def areas(wrong: list[NDArray[np.bool_]], rates: list[Array]) -> float:
    from sklearn.metrics import roc_auc_score

    return float(roc_auc_score(np.concatenate(wrong), 1.0 - np.concatenate(rates)))


@paired
def test_joints_that_marker_mocap_refutes_are_found() -> None:
    accuracy = Accuracy(KINECT_V1)
    far, offset = [], []
    rates: dict[type[ReliabilityScorer], list[Array]] = {
        NoiseReliabilityScorer: [],
        ReliabilityScorer: [],
    }
    for file in sorted(PAIRS.glob("s*.npz")):
        for pair in read_pairs(file)[::32]:
            varying = accuracy.varying(pair.take.positions, pair.truth)
            distances = accuracy.distances(pair.take.positions, pair.truth)
            seen = ~np.isnan(varying)
            far.append(varying[seen] > 0.07)
            offset.append(distances[seen] > 0.10)
            reference = measure_reference(pair.take)
            for scorer, found in rates.items():
                reliability = scorer(KINECT_V1, reference).score(pair.take).reliability
                found.append(reliability[:, accuracy.limbs][seen])
    noise, shum = rates[NoiseReliabilityScorer], rates[ReliabilityScorer]
    assert areas(far, noise) > 0.80
    assert areas(far, noise) > areas(far, shum) + 0.05
    assert areas(offset, noise) > areas(offset, shum)


@recorded
def test_recorded_punches_and_kicks_are_doubted_less_than_by_shum() -> None:
    doubts = []
    for path in sorted((TAKES / "precog16").glob("*_3.csv.gz")):
        take = read_take(path)
        reference = measure_reference(take)
        for scorer in (NoiseReliabilityScorer, ReliabilityScorer):
            reliability = scorer(take.skeleton, reference).score(take).reliability
            doubts.append((reliability < RELIABLE).mean())
    noise, shum = np.mean(np.reshape(doubts, (-1, 2)), axis=0)
    assert noise < shum
