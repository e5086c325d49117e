"""Legs that kick: as high as they were seen, and without the rest of the body."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from test_target import placed

from kinefilter.characters import KINECT_V1, standard_body
from kinefilter.pipeline.correct import Observation
from kinefilter.pipeline.factory import shipped_model
from kinefilter.scenes.library import perform

Array = NDArray[np.float64]

BODY = standard_body(KINECT_V1)


def test_what_ships_does_not_lower_legs_that_kick() -> None:
    """Offsets that lengthen standing legs turn with them, or it would be 10 degrees."""
    act, skeleton = perform("kick", BODY, seed=0), KINECT_V1
    kick = act.positions - act.positions[:, [skeleton.root]]
    hip, ankle = skeleton.sides("Hip"), skeleton.sides("Ankle")

    def raised(positions: Array) -> Array:
        legs = positions[:, ankle] - positions[:, hip]
        return np.degrees(np.arccos(-legs[..., 1] / np.linalg.norm(legs, axis=2)))

    sure = np.ones(kick.shape[:2])
    seen = Observation(kick, sure, sure, act.time)
    made = shipped_model(skeleton).whole(seen).positions
    assert raised(kick).max() > 80.0
    assert raised(made).max() > raised(kick).max() - 6.5


def test_a_high_kick_hardly_draws_the_body_along() -> None:
    """A sensor that shows a kicking leg 15 cm too long, for a tenth of a second."""
    act = perform("wave", BODY, seed=0)
    path, kick = act.positions.copy(), slice(40, 43)
    hip, knee, ankle, foot = (
        BODY.skeleton.index(f"{j}Right") for j in ("Hip", "Knee", "Ankle", "Foot")
    )
    for j, reach in ((knee, 0.42), (ankle, 0.9), (foot, 1.0)):
        path[kick, j] = path[kick, hip] + [0.0, 0.1 * reach, reach]
    root = placed(act.time, path).posed[:, BODY.skeleton.root]
    assert (
        np.linalg.norm(np.diff(root, axis=0), axis=1).max() < 0.05
    )  # m, between two frames
