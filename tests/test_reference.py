"""Segment lengths of reference: of the posed frames, or medians over the take."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scored_takes import HAND, Array, score, still_take, with_state
from skeletons import every_skeleton

from kinefilter.characters import (
    KINECT_V1,
    Skeleton,
    State,
    Take,
    positions_from_rotations,
    standard_body,
)
from kinefilter.characters.rotations import IDENTITY, about_y, rotate
from kinefilter.pipeline.reliability import measure_reference, segment_lengths
from kinefilter.scenes.sensor import sample_take


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


@pytest.mark.parametrize("side", ["Left", "Right"])
def test_one_arm_down_and_one_sideways_is_no_reference_posture(side: str) -> None:
    pose = arms_down()
    arm = [KINECT_V1.index(part + side) for part in ("Elbow", "Wrist", "Hand")]
    rest = standard_body(KINECT_V1).rest_positions
    pose[arm] = rest[arm] - rest[KINECT_V1.root]
    assert not measure_reference(take_of(*[pose] * 20)).from_reference_posture


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
    reliability = score(take, reference).reliability
    np.testing.assert_allclose(reliability[:, hands], 0.0)
    np.testing.assert_allclose(np.delete(reliability, hands, axis=1), 1.0)


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


def test_trunk_directions_are_of_frames_in_which_all_of_the_trunk_is_tracked() -> None:
    body, hip = standard_body(KINECT_V1), KINECT_V1.index("HipLeft")
    wrong = body.rest_positions.copy()
    wrong[hip] += [0.0, 0.3, 0.0]
    take = take_of(*[wrong] * 15, *[body.rest_positions] * 5)
    take = with_state(take, slice(0, 15), hip, State.INFERRED)
    directions = measure_reference(take).directions
    np.testing.assert_allclose(directions[hip], body.directions[hip], atol=1e-12)


@pytest.mark.filterwarnings("error")
def test_frames_with_a_bone_of_no_length_do_not_count() -> None:
    still = replace(still_take(), positions=np.tile(arms_down(), (20, 1, 1)))
    ankle, knee = (KINECT_V1.index(part + "Left") for part in ("Ankle", "Knee"))
    positions = still.positions.copy()
    positions[:10, ankle] = positions[:10, knee]
    reference = measure_reference(replace(still, positions=positions))
    np.testing.assert_allclose(reference.lengths, measure_reference(still).lengths)


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
