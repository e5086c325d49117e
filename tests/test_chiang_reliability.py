"""Chiang's reliability terms and their score (section 4.2, eq. 6-12), by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scored_takes import average, blind, still_take
from skeletons import every_skeleton

from kinefilter.characters import KINECT_V1, Skeleton, State, Take, Term, standard_body
from kinefilter.pipeline.lab.scorers import ChiangReliabilityScorer
from kinefilter.pipeline.reliability import (
    Reference,
    ReliabilityScorer,
    Scores,
    measure_reference,
)
from kinefilter.scenes.sensor import sample_take

Array = NDArray[np.float64]

JOINTS = len(KINECT_V1)
HAND, WRIST = KINECT_V1.index("HandLeft"), KINECT_V1.index("WristLeft")
LIMIT = 0.03  # m, the paper's T


def moved(path: Array, joint: int = HAND) -> Take:
    """Return a still take with a joint's x displaced, path (T,)."""
    take = still_take(len(path))
    positions = take.positions.copy()
    positions[:, joint, 0] += path
    return replace(take, positions=positions)


def with_state(take: Take, frames: slice, state: State) -> Take:
    states = take.state.copy()
    states[frames, HAND] = state
    return replace(take, state=states)


def score(take: Take, reference: Reference) -> Scores:
    return ChiangReliabilityScorer(take.skeleton, reference).score(take)


def unwound(reliability: Array) -> Array:
    """Return each frame's own score, taking eq. 12 apart."""
    scores = [float(reliability[0])]
    for value in reliability[1:]:
        scores.append((float(value) - 0.3 * scores[-1]) / 0.7)
    return np.array(scores)


@every_skeleton
def test_a_still_tracked_person_scores_one(skeleton: Skeleton) -> None:
    result = score(still_take(8, skeleton), average(skeleton))
    np.testing.assert_allclose(result.reliability, 1.0)
    np.testing.assert_allclose(result.geometry, 1.0)


@pytest.mark.parametrize(
    ("share", "expected"),
    [(0.9, 1.0), (1.01, 0.96), (1.1, 0.6), (1.2, 0.2), (1.25, 0.0), (5.0, 0.0)],
)
def test_a_jump_that_stays_loses_trust_as_the_corrected_equation_says(
    share: float, expected: float
) -> None:
    path = np.zeros(10)
    path[5:] = share * LIMIT
    result = score(moved(path), blind())
    own = np.ones(10)
    own[5] = expected
    np.testing.assert_allclose(unwound(result.reliability[:, HAND]), own, atol=1e-9)
    np.testing.assert_allclose(result.geometry, result.reliability)
    if expected < 1.0:
        assert result.term[5, HAND] == Term.BEHAVIOR
    np.testing.assert_array_equal(np.delete(result.reliability, HAND, axis=1), 1.0)


def test_a_spike_of_one_frame_is_refused_and_its_return_trusted() -> None:
    path = np.zeros(10)
    path[5] = 0.2
    own = unwound(score(moved(path), blind()).reliability[:, HAND])
    expected = np.ones(10)
    # Frame 5 is far from 3 and 4; frame 6 far from 5, but where 4 was; 7 far from 5
    # only, which is two frames ago.
    expected[5] = 0.0
    np.testing.assert_allclose(own, expected, atol=1e-9)


def test_slow_movement_is_trusted_although_two_frames_exceed_the_limit() -> None:
    path = 0.9 * LIMIT * np.arange(12.0)
    np.testing.assert_array_equal(score(moved(path), blind()).reliability, 1.0)


def test_the_first_two_frames_and_gaps_make_no_displacement() -> None:
    path = np.array([0.0, 0.5, 1.0, np.nan, 2.0, 3.0, 4.0])
    take = moved(path)
    positions = take.positions.copy()
    positions[3, HAND] = np.nan
    own = score(replace(take, positions=positions), blind()).geometry[:, HAND]
    scores = unwound(own)
    np.testing.assert_allclose(scores, [1.0, 1.0, 0.0, 1.0, 1.0, 1.0, 0.0], atol=1e-9)


