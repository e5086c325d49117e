"""Small neural networks with rectified units, and files of their weights."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters.arrays import Array, Singles

from .formats.npz import read_arrays


class Network(NamedTuple):
    """The mean of the inputs, shape (F,), and the weights and biases of the layers."""

    mean: Array
    layers: list[tuple[Singles, Singles]]

    def __call__(self, inputs: Array | Singles) -> Singles:
        """Return the outputs for inputs (..., F); a missing one (NaN) is usual."""
        given = np.where(np.isnan(inputs), 0.0, inputs - self.mean)
        values: Singles = given.astype(np.float32)
        for k, (weights, biases) in enumerate(self.layers):
            values = values @ weights + biases
            if k < len(self.layers) - 1:
                values = np.maximum(values, 0.0)
        return values


def read_networks(path: Path, contents: str) -> dict[str, Network]:
    """Read networks by name from a file of ``network_arrays``."""
    arrays, networks = read_arrays(path, contents), {}
    for name in (key.removesuffix("_mean") for key in arrays if key.endswith("_mean")):
        layers: list[tuple[Singles, Singles]] = []
        while (weights := arrays.get(f"{name}_weights_{len(layers)}")) is not None:
            biases = arrays[f"{name}_biases_{len(layers)}"]
            layers.append((weights.astype(np.float32), biases))
        networks[name] = Network(arrays[f"{name}_mean"], layers)
    return networks


def network_arrays(networks: Mapping[str, Network]) -> dict[str, NDArray[Any]]:
    """Return networks as named arrays, for a file."""
    arrays: dict[str, NDArray[Any]] = {}
    for name, network in networks.items():
        arrays[f"{name}_mean"] = network.mean.astype(np.float32)
        for k, (weights, biases) in enumerate(network.layers):
            arrays[f"{name}_weights_{k}"] = weights.astype(np.float16)
            arrays[f"{name}_biases_{k}"] = biases.astype(np.float32)
    return arrays
