"""Random features of a kernel, and helpers for features of movement."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.special import ndtri

from kinefilter.characters.arrays import Array, Singles

_LINEAR = 0.8  # variance of the linear part, against 1 for the Gaussian part


class RandomFeatures:
    """Random features whose inner products approximate the kernel of the inputs.

    ``count``, which is even, is the number of features besides the linear ones,
    ``seed`` that of the frequencies. Mean and weights of the inputs have shape (F,).
    """

    def __init__(self, mean: Singles, count: int, seed: int, weights: Singles) -> None:
        self._frequencies = _frequencies(len(mean), count // 2, seed)
        self._mean, self._weights, self.size = mean, weights, count + len(mean)
        self._linear = weights * np.float32(np.sqrt(_LINEAR))

    def __call__(self, inputs: Singles) -> Singles:
        """Return the random and the linear features of frames, (T, size)."""
        half = self._frequencies.shape[1]
        features = np.empty((len(inputs), self.size), dtype=np.float32)
        angles = (inputs * self._weights) @ self._frequencies
        np.cos(angles, out=features[:, :half])
        np.sin(angles, out=features[:, half : 2 * half])
        features[:, : 2 * half] *= np.float32(1.0 / np.sqrt(half))
        features[:, 2 * half :] = (inputs - self._mean) * self._linear
        return features


@lru_cache(maxsize=8)  # every run of clean begins with the same ones
def _frequencies(size: int, count: int, seed: int) -> Singles:
    """Return orthogonal random frequencies, shape (size, count), read-only."""
    blocks = -(-count // size)
    # Raw bits and the normal quantile give the same numbers in every version of numpy.
    bits = np.random.PCG64(seed).random_raw(blocks * size * size) >> np.uint64(11)
    normal = ndtri((bits.astype(float) + 0.5) * 2.0**-53).reshape(blocks, size, size)
    turns = np.linalg.qr(normal)[0]
    lengths = np.linalg.norm(normal, axis=2, keepdims=True)
    rows = (turns * lengths).reshape(-1, size)[:count]
    frequencies: Singles = np.ascontiguousarray(rows.T, dtype=np.float32)
    frequencies.flags.writeable = False
    return frequencies


def values_at(times: Array, values: Array, wanted: Array) -> Array:
    """Interpolate values (N, ...) at other times; outside, the ends are held."""
    if len(times) < 2:
        return np.broadcast_to(values, (len(wanted), *values.shape[1:]))
    after = np.clip(np.searchsorted(times, wanted), 1, len(times) - 1)
    apart = np.maximum(times[after] - times[after - 1], 1e-9)
    share = np.clip((wanted - times[after - 1]) / apart, 0.0, 1.0)
    share = share.reshape(-1, *(1,) * (values.ndim - 1))
    return np.asarray(values[after - 1] * (1.0 - share) + values[after] * share)


def direction_to(sensor: Array | None, count: int) -> Array:
    """Return horizontal unit vectors (T, 2), left and ahead, from people to the sensor.

    Without a sensor, or with one closer than 0.5 m, the direction is straight ahead.
    """
    if sensor is None:
        return np.tile([0.0, 1.0], (count, 1))
    flat = np.atleast_2d(sensor)[:, [0, 2]]
    distance = np.hypot(flat[:, 0], flat[:, 1])[:, None]
    return np.where(distance > 0.5, flat / np.maximum(distance, 0.5), [0.0, 1.0])


def similarity_to(features: Singles, centers: Singles, squares: Singles) -> Array:
    """Return the similarity of frames to the nearest center, in [0, 1], shape (T,).

    ``squares`` are the squared lengths of the centers.
    """
    if not len(centers):
        return np.zeros(len(features))
    nearest = (squares - 2.0 * features @ centers.T).min(axis=1)
    nearest = nearest + np.vecdot(features, features)
    return np.asarray(np.exp(-0.5 * np.maximum(nearest, 0.0)))
