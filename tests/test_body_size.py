"""Postures of one body on another, and what a person measures."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from skeletons import every_skeleton

from kinefilter.characters import (
    KINECT_V1,
    KINECT_V2,
    STANDARD_HEIGHT,
    Body,
    InputError,
    Skeleton,
    positions_from_rotations,
    standard_body,
)
from kinefilter.characters.rotations import about_y, normalize, rotate
from kinefilter.retarget import Standardizer, find_yaw, measured_body

Array = NDArray[np.float64]


def person(skeleton: Skeleton, seed: int, *, turned: bool = True) -> Body:
    """Return someone of odd proportions with other rest directions."""
    rng = np.random.default_rng(seed)
    body = standard_body(skeleton, height=rng.uniform(1.3, 2.0))
    lengths = body.lengths * rng.uniform(0.7, 1.4, len(skeleton))
    lengths = (lengths + lengths[skeleton.mirror]) / 2.0
    directions = body.directions
    if turned:
        directions = directions + rng.normal(0.0, 0.2, directions.shape)
        directions[skeleton.root] = 0.0
        norms = np.linalg.norm(directions, axis=1, keepdims=True)
        directions = directions / np.where(norms > 0.0, norms, 1.0)
    return Body(skeleton, body.height, body.mass, lengths, directions)


def posture(body: Body, seed: int) -> Array:
    """Return a posture of a body somewhere in the room."""
    rng = np.random.default_rng(seed)
    swing = rng.normal(0.0, 0.3, (len(body.skeleton), 4)) + np.array(
        [1.0, 0.0, 0.0, 0.0]
    )
    pose = positions_from_rotations(normalize(swing), np.zeros(3), body)
    return rotate(about_y(rng.uniform(-3.0, 3.0)), pose) + rng.normal(size=3)


def ones(body: Body) -> Array:
    return np.ones(len(body.skeleton))


# Standardizer


@settings(max_examples=40, deadline=None)
@given(
    skeleton=st.sampled_from([KINECT_V1, KINECT_V2]),
    seed=st.integers(0, 2**32 - 1),
    noise=st.sampled_from([0.0, 0.1]),
)
def test_undo_brings_any_posture_of_any_body_back(
    skeleton: Skeleton, seed: int, noise: float
) -> None:
    body = person(skeleton, seed)
    measured = posture(body, seed)
    measured += np.random.default_rng(seed).normal(0.0, noise, measured.shape)
    before = measured.copy()
    standardizer = Standardizer(body)
    standard, view = standardizer.step(measured, ones(body))
    np.testing.assert_array_equal(measured, before)
    np.testing.assert_allclose(standardizer.undo(standard, view), measured, atol=1e-12)


@every_skeleton
def test_a_posture_without_error_gets_standard_lengths_and_view(
    skeleton: Skeleton,
) -> None:
    body, ends = person(skeleton, 3, turned=False), skeleton.segments
    standard, _ = Standardizer(body).step(posture(body, 4), ones(body))
    bones = standard[ends] - standard[skeleton.segment_parents]
    np.testing.assert_allclose(
        np.linalg.norm(bones, axis=1), standard_body(skeleton).lengths[ends]
    )
    np.testing.assert_array_equal(standard[skeleton.root], 0.0)
    ordinary = standard_body(skeleton, height=1.4)
    standard, _ = Standardizer(ordinary).step(posture(ordinary, 4), ones(body))
    assert find_yaw(standard, skeleton) == pytest.approx(0.0, abs=1e-9)


@every_skeleton
def test_the_rest_posture_of_anybody_becomes_the_standard_one(
    skeleton: Skeleton,
) -> None:
    # Symmetric, so that the hips' and shoulders' lines show no yaw of their own.
    body = person(skeleton, 5)
    mirrored = body.directions[skeleton.mirror] * [-1.0, 1.0, 1.0]
    directions = body.directions + mirrored
    norms = np.linalg.norm(directions, axis=1, keepdims=True)
    directions /= np.where(norms > 0.0, norms, 1.0)
    body = Body(skeleton, body.height, body.mass, body.lengths, directions)
    standard, _ = Standardizer(body).step(body.rest_positions, ones(body))
    rest = standard_body(skeleton).rest_positions
    np.testing.assert_allclose(standard, rest - rest[skeleton.root], atol=1e-12)


@pytest.mark.parametrize("height", [1.2, 1.75, 2.0])
def test_a_wrong_elbow_leaves_the_wrist_where_it_was_on_ordinary_proportions(
    height: float,
) -> None:
    body = standard_body(KINECT_V1, height=height)
    elbow = KINECT_V1.index("ElbowLeft")
    right = posture(body, 6)
    wrong = right.copy()
    wrong[elbow] += [0.2, -0.1, 0.15]
    a, view = Standardizer(body).step(right, ones(body))
    b, _ = Standardizer(body).step(wrong, ones(body))
    moved = np.linalg.norm(a - b, axis=1)
    assert moved[elbow] == pytest.approx(
        np.linalg.norm([0.2, 0.1, 0.15]) * STANDARD_HEIGHT / height
    )
    np.testing.assert_allclose(np.delete(moved, elbow), 0.0, atol=1e-12)
    assert np.isfinite(view.yaw)


@every_skeleton
def test_missing_joints_stay_missing_and_leave_the_others_alone(
    skeleton: Skeleton,
) -> None:
    body = standard_body(skeleton, height=1.5)
    full = posture(body, 7)
    holes = full.copy()
    missing = [skeleton.index(j) for j in ("ElbowRight", "KneeLeft", "Head")]
    holes[missing] = np.nan
    whole, _ = Standardizer(body).step(full, ones(body))
    standardizer = Standardizer(body)
    partial, view = standardizer.step(holes, ones(body))
    assert np.flatnonzero(np.isnan(partial).any(axis=1)).tolist() == sorted(missing)
    rest = np.setdiff1d(np.arange(len(skeleton)), missing)
    np.testing.assert_allclose(partial[rest], whole[rest], atol=1e-12)
    back = standardizer.undo(whole, view)
    np.testing.assert_allclose(back, full, atol=1e-12)


def test_below_a_missing_joint_the_last_known_bone_serves() -> None:
    body = person(KINECT_V1, 8)
    still = posture(body, 9)
    elbow = KINECT_V1.index("ElbowLeft")
    holes = still.copy()
    holes[elbow] = np.nan
    standardizer = Standardizer(body)
    seen, _ = standardizer.step(still, ones(body))
    for _ in range(3):
        hidden, _ = standardizer.step(holes, ones(body))
        np.testing.assert_allclose(
            np.delete(hidden, elbow, axis=0), np.delete(seen, elbow, axis=0), atol=1e-12
        )


def test_a_missing_root_keeps_the_last_place() -> None:
    body = person(KINECT_V1, 10)
    pose = posture(body, 11)
    standardizer = Standardizer(body)
    whole, first = standardizer.step(pose, ones(body))
    pose = pose.copy()
    pose[KINECT_V1.root] = np.nan
    partial, view = standardizer.step(pose, ones(body))
    np.testing.assert_array_equal(view.root, first.root)
    assert np.isnan(partial[KINECT_V1.root]).all()
    np.testing.assert_allclose(partial[1:], whole[1:], atol=1e-12)


def test_a_heading_that_nothing_shows_is_that_of_the_frame_before() -> None:
    body = standard_body(KINECT_V1)
    pose = rotate(about_y(1.1), body.rest_positions)
    standardizer = Standardizer(body)
    standardizer.step(pose, ones(body))
    _, view = standardizer.step(pose + 1.0, np.zeros(20))
    assert view.yaw == pytest.approx(1.1)
    standardizer.start()
    _, view = standardizer.step(pose, np.zeros(20))
    assert view.yaw == 0.0


def test_a_frame_without_joints_gives_none_and_disturbs_nothing() -> None:
    body = person(KINECT_V1, 12)
    pose = posture(body, 13)
    standardizer = Standardizer(body)
    first, before = standardizer.step(pose, ones(body))
    empty, view = standardizer.step(np.full((20, 3), np.nan), ones(body))
    assert np.isnan(empty).all()
    np.testing.assert_array_equal(view.root, before.root)
    assert view.yaw == before.yaw
    again, _ = standardizer.step(pose, ones(body))
    np.testing.assert_array_equal(first, again)


def test_start_forgets() -> None:
    body = person(KINECT_V1, 14)
    standardizer = Standardizer(body)
    holes = posture(body, 15)
    holes[[KINECT_V1.root, KINECT_V1.index("KneeLeft")]] = np.nan
    fresh, _ = standardizer.step(holes, ones(body))
    standardizer.step(posture(body, 16) + 5.0, ones(body))
    standardizer.start()
    again, _ = standardizer.step(holes, ones(body))
    np.testing.assert_array_equal(fresh, again)


def test_a_motion_at_once_is_standardized_as_frame_by_frame() -> None:
    """With holes, and in two parts of which the second follows the first."""
    rng, body = np.random.default_rng(19), standard_body(KINECT_V1, height=1.6)
    motion = np.array([posture(body, seed) for seed in range(30)])
    motion[rng.random(motion.shape[:2]) < 0.2] = np.nan
    motion[10:12] = np.nan
    weights = rng.uniform(size=motion.shape[:2])
    one, many = Standardizer(body), Standardizer(body)
    steps = [one.step(p, w) for p, w in zip(motion, weights, strict=True)]
    parts = [many.steps(motion[k], weights[k]) for k in (np.s_[:13], np.s_[13:])]
    standard = np.concatenate([part for part, _ in parts])
    np.testing.assert_allclose(standard, [p for p, _ in steps], atol=1e-12)
    yaw = np.concatenate([view.yaw for _, view in parts])
    np.testing.assert_allclose(yaw, [view.yaw for _, view in steps], atol=1e-12)


@every_skeleton
def test_undo_takes_a_whole_motion_at_once(skeleton: Skeleton) -> None:
    body = person(skeleton, 17)
    standardizer = Standardizer(body)
    _, view = standardizer.step(posture(body, 18), ones(body))
    motion = np.random.default_rng(0).normal(size=(5, len(skeleton), 3))
    for k, frame in enumerate(motion):
        np.testing.assert_allclose(
            standardizer.undo(motion, view)[k], standardizer.undo(frame, view)
        )


# What a person measures


@every_skeleton
@pytest.mark.parametrize("height", [1.0, 1.62, 1.95])
def test_the_measured_body_of_average_lengths_is_the_average_body(
    skeleton: Skeleton, height: float
) -> None:
    expected = standard_body(skeleton, height=height)
    lengths = expected.lengths.copy()
    lengths[skeleton.root] = np.nan
    body = measured_body(skeleton, lengths, expected.directions)
    assert body.height == pytest.approx(height)
    assert body.mass == pytest.approx(expected.mass)
    np.testing.assert_allclose(body.lengths, expected.lengths)
    np.testing.assert_allclose(body.directions, expected.directions, atol=1e-15)


@settings(deadline=None)
@given(skeleton=st.sampled_from([KINECT_V1, KINECT_V2]), seed=st.integers(0, 2**32 - 1))
def test_a_measured_body_is_symmetric_and_complete(
    skeleton: Skeleton, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    average = standard_body(skeleton)
    lengths = average.lengths * rng.uniform(0.8, 1.2, len(skeleton))
    directions = average.directions + rng.normal(0.0, 0.1, (len(skeleton), 3))
    lengths[rng.random(len(skeleton)) < 0.3] = np.nan
    directions[rng.random(len(skeleton)) < 0.3] = np.nan
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    directions[skeleton.root] = np.nan
    body = measured_body(skeleton, lengths, directions)
    np.testing.assert_allclose(body.lengths, body.lengths[skeleton.mirror])
    np.testing.assert_allclose(
        body.directions,
        body.directions[skeleton.mirror] * [-1.0, 1.0, 1.0],
        atol=1e-15,
    )
    ends = skeleton.segments
    assert (body.lengths[ends] > 0.0).all()
    np.testing.assert_allclose(np.linalg.norm(body.directions[ends], axis=1), 1.0)


def test_left_and_right_share_their_mean_and_one_serves_for_both() -> None:
    i = KINECT_V1.index
    lengths = standard_body(KINECT_V1).lengths.copy()
    lengths[i("WristLeft")], lengths[i("WristRight")] = 0.24, 0.28
    lengths[i("KneeLeft")], lengths[i("KneeRight")] = 0.45, np.nan
    body = measured_body(KINECT_V1, lengths, height=1.75)
    for joint, length in {"Wrist": 0.26, "Knee": 0.45}.items():
        for side in ("Left", "Right"):
            assert body.lengths[i(joint + side)] == pytest.approx(length)


@pytest.mark.parametrize("unseen", [("Knee", "Ankle"), ("Elbow", "Wrist")])
def test_trunk_and_leg_are_2_6_times_as_long_as_an_arm(unseen: tuple[str, str]) -> None:
    i, lengths = KINECT_V1.index, 1.05 * standard_body(KINECT_V1).lengths
    lengths[[j for part in unseen for j in KINECT_V1.sides(part)]] = np.nan
    found = measured_body(KINECT_V1, lengths).lengths
    trunk = found[[i("Spine"), i("ShoulderCenter")]].sum()
    leg, arm = found[i("KneeLeft")] + found[i("AnkleLeft")], found[i("ElbowRight")]
    assert trunk + leg == pytest.approx(2.6 * (arm + found[i("WristRight")]))
    np.testing.assert_allclose(found, np.where(np.isnan(lengths), found, lengths))


@pytest.mark.parametrize(
    ("part", "factor"),
    [("Elbow", f) for f in (0.0, 0.3, 0.62, 1.61, 4.0)] + [("Hip", 0.6)],
)
def test_an_odd_limb_takes_average_proportions(part: str, factor: float) -> None:
    average = standard_body(KINECT_V1)
    lengths = average.lengths.copy()
    lengths[KINECT_V1.sides(part)] *= factor
    body = measured_body(KINECT_V1, lengths)
    np.testing.assert_allclose(body.lengths, average.lengths)


def test_the_side_within_reason_serves_for_both() -> None:
    left, right = (KINECT_V1.index(f"Shoulder{side}") for side in ("Left", "Right"))
    lengths = standard_body(KINECT_V1).lengths.copy()
    lengths[left], lengths[right] = 0.9 * lengths[left], 2.5 * lengths[right]
    body = measured_body(KINECT_V1, lengths)
    np.testing.assert_allclose(body.lengths[[left, right]], lengths[left])


@pytest.mark.parametrize(
    ("joint", "factor"),
    [("Elbow", 0.65), ("Elbow", 1.55), ("Shoulder", 0.55), ("Spine", 0.3)],
)
def test_a_limb_or_a_trunk_within_reason_is_kept(joint: str, factor: float) -> None:
    chosen = [j for j, n in enumerate(KINECT_V1.joints) if n.startswith(joint)]
    lengths = standard_body(KINECT_V1).lengths.copy()
    lengths[chosen] *= factor
    body = measured_body(KINECT_V1, lengths, height=1.75)
    np.testing.assert_allclose(body.lengths[chosen], lengths[chosen])


@pytest.mark.parametrize("angle", [40.0, 50.0, -80.0])
@pytest.mark.parametrize("part", ["Hip", "Shoulder"])
def test_sides_ahead_take_average_directions(part: str, angle: float) -> None:
    body, sides = standard_body(KINECT_V1), KINECT_V1.sides(part)
    directions, turn = body.directions.copy(), np.radians(angle)
    directions[sides, 0] *= np.cos(turn)
    directions[sides, 2] = np.sin(turn)
    found = measured_body(KINECT_V1, body.lengths, directions).directions
    np.testing.assert_allclose(found, directions if angle == 40.0 else body.directions)


@pytest.mark.parametrize(
    ("skeleton", "stack"),
    [
        (KINECT_V1, "Head ShoulderCenter Spine KneeLeft AnkleLeft"),
        (KINECT_V2, "Head Neck SpineShoulder SpineMid KneeLeft AnkleLeft"),
    ],
)
def test_stature_is_stacked_from_head_to_ankle(skeleton: Skeleton, stack: str) -> None:
    average = standard_body(skeleton).lengths
    upright = np.isin(skeleton.joints, stack.split())
    upright |= upright[skeleton.mirror]
    lengths = np.where(upright, 0.9 * average, 1.2 * average)
    assert measured_body(skeleton, lengths).height == pytest.approx(0.9 * 1.75)
    lengths[skeleton.index("Head")] = np.nan
    assert measured_body(skeleton, lengths).height == pytest.approx(0.9 * 1.75)
    unknown = np.full(len(skeleton), np.nan)
    assert measured_body(skeleton, unknown).height == STANDARD_HEIGHT


def test_stature_counts_trunk_and_leg_by_their_lengths() -> None:
    average = standard_body(KINECT_V1).lengths
    legs = [KINECT_V1.index(f"{part}Left") for part in ("Knee", "Ankle")]
    legs += [KINECT_V1.index(f"{part}Right") for part in ("Knee", "Ankle")]
    lengths = average.copy()
    lengths[legs] *= 0.8
    trunk = [KINECT_V1.index(part) for part in ("Head", "ShoulderCenter", "Spine")]
    stack, leg = average[trunk].sum(), average[legs[:2]].sum()
    expected = 1.75 * (stack + 0.8 * leg) / (stack + leg)
    assert measured_body(KINECT_V1, lengths).height == pytest.approx(expected)


def test_a_given_stature_and_mass_are_kept() -> None:
    lengths = standard_body(KINECT_V1, height=1.6).lengths
    body = measured_body(KINECT_V1, lengths, height=1.7, mass=90.0)
    assert (body.height, body.mass) == (1.7, 90.0)
    np.testing.assert_allclose(body.lengths, lengths)
    assert body.masses.sum() == pytest.approx(90.0)


def test_lengths_in_another_unit_are_refused_naming_where_they_came_from() -> None:
    lengths = 100.0 * standard_body(KINECT_V1).lengths
    with pytest.raises(InputError, match=r"^a\.csv: .*175 m.*by 100$"):
        measured_body(KINECT_V1, lengths, source="a.csv")


@pytest.mark.parametrize("wrong", [{"height": 17.0}, {"height": 1.7, "mass": 0.0}])
def test_absurd_statures_and_masses_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(InputError):
        measured_body(KINECT_V1, np.full(20, np.nan), **wrong)
