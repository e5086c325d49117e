"""Bodies of given height and mass."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation
from skeletons import every_skeleton

from kinefilter.characters import (
    KINECT_V1,
    KINECT_V2,
    STANDARD_HEIGHT,
    InputError,
    Skeleton,
    standard_body,
)
from kinefilter.characters.anthropometry import joint_range, within_ranges
from kinefilter.characters.arrays import Array
from kinefilter.scenes.library import random_body

skeletons = st.sampled_from([KINECT_V1, KINECT_V2])
heights = st.floats(0.6, 2.4)
LEFT_RIGHT = np.array([-1.0, 1.0, 1.0])


@given(skeleton=skeletons, height=heights, mass=st.floats(10.0, 200.0))
def test_masses_sum_to_the_body_mass_and_are_all_positive(
    skeleton: Skeleton, height: float, mass: float
) -> None:
    body = standard_body(skeleton, height=height, mass=mass)
    assert body.masses.sum() == pytest.approx(mass)
    assert (body.masses > 0.0).all()


@given(skeleton=skeletons, height=heights)
def test_lengths_and_rest_posture_scale_with_height(
    skeleton: Skeleton, height: float
) -> None:
    mass = 70.0
    scale = height / STANDARD_HEIGHT
    body = standard_body(skeleton, height=height, mass=mass * scale**3)
    standard = standard_body(skeleton, mass=mass)
    np.testing.assert_allclose(body.lengths, standard.lengths * scale)
    np.testing.assert_allclose(body.radii, standard.radii * scale)
    np.testing.assert_allclose(
        body.rest_positions, standard.rest_positions * scale, atol=1e-12
    )


@every_skeleton
def test_left_and_right_are_equal(skeleton: Skeleton) -> None:
    body = standard_body(skeleton)
    for values in (body.lengths, body.masses, body.radii):
        np.testing.assert_array_equal(values, values[skeleton.mirror])


@every_skeleton
def test_the_rest_posture_is_symmetric(skeleton: Skeleton) -> None:
    rest = standard_body(skeleton).rest_positions
    np.testing.assert_allclose(rest[skeleton.mirror] * LEFT_RIGHT, rest, atol=1e-15)


@every_skeleton
@pytest.mark.parametrize("height", [0.8, 1.75, 2.2])
def test_the_rest_posture_stands_on_the_floor_facing_forward(
    skeleton: Skeleton, height: float
) -> None:
    body = standard_body(skeleton, height=height)
    rest, i = body.rest_positions, skeleton.index
    capsules = body.radii[skeleton.segments]
    ends = rest[skeleton.segments, 1] - capsules
    starts = rest[skeleton.segment_parents, 1] - capsules
    assert min(ends.min(), starts.min()) == pytest.approx(0.0, abs=1e-12)
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        foot = i(f"Foot{side}")
        assert rest[foot, 1] - body.radii[foot] == pytest.approx(0.0, abs=1e-12)
        assert rest[foot, 2] - rest[i(f"Ankle{side}"), 2] > 0.05 * height
        assert sign * rest[i(f"Hand{side}"), 0] > 0.4 * height
    np.testing.assert_array_equal(rest[skeleton.root, [0, 2]], 0.0)
    assert np.argmax(rest[:, 1]) == i("Head")
    assert 0.9 * height < rest[i("Head"), 1] < height


@every_skeleton
def test_the_rest_posture_has_the_lengths_and_directions(skeleton: Skeleton) -> None:
    body = standard_body(skeleton)
    ends = skeleton.segments
    bones = body.rest_positions[ends] - body.rest_positions[skeleton.segment_parents]
    np.testing.assert_allclose(np.linalg.norm(bones, axis=1), body.lengths[ends])
    np.testing.assert_allclose(np.linalg.norm(body.directions[ends], axis=1), 1.0)
    np.testing.assert_allclose(bones, body.rest_offsets[ends], atol=1e-12)
    for values in (body.lengths, body.directions, body.rest_offsets):
        assert not values[skeleton.root].any()


def test_both_skeletons_share_limbs_trunk_and_stature() -> None:
    v1, v2 = standard_body(KINECT_V1), standard_body(KINECT_V2)
    shared = set(KINECT_V1.joints) & set(KINECT_V2.joints)
    assert len(shared) == 17
    for joint in shared - {"Head"}:
        a, b = KINECT_V1.index(joint), KINECT_V2.index(joint)
        np.testing.assert_allclose(v1.rest_positions[a], v2.rest_positions[b])
    head = [
        b.rest_positions[b.skeleton.index("Head"), 1] / STANDARD_HEIGHT
        for b in (v1, v2)
    ]
    assert head[0] == pytest.approx(head[1], abs=0.003)
    assert v1.masses[KINECT_V1.root] == pytest.approx(v2.masses[KINECT_V2.root])


@every_skeleton
def test_mass_follows_from_height_at_an_ordinary_body_mass_index(
    skeleton: Skeleton,
) -> None:
    for height in (1.5, 2.0):
        assert standard_body(skeleton, height=height).mass == pytest.approx(
            22.0 * height**2
        )


@every_skeleton
def test_limbs_are_cylinders_of_their_mass_at_the_density_of_tissue(
    skeleton: Skeleton,
) -> None:
    body = standard_body(skeleton)
    for joint in ("ElbowLeft", "WristRight", "KneeLeft", "AnkleRight"):
        j = skeleton.index(joint)
        density = body.masses[j] / (np.pi * body.radii[j] ** 2 * body.lengths[j])
        assert density == pytest.approx(1050.0)


@pytest.mark.parametrize("height", [0.29, 0.0, -1.7, 3.01, 175.0, np.nan])
def test_absurd_heights_are_refused_asking_for_meters(height: float) -> None:
    with pytest.raises(InputError, match=f"height {height:g} m.*meters"):
        standard_body(KINECT_V1, height=height, mass=70.0)
    with pytest.raises(InputError):
        standard_body(KINECT_V2, height=height)


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("lengths", np.full(5, 0.3), r"a body: lengths has shape \(5,\)"),
        ("directions", np.zeros(20), r"expected \(20, 3\) for kinect_v1"),
        ("lengths", 0.0, "segment to WristLeft is 0 m long"),
        ("lengths", -0.2, "segment to WristLeft is -0.2 m long"),
        ("lengths", np.nan, "segment to WristLeft is nan m long"),
        ("lengths", np.inf, "segment to WristLeft is inf m long"),
        ("directions", 0.0, "segment to WristLeft points along a vector of length 0"),
        ("directions", np.nan, "segment to WristLeft points along"),
        ("directions", [0.0, 2.0, 0.0], "segment to WristLeft points .* of length 2"),
        ("directions", 1e200, "segment to WristLeft points .* of length inf"),
    ],
)
def test_segments_that_no_body_has_are_refused_by_name(
    name: str, value: ArrayLike, words: str
) -> None:
    body = standard_body(KINECT_V1)
    wrong = np.asarray(value)
    if wrong.shape in ((), (3,)):
        wrong = getattr(body, name).copy()
        wrong[KINECT_V1.index("WristLeft")] = value
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(InputError, match=words):
            replace(body, **{name: wrong})


@every_skeleton
def test_a_body_that_many_share_cannot_be_overwritten(skeleton: Skeleton) -> None:
    body = standard_body(skeleton)
    for name in (
        "lengths",
        "directions",
        "rest_offsets",
        "rest_positions",
        "masses",
        "radii",
    ):
        with pytest.raises(ValueError, match="read-only"):
            getattr(body, name)[0] = 9.0


@pytest.mark.parametrize("mass", [0.9, 0.0, -70.0, 501.0, 70000.0, np.inf, np.nan])
def test_absurd_masses_are_refused_asking_for_kilograms(mass: float) -> None:
    with pytest.raises(InputError, match=r"mass.*kilograms"):
        standard_body(KINECT_V1, mass=mass)


@every_skeleton
def test_people_at_random_are_built_like_the_average_on_the_whole(
    skeleton: Skeleton,
) -> None:
    rng, ends = np.random.default_rng(0), skeleton.segments
    builds = []
    for _ in range(200):
        body = random_body(skeleton, rng)
        average = standard_body(skeleton, height=body.height)
        builds.append(body.lengths[ends] / average.lengths[ends])
    np.testing.assert_allclose(np.mean(builds, axis=0), 1.0, atol=0.02)
    assert np.std(builds, axis=0).max() > 0.01
    mirrored = skeleton.mirror[ends]
    body = random_body(skeleton, rng)
    np.testing.assert_array_equal(body.lengths[ends], body.lengths[mirrored])


@pytest.mark.parametrize("height", [0.3, 3.0])
def test_the_bounds_of_a_height_are_heights(height: float) -> None:
    assert standard_body(KINECT_V1, height=height).height == height


@every_skeleton
def test_joints_turn_back_into_their_ranges_and_no_farther(skeleton: Skeleton) -> None:
    starts, ends = skeleton.segment_parents, skeleton.segments
    most = np.array([joint_range(skeleton.joints[j]) for j in ends])

    def angles(turns: Array) -> Array:
        first, second = (
            Rotation.from_quat(turns[:, k].reshape(-1, 4), scalar_first=True)
            for k in (starts, ends)
        )
        return (first.inv() * second).magnitude().reshape(len(turns), -1)

    random = Rotation.random(200 * len(skeleton), rng=np.random.default_rng(1))
    turns = random.as_quat(scalar_first=True).reshape(200, -1, 4)
    found = within_ranges(turns, skeleton)
    over = angles(found) - most
    assert over.max() < 1e-7
    moved = (found != turns).any(axis=2)[:, ends]
    assert moved.any(axis=0).all()
    assert np.abs(over[moved]).max() < 1e-7
    # Of joints whose parents did not move, the short way.
    alone = moved & ~(found != turns).any(axis=2)[:, starts]
    back = Rotation.from_quat(turns[:, ends][alone], scalar_first=True).inv()
    back = back * Rotation.from_quat(found[:, ends][alone], scalar_first=True)
    expected = (angles(turns) - most)[alone]
    np.testing.assert_allclose(back.magnitude(), expected, atol=1e-7)
