"""Synthetic people with realistic statures, builds and masses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kinefilter.characters import Body, Skeleton, standard_body
from kinefilter.characters.arrays import check_kind

_SHORTEST, _TALLEST = 1.5, 2.0  # m, of random bodies: about 99 % of adults
# Mean and standard deviation of stature [m], men and women, in ANSUR II (Gordon et al.
# 2014, 2012 Anthropometric Survey of U.S. Army Personnel, Natick/TR-15/007), rounded.
_STATURES = ((1.756, 0.069), (1.629, 0.064))
# Relative standard deviation of segment lengths among people of the same stature. Based
# on the same survey's coefficients of variation among all statures (sitting height 4 %,
# arm and leg segments 5 %, biacromial breadth 4.6 %); the share that remains at one
# stature is a guess.
_BUILD = {"trunk": 0.03, "Shoulder": 0.04, "Hip": 0.05}
_BUILD |= dict.fromkeys(("Elbow", "Wrist", "Knee", "Ankle"), 0.03)
_MASS_INDEX = (23.5, 2.5)  # kg/m^2: mean and standard deviation, a guess


def random_body(skeleton: Skeleton, rng: np.random.Generator) -> Body:
    """Draw the stature, build and mass of a person and return the body.

    The body is symmetric. The same draws give the same person on every skeleton.
    """
    check_kind(rng, np.random.Generator, "rng")
    mean, deviation = _STATURES[int(rng.integers(2))]
    height = float(np.clip(rng.normal(mean, deviation), _SHORTEST, _TALLEST))
    index = float(np.clip(rng.normal(*_MASS_INDEX), 18.5, 30.0))
    scale = {part: 1.0 + sd * rng.normal() for part, sd in _BUILD.items()}
    body = standard_body(skeleton, height=height, mass=index * height**2)
    parts = [j.removesuffix("Left").removesuffix("Right") for j in skeleton.joints]
    factors = [
        scale["trunk"] if part == joint else scale.get(part, 1.0)
        for part, joint in zip(parts, skeleton.joints, strict=True)
    ]
    return replace(body, lengths=body.lengths * np.array(factors))
