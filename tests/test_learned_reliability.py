"""Learned reliability: what it goes by, what it learns, and whom it finds."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from real_data import PAIRS, paired
from scored_takes import average
from sklearn.metrics import roc_auc_score

from kinefilter import CleanConfig, clean
from kinefilter.characters import (
    KINECT_V1,
    KINECT_V2,
    SKELETONS,
    InputError,
    Skeleton,
    State,
    Take,
    Term,
    standard_body,
)
from kinefilter.characters.rotations import about_y, rotate
from kinefilter.pipeline.lab.evaluate import reliability_auc
from kinefilter.pipeline.lab.scorers import (
    TERMS,
    ClueWeights,
    LearnedReliabilityScorer,
    learned_weights,
)
from kinefilter.pipeline.lab.simulation import pairs_with_props, simulate
from kinefilter.pipeline.pairs import PairedTake, read_pairs
from kinefilter.pipeline.reliability import measure_reference
from kinefilter.scenes.library import perform
from kinefilter.scenes.sensor import sample_take

Array = NDArray[np.float64]

WRIST = KINECT_V1.index("WristLeft")


@cache
def performed(motion: str, skeleton: Skeleton = KINECT_V1, seed: int = 0) -> Take:
    act = perform(motion, standard_body(skeleton), seed=seed)
    state = np.full(act.positions.shape[:2], int(State.TRACKED), dtype=np.uint8)
    return Take(act.time, act.positions, state, skeleton)


def scorer_of(
    take: Take, weights: ClueWeights | None = None
) -> LearnedReliabilityScorer:
    return LearnedReliabilityScorer(take.skeleton, average(take.skeleton), weights)


# What it goes by


def test_position_and_heading_in_the_room_do_not_matter() -> None:
    take = sample_take()
    turned = rotate(about_y(2.0), take.positions) + np.array([3.0, -1.0, 5.0])
    here = scorer_of(take).score(take)
    away = scorer_of(take).score(replace(take, positions=turned))
    np.testing.assert_allclose(here.reliability, away.reliability, atol=1e-9)
    np.testing.assert_array_equal(here.term, away.term)


@pytest.mark.parametrize("skeleton", SKELETONS.values(), ids=SKELETONS)
def test_left_and_right_are_judged_alike(skeleton: Skeleton) -> None:
    take = performed("tai_chi", skeleton)
    mirrored = take.positions[:, skeleton.mirror] * [-1.0, 1.0, 1.0]
    here = scorer_of(take).score(take).reliability
    there = scorer_of(take).score(replace(take, positions=mirrored)).reliability
    sided = np.flatnonzero(skeleton.mirror != np.arange(len(skeleton)))
    np.testing.assert_allclose(
        here[:, sided], there[:, skeleton.mirror][:, sided], atol=1e-9
    )


def test_large_and_small_people_in_the_same_posture_are_judged_alike() -> None:
    small, large = (
        LearnedReliabilityScorer(
            KINECT_V1,
            replace(average(), lengths=factor * average().lengths),
        ).score(replace(take, positions=factor * take.positions))
        for factor in (0.9, 1.1)
        for take in [replace(performed("wave"), time=1e3 * performed("wave").time)]
    )
    # So slow that nobody moves: only the posture counts.
    np.testing.assert_allclose(small.reliability, large.reliability, atol=0.02)


@pytest.mark.parametrize("skeleton", SKELETONS.values(), ids=SKELETONS)
def test_what_trembles_or_is_inferred_is_doubted_and_told_so(
    skeleton: Skeleton,
) -> None:
    take = performed("stand_idle", skeleton)
    wrist = skeleton.index("WristLeft")
    calm = scorer_of(take).score(take).reliability[20:, wrist]
    positions, state = take.positions.copy(), take.state.copy()
    noise = np.random.default_rng(0).normal(0.0, 0.04, (len(take), 3))
    positions[:, wrist] += noise
    shaken = scorer_of(take).score(replace(take, positions=positions))
    assert 1.0 - shaken.reliability[20:, wrist].mean() > 10.0 * (1.0 - calm.mean())
    told = shaken.term[20:, wrist]
    assert np.isin(told, [Term.BEHAVIOR, Term.KINEMATICS]).mean() > 0.75
    state[:, wrist] = State.INFERRED
    guessed = scorer_of(take).score(replace(take, state=state))
    assert (1.0 - guessed.reliability[20:, wrist] > 10.0 * (1.0 - calm)).all()
    assert (guessed.term[20:, wrist] == Term.TRACKING_STATE).all()
    np.testing.assert_allclose(guessed.geometry[20:, wrist], calm)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_rates_are_probabilities_and_0_without_a_position(seed: int) -> None:
    rng = np.random.default_rng(seed)
    take = performed("talk")
    take = Take(take.time[:20], take.positions[:20], take.state[:20], KINECT_V1)
    scale = rng.choice([0.01, 1.0, 1e6], take.state.shape)[..., None]
    positions = take.positions + scale * rng.normal(size=take.positions.shape)
    state = rng.integers(0, 3, take.state.shape).astype(np.uint8)
    missing = state == State.NOT_TRACKED
    positions[missing] = np.nan
    result = scorer_of(take).score(replace(take, positions=positions, state=state))
    for values in (result.reliability, result.geometry):
        assert ((values >= 0.0) & (values <= 1.0)).all()
    np.testing.assert_array_equal(result.reliability[missing], 0.0)
    np.testing.assert_array_equal(result.term[missing], Term.TRACKING_STATE)


def test_a_hand_out_of_view_says_nothing_about_the_rest_but_its_own_arm() -> None:
    take = performed("wave")
    positions, state = take.positions.copy(), take.state.copy()
    hand = KINECT_V1.index("HandLeft")
    positions[:, hand], state[:, hand] = np.nan, State.NOT_TRACKED
    whole = scorer_of(take).score(take).reliability
    part = (
        scorer_of(take)
        .score(replace(take, positions=positions, state=state))
        .reliability
    )
    others = [j for j in range(len(KINECT_V1)) if j not in (hand, WRIST)]
    np.testing.assert_allclose(part[:, others], whole[:, others])


def test_steps_equal_the_score_bit_for_bit_and_start_forgets() -> None:
    take = sample_take()
    scorer = LearnedReliabilityScorer(take.skeleton, measure_reference(take))
    whole, buffer = scorer.score(take), np.empty_like(take.positions[0])
    for _ in range(2):
        scorer.start()
        for k in range(len(take)):
            buffer[:] = take.positions[k]
            found = scorer.step(buffer, take.state[k], float(take.time[k]))
            for one, all_ in zip(
                found, (whole.reliability, whole.term, whole.geometry), strict=True
            ):
                np.testing.assert_array_equal(one, all_[k])


def test_a_take_is_cleaned_with_it() -> None:
    take = sample_take()
    config = CleanConfig(method="none", physics=False, scoring="learned")
    scorer = LearnedReliabilityScorer(take.skeleton, measure_reference(take))
    expected = scorer.score(take).reliability
    np.testing.assert_array_equal(clean(take, config).clip.reliability, expected)


# What it learns


def wrong_when_raised(motion: str, seed: int) -> PairedTake:
    """Return a take whose wrists are 15 cm off while they are over the shoulders."""
    take = performed(motion, seed=seed)
    positions = take.positions.copy()
    for side in ("Left", "Right"):
        wrist, shoulder = (
            KINECT_V1.index(part + side) for part in ("Wrist", "Shoulder")
        )
        raised = positions[:, wrist, 1] > positions[:, shoulder, 1]
        positions[raised, wrist, 2] += 0.15
    return PairedTake(replace(take, positions=positions), take.positions, "one", motion)


def test_a_posture_that_goes_with_errors_is_learned_for_both_sides() -> None:
    lessons = [wrong_when_raised(m, 0) for m in ("raise_arms", "wave", "reach_up")]
    pair = wrong_when_raised("dance", 1)
    result = scorer_of(pair.take, learned_weights(lessons)).score(pair.take)
    for side in ("Left", "Right"):
        wrist = KINECT_V1.index(f"Wrist{side}")
        wrong = np.linalg.norm((pair.take.positions - pair.truth)[:, wrist], axis=1)
        assert roc_auc_score(wrong > 0.1, 1.0 - result.reliability[:, wrist]) > 0.95
    # Where nothing was ever wrong there is nothing to doubt.
    assert result.reliability[:, KINECT_V1.index("KneeLeft")].min() > 0.99


def test_without_training_the_odds_are_even() -> None:
    take = sample_take()
    present = ~np.isnan(take.positions[..., 0])
    reliability = (
        scorer_of(take, ClueWeights.even_odds(KINECT_V1)).score(take).reliability
    )
    np.testing.assert_array_equal(reliability[present], 0.5)


def test_weights_are_the_same_after_writing_and_reading(tmp_path: Path) -> None:
    weights = learned_weights([wrong_when_raised("wave", 0)])
    weights.save(tmp_path / "doubt.npz")
    again = ClueWeights.load(tmp_path / "doubt.npz", KINECT_V1)
    for one, other in (
        (weights.usual, again.usual),
        (weights.weights, again.weights),
        (weights.intercepts, again.intercepts),
    ):
        np.testing.assert_allclose(one, other, rtol=1e-6)
        assert other.shape[0] == len(KINECT_V1)
    assert weights.weights.shape[1] == len(TERMS)


def test_weights_of_another_skeleton_or_none_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "doubt.npz"
    ClueWeights.even_odds(KINECT_V1).save(path)
    for file, skeleton in ((path, KINECT_V2), (tmp_path / "absent.npz", KINECT_V1)):
        with pytest.raises(InputError, match="no reliability weights"):
            ClueWeights.load(file, skeleton)


def test_lessons_hold_every_scene_and_nobody_of_a_study() -> None:
    pairs = pairs_with_props("kinect_v1", people=7)
    seeds = [int(pair.clip.rpartition("_e")[2]) for pair in pairs]
    assert len(set(seeds)) == 7
    assert max(seeds) < 1000
    assert all(
        any(scene in pair.clip for pair in pairs)
        for scene in ("basic", "box", "flip_chart")
    )


# Whom it finds


@pytest.mark.parametrize("sensor", ["v1", "v2"])
def test_simulated_joints_that_are_far_off_are_found(sensor: str) -> None:
    settings_ = [
        *(("basic", "cross_arms"), ("office", "talk")),
        *(("box", "lift_box"), ("flip_chart", "wave")),
    ]
    pairs = [
        simulate(scene, motion, sensor=sensor, seed=1400 + k)
        for k, (scene, motion) in enumerate(settings_)
    ]
    areas = reliability_auc(pairs)
    found = areas["learned"]["over_10_cm"]
    assert found is not None
    assert found > 0.85
    assert all(
        found > (areas[other]["over_10_cm"] or 1.0) + 0.08
        for other in ("shum", "chiang", "noise")
    )


@paired
def test_recorded_joints_that_are_far_off_are_found() -> None:
    """Of real people, although it was taught by simulated ones alone."""
    files = sorted(PAIRS.glob("s*.npz"))[::2]
    areas = reliability_auc([pair for f in files for pair in read_pairs(f)[::12]])
    for key, least, better in (
        ("over_10_cm", 0.8, 0.2),
        ("varying_over_7_cm", 0.75, 0.03),
    ):
        found, shum = areas["learned"][key], areas["shum"][key]
        assert found is not None
        assert shum is not None
        assert found > max(least, shum + better)
