"""The external force is what moves the body beyond gravity, the floor and pushes."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest
from known_motions import pulled_through
from numpy.typing import NDArray

from kinefilter.characters import KINECT_V1, Tracking, standard_body
from kinefilter.characters.anthropometry import GRAVITY
from kinefilter.characters.humanoid import to_mujoco
from kinefilter.characters.rotations import IDENTITY
from kinefilter.pipeline.physics import pulled_character as pulled
from kinefilter.pipeline.physics.pulled_character import PulledCharacter
from kinefilter.scenes.library import perform

Array = NDArray[np.float64]
BODY = standard_body(KINECT_V1)
WEIGHT = BODY.mass * GRAVITY
UPWARD = np.array([0.0, 0.0, WEIGHT])


@pytest.fixture
def contacts(monkeypatch: pytest.MonkeyPatch) -> list[Array]:
    """What contacts give the body [N] in each substep since the list was emptied."""
    found: list[Array] = []
    step = mujoco.mj_step

    def noted(model: Any, data: Any, **options: Any) -> None:
        step(model, data, **options)
        found.append(data.qfrc_constraint[:3].copy())  # the root's, so on all it holds

    monkeypatch.setattr(pulled.mujoco, "mj_step", noted)
    return found


def _momentum(character: PulledCharacter) -> Array:
    model, data = character.model, mujoco.MjData(character.model)
    mujoco.mj_copyData(data, model, character.data)
    mujoco.mj_fwdPosition(model, data)
    mujoco.mj_fwdVelocity(model, data)
    mujoco.mj_subtreeVel(model, data)
    return BODY.mass * np.asarray(data.subtree_linvel[model.body("HipCenter").id])


@pytest.mark.parametrize("frequency", [30.0, 60.0])
@pytest.mark.parametrize("motion", ["squat", "punch", "walk"])
@pytest.mark.parametrize("pushed", [0.0, 150.0])
def test_it_is_what_the_momentum_gains_beyond_gravity_floor_and_pushes(
    motion: str, frequency: float, pushed: float, contacts: list[Array]
) -> None:
    act = perform(motion, BODY, seed=3)
    dt = float(act.time[1] - act.time[0])
    character = PulledCharacter(BODY, Tracking(natural_frequency=frequency))
    character.start(act.positions[0], act.rotations[0])
    push = np.array([0.0, 0.3, 1.0]) * pushed
    stands = np.full(2, motion != "walk")  # no foot that walks away
    differences, sizes = [], []
    for k in range(1, 60):
        character.push("ShoulderCenter", push, dt)
        before = _momentum(character)
        contacts.clear()
        assert character.step(act.positions[k], act.rotations[k], dt, stands=stands)
        gained = (_momentum(character) - before) / dt
        beyond = gained + UPWARD - np.mean(contacts, axis=0) - to_mujoco(push)
        force = np.linalg.norm(beyond) / WEIGHT
        differences.append(character.external_force - force)
        sizes.append(force)
    assert np.max(sizes) > 0.05  # there is something to find
    assert np.abs(differences).mean() < 0.1 * np.mean(sizes)


def test_in_the_air_it_is_what_the_motion_needs_however_hard_the_pulls() -> None:
    time = np.arange(120) / 30.0
    pace = 2.0 * np.pi * 0.7
    positions = np.tile(BODY.rest_positions, (len(time), 1, 1))
    positions += np.array([0.2, 0.0, 0.0]) * np.sin(pace * time)[:, None, None]
    positions[..., 1] += 1.0
    rotations = np.tile(IDENTITY, (*positions.shape[:2], 1))
    needed = np.hypot(GRAVITY, 0.2 * pace**2 * np.sin(pace * (time - 0.5 / 30.0)))
    for frequency in (30.0, 60.0, 90.0):
        character = PulledCharacter(BODY, Tracking(natural_frequency=frequency))
        found = pulled_through(
            character, time, positions, rotations
        ).trace.external_force
        np.testing.assert_allclose(found[10:], needed[10:] / GRAVITY, atol=0.05)


def test_it_is_no_more_than_the_pulls_can_give() -> None:
    act = perform("stand_idle", BODY, seed=3)
    character = PulledCharacter(BODY, Tracking())
    character.start(act.positions[0], act.rotations[0])
    character.step(act.positions[1], act.rotations[1], 1 / 30)
    character.momentum._before = np.array([0.0, 0.0, 1e9])  # as contacts that explode
    character.step(act.positions[2], act.rotations[2], 1 / 30)
    ranges = character.model.actuator_forcerange[
        character.model.actuator_gear[:, 2] > 0
    ]
    strongest = np.abs(ranges).max(axis=1).sum() / WEIGHT
    assert character.external_force == pytest.approx(strongest, rel=1e-3)
