"""Segment rotations from joint positions, twist included."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from skeletons import every_skeleton

from kinefilter.characters import (
    KINECT_V1,
    KINECT_V2,
    Body,
    Skeleton,
    positions_from_rotations,
    standard_body,
)
from kinefilter.characters.rotations import (
    IDENTITY,
    about_y,
    about_z,
    inverse,
    multiply,
    normalize,
    rotate,
    rotation_vector,
)
from kinefilter.retarget import (
    Hinges,
    fill_missing_joints,
    rotations_from_positions,
)
from kinefilter.scenes.library import perform

Array = NDArray[np.float64]


def wild(skeleton: Skeleton, seed: int, frames: int = 3) -> Array:
    rng = np.random.default_rng(seed)
    return normalize(rng.normal(size=(frames, len(skeleton), 4)))


def twist(axes: Array, angle: float) -> Array:
    cosine = np.full((*axes.shape[:-1], 1), np.cos(angle / 2))
    return np.concatenate([cosine, np.sin(angle / 2) * axes], axis=-1)


def assert_same_rotations(a: Array, b: Array, atol: float = 1e-7) -> None:
    away = np.linalg.norm(rotation_vector(multiply(a, inverse(b))), axis=-1)
    np.testing.assert_allclose(away, 0.0, atol=atol)


def leaning(skeleton: Skeleton) -> Body:
    """Return a body whose spine rests 0.4 rad forward, as some sensors have it."""
    body = standard_body(skeleton)
    lean = twist(np.array([1.0, 0.0, 0.0]), 0.4)
    spine = np.array([*skeleton.children[skeleton.root], skeleton.girdle])[:, None]
    directions = body.directions.copy()
    directions[spine] = rotate(lean, directions[spine])
    return replace(body, directions=directions)


@settings(max_examples=30, deadline=None)
@given(
    skeleton=st.sampled_from([KINECT_V1, KINECT_V2]),
    seed=st.integers(0, 2**32 - 1),
    made=st.sampled_from([standard_body, leaning]),
)
def test_forward_kinematics_gives_the_positions_back(
    skeleton: Skeleton, seed: int, made: Callable[[Skeleton], Body]
) -> None:
    body = made(skeleton)
    root = np.random.default_rng(seed).normal(size=(3, 3))
    positions = positions_from_rotations(wild(skeleton, seed), root, body)
    rotations = rotations_from_positions(positions, body)
    np.testing.assert_allclose(np.linalg.norm(rotations, axis=-1), 1.0)
    again = positions_from_rotations(rotations, root, body)
    np.testing.assert_allclose(again, positions, atol=1e-4)


@every_skeleton
def test_a_performance_goes_through_positions_and_back(skeleton: Skeleton) -> None:
    act = perform("punch", standard_body(skeleton), seed=0)
    rotations = rotations_from_positions(act.positions, act.body)
    root = act.positions[:, skeleton.root]
    again = positions_from_rotations(rotations, root, act.body)
    np.testing.assert_allclose(again, act.positions, atol=1e-9)


@every_skeleton
@pytest.mark.parametrize(
    ("part", "sign", "most"), [("Elbow", 1.0, 80.0), ("Knee", -1.0, 30.0)]
)
@pytest.mark.parametrize("side", ["Left", "Right"])
def test_elbows_and_knees_are_hinges(
    skeleton: Skeleton, part: str, side: str, sign: float, most: float
) -> None:
    """However an upper segment is twisted, its limb's bend tells: here."""
    body = standard_body(skeleton)
    upper = skeleton.index(part + side)
    beyond = skeleton.descendants(upper)
    along, ahead = body.directions[upper], np.array([0.0, 0.0, sign])
    for twisted in np.radians(most) * np.array([-1.0, -0.4, 0.0, 0.6, 1.0]):
        posed = np.tile(IDENTITY, (len(skeleton), 1))
        posed[[upper, *beyond]] = twist(along, twisted)
        axis = rotate(posed[upper], np.cross(along, ahead))
        posed[beyond] = multiply(twist(axis, np.radians(90.0)), posed[beyond])
        positions = positions_from_rotations(posed, np.zeros(3), body)
        found = rotations_from_positions(positions, body)
        away = rotation_vector(multiply(inverse(found[upper]), posed[upper]))
        # Less than half of what positions show bent by 18 degrees, or by toes.
        assert np.linalg.norm(away) < 0.12 * abs(twisted) + 1e-9
        np.testing.assert_allclose(np.cross(away, along), 0.0, atol=1e-9)
        shank = multiply(inverse(found[upper]), found[beyond[0]])
        np.testing.assert_allclose(
            rotation_vector(shank), np.pi / 2 * np.cross(along, ahead), atol=0.25
        )


