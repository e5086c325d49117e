"""Quaternions against scipy's Rotation, and where formulas break."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from kinefilter.characters.rotations import (
    IDENTITY,
    about_x,
    about_y,
    about_z,
    between,
    continuous,
    cross,
    inverse,
    matrix_from_wxyz,
    multiply,
    normalize,
    rotate,
    rotation_vector,
    slerp,
    wxyz_from_matrix,
)

Array = NDArray[np.float64]

seeds = st.integers(0, 2**32 - 1)
angles = st.one_of(
    st.floats(0.0, np.pi),
    st.sampled_from([0.0, 1e-16, 1e-12, 1e-8, np.pi - 1e-8, np.pi - 1e-12, np.pi]),
)


def random_rotations(count: int, seed: int = 0) -> Array:
    rng = np.random.default_rng(seed)
    return Rotation.random(count, rng=rng).as_quat(scalar_first=True)


def scipy_of(q: Array) -> Rotation:
    return Rotation.from_quat(q, scalar_first=True)


def axis_of(seed: int) -> Array:
    axis = np.random.default_rng(seed).normal(size=3)
    return np.asarray(axis / np.linalg.norm(axis))


def turn(axis: Array, angle: float) -> Array:
    return np.concatenate([[np.cos(angle / 2)], np.sin(angle / 2) * axis])


def assert_same_rotation(a: Array, b: Array, atol: float = 1e-12) -> None:
    sign = np.where(np.sum(a * b, axis=-1, keepdims=True) < 0.0, -1.0, 1.0)
    np.testing.assert_allclose(a, sign * b, atol=atol)


def test_product_inverse_rotation_and_matrix_are_those_of_scipy() -> None:
    a, b = random_rotations(200, 1), random_rotations(200, 2)
    v = np.random.default_rng(3).normal(size=(200, 3))
    assert_same_rotation(
        multiply(a, b), (scipy_of(a) * scipy_of(b)).as_quat(scalar_first=True)
    )
    assert_same_rotation(inverse(a), scipy_of(a).inv().as_quat(scalar_first=True))
    np.testing.assert_allclose(rotate(a, v), scipy_of(a).apply(v), atol=1e-14)
    np.testing.assert_allclose(matrix_from_wxyz(a), scipy_of(a).as_matrix(), atol=1e-14)


def test_names_compose_like_the_algebra() -> None:
    a, b, c = (random_rotations(50, seed) for seed in (4, 5, 8))
    v = np.random.default_rng(6).normal(size=(50, 3))
    np.testing.assert_allclose(
        rotate(multiply(a, b), v), rotate(a, rotate(b, v)), atol=1e-13
    )
    np.testing.assert_allclose(
        multiply(multiply(a, b), c), multiply(a, multiply(b, c)), atol=1e-14
    )
    np.testing.assert_allclose(rotate(inverse(a), rotate(a, v)), v, atol=1e-13)
    assert_same_rotation(multiply(a, inverse(a)), np.tile(IDENTITY, (50, 1)))


@pytest.mark.parametrize("shape", [(), (1,), (7,), (2, 3), (0,)])
def test_matrix_round_trip_keeps_the_rotation_and_the_shape(
    shape: tuple[int, ...],
) -> None:
    q = random_rotations(max(int(np.prod(shape)), 1))[: int(np.prod(shape))]
    q = q.reshape(*shape, 4)
    again = wxyz_from_matrix(matrix_from_wxyz(q))
    assert again.shape == q.shape
    assert_same_rotation(again, q)


@pytest.mark.parametrize(
    ("left", "right", "shape"),
    [
        ((), (), ()),
        ((5,), (), (5,)),
        ((), (5,), (5,)),
        ((4, 1), (3,), (4, 3)),
        ((2, 1, 3), (4, 1), (2, 4, 3)),
    ],
)
def test_leading_axes_broadcast(
    left: tuple[int, ...], right: tuple[int, ...], shape: tuple[int, ...]
) -> None:
    rng = np.random.default_rng(0)
    a, b = (
        normalize(rng.normal(size=(*left, 4))),
        normalize(rng.normal(size=(*right, 4))),
    )
    u, v = rng.normal(size=(*left, 3)), rng.normal(size=(*right, 3))
    assert_close = partial(np.testing.assert_allclose, rtol=0.0, atol=1e-14)
    full_a, full_b = (np.broadcast_to(x, (*shape, 4)) for x in (a, b))
    full_u, full_v = (np.broadcast_to(x, (*shape, 3)) for x in (u, v))
    assert_close(multiply(a, b), multiply(full_a, full_b))
    assert_close(rotate(a, v), rotate(full_a, full_v))
    assert_close(between(u, v), between(full_u, full_v))
    assert multiply(a, b).shape == between(u, v).shape == (*shape, 4)
    assert rotate(a, v).shape == (*shape, 3)


# between


@given(seed=seeds, lengths=st.tuples(*[st.floats(1e-3, 1e3)] * 2), angle=angles)
def test_between_turns_one_direction_onto_the_other_by_the_smallest_angle(
    seed: int, lengths: tuple[float, float], angle: float
) -> None:
    axis = axis_of(seed)
    a = np.cross(axis, axis_of(seed + 1))
    a /= np.linalg.norm(a)
    b = rotate(turn(axis, angle), a)
    q = between(lengths[0] * a, lengths[1] * b)
    assert np.linalg.norm(q) == pytest.approx(1.0)
    # A direction within 5e-5 of the opposite one counts as opposite.
    np.testing.assert_allclose(rotate(q, a), b, atol=5e-5)
    if angle < np.pi - 1e-4:
        np.testing.assert_allclose(rotate(q, a), b, atol=1e-9)
    assert np.linalg.norm(rotation_vector(q)) == pytest.approx(angle, abs=5e-5)


def test_between_parallel_vectors_is_the_identity() -> None:
    v = np.random.default_rng(0).normal(size=(100, 3))
    assert_same_rotation(between(v, 3.0 * v), np.tile(IDENTITY, (100, 1)), atol=1e-7)
    np.testing.assert_array_equal(
        between(np.eye(3), np.eye(3)), np.tile(IDENTITY, (3, 1))
    )


def test_between_opposite_vectors_is_a_half_turn_across_them() -> None:
    v = np.concatenate(
        [np.eye(3), -np.eye(3), np.random.default_rng(1).normal(size=(100, 3))]
    )
    q = between(v, -0.1 * v)
    np.testing.assert_allclose(np.linalg.norm(rotation_vector(q), axis=1), np.pi)
    np.testing.assert_allclose(np.sum(q[:, 1:] * v, axis=1), 0.0, atol=1e-12)
    np.testing.assert_allclose(rotate(q, v), -v, atol=1e-12)


def test_between_a_zero_vector_and_any_is_the_identity() -> None:
    zero, v = np.zeros(3), np.array([1.0, -2.0, 3.0])
    for a, b in ((zero, v), (v, zero), (zero, zero)):
        np.testing.assert_array_equal(between(a, b), IDENTITY)


def test_between_treats_every_row_by_itself() -> None:
    x = np.array([1.0, 0.0, 0.0])
    b = np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    rows = between(x, b)
    for row, target in zip(rows, b, strict=True):
        np.testing.assert_array_equal(row, between(x, target))


# Angles


@given(seed=seeds, angle=angles, flipped=st.booleans())
def test_rotation_vector_is_axis_times_angle_of_either_sign(
    seed: int, angle: float, flipped: bool
) -> None:
    axis = axis_of(seed)
    q = turn(axis, angle)
    vector = rotation_vector(-q if flipped else q)
    # At a half turn both axes are right.
    if angle > np.pi - 1e-9 and vector @ axis < 0.0:
        axis = -axis
    np.testing.assert_allclose(vector, angle * axis, atol=1e-9)
    np.testing.assert_allclose(
        Rotation.from_rotvec(vector).apply([1.0, 2.0, 3.0]),
        rotate(q, np.array([1.0, 2.0, 3.0])),
        atol=1e-9,
    )


def test_rotation_vector_of_tiny_turns_keeps_its_relative_accuracy() -> None:
    axis = axis_of(3)
    for angle in (1e-6, 1e-10, 1e-13, 1e-100):
        np.testing.assert_allclose(
            rotation_vector(turn(axis, angle)), angle * axis, rtol=1e-9
        )
    np.testing.assert_array_equal(rotation_vector(IDENTITY), 0.0)
    np.testing.assert_array_equal(rotation_vector(-IDENTITY), 0.0)


def test_rotation_vectors_are_those_of_scipy() -> None:
    q = random_rotations(300, 7).reshape(30, 10, 4)
    expected = scipy_of(q.reshape(-1, 4)).as_rotvec().reshape(30, 10, 3)
    np.testing.assert_allclose(rotation_vector(q), expected, atol=1e-12)


@pytest.mark.parametrize(
    ("axis", "about"), [("x", about_x), ("y", about_y), ("z", about_z)]
)
def test_a_quarter_turn_about_an_axis_takes_the_next_onto_the_one_after(
    axis: str, about: Callable[[Array], Array]
) -> None:
    k = "xyz".index(axis)
    after, last = np.roll(np.eye(3), -k - 1, axis=0)[:2]
    np.testing.assert_allclose(
        rotate(about(np.array(np.pi / 2)), after), last, atol=1e-15
    )
    turns = np.linspace(-7.0, 7.0, 12).reshape(3, 4)
    expected = (
        Rotation.from_euler(axis, turns.reshape(-1, 1)).as_matrix().reshape(3, 4, 3, 3)
    )
    np.testing.assert_allclose(matrix_from_wxyz(about(turns)), expected, atol=1e-15)


@given(seed=seeds, angle=angles, flipped=st.booleans(), share=st.floats(0.0, 1.0))
def test_a_share_of_the_way_is_that_share_of_the_angle(
    seed: int, angle: float, flipped: bool, share: float
) -> None:
    axis, start = axis_of(seed), random_rotations(1, seed)[0]
    end = multiply(start, turn(axis, angle))
    there = slerp(start, -end if flipped else end, np.array(share))
    assert np.linalg.norm(there) == pytest.approx(1.0)
    part = rotation_vector(multiply(inverse(start), there))
    # At a half turn both ways are shortest.
    if angle > np.pi - 1e-7 and part @ axis < 0.0:
        axis = -axis
    np.testing.assert_allclose(part, share * angle * axis, atol=1e-7)


# What they take


def test_lists_are_as_good_as_arrays() -> None:
    p, q = random_rotations(2, 9)
    u, v = np.random.default_rng(10).normal(size=(2, 3))
    for function, arrays in (
        (multiply, (p, q)),
        (inverse, (p,)),
        (normalize, (2.0 * p,)),
        (rotate, (p, u)),
        (cross, (u, v)),
        (between, (u, v)),
        (about_x, (u,)),
        (about_y, (u,)),
        (about_z, (u,)),
        (rotation_vector, (p,)),
        (slerp, (p, q, np.array(0.3))),
        (matrix_from_wxyz, (p,)),
        (wxyz_from_matrix, (matrix_from_wxyz(p),)),
        (continuous, (np.array([p, -q]),)),
    ):
        lists = [array.tolist() for array in arrays]
        np.testing.assert_array_equal(function(*lists), function(*arrays))


# Signs and lengths


def test_normalize_scales_to_unit_length_and_makes_zero_the_identity() -> None:
    q = np.array([[0.0, 0.0, 0.0, 0.0], [0.0, -3.0, 0.0, 4.0], [1e-200, 0.0, 0.0, 0.0]])
    np.testing.assert_allclose(
        normalize(q), np.array([[1.0, 0, 0, 0], [0, -0.6, 0, 0.8], [1.0, 0, 0, 0]])
    )


def test_normalize_invents_nothing_for_what_is_unknown() -> None:
    q = np.array([[np.nan, 0.0, 0.0, 1.0], [0.0, 0.0, 0.0, 0.0], [3.0, 0.0, 4.0, 0.0]])
    expected = [[np.nan] * 4, [1.0, 0.0, 0.0, 0.0], [0.6, 0.0, 0.8, 0.0]]
    np.testing.assert_allclose(normalize(q), expected)


@given(seed=seeds, frames=st.integers(1, 12))
def test_continuous_flips_whole_rows_so_that_neighbors_agree(
    seed: int, frames: int
) -> None:
    rng = np.random.default_rng(seed)
    q = normalize(rng.normal(size=(frames, 3, 4)))
    before = q.copy()
    smooth = continuous(q)
    np.testing.assert_array_equal(q, before)
    np.testing.assert_array_equal(smooth[0], q[0])
    same = (smooth == q).all(axis=-1) | (smooth == -q).all(axis=-1)
    assert same.all()
    assert (np.sum(smooth[1:] * smooth[:-1], axis=-1) >= 0.0).all()


def test_continuous_undoes_sign_flips_of_a_smooth_turn() -> None:
    time = np.linspace(0.0, 4.0 * np.pi, 200)
    q = about_y(time)
    signs = np.where(np.random.default_rng(0).random(200) < 0.5, -1.0, 1.0)
    signs[0] = 1.0
    np.testing.assert_array_equal(continuous(q * signs[:, None]), q)


def test_the_identity_cannot_be_overwritten() -> None:
    with pytest.raises(ValueError, match="read-only"):
        IDENTITY[0] = 2.0
