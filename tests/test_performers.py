"""Scripted performers: bodies that move as people do."""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray
from skeletons import every_skeleton

from kinefilter.characters import (
    KINECT_V1,
    KINECT_V2,
    InputError,
    Motion,
    Skeleton,
    positions_from_rotations,
    standard_body,
)
from kinefilter.characters.rotations import inverse, rotate
from kinefilter.scenes.library import MOTIONS, perform, perform_medley

Array = NDArray[np.float64]
SEEDS = {KINECT_V1: range(2), KINECT_V2: range(1)}  # both share the motion
STANDING = sorted(
    set(MOTIONS)
    - {"carry", "kick", "lunge", "march", "raise_leg", "run", "step_over", "turn"}
    - {"walk", "basketball", "bend_leg", "chair", "dance", "golf_swing", "jump"}
    - {"hurdle_step", "inline_lunge", "leg_raise", "side_lunge", "tai_chi"}
)

every_motion = pytest.mark.parametrize("name", MOTIONS)


@cache
def performance(name: str, skeleton: Skeleton, seed: int) -> Motion:
    return perform(name, standard_body(skeleton), seed=seed)


def performances(name: str, skeleton: Skeleton) -> list[Motion]:
    return [performance(name, skeleton, seed) for seed in SEEDS[skeleton]]


@every_skeleton
@every_motion
def test_rotations_and_root_give_the_positions_with_constant_bones(
    name: str, skeleton: Skeleton
) -> None:
    for p in performances(name, skeleton):
        root = p.positions[:, skeleton.root]
        rebuilt = positions_from_rotations(p.rotations, root, p.body)
        np.testing.assert_allclose(rebuilt, p.positions, atol=1e-12)
        np.testing.assert_allclose(np.linalg.norm(p.rotations, axis=-1), 1.0)
        bones = (
            p.positions[:, skeleton.segments] - p.positions[:, skeleton.segment_parents]
        )
        lengths = np.linalg.norm(bones, axis=-1)
        expected = np.broadcast_to(p.body.lengths[skeleton.segments], lengths.shape)
        np.testing.assert_allclose(lengths, expected, atol=1e-9)


def hinge_angle(
    p: Motion, upper: str, lower: str, bone: ArrayLike, axis: ArrayLike
) -> tuple[Array, Array]:
    """Signed turn of the lower bone about an axis of the upper segment, and the tilt
    of the lower bone out of the plane across that axis."""
    index = p.skeleton.index
    start, end = p.positions[:, index(upper)], p.positions[:, index(lower)]
    local = rotate(inverse(p.rotations[:, index(upper)]), end - start)
    local /= np.linalg.norm(local, axis=-1, keepdims=True)
    bone, axis = np.array(bone, float), np.array(axis, float)
    turn = np.arctan2(local @ np.cross(axis, bone), local @ bone)
    return np.degrees(turn), np.degrees(np.arcsin(np.clip(local @ axis, -1, 1)))


@every_skeleton
@every_motion
def test_knees_and_elbows_bend_the_right_way_about_one_axis(
    name: str, skeleton: Skeleton
) -> None:
    hinges = [
        ("KneeLeft", "AnkleLeft", (0, -1, 0), (1, 0, 0), 146.0),
        ("KneeRight", "AnkleRight", (0, -1, 0), (1, 0, 0), 146.0),
        ("ElbowLeft", "WristLeft", (1, 0, 0), (0, -1, 0), 151.0),
        ("ElbowRight", "WristRight", (-1, 0, 0), (0, 1, 0), 151.0),
    ]
    for p in performances(name, skeleton):
        for upper, lower, bone, axis, most in hinges:
            turn, tilt = hinge_angle(p, upper, lower, bone, axis)
            assert turn.min() > -0.1, upper
            assert turn.max() < most, upper
            assert np.abs(tilt).max() < 0.1, upper


@every_skeleton
@every_motion
def test_no_part_of_the_body_is_under_the_floor(name: str, skeleton: Skeleton) -> None:
    for p in performances(name, skeleton):
        for j, parent in zip(skeleton.segments, skeleton.segment_parents, strict=True):
            lowest = p.positions[:, [j, parent], 1].min() - p.body.radii[j]
            assert lowest > -0.01, skeleton.joints[j]


@every_skeleton
@every_motion
def test_no_joint_is_faster_than_a_human(name: str, skeleton: Skeleton) -> None:
    for p in performances(name, skeleton):
        steps = np.linalg.norm(np.diff(p.positions, axis=0), axis=-1)
        speed = steps / np.diff(p.time)[:, None]
        assert 0.05 < speed.max() < 12.0


