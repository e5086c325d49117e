"""Made-up people: bodies of the statures, builds and masses that there are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kinefilter.characters import Body, Skeleton, standard_body
from kinefilter.characters.arrays import check_kind

_SHORTEST, _TALLEST = 1.5, 2.0  # m, of random bodies: about 99 % of adults
# Mean and standard deviation of stature [m], men and women, in ANSUR II (Gordon et al.
# 2014, 2012 Anthropometric Survey of U.S. Army Personnel, Natick/TR-15/007), rounded.
_STATURES = ((1.756, 0.069), (1.629, 0.064))
# Standard deviation of segment lengths among people of one stature, as a share. Rounded
# from the same survey's coefficients of variation, sitting height 4 %, arm and leg
# segments 5 %, biacromial breadth 4.6 %; how much of it is left at one stature is a
# guess.
_BUILD = {"trunk": 0.03, "Shoulder": 0.04, "Hip": 0.05}
_BUILD |= dict.fromkeys(("Elbow", "Wrist", "Knee", "Ankle"), 0.03)
_MASS_INDEX = (23.5, 2.5)  # kg/m^2, mean and standard deviation, a guess of the slim


def random_body(skeleton: Skeleton, rng: np.random.Generator) -> Body:
    """Return the body of somebody: stature, build and mass drawn.

    Left and right are alike. The same draws give the same person on every skeleton.
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
