"""Random features of a kernel, and how like postures are to those of before."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.special import ndtri

from kinefilter.characters.arrays import Array, Singles

_LINEAR = 0.8  # variance of the linear part, against 1 of the Gaussian one


class RandomFeatures:
    """Random features whose products are the kernel of postures' features.

    Args:
        mean: Mean of what they are made of, shape (F,).
        count: How many there are beside the linear ones, a multiple of two.
        seed: Draws their frequencies.
        weights: How much each of what they are made of counts, shape (F,).
    """

    def __init__(self, mean: Singles, count: int, seed: int, weights: Singles) -> None:
        frequencies = _frequencies(len(mean), count // 2, seed)
        self._frequencies = np.ascontiguousarray(frequencies * weights[:, None])
        self._mean, self.size = mean, count + len(mean)
        self._linear = weights * np.float32(np.sqrt(_LINEAR))

    def __call__(self, features: Singles) -> Singles:
        """Return the random and the linear features of frames, (T, size)."""
        half = self._frequencies.shape[1]
        made = np.empty((len(features), self.size), dtype=np.float32)
        angles = features @ self._frequencies
        np.cos(angles, out=made[:, :half])
        np.sin(angles, out=made[:, half : 2 * half])
        made[:, : 2 * half] *= np.float32(1.0 / np.sqrt(half))
        made[:, 2 * half :] = (features - self._mean) * self._linear
        return made


@lru_cache(maxsize=8)  # every clean begins with the same ones
def _frequencies(size: int, count: int, seed: int) -> Singles:
    """Return orthogonal random frequencies, shape (size, count), read-only."""
    blocks = -(-count // size)
    # Raw bits and the normal quantile: the same in every version of numpy.
    bits = np.random.PCG64(seed).random_raw(blocks * size * size) >> np.uint64(11)
    normal = ndtri((bits.astype(float) + 0.5) * 2.0**-53)
    square = normal.reshape(blocks, size, size)
    turns = np.linalg.qr(square)[0]
    lengths = np.linalg.norm(square, axis=2, keepdims=True)
    rows = (turns * lengths).reshape(-1, size)[:count]
    frequencies: Singles = rows.T.astype(np.float32)
    frequencies.flags.writeable = False
    return frequencies


def values_at(times: Array, values: Array, wanted: Array) -> Array:
    """Return values (N, ...) at other times, between frames; the ends beyond them."""
    if len(times) < 2:
        return np.broadcast_to(values, (len(wanted), *values.shape[1:]))
    after = np.clip(np.searchsorted(times, wanted), 1, len(times) - 1)
    apart = np.maximum(times[after] - times[after - 1], 1e-9)
    share = np.clip((wanted - times[after - 1]) / apart, 0.0, 1.0)
    share = share.reshape(-1, *(1,) * (values.ndim - 1))
    return np.asarray(values[after - 1] * (1.0 - share) + values[after] * share)


def direction_to(sensor: Array | None, count: int) -> Array:
    """Return unit vectors (T, 2), to the left and ahead, from people to the sensor.

    A sensor whose place nobody knows, or that is said to be inside of the person, is
    ahead.
    """
    if sensor is None:
        return np.tile([0.0, 1.0], (count, 1))
    flat = np.atleast_2d(sensor)[:, [0, 2]]
    distance = np.hypot(flat[:, 0], flat[:, 1])[:, None]
    return np.where(distance > 0.5, flat / np.maximum(distance, 0.5), [0.0, 1.0])


def likeness_to(features: Singles, centers: Singles, squares: Singles) -> Array:
    """Return how like the nearest center frames are, in [0, 1], shape (T,).

    ``squares`` are those of the centers' lengths.
    """
    if not len(centers):
        return np.zeros(len(features))
    nearest = (squares - 2.0 * features @ centers.T).min(axis=1)
    nearest = nearest + np.sum(features**2, axis=1)
    return np.asarray(np.exp(-0.5 * np.maximum(nearest, 0.0)))
