"""Unit quaternions, scalar first (wxyz); leading axes broadcast.

The names compose like the algebra: ``rotate(multiply(a, b), v)`` is
``rotate(a, rotate(b, v))``. scipy's Rotation serves where whole arrays convert between
representations; these few functions serve the frame loop, where its overhead counts.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .arrays import Array

IDENTITY: Array = np.array([1.0, 0.0, 0.0, 0.0])
IDENTITY.flags.writeable = False

# The matrix that multiplies from the left, by components of the quaternion.
_HAMILTON = np.array([[0, 1, 2, 3], [1, 0, 3, 2], [2, 3, 0, 1], [3, 2, 1, 0]])
_HAMILTON_SIGNS = np.array(
    [[1.0, -1.0, -1.0, -1.0], [1, 1, -1, 1], [1, 1, 1, -1], [1, -1, 1, 1]]
)
# The matrix that takes the cross product with the quaternion's axis, likewise.
_CROSS = np.array([[0, 3, 2], [3, 0, 1], [2, 1, 0]])
_CROSS_SIGNS = np.array([[0.0, -1.0, 1.0], [1.0, 0.0, -1.0], [-1.0, 1.0, 0.0]])
_CONJUGATE = np.array([1.0, -1.0, -1.0, -1.0])


def multiply(a: ArrayLike, b: ArrayLike) -> Array:
    """Return the Hamilton product ``a * b`` (first b, then a), shape (..., 4)."""
    left = np.asarray(a)[..., _HAMILTON] * _HAMILTON_SIGNS
    return np.asarray((left @ np.asarray(b)[..., None])[..., 0])


def inverse(q: ArrayLike) -> Array:
    """Return the inverse of unit quaternions, shape (..., 4)."""
    return np.asarray(np.asarray(q) * _CONJUGATE)


def normalize(q: ArrayLike) -> Array:
    """Scale quaternions to unit length; a zero quaternion becomes the identity.

    One with a NaN in it stays NaN.
    """
    q = np.asarray(q)
    norm = np.sqrt(np.vecdot(q, q))[..., None]
    zero = norm == 0.0
    if not np.any(zero):
        return np.asarray(q / norm)
    return np.where(zero, IDENTITY, q / np.where(zero, 1.0, norm))


def rotate(q: ArrayLike, v: ArrayLike) -> Array:
    """Rotate vectors (..., 3) by unit quaternions (..., 4)."""
    q, v = np.asarray(q), np.asarray(v)[..., None]
    across = q[..., _CROSS] * _CROSS_SIGNS
    t = 2.0 * (across @ v)
    return np.asarray((v + q[..., :1, None] * t + across @ t)[..., 0])


def unit(v: Array) -> Array:
    """Return vectors (..., 3) at unit length; null vectors stay."""
    lengths = np.linalg.norm(v, axis=-1, keepdims=True)
    return np.asarray(v / np.maximum(lengths, 1e-9))


def cross(a: ArrayLike, b: ArrayLike) -> Array:
    """Return the cross product of vectors (..., 3).

    For a single frame, ``np.cross`` spends ten times this on bookkeeping of axes.
    """
    a, b = np.asarray(a), np.asarray(b)
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    product = np.empty(np.broadcast_shapes(a.shape, b.shape))
    product[..., 0] = ay * bz - az * by
    product[..., 1] = az * bx - ax * bz
    product[..., 2] = ax * by - ay * bx
    return product


def between(a: ArrayLike, b: ArrayLike) -> Array:
    """Return the smallest rotation that turns direction a onto b, shape (..., 4).

    Vectors (..., 3) need not be unit; a zero vector gives the identity. Opposite
    vectors turn about an arbitrary axis across them.
    """
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    length = np.sqrt(np.vecdot(a, a) * np.vecdot(b, b))
    w = length + np.vecdot(a, b)
    q = np.empty((*w.shape, 4))
    q[..., 0], q[..., 1:] = w, cross(a, b)
    opposite = (w <= 1e-9 * length) & (length > 0.0)
    if np.any(opposite):
        # The axis of the smallest component is never along a.
        helper = np.eye(3)[np.argmin(np.abs(a), axis=-1)]
        across = np.zeros_like(q)
        across[..., 1:] = cross(a, helper)
        q = np.where(opposite[..., None], across, q)
    return normalize(q)


def about_x(angle: ArrayLike) -> Array:
    """Return the rotation by ``angle`` [rad] about x: forward for who faces +z."""
    return _about(1, angle)


def about_y(angle: ArrayLike) -> Array:
    """Return the rotation by ``angle`` [rad] about the vertical axis, (..., 4)."""
    return _about(2, angle)


def about_z(angle: ArrayLike) -> Array:
    """Return the rotation by ``angle`` [rad] about z: to the right for who faces +z."""
    return _about(3, angle)


def _about(part: int, angle: ArrayLike) -> Array:
    half = np.asarray(angle, dtype=float) / 2.0
    q = np.zeros((*half.shape, 4))
    q[..., 0], q[..., part] = np.cos(half), np.sin(half)
    return q


def rotation_vector(q: ArrayLike) -> Array:
    """Return axis times angle [rad], angle in [0, pi], shape (..., 3)."""
    q = np.asarray(q)
    w, u = q[..., :1], q[..., 1:]
    sine = np.sqrt(np.vecdot(u, u))[..., None]
    angle = 2.0 * np.arctan2(sine, np.abs(w))
    ratio = np.where(sine > 1e-12, angle / np.maximum(sine, 1e-300), 2.0)
    return np.asarray(u * np.where(w < 0.0, -ratio, ratio))


def slerp(a: ArrayLike, b: ArrayLike, share: ArrayLike) -> Array:
    """Return rotations on the shortest arc from a (0) to b (1), shape (..., 4)."""
    a, b, share = np.asarray(a), np.asarray(b), np.asarray(share)[..., None]
    cosine = np.sum(a * b, axis=-1, keepdims=True)
    b = np.where(cosine < 0.0, -b, b)
    angle = np.arccos(np.minimum(np.abs(cosine), 1.0))
    small = angle < 1e-6  # there the arc is as straight as the numbers are exact
    sine = np.where(small, 1.0, np.sin(angle))
    near = np.where(small, 1.0 - share, np.sin((1.0 - share) * angle) / sine)
    far = np.where(small, share, np.sin(share * angle) / sine)
    return normalize(near * a + far * b)


def matrix_from_wxyz(q: ArrayLike) -> Array:
    """Return rotation matrices, columns the rotated axes, shape (..., 3, 3)."""
    return np.stack([rotate(q, axis) for axis in np.eye(3)], axis=-1)


def wxyz_from_matrix(matrix: ArrayLike) -> Array:
    """Return unit quaternions of rotation matrices (..., 3, 3), shape (..., 4)."""
    from scipy.spatial.transform import Rotation

    flat = np.asarray(matrix).reshape(-1, 3, 3)
    quats = Rotation.from_matrix(flat).as_quat(scalar_first=True)
    return np.asarray(quats.reshape(*np.shape(matrix)[:-2], 4))


def continuous(q: ArrayLike) -> Array:
    """Flip signs along axis 0 so that neighbors lie on one hemisphere, (T, ..., 4)."""
    q = np.asarray(q)
    signed = q.copy()
    if len(q) > 1:
        flips = np.cumprod(np.where(np.vecdot(q[1:], q[:-1]) < 0.0, -1.0, 1.0), axis=0)
        signed[1:] *= flips[..., None]
    return signed