@every_skeleton
def test_folded_and_overstretched_arms_do_not_spin(skeleton: Skeleton) -> None:
    """A forearm passes the upper arm, and an elbow bends backward a little."""
    body, upper = standard_body(skeleton), skeleton.index("ElbowLeft")
    beyond = skeleton.descendants(upper)
    for start, end in ((160.0, 178.0), (-12.0, 12.0)):
        posed = np.tile(IDENTITY, (200, len(skeleton), 1))
        bend = np.radians(np.linspace(start, end, 200))
        aside = np.radians(np.linspace(-3.0, 3.0, 200))
        posed[:, beyond] = multiply(about_y(-bend), about_z(aside))[:, None]
        positions = positions_from_rotations(posed, np.zeros((200, 3)), body)
        found = rotations_from_positions(positions, body)[:, [upper, beyond[0]]]
        turned = rotation_vector(multiply(inverse(found[:-1]), found[1:]))
        assert np.degrees(np.abs(turned[..., 0])).max() < 2.0


@every_skeleton
@pytest.mark.parametrize("name", ["walk", "squat", "punch"])
def test_limbs_of_performers_are_twisted_as_they_are(
    name: str, skeleton: Skeleton
) -> None:
    """The performers' elbows and knees are hinges."""
    act = perform(name, standard_body(skeleton), seed=2)
    found = rotations_from_positions(act.positions, act.body)
    for upper, lower in (("Elbow", "Wrist"), ("Knee", "Ankle")):
        for up, low in zip(skeleton.sides(upper), skeleton.sides(lower), strict=True):
            axes = act.body.directions[[up, low]]
            above, below = np.moveaxis(rotate(act.rotations[:, [up, low]], axes), 1, 0)
            bent = np.vecdot(above, below) < np.cos(np.radians(40.0))
            away = multiply(inverse(found[:, up]), act.rotations[:, up])
            away = np.linalg.norm(rotation_vector(away), axis=-1)[bent]
            assert np.degrees(np.median(away)) < 12.0 if bent.sum() > 9 else True


@every_skeleton
def test_the_chest_turns_with_the_shoulders(skeleton: Skeleton) -> None:
    body, chest = standard_body(skeleton), skeleton.girdle
    turned = [chest, *skeleton.descendants(chest)]
    posed = np.tile(IDENTITY, (len(skeleton), 1))
    posed[turned] = about_y(0.6)
    positions = positions_from_rotations(posed, np.zeros(3), body)
    found = rotations_from_positions(positions, body)
    assert_same_rotations(found[turned], posed[turned])
    assert_same_rotations(found[skeleton.parents[chest]], about_y(0.3))


@every_skeleton
def test_standing_feet_are_level(skeleton: Skeleton) -> None:
    """Whatever way the legs lean; others follow their shanks."""
    body, hinges = standard_body(skeleton), Hinges(standard_body(skeleton))
    posed = np.tile(twist(np.array([0.0, 0.0, 1.0]), 0.4), (len(skeleton), 1))
    positions = positions_from_rotations(posed, np.zeros(3), body)
    plain = hinges.untwisted(positions)
    bends = hinges.bends(positions, plain)
    found = hinges.twisted(positions, plain, bends, np.array([1.0, 0.0]))
    left, right = skeleton.sides("Foot")
    across = rotate(found, np.array([1.0, 0.0, 0.0]))
    assert across[left, 1] == pytest.approx(0.0, abs=1e-9)
    assert_same_rotations(found[right], posed[right])
    again = positions_from_rotations(found, np.zeros(3), body)
    np.testing.assert_allclose(again, positions, atol=1e-9)


@every_skeleton
@pytest.mark.parametrize("yaw", [0.0, 1.0, -2.5, np.pi])
def test_the_turned_rest_posture_has_the_same_turn_everywhere(
    skeleton: Skeleton, yaw: float
) -> None:
    body = standard_body(skeleton)
    rotations = rotations_from_positions(
        rotate(about_y(yaw), body.rest_positions), body
    )
    assert_same_rotations(rotations, np.broadcast_to(about_y(yaw), rotations.shape))


def test_the_twist_of_straight_limbs_follows_the_parent() -> None:
    body, i = standard_body(KINECT_V1), KINECT_V1.index
    posed = np.tile(IDENTITY, (20, 1))
    x = np.array([1.0, 0.0, 0.0])
    bend = twist(np.array([0.0, 0.0, 1.0]), 0.9)
    for joint in ("ElbowLeft", "WristLeft", "HandLeft"):
        posed[i(joint)] = bend
    positions = positions_from_rotations(posed, np.zeros(3), body)
    assert_same_rotations(rotations_from_positions(positions, body), posed)
    # Turned about its own axis the forearm lies as before: positions cannot tell.
    posed[i("WristLeft")] = multiply(bend, twist(x, 0.5))
    np.testing.assert_allclose(
        positions_from_rotations(posed, np.zeros(3), body), positions, atol=1e-12
    )