@pytest.mark.parametrize("factor", [1.2, 0.8])
def test_a_segment_off_by_a_fifth_lowers_its_joints_by_the_mean_over_their_segments(
    factor: float,
) -> None:
    take = still_take(6)
    positions = take.positions.copy()
    stretch = (factor - 1.0) * standard_body(KINECT_V1).rest_offsets[WRIST]
    positions[:, [WRIST, HAND]] += stretch
    result = score(replace(take, positions=positions), average())
    expected = np.ones(JOINTS)
    expected[[KINECT_V1.parents[WRIST], WRIST]] = 0.9
    np.testing.assert_allclose(result.reliability, np.tile(expected, (6, 1)))
    np.testing.assert_array_equal(result.term[:, WRIST], Term.KINEMATICS)


def test_an_untracked_joint_scores_zero_and_counts_for_a_frame_more() -> None:
    take = with_state(still_take(12), slice(4, 7), State.NOT_TRACKED)
    result = score(take, average())
    expected = [1, 1, 1, 1, 0.3, 0, 0, 0.7, 1, 1, 1, 1]
    np.testing.assert_allclose(result.reliability[:, HAND], expected)


def test_a_take_that_begins_untracked_begins_at_zero() -> None:
    take = with_state(still_take(3), slice(0, 1), State.NOT_TRACKED)
    reliability = score(take, average()).reliability[:, HAND]
    np.testing.assert_allclose(reliability, [0.0, 0.7, 1.0])


def test_an_inferred_joint_is_worth_its_geometry() -> None:
    take = with_state(still_take(12), slice(4, 8), State.INFERRED)
    result = score(take, average())
    np.testing.assert_allclose(result.reliability, 1.0)
    assert (result.term != Term.TRACKING_STATE).all()
    shum = ReliabilityScorer(KINECT_V1, average()).score(take)
    assert (shum.reliability[4:8, HAND] < 0.8).all()
    path = np.zeros(12)
    path[5:] = 0.2
    tracked = moved(path)
    inferred = with_state(tracked, slice(None), State.INFERRED)
    np.testing.assert_array_equal(
        score(inferred, blind()).reliability, score(tracked, blind()).reliability
    )


def test_the_smallest_term_decides() -> None:
    path = np.zeros(8)
    path[5:] = 1.1 * LIMIT  # 0.6 by eq. 10
    take = moved(path)
    result = score(take, average())
    length = np.linalg.norm(take.positions[5, HAND] - take.positions[5, WRIST])
    reference = standard_body(KINECT_V1).lengths[HAND]
    kinematics = 1.0 - abs(length - reference) / reference
    assert 0.0 < kinematics < 0.7
    expected = min(0.6, kinematics)
    assert unwound(result.reliability[:, HAND])[5] == pytest.approx(expected)
    decided = Term.KINEMATICS if kinematics < 0.6 else Term.BEHAVIOR
    assert result.term[5, HAND] == decided


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_scores_are_shares_and_geometry_is_never_below_the_rate(seed: int) -> None:
    rng = np.random.default_rng(seed)
    take = still_take(15)
    positions = take.positions + rng.normal(0.0, 0.05, take.positions.shape)
    state = rng.integers(0, 3, take.state.shape).astype(np.uint8)
    positions[state == State.NOT_TRACKED] = np.nan
    result = score(replace(take, positions=positions, state=state), average())
    for values in (result.reliability, result.geometry):
        assert ((values >= 0.0) & (values <= 1.0)).all()
    assert (result.geometry >= result.reliability).all()


def test_stepping_equals_scoring_bit_for_bit_and_start_forgets() -> None:
    take = sample_take()
    reference = measure_reference(take)
    scorer = ChiangReliabilityScorer(take.skeleton, reference)
    whole, buffer = scorer.score(take), np.empty_like(take.positions[0])
    for _ in range(2):
        scorer.start()
        for k in range(len(take)):
            buffer[:] = take.positions[k]
            reliability, term, geometry = scorer.step(buffer, take.state[k])
            np.testing.assert_array_equal(reliability, whole.reliability[k])
            np.testing.assert_array_equal(term, whole.term[k])
            np.testing.assert_array_equal(geometry, whole.geometry[k])
    assert 0.05 < (whole.reliability < 0.7).mean() < 0.95
