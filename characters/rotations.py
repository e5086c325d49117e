"""Unit quaternions, scalar first (wxyz); leading axes broadcast.

Functions compose as in algebra: ``rotate(multiply(a, b), v)`` equals
``rotate(a, rotate(b, v))``. These few functions are for the loop over frames, where the
overhead of scipy's Rotation matters; elsewhere, scipy converts whole arrays.
"""

import numpy as np
from numpy.typing import ArrayLike

from .arrays import Array

IDENTITY: Array = np.array([1.0, 0.0, 0.0, 0.0])
IDENTITY.flags.writeable = False

# Matrix of the product with a quaternion on the left: which component is at each place.
_HAMILTON = np.array([[0, 1, 2, 3], [1, 0, 3, 2], [2, 3, 0, 1], [3, 2, 1, 0]])
_SIGNS = np.array([[1, -1, -1, -1], [1, 1, -1, 1], [1, 1, 1, -1], [1, -1, 1, 1]])
# Maps a quaternion to that matrix, row after row.
_TO_PRODUCT = np.zeros((4, 16))
_TO_PRODUCT[_HAMILTON.ravel(), np.arange(16)] = _SIGNS.ravel()
# Likewise, the matrix of the cross product with the quaternion's vector part.
_CROSS = np.array([[0, 3, 2], [3, 0, 1], [2, 1, 0]])
_CROSS_SIGNS = np.array([[0.0, -1.0, 1.0], [1.0, 0.0, -1.0], [-1.0, 1.0, 0.0]])
_CONJUGATE = np.array([1.0, -1.0, -1.0, -1.0])


def multiply(a: ArrayLike, b: ArrayLike) -> Array:
    """Return the Hamilton product ``a * b`` (first b, then a), shape (..., 4)."""
    left = (np.asarray(a) @ _TO_PRODUCT).reshape(*np.shape(a)[:-1], 4, 4)
    return np.asarray((left @ np.asarray(b)[..., None])[..., 0])


def inverse(q: ArrayLike) -> Array:
    """Return the inverse of unit quaternions, shape (..., 4)."""
    return np.asarray(np.asarray(q) * _CONJUGATE)


def normalize(q: ArrayLike) -> Array:
    """Scale quaternions to unit length; zero becomes the identity, NaN stays NaN."""
    q = np.asarray(q)
    norm = np.sqrt(np.vecdot(q, q))[..., None]
    if norm.all():
        return np.asarray(q / norm)
    return np.where(norm == 0.0, IDENTITY, q / np.where(norm == 0.0, 1.0, norm))


def rotate(q: ArrayLike, v: ArrayLike) -> Array:
    """Rotate vectors (..., 3) by unit quaternions (..., 4)."""
    q, v = np.asarray(q), np.asarray(v)[..., None]
    across = q[..., _CROSS] * _CROSS_SIGNS
    t = 2.0 * (across @ v)
    return np.asarray((v + q[..., :1, None] * t + across @ t)[..., 0])


def unit(v: Array) -> Array:
    """Return vectors (..., 3) scaled to unit length; zero vectors stay zero."""
    lengths = np.sqrt(np.vecdot(v, v))[..., None]
    return np.asarray(v / np.maximum(lengths, 1e-9))


def cross(a: ArrayLike, b: ArrayLike) -> Array:
    """Return the cross product (..., 3); for one frame ten times as fast as numpy's."""
    a, b = np.asarray(a), np.asarray(b)
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    product = np.empty(np.broadcast_shapes(a.shape, b.shape))
    product[..., 0] = ay * bz - az * by
    product[..., 1] = az * bx - ax * bz
    product[..., 2] = ax * by - ay * bx
    return product


def between(a: ArrayLike, b: ArrayLike) -> Array:
    """Return the smallest rotation that turns direction a to b, shape (..., 4).

    Vectors (..., 3) may have any length; a zero vector gives the identity. For opposite
    vectors the axis is arbitrary, but perpendicular to them.
    """
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    length = np.sqrt(np.vecdot(a, a) * np.vecdot(b, b))
    w = length + np.vecdot(a, b)
    q = np.empty((*w.shape, 4))
    q[..., 0], q[..., 1:] = w, cross(a, b)
    opposite = (w <= 1e-9 * length) & (length > 0.0)
    if opposite.any():
        # The coordinate axis along which a is shortest is never parallel to a.
        helper = np.eye(3)[np.argmin(np.abs(a), axis=-1)]
        across = np.zeros_like(q)
        across[..., 1:] = cross(a, helper)
        q = np.where(opposite[..., None], across, q)
    return normalize(q)


