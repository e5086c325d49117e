"""Limbs that the sensor did not see go on as they went, and as they moved before."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from real_data import PAIRS, paired
from threadpoolctl import threadpool_info, threadpool_limits

from kinefilter import CleanConfig, Cleaner
from kinefilter.characters import KINECT_V1, State, Take, standard_body
from kinefilter.pipeline.formats import write_take_csv
from kinefilter.pipeline.pairs import read_pairs
from kinefilter.pipeline.reconstruct import (
    HiddenLimbTracker,
    MotionPrior,
    fill_hidden,
    hidden_limbs,
    recall,
)
from kinefilter.pipeline.reconstruct.continuity import (
    bridge,
    bridge_matrix,
    coast,
    leg_to_goal,
    middle_joint,
)
from kinefilter.pipeline.reconstruct.recall import Process, kernel_between

Array = NDArray[np.float64]
RATE = 30.0
PLACE = np.array([0.0, 1.0, 2.5])
BODY = standard_body(KINECT_V1)
ARM = [KINECT_V1.index(f"{part}Right") for part in ("Elbow", "Wrist", "Hand")]
LEG = [KINECT_V1.index(f"{part}Left") for part in ("Knee", "Ankle", "Foot")]


def waving(count: int, *, period: float = 2.0, together: bool = True) -> Array:
    """Return somebody who lifts both arms at once and lowers them, (T, J, 3)."""
    time = np.arange(count) / RATE
    swing = 0.7 - 0.7 * np.cos(2.0 * np.pi * time / period)
    frames = np.repeat(BODY.rest_positions[None], count, axis=0) + PLACE
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        angle = swing if together or side == "Right" else np.zeros(count)
        bone = np.stack([sign * np.sin(angle), -np.cos(angle), 0.2 + 0.0 * angle], 1)
        bone /= np.linalg.norm(bone, axis=1, keepdims=True)
        at = frames[:, KINECT_V1.index(f"Shoulder{side}")]
        for part in ("Elbow", "Wrist", "Hand"):
            j = KINECT_V1.index(part + side)
            at = frames[:, j] = at + BODY.lengths[j] * bone
    return frames


def hidden_in(count: int, joints: list[int], *gaps: slice) -> NDArray[np.bool_]:
    hidden = np.zeros((count, len(KINECT_V1)), dtype=np.bool_)
    for gap in gaps:
        hidden[gap, joints] = True
    return hidden


def filled(
    positions: Array, hidden: NDArray[np.bool_], prior: MotionPrior | None = None
) -> Array:
    time = np.arange(len(positions)) / RATE
    empty = np.where(hidden[..., None], np.nan, positions)
    return fill_hidden(time, empty, hidden, KINECT_V1, prior)[0]


def error(found: Array, truth: Array, gap: slice, joints: list[int]) -> float:
    away = np.linalg.norm(found[gap][:, joints] - truth[gap][:, joints], axis=2)
    return float(away.mean())


@given(st.integers(2, 60), st.integers(1, 40), st.sampled_from([15.0, 30.0, 60.0]))
def test_what_moves_evenly_goes_on_evenly(before: int, gap: int, rate: float) -> None:
    even = np.arange(before + gap + before)[:, None] * np.array([0.3, -1.0]) + 2.0
    known = np.ones(len(even), dtype=np.bool_)
    known[before : before + gap] = False
    empty = np.where(known[:, None], even, np.nan)
    np.testing.assert_allclose(bridge(empty, known, rate), even, atol=1e-6)


def test_the_bridge_is_a_linear_map_of_the_frames_around_it() -> None:
    ends = np.random.default_rng(1).normal(size=(12, 3))
    known = np.ones(32, dtype=np.bool_)
    known[6:26] = False
    values = np.zeros((32, 3))
    values[known] = ends
    expected = bridge(values, known, RATE)[~known]
    np.testing.assert_allclose(bridge_matrix(20, 6, RATE) @ ends, expected, atol=1e-9)


def test_what_coasts_starts_with_its_speed_and_comes_to_rest() -> None:
    last, velocity = np.array([1.0, 2.0]), np.array([0.5, -1.0])
    soon = coast(last, velocity, np.array([[1e-6]]))[0]
    np.testing.assert_allclose((soon - last) / 1e-6, velocity, rtol=1e-4)
    late = [coast(last, velocity, np.array([[t]]))[0] for t in (20.0, 30.0)]
    np.testing.assert_allclose(late[0], late[1], atol=1e-12)
    assert np.linalg.norm(late[0] - last) < 0.3


@given(st.lists(st.floats(-0.3, 0.3), min_size=3, max_size=3))
def test_a_leg_reaches_its_goal_with_its_own_lengths(shift: list[float]) -> None:
    hip = np.array([0.1, 0.9, 0.0])
    knee, ankle = hip - np.array([[0.0, 0.4, -0.05], [0.0, 0.75, 0.0]])
    thigh, shin = (float(np.linalg.norm(v)) for v in (knee - hip, ankle - knee))
    goal = hip + np.array([0.0, -0.6, 0.0]) + 0.4 * np.array(shift)
    new_knee, new_ankle = leg_to_goal(hip, knee, ankle, goal, (thigh, shin))
    if np.linalg.norm(goal - hip) < 0.99 * (thigh + shin):
        np.testing.assert_allclose(new_ankle, goal, atol=1e-9)
        between, _ = middle_joint(hip, new_knee, new_ankle, (thigh, shin))
        assert abs(np.linalg.norm(between - hip) - thigh) < 1e-9
        assert abs(np.linalg.norm(between - new_ankle) - shin) < 1e-9


def test_a_leg_whose_ankle_is_where_it_should_be_stays() -> None:
    hip, knee, ankle = np.eye(3)
    found = leg_to_goal(hip, knee, ankle, ankle, (0.4, 0.4))
    np.testing.assert_allclose(found, [knee, ankle], atol=1e-12)


def test_the_process_agrees_with_scikit_learn() -> None:
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF

    rng = np.random.default_rng(0)
    features, targets, queries = (
        rng.normal(size=shape) for shape in ((40, 3), (40, 2), (9, 3))
    )
    process = Process.of(kernel_between(features, features), targets)
    other = GaussianProcessRegressor(RBF(1.0), alpha=0.3**2, optimizer=None)
    mean, sigma = other.fit(features, targets).predict(queries, return_std=True)
    expected = mean * (1.0 - sigma[:, :1] ** 2)
    found = process.predict(kernel_between(queries, features))
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_what_a_take_shows_is_learned_in_one_thread(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    threads: list[int] = []

    def fit(kernel: Array, targets: Array) -> Process:
        libraries = threadpool_info()
        threads.extend(x["num_threads"] for x in libraries if x["user_api"] == "blas")
        return of(kernel, targets)

    of = Process.of
    monkeypatch.setattr(Process, "of", fit)
    positions = waving(300)
    with threadpool_limits(2, "blas"):
        filled(positions, hidden_in(300, ARM, slice(200, 240)))
    assert set(threads) == {1}


def test_a_take_without_hidden_joints_stays_as_it_is() -> None:
    positions = waving(60)
    hidden = hidden_in(60, ARM)
    found, which = fill_hidden(np.arange(60) / RATE, positions, hidden, KINECT_V1)
    assert found is positions
    assert not which.any()


def test_seen_joints_stay_and_filled_ones_are_on_their_segments() -> None:
    truth, gap = waving(90), slice(30, 60)
    hidden = hidden_in(90, ARM, gap)
    found = filled(truth, hidden)
    np.testing.assert_array_equal(found[~hidden], truth[~hidden])
    for j in ARM:
        bones = found[gap, j] - found[gap, KINECT_V1.parents[j]]
        np.testing.assert_allclose(
            np.linalg.norm(bones, axis=1), BODY.lengths[j], rtol=1e-6
        )


def test_an_arm_that_was_seen_before_moves_as_it_did_then() -> None:
    """The other arm moves with it, which the rest of the take shows."""
    truth, gap = waving(600), slice(310, 350)
    nothing = MotionPrior({})
    alone = filled(truth[280:380], hidden_in(100, ARM, slice(30, 70)), nothing)
    found = filled(truth, hidden_in(600, ARM, gap), nothing)
    bridged = error(alone, truth[280:380], slice(30, 70), ARM)
    assert error(found, truth, gap, ARM) < 0.25 * bridged


def test_what_is_far_away_in_a_long_take_does_not_teach(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """There only one arm moves, and at the gap both."""
    gap, count = slice(700, 745), 900
    here = waving(count)
    there = here.copy()
    there[:400] = waving(400, together=False)
    hidden = hidden_in(count, ARM, gap)
    whole = [filled(positions, hidden)[gap] for positions in (here, there)]
    monkeypatch.setattr(recall, "_REACH", 8.0)
    near = [filled(positions, hidden)[gap] for positions in (here, there)]
    assert np.abs(whole[0] - whole[1]).max() > 0.001
    np.testing.assert_allclose(near[0], near[1], atol=1e-9)


def test_a_foot_that_stood_stays_while_the_body_sinks() -> None:
    truth = np.repeat(BODY.rest_positions[None], 90, axis=0) + PLACE
    sinks = 0.25 * (1.0 - np.cos(2.0 * np.pi * np.arange(90) / 90))
    truth[..., 1] -= sinks[:, None]
    for side in ("Left", "Right"):
        hip, knee, ankle, foot = (
            KINECT_V1.index(part + side) for part in ("Hip", "Knee", "Ankle", "Foot")
        )
        truth[:, [ankle, foot]] = truth[0, [ankle, foot]]
        limb, lengths = truth[:, [hip, knee, ankle]], BODY.lengths[[knee, ankle]]
        truth[:, knee], _ = middle_joint(*np.moveaxis(limb, 1, 0), lengths)
    gap = slice(20, 70)
    found = filled(truth, hidden_in(90, LEG, gap))
    assert error(found, truth, gap, LEG[:2]) < 0.03
    held = np.linalg.norm(found[gap, LEG[1]] - truth[0, LEG[1]], axis=1)
    assert held.max() < 0.06


def test_a_hidden_knee_is_between_hip_and_ankle() -> None:
    truth = waving(60)
    found = filled(truth, hidden_in(60, LEG[:1], slice(20, 40)))
    np.testing.assert_array_equal(found[:, LEG[1]], truth[:, LEG[1]])
    thigh = np.linalg.norm(found[20:40, LEG[0]] - found[20:40, 12], axis=1)
    np.testing.assert_allclose(thigh, BODY.lengths[LEG[0]], rtol=1e-3)


def test_a_joint_that_was_never_seen_is_left_to_the_method() -> None:
    positions = waving(60)
    hidden = hidden_in(60, ARM[2:], slice(None))
    positions[:, ARM[2]] = np.nan
    found, which = fill_hidden(np.arange(60) / RATE, positions, hidden, KINECT_V1)
    assert np.isnan(found[:, ARM[2]]).all()
    assert not which.any()


@pytest.mark.parametrize("guess", [0.0, 0.3])
def test_wrong_guesses_count_as_little_as_nothing(guess: float) -> None:
    """What a sensor says of a limb that it only inferred does not show."""
    truth, gap = waving(300), slice(130, 170)
    hidden = hidden_in(300, ARM, gap)
    state = np.where(hidden, State.INFERRED, State.TRACKED).astype(np.uint8)
    wrong = truth + guess * hidden[..., None]
    time = np.arange(300) / RATE
    cleaner = Cleaner(CleanConfig(physics=False)).until("reconstruct")
    found = cleaner.whole(Take(time, wrong, state, KINECT_V1, "take")).filled
    np.testing.assert_allclose(found, filled(truth, hidden), atol=1e-9)


def tracked(positions: Array, hidden: NDArray[np.bool_]) -> Array:
    tracker = HiddenLimbTracker(BODY)
    empty = np.where(hidden[..., None], np.nan, positions)
    frames = zip(empty, hidden, strict=True)
    return np.array(
        [tracker.step(f, h, k / RATE)[0] for k, (f, h) in enumerate(frames)]
    )


def test_frame_by_frame_seen_joints_stay_and_limbs_are_joined_soon() -> None:
    truth, gap = waving(330), slice(250, 290)
    hidden = hidden_in(330, ARM, gap)
    found = tracked(truth, hidden)
    others = [j for j in range(len(KINECT_V1)) if j not in ARM]
    np.testing.assert_allclose(found[:, others], truth[:, others], atol=1e-12)
    np.testing.assert_allclose(found[297:, ARM], truth[297:, ARM], atol=1e-12)
    steps = np.linalg.norm(np.diff(found[:, ARM], axis=0), axis=2)
    fastest = np.linalg.norm(np.diff(truth[:, ARM], axis=0), axis=2).max()
    assert steps.max() < 3.0 * fastest


def test_limbs_that_are_lost_now_and_then_hardly_lag() -> None:
    truth = waving(240)
    hidden = hidden_in(240, ARM, *(slice(k, k + 1) for k in range(60, 240, 3)))
    found, arm = tracked(truth, hidden)[:, ARM], truth[:, ARM]
    fastest = np.linalg.norm(np.diff(arm, axis=0), axis=2).max()
    away = np.linalg.norm(found - arm, axis=2)[~hidden[:, ARM[0]]]
    assert away.max() < 0.7 * fastest
    assert np.linalg.norm(np.diff(found, axis=0), axis=2).max() < 1.6 * fastest


def test_frame_by_frame_repetitions_teach() -> None:
    truth, gap = waving(330), slice(250, 290)
    learned = tracked(truth, hidden_in(330, ARM, gap))
    still = truth[gap.start - 1, ARM] - truth[gap.start - 1, ARM[0] - 1]
    held = truth[gap, None, ARM[0] - 1] + still
    away = np.linalg.norm(held - truth[gap][:, ARM], axis=2).mean()
    assert error(learned, truth, gap, ARM) < 0.5 * away


def test_memory_of_a_long_stream_is_bounded_and_goes_on() -> None:
    count = 3700
    truth = waving(count)
    hidden = hidden_in(count, ARM, slice(3590, 3630))
    found = tracked(truth, hidden)
    assert np.isfinite(found).all()
    still = np.linalg.norm(truth[3590:3630, ARM] - truth[3589, ARM], axis=2).mean()
    assert error(found, truth, slice(3590, 3630), ARM) < 0.5 * still


@pytest.mark.parametrize("limb", [ARM, LEG])
def test_a_limb_hidden_at_first_is_as_at_the_end_of_the_take_played_backward(
    limb: list[int],
) -> None:
    truth = waving(150)
    hidden = hidden_in(150, limb, slice(0, 60), slice(90, 110))
    found = filled(truth, hidden)
    backward = filled(truth[::-1], hidden[::-1])[::-1]
    np.testing.assert_allclose(found[:60], backward[:60], atol=1e-9)


@paired
def test_limbs_hidden_at_first_are_nearer_than_held_ones() -> None:
    ours, holding = 0.0, 0.0
    for pair in read_pairs(PAIRS / "s08.npz")[::12]:
        truth = pair.take.positions
        gap = slice(0, len(truth) // 2)
        for limb in (ARM, LEG):
            hidden = np.isnan(truth[..., 0]) | hidden_in(len(truth), limb, gap)
            top, held = KINECT_V1.parents[limb[0]], truth.copy()
            first = truth[gap.stop, limb] - truth[gap.stop, top]
            held[gap, limb] = truth[gap, top, None] + first
            ours += error(filled(truth, hidden), truth, gap, limb[:2])
            holding += error(held, truth, gap, limb[:2])
    assert ours < 0.6 * holding


@paired
def test_hidden_limbs_of_recorded_people_are_nearer_than_held_ones() -> None:
    """One of the six; what is chosen was chosen on others."""
    ours, holding = {"arm": 0.0, "leg": 0.0}, {"arm": 0.0, "leg": 0.0}
    for pair in read_pairs(PAIRS / "s08.npz")[::12]:
        truth = pair.take.positions
        gap = slice(round(0.225 * len(truth)), round(0.775 * len(truth)))
        for name, limb in (("arm", ARM), ("leg", LEG)):
            hidden = np.isnan(truth[..., 0]) | hidden_in(len(truth), limb, gap)
            found = filled(truth, hidden)
            top = KINECT_V1.parents[limb[0]]
            last = truth[gap.start - 1, limb] - truth[gap.start - 1, top]
            held = truth.copy()
            held[gap, limb] = truth[gap, top, None] + last
            ours[name] += error(found, truth, gap, limb[:2])
            holding[name] += error(held, truth, gap, limb[:2])
    assert ours["arm"] < 0.75 * holding["arm"]
    assert ours["leg"] < 0.6 * holding["leg"]


def test_another_take_of_the_person_teaches(tmp_path: Path) -> None:
    """What the take itself does not show, another one does."""
    truth, gap = waving(100)[10:], slice(30, 70)
    hidden = hidden_in(90, ARM, gap)
    state = np.where(hidden, State.NOT_TRACKED, State.TRACKED).astype(np.uint8)
    empty = np.where(hidden[..., None], np.nan, truth)
    take = Take(np.arange(90) / RATE, empty, state, KINECT_V1, "take")
    other = waving(400)
    every = np.full(other.shape[:2], State.TRACKED, dtype=np.uint8)
    file = tmp_path / "other.csv"
    write_take_csv(Take(np.arange(400) / RATE, other, every, KINECT_V1, "other"), file)
    found = {}
    for files in ((), (file,)):
        config = CleanConfig(physics=False, same_person=files)
        draft = Cleaner(config).until("reconstruct").whole(take)
        assert draft.filled.shape == truth.shape
        np.testing.assert_allclose(draft.filled[~hidden], truth[~hidden], atol=1e-5)
        found[files] = error(draft.filled, truth, gap, ARM)
    assert found[(file,)] < 0.4 * found[()]


def test_a_limb_that_is_hidden_from_the_start_does_not_go_on_from_another_take(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # The other take may teach; nothing else may come of it.
    monkeypatch.setattr(hidden_limbs, "learn", lambda *_, **__: None)
    before, after = waving(90), waving(90, together=False)
    positions = np.concatenate([before, after])
    time = np.concatenate([np.arange(90), np.arange(90) + 150]) / RATE
    hidden = hidden_in(180, ARM, slice(90, 120))
    empty = np.where(hidden[..., None], np.nan, positions)
    joined = fill_hidden(time, empty, hidden, KINECT_V1)[0][90:]
    alone = fill_hidden(time[90:], empty[90:], hidden[90:], KINECT_V1)[0]
    np.testing.assert_allclose(joined[:, ARM[:2]], alone[:, ARM[:2]], atol=1e-9)
