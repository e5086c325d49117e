"""The skin: one closed mesh that bends with the body and never tears."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from kinefilter.characters import (
    KINECT_V1,
    KINECT_V2,
    Body,
    positions_from_rotations,
    standard_body,
)
from kinefilter.characters.rotations import IDENTITY, multiply, rotate
from kinefilter.characters.skin import INFLUENCES, Skin, quads_of, seams_of, skin_of
from kinefilter.scenes.library import random_body

Array = NDArray[np.float64]
DENSITY = 1050.0  # kg/m^3


def narrow(body: Body) -> Body:
    """Return a body with hips as near to each other as sensors see them."""
    hips = [j for j, n in enumerate(body.skeleton.joints) if n.startswith("Hip")]
    lengths = body.lengths.copy()
    lengths[hips] *= 0.7
    return replace(body, lengths=lengths)


def low_spine(body: Body) -> Body:
    """Return a body whose spine has its joint as low as Kinect v1 often has it."""
    spine, girdle = body.skeleton.parents[body.skeleton.girdle], body.skeleton.girdle
    lengths = body.lengths.copy()
    lower = 0.7 * lengths[spine]
    lengths[spine] -= lower
    lengths[girdle] += lower
    return replace(body, lengths=lengths)


BODIES = {
    "v1": standard_body(KINECT_V1),
    "v2": standard_body(KINECT_V2),
    "child": standard_body(KINECT_V2, height=1.1),
    "heavy": standard_body(KINECT_V1, height=1.7, mass=130.0),
    "narrow": narrow(standard_body(KINECT_V2)),
    "low spine": low_spine(standard_body(KINECT_V1)),
    **{
        f"random {seed}": random_body(KINECT_V2, np.random.default_rng(seed))
        for seed in range(2)
    },
}
all_bodies = pytest.mark.parametrize("body", BODIES.values(), ids=BODIES)


def turn(axis: list[float], degrees: float) -> Array:
    half = np.radians(degrees) / 2.0
    return np.array([np.cos(half), *(np.sin(half) * np.array(axis))])


def posed(skin: Skin, body: Body, rotations: Array) -> Array:
    """Return the points moved by linear blend skinning, shape (P, 3)."""
    rest, skeleton = body.rest_positions, body.skeleton
    joints = positions_from_rotations(rotations, rest[skeleton.root], body)
    starts = np.array([j if p < 0 else p for j, p in enumerate(skeleton.parents)])
    moved = np.zeros_like(skin.points)
    for segments, weights in zip(skin.segments.T, skin.weights.T, strict=True):
        start = starts[segments]
        turned = rotate(rotations[segments], skin.points - rest[start])
        moved += weights[:, None] * (joints[start] + turned)
    return moved


def edges(skin: Skin) -> NDArray[np.int64]:
    return np.concatenate([skin.quads[:, [k, (k + 1) % 4]] for k in range(4)])


@all_bodies
def test_the_skin_is_one_closed_mesh_with_its_outside_outside(body: Body) -> None:
    skin = skin_of(body)
    triangles = np.concatenate([skin.quads[:, [0, 1, 2]], skin.quads[:, [0, 2, 3]]])
    mesh = trimesh.Trimesh(skin.points, triangles, process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.body_count == 1
    assert 0.6 < mesh.volume * DENSITY / body.mass < 1.1
    lifted = trimesh.Trimesh(skin.points + 1e-3 * skin.normals, triangles)
    assert lifted.volume > mesh.volume
    np.testing.assert_allclose(np.linalg.norm(skin.normals, axis=1), 1.0)


@all_bodies
def test_it_is_as_tall_as_the_person_and_stands_on_the_floor(body: Body) -> None:
    skin = skin_of(body)
    top = body.rest_positions[body.skeleton.index("Head"), 1]
    assert skin.points[:, 1].min() == pytest.approx(0.0, abs=0.004)
    assert top < skin.points[:, 1].max() < top + 0.15 * body.height


@all_bodies
def test_shares_sum_to_one_and_left_is_as_right(body: Body) -> None:
    skin = skin_of(body)
    assert skin.weights.shape == skin.segments.shape == (len(skin.points), INFLUENCES)
    assert (skin.weights >= 0.0).all()
    np.testing.assert_allclose(skin.weights.sum(axis=1), 1.0, atol=1e-12)
    whole = np.zeros(len(body.skeleton))
    np.add.at(whole, skin.segments, skin.weights)
    np.testing.assert_allclose(whole, whole[body.skeleton.mirror], rtol=0.02, atol=1e-9)
    still = [name.startswith("Hip") for name in body.skeleton.joints]
    assert ((whole > 0.0) | still).all()


@all_bodies
def test_neighbors_move_nearly_together(body: Body) -> None:
    skin = skin_of(body)
    dense = np.zeros((len(skin.points), len(body.skeleton)))
    np.put_along_axis(dense, skin.segments, skin.weights, axis=1)
    a, b = edges(skin).T
    assert 0.5 * np.abs(dense[a] - dense[b]).sum(axis=1).max() < 0.5


def test_the_trunk_keeps_its_shape_wherever_the_spine_has_its_joint() -> None:
    usual, low = (skin_of(BODIES[name]) for name in ("v1", "low spine"))
    for height in (1.0, 1.1, 1.2, 1.3):
        deep = []
        for skin in (usual, low):
            near = np.abs(skin.points[:, 1] - height) < 0.012
            trunk = skin.points[near & (np.abs(skin.points[:, 0]) < 0.15)]
            deep.append(np.ptp(trunk[:, 2]))
        assert deep[1] == pytest.approx(deep[0], rel=0.02)


@pytest.mark.parametrize("degrees", [60.0, 100.0, 140.0])
@pytest.mark.parametrize(
    ("joints", "axis"),
    [
        (["WristLeft", "HandLeft", "HandTipLeft", "ThumbLeft"], [0.0, -1.0, 0.0]),
        (["AnkleRight", "FootRight"], [1.0, 0.0, 0.0]),
    ],
)
def test_elbows_and_knees_bend_without_a_gap(
    joints: list[str], axis: list[float], degrees: float
) -> None:
    body = BODIES["v2"]
    skin = skin_of(body)
    rotations = np.tile(IDENTITY, (len(body.skeleton), 1))
    for joint in joints:
        rotations[body.skeleton.index(joint)] = turn(axis, degrees)
    a, b = edges(skin).T
    before = np.linalg.norm(skin.points[a] - skin.points[b], axis=1).max()
    moved = posed(skin, body, rotations)
    assert np.linalg.norm(moved[a] - moved[b], axis=1).max() < 2.5 * before


def test_in_any_posture_the_skin_stays_within_its_margins() -> None:
    body, rng = BODIES["v2"], np.random.default_rng(1)
    skin, parents = skin_of(body), np.array(body.skeleton.parents)
    for _ in range(10):
        rotations = rng.normal(size=(len(body.skeleton), 4))
        rotations /= np.linalg.norm(rotations, axis=1, keepdims=True)
        joints = positions_from_rotations(rotations, np.zeros(3), body)
        joints += body.rest_positions[body.skeleton.root]
        starts = joints[np.where(parents < 0, body.skeleton.root, parents)]
        both = np.stack([joints, starts])
        low = (both - skin.margins[:, None]).min(axis=(0, 1))
        high = (both + skin.margins[:, None]).max(axis=(0, 1))
        moved = posed(skin, body, rotations)
        assert (moved > low - 1e-9).all()
        assert (moved < high + 1e-9).all()


@all_bodies
def test_two_seams_run_along_each_segment_and_one_around_its_middle(body: Body) -> None:
    skin, seams = skin_of(body), seams_of(body)
    assert seams.shape == (len(skin.points), 2)
    assert (seams >= 0.0).all()
    assert (seams <= 1.0).all()
    knee = body.skeleton.index("KneeLeft")
    own = skin.segments[:, 0] == knee
    hip = body.rest_positions[body.skeleton.parents[knee]]
    near = np.abs(seams[own, 0] - 0.5) < 0.05
    away = skin.points[own][near] - hip
    assert np.abs(away[:, 2]).max() < 0.15 * np.abs(away[:, 0]).max()  # at the sides
    assert len(np.unique(np.sign(away[:, 0]))) == 2
    middle = np.abs(seams[own, 1] - 0.5) < 0.05
    half = 0.5 * body.lengths[knee]
    down = hip[1] - skin.points[own][middle][:, 1]
    np.testing.assert_allclose(down, half, atol=0.06 * body.lengths[knee])


def test_a_turned_body_turns_its_skin() -> None:
    body, quarter = BODIES["v1"], turn([0.0, 1.0, 0.0], 90.0)
    skin = skin_of(body)
    rotations = multiply(quarter, np.tile(IDENTITY, (len(body.skeleton), 1)))
    root = body.rest_positions[body.skeleton.root]
    np.testing.assert_allclose(
        posed(skin, body, rotations), root + rotate(quarter, skin.points - root)
    )


def test_the_surface_of_a_ball_is_a_ball() -> None:
    grid = np.moveaxis(np.indices((24, 22, 26)), 0, -1) - [11.2, 10.4, 12.7]
    points, quads = quads_of(np.linalg.norm(grid, axis=-1) - 8.0)
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    mesh = trimesh.Trimesh(points, triangles, process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume == pytest.approx(4.0 / 3.0 * np.pi * 8.0**3, rel=0.02)
    assert np.linalg.norm(points - [11.2, 10.4, 12.7], axis=1).std() < 0.1
