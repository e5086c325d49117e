"""The three reliability terms and their rate (Shum 2013, eq. 1-8), by hand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from kinefilter.characters import (
    KINECT_V1,
    KINECT_V2,
    Skeleton,
    State,
    Take,
    standard_body,
)
from kinefilter.pipeline.formats import read_take
from kinefilter.pipeline.reliability import (
    Reference,
    Reliability,
    ReliabilityScorer,
    Term,
    measure_reference,
    segment_lengths,
)
from kinefilter.retarget import positions_from_rotations
from kinefilter.retarget.rotations import IDENTITY, about_y, rotate
from kinefilter.scenes import sample_take

Array = NDArray[np.float64]

TAKES = Path(__file__).parents[2] / "shared" / "data" / "takes"
recorded = pytest.mark.skipif(
    not TAKES.is_dir(), reason="no recorded takes in ../shared/data"
)
every_skeleton = pytest.mark.parametrize(
    "skeleton", [KINECT_V1, KINECT_V2], ids=lambda s: s.name
)

JOINTS = len(KINECT_V1)
HAND = KINECT_V1.index("HandLeft")
# The newest frame weighs most; the oldest of six is at two sigma.
WEIGHTS = np.exp(-0.5 * (np.arange(6) * 2.0 / 5.0) ** 2)
WEIGHTS /= WEIGHTS.sum()


def still_take(frames: int = 20, skeleton: Skeleton = KINECT_V1) -> Take:
    rest = standard_body(skeleton).rest_positions
    return Take(
        time=np.arange(frames) / 30.0,
        positions=np.tile(rest, (frames, 1, 1)),
        state=np.full((frames, len(skeleton)), int(State.TRACKED), dtype=np.uint8),
        skeleton=skeleton,
    )


def moved(take: Take, joint: int, path: Array) -> Take:
    """Return a take with a joint displaced, path (T, 3) or (3,)."""
    positions = take.positions.copy()
    positions[:, joint] += path
    return replace(take, positions=positions)


def with_state(take: Take, frames: slice, joint: int, state: State) -> Take:
    states = take.state.copy()
    states[frames, joint] = state
    return replace(take, state=states)


def blind(skeleton: Skeleton = KINECT_V1) -> Reference:
    """Return a reference that knows no segment, so that no length can be wrong."""
    unknown = np.full(len(skeleton), np.nan)
    return Reference(unknown, np.full((len(skeleton), 3), np.nan), False)


def average(skeleton: Skeleton = KINECT_V1) -> Reference:
    lengths = standard_body(skeleton).lengths.copy()
    lengths[skeleton.root] = np.nan
    return replace(blind(skeleton), lengths=lengths)


def score(take: Take, reference: Reference) -> Reliability:
    return ReliabilityScorer(take.skeleton, reference).score(take)


def unwound(rate: Array) -> Array:
    """Return each frame's own score, by taking the Gaussian average of eq. 8 apart."""
    scores: list[float] = []
    for k, value in enumerate(rate):
        weights = WEIGHTS[: k + 1] / WEIGHTS[: k + 1].sum()
        past = sum(w * s for w, s in zip(weights[1:], scores[::-1], strict=False))
        scores.append((value - past) / weights[0])
    return np.array(scores)


# Behavior, eq. 1-4


@every_skeleton
def test_a_still_tracked_person_scores_one(skeleton: Skeleton) -> None:
    take = still_take(12, skeleton)
    result = score(take, average(skeleton))
    np.testing.assert_allclose(result.rate, 1.0)
    np.testing.assert_allclose(result.geometry, 1.0)