@every_skeleton
@pytest.mark.parametrize("name", ["walk", "bend", "squat"])
def test_the_pelvis_of_a_performance_is_found(name: str, skeleton: Skeleton) -> None:
    act = perform(name, standard_body(skeleton), seed=0)
    rotations = rotations_from_positions(act.positions, act.body)[:, skeleton.root]
    left, right = skeleton.index("HipLeft"), skeleton.index("HipRight")
    across = act.positions[:, left] - act.positions[:, right]
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    np.testing.assert_allclose(
        rotate(rotations, np.array([1.0, 0.0, 0.0])), across, atol=1e-9
    )
    root, spine = (
        act.positions[:, skeleton.root],
        skeleton.index("Spine" if skeleton is KINECT_V1 else "SpineMid"),
    )
    forward = rotate(rotations, np.array([0.0, 0.0, 1.0]))
    up = act.positions[:, spine] - root
    np.testing.assert_allclose(np.sum(forward * up, axis=1), 0.0, atol=1e-9)
    assert (np.sum(rotate(rotations, np.array([0.0, 1.0, 0.0])) * up, axis=1) > 0).all()


@every_skeleton
def test_a_posture_folded_to_a_point_has_rotations_all_the_same(
    skeleton: Skeleton,
) -> None:
    body = standard_body(skeleton)
    rotations = rotations_from_positions(np.zeros((len(skeleton), 3)), body)
    np.testing.assert_array_equal(rotations, np.tile(IDENTITY, (len(skeleton), 1)))


@pytest.mark.parametrize("shape", [(), (1,), (4,), (2, 3)])
def test_leading_axes_pass_through(shape: tuple[int, ...]) -> None:
    body = standard_body(KINECT_V1)
    rng = np.random.default_rng(8)
    count = int(np.prod(shape))
    posed = normalize(rng.normal(size=(count, 20, 4)))
    flat = positions_from_rotations(posed, rng.normal(size=(count, 3)), body)
    rotations = rotations_from_positions(flat.reshape(*shape, 20, 3), body)
    assert rotations.shape == (*shape, 20, 4)
    rows = rotations.reshape(count, 20, 4)
    for k in range(count):
        single = rotations_from_positions(flat[k], body)
        np.testing.assert_allclose(rows[k], single, atol=1e-12)


@every_skeleton
@pytest.mark.parametrize("made", [standard_body, leaning])
def test_hips_and_spine_in_a_line_leave_the_pelvis_as_at_rest(
    skeleton: Skeleton, made: Callable[[Skeleton], Body]
) -> None:
    body, root = made(skeleton), skeleton.root
    line, zero = np.array([0.1, -0.2, 0.3]), np.zeros(3)
    hips = [skeleton.index("HipLeft"), skeleton.index("HipRight")]
    (spine,) = (j for j in skeleton.children[root] if j not in hips)
    for across, up in ((line, 2.0 * line), (zero, line), (line, zero), (zero, zero)):
        posture = np.zeros((len(skeleton), 3))
        posture[hips], posture[spine] = [across, -across], up
        rotations = rotations_from_positions(posture, body)
        np.testing.assert_array_equal(rotations[root], IDENTITY)


@every_skeleton
def test_what_is_missing_hangs_on_its_parent_as_at_rest(skeleton: Skeleton) -> None:
    body = standard_body(skeleton)
    missing = {skeleton.index(j) for j in ("WristLeft", "FootRight", "Head")}
    gone = [j for j in skeleton.order if {j, skeleton.parents[j]} & missing]
    gone += [c for j in gone for c in skeleton.children[j] if c not in gone]
    root = np.zeros((4, 3))
    whole = positions_from_rotations(wild(skeleton, 10, 4), root, body)
    holed = whole.copy()
    holed[1:, gone] = np.nan
    turns = rotations_from_positions(holed, body)
    for j in gone:
        turns[1:, j] = turns[1:, skeleton.parents[j]]
    expected = positions_from_rotations(turns, root, body)
    hung = fill_missing_joints(holed, body)
    np.testing.assert_allclose(hung, expected, atol=1e-7)
    np.testing.assert_array_equal(hung[0], whole[0])
    assert np.isnan(holed[1:, gone]).all()


@every_skeleton
def test_a_missing_joint_leaves_its_segments_unknown_and_no_other(
    skeleton: Skeleton,
) -> None:
    body, elbow = standard_body(skeleton), skeleton.index("ElbowLeft")
    positions = body.rest_positions.copy()
    whole = rotations_from_positions(positions, body)
    positions[elbow] = np.nan
    rotations = rotations_from_positions(positions, body)
    unknown = np.isnan(rotations).any(axis=1)
    assert set(np.flatnonzero(unknown)) == {elbow, *skeleton.descendants(elbow)}
    np.testing.assert_array_equal(rotations[~unknown], whole[~unknown])


def test_angles_do_not_depend_on_where_memory_lies(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of a view whose memory ends where the result's begins numpy rounds otherwise."""
    seen: list[bool] = []

    def arctan2(*sides: Array) -> Array:
        seen.extend(side.flags.c_contiguous for side in sides)
        return np.asarray(original(*sides))

    original = np.arctan2
    monkeypatch.setattr(np, "arctan2", arctan2)
    act = perform("wave", standard_body(KINECT_V1), seed=1)
    rotations_from_positions(act.positions, act.body)
    assert seen
    assert all(seen)