@pytest.mark.parametrize("name", STANDING)
def test_feet_do_not_slide_in_motions_that_stand(name: str) -> None:
    for p in performances(name, KINECT_V1):
        for foot in ("AnkleLeft", "FootLeft", "AnkleRight", "FootRight"):
            track = p.positions[:, KINECT_V1.index(foot)]
            assert np.ptp(track, axis=0).max() < 0.003, foot


@pytest.mark.parametrize("name", ["walk", "carry", "run", "march", "turn", "lunge"])
def test_toes_on_the_floor_do_not_slide_in_motions_that_step(name: str) -> None:
    for p in performances(name, KINECT_V1):
        for foot in ("FootLeft", "FootRight"):
            j = KINECT_V1.index(foot)
            track, sole = p.positions[:, j], p.positions[:, j, 1] - p.body.radii[j]
            standing = (sole[1:] < 1e-3) & (sole[:-1] < 1e-3)
            slide = np.linalg.norm(np.diff(track[:, [0, 2]], axis=0), axis=-1)
            assert standing.mean() > 0.2
            assert np.quantile(slide[standing], 0.95) < 0.003


@pytest.mark.parametrize("name", STANDING)
def test_the_character_stands_upright_facing_forward_with_its_left_at_plus_x(
    name: str,
) -> None:
    for p in performances(name, KINECT_V1):
        first = p.positions[0]
        left, right = (
            first[KINECT_V1.index(f"Shoulder{s}")] for s in ("Left", "Right")
        )
        toes = first[KINECT_V1.index("FootLeft")] - first[KINECT_V1.index("AnkleLeft")]
        assert left[0] - right[0] > 0.3
        assert toes[2] > 0.08
        assert first[KINECT_V1.index("Head"), 1] > 1.5


@every_motion
def test_forearms_and_hands_stay_outside_the_trunk(name: str) -> None:
    i = KINECT_V1.index
    for p in performances(name, KINECT_V1):
        x, radii = p.positions, p.body.radii
        for side in ("Left", "Right"):
            chain = [x[:, i(f"{part}{side}")] for part in ("Elbow", "Wrist", "Hand")]
            for a, b in pairwise(chain):
                points = a + np.linspace(0, 1, 5)[:, None, None] * (b - a)
                for end in ("Spine", "ShoulderCenter"):
                    start = x[:, KINECT_V1.parents[i(end)]]
                    gap = distance_to_segment(points, start, x[:, i(end)])
                    assert gap.min() > radii[i(end)], (side, end)


def distance_to_segment(points: Array, start: Array, end: Array) -> Array:
    along = end - start
    share = np.sum((points - start) * along, -1) / np.sum(along * along, -1)
    nearest = start + np.clip(share, 0.0, 1.0)[..., None] * along
    return np.asarray(np.linalg.norm(points - nearest, axis=-1))


@every_motion
def test_a_seed_fixes_the_performance_and_another_changes_it(name: str) -> None:
    body = standard_body(KINECT_V1)
    first, again = performance(name, KINECT_V1, 0), perform(name, body, seed=0)
    np.testing.assert_array_equal(first.positions, again.positions)
    np.testing.assert_array_equal(first.rotations, again.rotations)
    other = performance(name, KINECT_V1, 1)
    frames = min(len(first), len(other))
    assert np.abs(first.positions[:frames] - other.positions[:frames]).max() > 0.05


@every_motion
def test_both_skeletons_share_the_motion(name: str) -> None:
    v1, v2 = performance(name, KINECT_V1, 0), performance(name, KINECT_V2, 0)
    for joint in ("KneeLeft", "WristLeft", "WristRight", "AnkleRight"):
        a = v1.positions[:, KINECT_V1.index(joint)]
        b = v2.positions[:, KINECT_V2.index(joint)]
        np.testing.assert_allclose(a, b, atol=1e-9)


@pytest.mark.parametrize("height", [1.2, 2.0])
@every_motion
def test_small_and_tall_bodies_perform_too(name: str, height: float) -> None:
    p = perform(name, standard_body(KINECT_V1, height=height), seed=0)
    assert np.isfinite(p.positions).all()
    assert (p.positions[:, :, 1] - p.body.radii).min() > -0.01


def test_an_unknown_motion_is_refused_with_the_known_names() -> None:
    body = standard_body(KINECT_V1)
    with pytest.raises(InputError, match=r"moonwalk.*cross_arms"):
        perform("moonwalk", body, seed=0)
    with pytest.raises(InputError, match=r"'walk' does not stay on the spot.*wave"):
        perform_medley([("walk", 1.0)], body, seed=0)
    with pytest.raises(InputError, match="at least one"):
        perform_medley([], body, seed=0)
