"""Limp bodies: what falls bends as people do."""

from __future__ import annotations

import numpy as np
import pytest

from kinefilter.characters import KINECT_V1, TRACKINGS, standard_body
from kinefilter.characters.rotations import IDENTITY, inverse, multiply, rotate
from kinefilter.pipeline.physics.pulled_character import PulledCharacter

BODY = standard_body(KINECT_V1)
AHEAD = {"Wrist": 1.0, "Ankle": -1.0}


@pytest.mark.parametrize("degrees", [0.0, 90.0, 135.0, 180.0])
def test_elbows_and_knees_of_a_thrown_ragdoll_do_not_bend_backward(
    degrees: float,
) -> None:
    character, angle = PulledCharacter(BODY, TRACKINGS["ragdoll"]), np.radians(degrees)
    turns = np.tile(IDENTITY, (len(KINECT_V1), 1))
    high = np.array([0.0, 1.0, 0.0])
    target = BODY.rest_positions + high, turns
    character.start(*target)
    character.push("Spine", 2000.0 * np.array([np.sin(angle), 0.0, np.cos(angle)]), 0.2)
    least = dict.fromkeys(AHEAD, 180.0)
    for _ in range(60):
        character.step(*target, 1 / 30)
        for part, ahead in AHEAD.items():
            for j in KINECT_V1.sides(part):
                above, below = character.rotations[[KINECT_V1.parents[j], j]]
                along = BODY.directions[j]
                bone = rotate(multiply(inverse(above), below), along)
                bend = np.degrees(np.arctan2(ahead * bone[2], bone @ along))
                least[part] = min(least[part], float(bend))
    assert least["Wrist"] > -45.0  # -180 without springs
    assert least["Ankle"] > -15.0  # -131 without
