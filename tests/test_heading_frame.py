"""Translation and yaw out of a posture, and back."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from skeletons import every_skeleton

from kinefilter.characters import (
    KINECT_V1,
    Skeleton,
    positions_from_rotations,
    standard_body,
)
from kinefilter.characters.rotations import about_y, normalize, rotate
from kinefilter.retarget import HeadingFrame, find_yaw

Array = NDArray[np.float64]

yaws = st.floats(-np.pi + 1e-6, np.pi - 1e-6)


def turned_t_pose(skeleton: Skeleton, yaw: float) -> Array:
    return rotate(about_y(yaw), standard_body(skeleton).rest_positions)


def sides(skeleton: Skeleton, *parts: str) -> list[int]:
    return [skeleton.index(p + s) for p in parts for s in ("Left", "Right")]


@every_skeleton
@given(yaw=yaws)
def test_the_yaw_of_a_turned_t_pose_is_the_turn(skeleton: Skeleton, yaw: float) -> None:
    weights = np.ones(len(skeleton))
    found = find_yaw(turned_t_pose(skeleton, yaw), skeleton, weights)
    assert float(found) == pytest.approx(yaw, abs=1e-9)


def test_someone_who_faces_plus_x_has_turned_a_quarter_to_the_left() -> None:
    pose = turned_t_pose(KINECT_V1, np.pi / 2)
    toes = pose[KINECT_V1.index("FootLeft")] - pose[KINECT_V1.index("AnkleLeft")]
    assert toes[0] > 0.1
    assert find_yaw(pose, KINECT_V1) == pytest.approx(np.pi / 2)


@pytest.mark.parametrize("missing", ["Hip", "Shoulder"])
@pytest.mark.parametrize("how", ["nan", "no trust"])
def test_hips_or_shoulders_alone_show_the_yaw(missing: str, how: str) -> None:
    pose, weights = turned_t_pose(KINECT_V1, 0.7), np.ones(20)
    (left, _) = sides(KINECT_V1, missing)
    if how == "nan":
        pose[left] = np.nan
    else:
        weights[left] = 0.0
        pose[left] += 100.0
    assert find_yaw(pose, KINECT_V1, weights) == pytest.approx(0.7)


def test_yaw_is_nan_where_nothing_shows_it() -> None:
    poses = np.tile(turned_t_pose(KINECT_V1, 0.4), (5, 1, 1))
    weights = np.ones((5, 20))
    left_hip, _, _, right_shoulder = sides(KINECT_V1, "Hip", "Shoulder")
    poses[1, [left_hip, right_shoulder]] = np.nan
    weights[2] = 0.0
    poses[3] = np.nan
    # Lying on the side: left is straight over right.
    poses[4] = rotate(
        Rotation.from_euler("z", np.pi / 2).as_quat(scalar_first=True),
        turned_t_pose(KINECT_V1, 0.0),
    )
    yaw = find_yaw(poses, KINECT_V1, weights)
    assert yaw[0] == pytest.approx(0.4)
    assert np.isnan(yaw[1:]).all()


def test_yaw_does_not_depend_on_place_tilt_forward_or_other_joints() -> None:
    rng = np.random.default_rng(0)
    pose = standard_body(KINECT_V1).rest_positions
    bow = Rotation.from_euler("x", 1.2).as_quat(scalar_first=True)
    pose = rotate(about_y(-2.0), rotate(bow, pose)) + np.array([3.0, -1.0, 2.0])
    used = sides(KINECT_V1, "Hip", "Shoulder")
    others = np.setdiff1d(np.arange(20), used)
    pose[others] += rng.normal(size=(len(others), 3))
    assert find_yaw(pose, KINECT_V1) == pytest.approx(-2.0)


def test_the_yaw_leans_to_the_line_with_more_trust() -> None:
    hips, shoulders = (sides(KINECT_V1, part) for part in ("Hip", "Shoulder"))
    pose = standard_body(KINECT_V1).rest_positions.copy()
    pose[hips] = rotate(about_y(0.6), pose[hips])
    yaws = []
    for confidence in (0.0, 0.5, 1.0):
        weights = np.zeros(20)
        weights[hips], weights[shoulders] = 1.0, confidence
        yaws.append(float(find_yaw(pose, KINECT_V1, weights)))
    assert yaws[0] == pytest.approx(0.6)
    assert yaws[0] > yaws[1] > yaws[2] > 0.0


@given(
    seed=st.integers(0, 2**32 - 1),
    shape=st.sampled_from([(), (1,), (6,), (2, 3)]),
)
def test_restore_undoes_remove_for_any_shape(seed: int, shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(seed)
    view = HeadingFrame(rng.normal(size=(*shape, 3)), rng.uniform(-4.0, 4.0, shape))
    positions = rng.normal(size=(*shape, 20, 3))
    positions[..., 7, :] = np.nan
    before = positions.copy()
    seen = view.remove(positions)
    np.testing.assert_array_equal(positions, before)
    np.testing.assert_allclose(view.restore(seen), positions, atol=1e-12)
    np.testing.assert_allclose(view.remove(view.restore(seen)), seen, atol=1e-12)


@every_skeleton
def test_remove_leaves_the_root_at_the_origin_facing_forward(
    skeleton: Skeleton,
) -> None:
    yaw = np.array([0.3, -3.0, 2.0])
    poses = rotate(
        about_y(yaw)[:, None], standard_body(skeleton).rest_positions
    ) + np.array([1.0, 2.0, 3.0])
    found = find_yaw(poses, skeleton)
    seen = HeadingFrame(poses[:, skeleton.root], found).remove(poses)
    np.testing.assert_allclose(seen[:, skeleton.root], 0.0, atol=1e-12)
    np.testing.assert_allclose(find_yaw(seen, skeleton), 0.0, atol=1e-12)
    np.testing.assert_allclose(seen, np.broadcast_to(seen[0], seen.shape), atol=1e-12)


def test_rotations_and_positions_are_restored_alike() -> None:
    rng = np.random.default_rng(1)
    body = standard_body(KINECT_V1)
    rotations = normalize(rng.normal(size=(4, 20, 4)))
    view = HeadingFrame(rng.normal(size=(4, 3)), rng.uniform(-3.0, 3.0, 4))
    seen = positions_from_rotations(rotations, np.zeros((4, 3)), body)
    again = positions_from_rotations(view.restore_rotations(rotations), view.root, body)
    np.testing.assert_allclose(again, view.restore(seen), atol=1e-12)