def test_a_straight_path_and_a_right_angle_cost_no_trust() -> None:
    frames = 20
    straight = np.outer(np.arange(frames), [0.1, 0.0, 0.0])
    stairs = np.zeros((frames, 3))
    stairs[:, 0] = 0.1 * ((np.arange(frames) + 1) // 2)
    stairs[:, 1] = 0.1 * (np.arange(frames) // 2)
    for path in (straight, stairs):
        result = score(moved(still_take(frames), HAND, path), blind())
        np.testing.assert_allclose(result.rate, 1.0)


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
    np.testing.assert_allclose(unwound(result.rate[:, HAND]), expected, atol=1e-12)
    # The rate itself, where its six frames are 1, 1, 1, 1/3, 0, 0 from the oldest.
    by_hand = WEIGHTS[5] + WEIGHTS[4] + WEIGHTS[3] + WEIGHTS[2] / 3.0
    assert result.rate[5, HAND] == pytest.approx(by_hand)
    assert result.rate[-1, HAND] == pytest.approx(0.0)
    np.testing.assert_array_equal(result.term[3:, HAND], Term.BEHAVIOR)
    np.testing.assert_allclose(np.delete(result.rate, HAND, axis=1), 1.0)


def test_a_zigzag_under_three_centimeters_is_a_joint_at_rest() -> None:
    path = np.outer(0.0299 * (np.arange(10) % 2), [1.0, 0.0, 0.0])
    result = score(moved(still_take(10), HAND, path), blind())
    np.testing.assert_allclose(result.rate, 1.0)


def test_one_long_and_one_short_displacement_make_no_angle() -> None:
    # 10 cm there in one frame, back in 2.5 cm steps.
    cycle = np.array([0.0, 0.1, 0.075, 0.05, 0.025])
    path = np.outer(np.tile(cycle, 4), [0.0, 1.0, 0.0])
    result = score(moved(still_take(20), HAND, path), blind())
    np.testing.assert_allclose(result.rate, 1.0)


@pytest.mark.parametrize("degrees", [80.0, 90.0, 100.0, 120.0, 134.0, 136.0, 170.0])
def test_a_steady_angle_is_trusted_linearly_between_floor_and_roof(
    degrees: float,
) -> None:
    turns = np.radians(degrees) * np.arange(15)
    steps = 0.05 * np.stack([np.cos(turns), np.sin(turns), np.zeros(15)], axis=1)
    result = score(moved(still_take(15), HAND, np.cumsum(steps, axis=0)), blind())
    expected = 1.0 - np.clip((degrees - 90.0) / 45.0, 0.0, 1.0)
    assert result.rate[-1, HAND] == pytest.approx(expected, abs=1e-9)


def test_a_gap_makes_no_angle() -> None:
    path = np.outer(0.1 * (np.arange(9) % 2), [1.0, 0.0, 0.0])
    path[2::3] = np.nan
    result = score(moved(still_take(9), HAND, path), blind())
    np.testing.assert_allclose(result.rate, 1.0)


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
    np.testing.assert_allclose(result.rate, np.tile(expected, (8, 1)))
    assert (result.term[:, wrist] == Term.KINEMATICS).all()


def test_the_joint_of_three_segments_shares_an_error_by_three() -> None:
    take, body = still_take(8), standard_body(KINECT_V1)
    head, girdle = KINECT_V1.index("Head"), KINECT_V1.index("ShoulderCenter")
    result = score(moved(take, head, 0.2 * body.rest_offsets[head]), average())
    # Spine, head and two shoulders meet at the shoulder center: four segments.
    assert result.rate[-1, girdle] == pytest.approx(1.0 - 0.2 / 4.0)
    assert result.rate[-1, head] == pytest.approx(1.0 - 0.2)
    foot, ankle = KINECT_V1.index("FootLeft"), KINECT_V1.index("AnkleLeft")
    hip = KINECT_V1.index("HipLeft")
    result = score(moved(take, hip, 1e3 * body.rest_offsets[hip]), average())
    # A segment counts as wrong once at most; the hips' center ends three.
    assert result.rate[-1, hip] == pytest.approx(0.0)
    assert result.rate[-1, KINECT_V1.root] == pytest.approx(1.0 - 1.0 / 3.0)
    np.testing.assert_allclose(result.rate[-1, [foot, ankle]], 1.0)


def test_a_missing_joint_counts_as_wrong_at_both_ends_of_its_segments() -> None:
    take = moved(still_take(8), HAND, np.full(3, np.nan))
    take = with_state(take, slice(None), HAND, State.NOT_TRACKED)
    result = score(take, average())
    wrist = KINECT_V1.index("WristLeft")
    np.testing.assert_allclose(result.rate[:, HAND], 0.0)
    np.testing.assert_allclose(result.geometry[:, HAND], 0.0)
    np.testing.assert_allclose(result.rate[:, wrist], 0.5)
    np.testing.assert_allclose(np.delete(result.rate, [HAND, wrist], axis=1), 1.0)


def test_a_segment_never_measured_has_no_say() -> None:
    reference = average()
    reference.lengths[HAND] = np.nan
    take = moved(still_take(8), HAND, np.array([0.5, 0.0, 0.0]))
    np.testing.assert_allclose(score(take, reference).rate, 1.0)
    take = moved(still_take(8), HAND, np.full(3, np.nan))
    np.testing.assert_allclose(np.delete(score(take, reference).rate, HAND, 1), 1.0)


# Tracking state and rate, eq. 7-8


@pytest.mark.parametrize("state", [State.INFERRED, State.NOT_TRACKED])
def test_a_joint_not_tracked_scores_zero_and_recovers_over_six_frames(
    state: State,
) -> None:
    bad = slice(10, 20)
    take = with_state(still_take(40), bad, HAND, state)
    result = score(take, average())
    rate = result.rate[:, HAND]
    np.testing.assert_allclose(rate[:10], 1.0)
    np.testing.assert_allclose(rate[9:16], 1.0 - np.cumsum([0, *WEIGHTS]), atol=1e-12)
    np.testing.assert_allclose(rate[15:20], 0.0, atol=1e-12)
    np.testing.assert_allclose(rate[19:26], np.cumsum([0, *WEIGHTS]), atol=1e-12)
    np.testing.assert_allclose(rate[25:], 1.0)
    assert (np.diff(rate[19:26]) > 0).all()
    assert (np.diff(rate[19:26], n=2) < 0).all()
    assert (result.term[bad, HAND] == Term.TRACKING_STATE).all()
    np.testing.assert_allclose(result.geometry, 1.0)
    np.testing.assert_allclose(np.delete(result.rate, HAND, axis=1), 1.0)


def test_the_first_frames_are_averages_over_the_frames_there_are() -> None:
    take = with_state(still_take(4), slice(0, 1), HAND, State.INFERRED)
    rate = score(take, average()).rate[:, HAND]
    for k in range(4):
        expected = WEIGHTS[:k].sum() / WEIGHTS[: k + 1].sum()
        assert rate[k] == pytest.approx(expected, abs=1e-12)


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
    assert result.rate[-1, wrist] == 0.0
    assert result.geometry[-1, wrist] > 0.5


@every_skeleton
def test_rates_stay_in_zero_to_one_whatever_happens(skeleton: Skeleton) -> None:
    rng = np.random.default_rng(0)
    shape = (200, len(skeleton))
    positions = rng.normal(size=(*shape, 3)) * rng.choice([0.01, 1.0, 1e6], (*shape, 1))
    positions[rng.random(shape) < 0.2] = np.nan
    state = rng.integers(0, 3, shape).astype(np.uint8)
    take = Take(np.arange(200) / 30.0, positions, state, skeleton)
    for reference in (average(skeleton), blind(skeleton)):
        result = score(take, reference)
        for values in (result.rate, result.geometry):
            assert (values >= 0.0).all()
            assert (values <= 1.0 + 1e-12).all()
        assert (result.rate <= result.geometry + 1e-12).all()
        assert np.isin(result.term, [0, 1, 2]).all()


def assert_frames_equal_the_whole(take: Take) -> None:
    reference = measure_reference(take)
    whole = ReliabilityScorer(take.skeleton, reference).score(take)
    scorer = ReliabilityScorer(take.skeleton, reference)
    for k in range(len(take)):
        rate, term, geometry = scorer.step(take.positions[k], take.state[k])
        np.testing.assert_array_equal(rate, whole.rate[k])
        np.testing.assert_array_equal(term, whole.term[k])
        np.testing.assert_array_equal(geometry, whole.geometry[k])
    again = scorer.score(take)
    np.testing.assert_array_equal(again.rate, whole.rate)


def test_frame_by_frame_equals_the_whole_take_bit_for_bit() -> None:
    assert_frames_equal_the_whole(sample_take())


def test_a_take_with_errors_scores_low_where_they_are() -> None:
    take = sample_take()
    result = score(take, measure_reference(take))
    tracked = take.state == State.TRACKED
    assert (~tracked).mean() > 0.05
    assert np.median(result.rate[tracked]) > 0.85
    assert result.rate[~tracked].mean() < 0.5 * result.rate[tracked].mean()


# References


def arms_down(skeleton: Skeleton = KINECT_V1) -> Array:
    body = standard_body(skeleton)
    rotations = np.tile(IDENTITY, (len(skeleton), 1))
    half = np.pi / 4
    for side, turn in (("Left", -half), ("Right", half)):
        for part in ("Elbow", "Wrist", "Hand"):
            rotations[skeleton.index(part + side)] = [np.cos(turn), 0, 0, np.sin(turn)]
    return positions_from_rotations(rotations, np.zeros(3), body)


def squatting(skeleton: Skeleton = KINECT_V1) -> Array:
    body = standard_body(skeleton)
    rotations = np.tile(IDENTITY, (len(skeleton), 1))
    for joint, angle in {"Knee": -1.0, "Ankle": 0.8}.items():
        for side in ("Left", "Right"):
            rotations[skeleton.index(joint + side)] = [
                np.cos(angle / 2),
                np.sin(angle / 2),
                0,
                0,
            ]
    return positions_from_rotations(rotations, np.zeros(3), body)


def take_of(*poses: Array, skeleton: Skeleton = KINECT_V1) -> Take:
    positions = np.array(poses)
    state = np.full(positions.shape[:2], int(State.TRACKED), dtype=np.uint8)
    return Take(np.arange(len(poses)) / 30.0, positions, state, skeleton)


@every_skeleton
@pytest.mark.parametrize("yaw", [0.0, 2.0])
@pytest.mark.parametrize("posed", ["t-pose", "standing"])
def test_frames_in_reference_posture_are_used_when_present(
    skeleton: Skeleton, posed: str, yaw: float
) -> None:
    body = standard_body(skeleton)
    pose = body.rest_positions if posed == "t-pose" else arms_down(skeleton)
    pose = rotate(about_y(yaw), pose) + np.array([0.0, -1.0, 2.7])
    squat = 1.5 * squatting(skeleton)
    reference = measure_reference(
        take_of(*[squat] * 50, *[pose] * 5, skeleton=skeleton)
    )
    assert reference.from_reference_posture
    ends = skeleton.segments
    np.testing.assert_allclose(reference.lengths[ends], body.lengths[ends])
    assert np.isnan(reference.lengths[skeleton.root])


def test_without_enough_posed_frames_the_median_over_the_take_serves() -> None:
    body, squat = standard_body(KINECT_V1), squatting()
    poses = [squat] * 20 + [1.3 * squat] * 6 + [2.0 * body.rest_positions] * 4
    reference = measure_reference(take_of(*poses))
    assert not reference.from_reference_posture
    ends = KINECT_V1.segments
    np.testing.assert_allclose(reference.lengths[ends], body.lengths[ends])


def test_posed_frames_with_an_inferred_joint_do_not_count() -> None:
    rest = standard_body(KINECT_V1).rest_positions
    take = take_of(*[1.2 * rest] * 8, *[squatting()] * 20)
    assert measure_reference(take).from_reference_posture
    hidden = with_state(take, slice(0, 8), HAND, State.INFERRED)
    reference = measure_reference(hidden)
    assert not reference.from_reference_posture


def test_frames_where_an_end_is_inferred_do_not_disturb_the_median() -> None:
    body, squat = standard_body(KINECT_V1), squatting()
    stretched = squat.copy()
    stretched[HAND] += [0.3, 0.0, 0.0]
    take = take_of(*[stretched] * 15, *[squat] * 5)
    take = with_state(take, slice(0, 15), HAND, State.INFERRED)
    reference = measure_reference(take)
    assert reference.lengths[HAND] == pytest.approx(body.lengths[HAND])
    # Never tracked at all: what was inferred is better than nothing.
    take = with_state(take, slice(None), HAND, State.INFERRED)
    expected = segment_lengths(stretched, KINECT_V1)[HAND]
    assert measure_reference(take).lengths[HAND] == pytest.approx(expected)


def test_segments_never_seen_are_nan_and_without_say() -> None:
    hands = [KINECT_V1.index(f"Hand{side}") for side in ("Left", "Right")]
    take = still_take(10)
    positions, state = take.positions.copy(), take.state.copy()
    positions[:, hands], state[:, hands] = np.nan, State.NOT_TRACKED
    take = replace(take, positions=positions, state=state)
    reference = measure_reference(take)
    assert reference.from_reference_posture
    unknown = np.flatnonzero(np.isnan(reference.lengths))
    assert unknown.tolist() == sorted([KINECT_V1.root, *hands])
    rate = score(take, reference).rate
    np.testing.assert_allclose(rate[:, hands], 0.0)
    np.testing.assert_allclose(np.delete(rate, hands, axis=1), 1.0)


@every_skeleton
@pytest.mark.parametrize("yaw", [0.0, 1.3])
def test_trunk_directions_are_those_of_the_body_whatever_the_heading(
    skeleton: Skeleton, yaw: float
) -> None:
    body = standard_body(skeleton)
    pose = rotate(about_y(yaw), body.rest_positions)
    directions = measure_reference(take_of(*[pose] * 3, skeleton=skeleton)).directions
    known = np.flatnonzero(np.isfinite(directions).all(axis=1))
    names = {"HipLeft", "HipRight", "ShoulderLeft", "ShoulderRight"}
    names |= (
        {"Spine", "ShoulderCenter"}
        if skeleton is KINECT_V1
        else {"SpineMid", "SpineShoulder"}
    )
    assert {skeleton.joints[j] for j in known} == names
    np.testing.assert_allclose(directions[known], body.directions[known], atol=1e-12)


def test_measuring_a_reference_of_the_sample_finds_the_performer() -> None:
    reference = measure_reference(sample_take())
    limbs = [
        KINECT_V1.index(part + side)
        for part in ("Elbow", "Wrist", "Knee", "Ankle")
        for side in ("Left", "Right")
    ]
    expected = standard_body(KINECT_V1).lengths[limbs]
    # A Kinect's thighs are some 15 % short: its hips are low, its knees high.
    np.testing.assert_allclose(reference.lengths[limbs], expected, rtol=0.2)


# Recorded takes


@recorded
@pytest.mark.parametrize("name", ["labanotation/joints.csv", "precog16/Seq1_1.csv.gz"])
def test_recorded_takes_score_alike_frame_by_frame(name: str) -> None:
    assert_frames_equal_the_whole(read_take(TAKES / name))


@recorded
def test_inferred_joints_of_a_recorded_take_are_not_trusted() -> None:
    take = read_take(TAKES / "labanotation" / "joints.csv")
    reference = measure_reference(take)
    assert (reference.lengths[take.skeleton.segments] > 0.0).all()
    result = score(take, reference)
    tracked = take.state == State.TRACKED
    longer = np.array([tracked[max(k - 5, 0) : k + 1].all(0) for k in range(len(take))])
    assert np.median(result.rate[longer]) > 0.85
    lost = np.array([~tracked[max(k - 5, 0) : k + 1].any(0) for k in range(len(take))])
    assert lost.any()
    np.testing.assert_allclose(result.rate[lost], 0.0, atol=1e-12)
    assert (result.term[~tracked] != Term.BEHAVIOR).mean() > 0.9


@recorded
def test_a_failure_of_the_tracker_scores_under_a_good_take() -> None:
    worst: dict[bool, list[float]] = {False: [], True: []}
    for path in sorted((TAKES / "ui-prmd").glob("*.csv")):
        rates = lowest_rates(read_take(path))
        worst["_failure" in path.name].append(float(rates.mean()))
    assert worst[True]
    assert np.mean(worst[True]) < np.mean(worst[False])


def lowest_rates(take: Take) -> Array:
    """Return each frame's worst rate among the joints that the take has."""
    rate = score(take, measure_reference(take)).rate
    present = ~np.isnan(take.positions[..., 0]).all(axis=0)
    return np.asarray(rate[:, present].min(axis=1))