def about_x(angle: ArrayLike) -> Array:
    """Return rotations about x by angles [rad]; a body facing +z leans forward."""
    return _about(1, angle)


def about_y(angle: ArrayLike) -> Array:
    """Return rotations about y by angles [rad], seen from above counterclockwise."""
    return _about(2, angle)


def about_z(angle: ArrayLike) -> Array:
    """Return rotations about z by angles [rad]; a body facing +z leans right."""
    return _about(3, angle)


def _about(part: int, angle: ArrayLike) -> Array:
    half = np.asarray(angle, dtype=float) / 2.0
    q = np.zeros((*half.shape, 4))
    q[..., 0], q[..., part] = np.cos(half), np.sin(half)
    return q


def rotation_vector(q: ArrayLike) -> Array:
    """Return the axis times the angle [rad] in [0, pi], shape (..., 3)."""
    q = np.asarray(q)
    w, u = q[..., :1], q[..., 1:]
    sine = np.sqrt(np.vecdot(u, u))[..., None]
    angle = 2.0 * np.arctan2(sine, np.abs(w))
    ratio = np.where(sine > 1e-12, angle / np.maximum(sine, 1e-300), 2.0)
    return np.asarray(u * np.where(w < 0.0, -ratio, ratio))


def slerp(a: ArrayLike, b: ArrayLike, share: ArrayLike) -> Array:
    """Return rotations on the shortest arc from a (share 0) to b (1), (..., 4)."""
    a, b, share = np.asarray(a), np.asarray(b), np.asarray(share)[..., None]
    cosine = np.sum(a * b, axis=-1, keepdims=True)
    b = np.where(cosine < 0.0, -b, b)
    angle = np.arccos(np.minimum(np.abs(cosine), 1.0))
    small = angle < 1e-6  # here, the arc is straight to within rounding
    sine = np.where(small, 1.0, np.sin(angle))
    near = np.where(small, 1.0 - share, np.sin((1.0 - share) * angle) / sine)
    far = np.where(small, share, np.sin(share * angle) / sine)
    return normalize(near * a + far * b)


def matrix_from_wxyz(q: ArrayLike) -> Array:
    """Return rotation matrices, shape (..., 3, 3)."""
    return np.stack([rotate(q, axis) for axis in np.eye(3)], axis=-1)


def wxyz_from_matrix(matrix: ArrayLike) -> Array:
    """Return the unit quaternions of rotation matrices (..., 3, 3), (..., 4)."""
    from scipy.spatial.transform import Rotation

    flat = np.asarray(matrix).reshape(-1, 3, 3)
    quats = Rotation.from_matrix(flat).as_quat(scalar_first=True)
    return np.asarray(quats.reshape(*np.shape(matrix)[:-2], 4))


def wxyz_from_euler(angles: Array, axes: str) -> Array:
    """Convert intrinsic Euler angles [rad], shape (..., A), to wxyz, shape (..., 4).

    With axes ``ZYX``, the first angle turns about z, the second about the turned y.
    """
    rotation = np.tile(IDENTITY, (*np.shape(angles)[:-1], 1))
    for k, axis in enumerate(axes):
        rotation = multiply(rotation, _about(1 + "XYZ".index(axis), angles[..., k]))
    return rotation


def continuous(q: ArrayLike) -> Array:
    """Return quaternions (T, ..., 4) with signs that make them continuous in time."""
    signed = np.array(q)
    turned = np.vecdot(signed[1:], signed[:-1]) < 0.0
    signed[1:] *= np.cumprod(np.where(turned, -1.0, 1.0), axis=0)[..., None]
    return signed


def wrapped(angles: ArrayLike) -> Array:
    """Return angles [rad] in [-pi, pi)."""
    return np.asarray((np.asarray(angles) + np.pi) % (2.0 * np.pi) - np.pi)
