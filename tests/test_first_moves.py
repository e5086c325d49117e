"""The first moves of a character that starts over: in motion, as the target is."""

from __future__ import annotations

import numpy as np
import pytest
from known_motions import BODY, pulled_through, stamps, standing

from kinefilter.characters import positions_from_rotations
from kinefilter.characters.rotations import IDENTITY, about_y
from kinefilter.pipeline.physics.pulled_character import PulledCharacter

ROOT = BODY.skeleton.root


@pytest.mark.parametrize("live", [False, True])
@pytest.mark.parametrize("later", [0.0, 3.0])
def test_who_appears_while_walking_and_turning_is_followed_from_the_first_frame(
    later: float, *, live: bool
) -> None:
    time = stamps(20)
    rotations = np.tile(about_y(2.0 * time)[:, None], (1, len(BODY.skeleton), 1))
    path = standing(20)[:, ROOT] + [0.0, 1.0, 0.0] + [3.0, 0.0, 0.0] * time[:, None]
    positions = positions_from_rotations(rotations, path, BODY)
    character = PulledCharacter(BODY)
    if live:
        character.start(positions[0], rotations[0])
        found, forces = [character.positions], [1.0]
        for k, dt in enumerate(np.diff(time), start=1):
            character.step(positions[k], rotations[k], dt)
            found.append(character.positions)
            forces.append(character.external_force)
    else:
        time[10:] += later  # a long gap, after which the physics starts again
        result = pulled_through(character, time, positions, rotations)
        found, forces = list(result.positions), list(result.trace.external_force)
    away = np.linalg.norm(np.array(found) - positions, axis=2)
    assert away.max() < 0.003
    np.testing.assert_allclose(forces, 1.0, atol=0.3)  # 9 from rest


@pytest.mark.parametrize("leap", [0.15, 0.3])
def test_who_leaps_away_from_the_first_frame_is_not_thrown_far(leap: float) -> None:
    positions = standing(1)[0] + [0.0, 1.0, 0.0]
    rotations = np.tile(IDENTITY, (len(BODY.skeleton), 1))
    character = PulledCharacter(BODY)
    character.start(positions, rotations)
    for _ in range(10):
        character.step(np.add(positions, [leap, 0.0, 0.0]), rotations, 1 / 30)
        assert character.root[0] < leap + 0.07
