"""Postures whose left wrist is off, and what was taught with them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from real_data import PAIRS

from kinefilter.characters import KINECT_V1, standard_body
from kinefilter.pipeline.correct import Correction, Observation
from kinefilter.pipeline.lab.methods.baselines import Exemplar, FullGP
from kinefilter.pipeline.lab.methods.clustered_gp import ClusteredGP
from kinefilter.pipeline.lab.methods.local_gp import LocalGP
from kinefilter.pipeline.lab.methods.training_data import TrainingSet
from kinefilter.pipeline.lab.training import training_set
from kinefilter.pipeline.pairs import read_pairs

__all__ = [
    "BIAS",
    "ELBOW",
    "ONES",
    "SPINE",
    "WRIST",
    "Array",
    "Method",
    "bent",
    "constant",
    "copied",
    "corrected",
    "lessons_of",
    "local_gp",
    "moves_of",
    "postures_of",
    "recorded_lessons",
    "training_set_of",
]

Array = NDArray[np.float64]
Method = LocalGP | FullGP | Exemplar | ClusteredGP
ONES = np.ones(len(KINECT_V1))
WRIST, ELBOW = KINECT_V1.index("WristLeft"), KINECT_V1.index("ElbowLeft")
SPINE = KINECT_V1.index("Spine")
BIAS = np.array([0.03, -0.05, 0.02])


def postures_of(count: int, seed: int) -> Array:
    """Return postures on the standard body that vary along three directions."""
    rest = standard_body(KINECT_V1).rest_positions
    directions = np.random.default_rng(99).normal(0.0, 0.1, (3, *rest.shape))
    latent = np.random.default_rng(seed).uniform(-1.0, 1.0, (count, 3))
    postures = rest - rest[KINECT_V1.root] + np.tensordot(latent, directions, axes=1)
    postures[:, KINECT_V1.root] = 0.0
    return np.asarray(postures)


def lessons_of(
    offset: Callable[[Array], Array], count: int = 320, seed: int = 0
) -> TrainingSet:
    """Return postures whose left wrist is off; mocap has no spine."""
    seen = postures_of(count, seed)
    truth = seen.copy()
    truth[:, WRIST] += offset(seen)
    truth[:, SPINE] = np.nan
    reliability = np.ones(seen.shape[:2])
    first = np.zeros(count, dtype=bool)
    first[0] = True
    return training_set_of(seen, reliability, truth, first)


def training_set_of(
    positions: Array,
    reliability: Array,
    truth: Array,
    first: NDArray[np.bool_],
    **known: Any,
) -> TrainingSet:
    """Return frames at 30 Hz of one person of standard size in front of a sensor."""
    count = len(positions)
    usual: dict[str, Any] = {
        "skeleton": KINECT_V1,
        "source": "imagined",
        "lengths": np.tile(standard_body(KINECT_V1).lengths, (count, 1)),
        "person": np.zeros(count, dtype=np.intp),
        "people": ("somebody",),
        "time": np.arange(count) / 30.0,
        "sensor": np.zeros((count, 3)),
    }
    return TrainingSet(positions, reliability, truth, first, **usual | known)


def bent(seen: Array) -> Array:
    return BIAS * np.sin(6.0 * seen[:, WRIST, :1])


def constant(seen: Array) -> Array:
    return np.tile(BIAS, (len(seen), 1))


def local_gp(**settings: Any) -> LocalGP:
    return LocalGP(KINECT_V1, **{"clusters": 6, "samples": 30, **settings})


def corrected(
    model: Method, postures: Array, reliability: Array = ONES
) -> list[Correction]:
    model.start()
    return [
        model.step(Observation(posture, reliability, reliability, k / 30.0))
        for k, posture in enumerate(postures)
    ]


def moves_of(model: Method, postures: Array) -> Array:
    """Return by how much joints move, each posture by itself, (N, J, 3)."""
    return np.array([corrected(model, p[None])[0].positions - p for p in postures])


def copied(model: Method) -> Method:
    return type(model).from_arrays(KINECT_V1, model.arrays())


def recorded_lessons(keep: Callable[[int], bool]) -> TrainingSet:
    """Return two movements of one person, of the repetitions that are kept."""
    pairs = [
        pair
        for pair in read_pairs(PAIRS / "s02.npz")
        if pair.clip[:3] in ("m01", "m07")
        and "_inc" not in pair.clip
        and keep(int(pair.clip[9:11]))
    ]
    return training_set(pairs)
