"""The physics filter on motions whose outcome is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from kinefilter.characters import KINECT_V1, Body, standard_body
from kinefilter.characters.humanoid import Tracking, joint_masses
from kinefilter.pipeline.metrics import bone_length_cv, jitter, lowest_point
from kinefilter.pipeline.physics import PhysicsFilter, substeps_in
from kinefilter.retarget import positions_from_rotations
from kinefilter.retarget.rotations import (
    IDENTITY,
    about_y,
    inverse,
    multiply,
    rotation_vector,
)
from kinefilter.scenes import perform

Array = NDArray[np.float64]
BODY = standard_body(KINECT_V1)


def _standing(count: int, lift: float = 0.0) -> tuple[Array, Array, Array]:
    time = np.arange(count) / 30.0
    positions = np.tile(BODY.rest_positions, (count, 1, 1))
    positions[..., 1] += lift
    return time, positions, np.tile(IDENTITY, (count, len(KINECT_V1), 1))


def test_in_the_air_the_pull_sags_by_gravity_over_frequency_squared() -> None:
    time, positions, rotations = _standing(60, lift=1.0)
    tracking = Tracking(natural_frequency=50.0)
    result = PhysicsFilter(BODY, tracking).run(time, positions, rotations)
    sag = positions[-1, :, 1] - result.positions[-1, :, 1]
    np.testing.assert_allclose(sag, 9.81 / 50.0**2, rtol=0.01)


def test_in_the_air_the_external_force_is_one_body_weight() -> None:
    time, positions, rotations = _standing(60, lift=1.0)
    result = PhysicsFilter(BODY).run(time, positions, rotations)
    assert result.trace.external_force[-1] == pytest.approx(1.0, rel=0.01)
    assert result.trace.contacts[-1] == 0


def test_on_the_floor_the_floor_carries() -> None:
    time, positions, rotations = _standing(60)
    positions[..., 1] -= 0.02
    result = PhysicsFilter(BODY).run(time, positions, rotations)
    assert result.trace.contacts[-1] >= 2
    assert lowest_point(result.positions, BODY).min() > -0.002


def test_constant_velocity_is_followed_without_lag() -> None:
    time, positions, rotations = _standing(60, lift=1.0)
    positions[..., 0] += 1.5 * time[:, None]
    result = PhysicsFilter(BODY).run(time, positions, rotations)
    behind = positions[-1, :, 0] - result.positions[-1, :, 0]
    np.testing.assert_allclose(behind, 0.0, atol=5e-4)


def test_a_performed_motion_is_followed_closely() -> None:
    act = perform("wave", BODY, seed=3)
    result = PhysicsFilter(BODY).run(act.time, act.positions, act.rotations)
    assert result.trace.status == "ok"
    away = np.linalg.norm(result.positions - act.positions, axis=2)
    assert away.mean() < 0.01
    turned = rotation_vector(multiply(result.rotations, inverse(act.rotations)))
    assert np.degrees(np.linalg.norm(turned, axis=2)).mean() < 5.0


def test_twist_alone_is_followed() -> None:
    time, positions, rotations = _standing(90)
    arm = [KINECT_V1.index(j) for j in ("ElbowLeft", "WristLeft", "HandLeft")]
    angle = np.radians(40.0) * np.sin(2 * np.pi * 0.5 * time)
    half = angle / 2.0
    about_arm = np.stack([np.cos(half), np.sin(half), 0 * half, 0 * half], axis=1)
    rotations[:, arm] = about_arm[:, None]
    result = PhysicsFilter(BODY).run(time, positions, rotations)
    turned = rotation_vector(multiply(result.rotations, inverse(rotations)))
    assert np.degrees(np.linalg.norm(turned[:, arm], axis=2)).max() < 6.0


def test_bone_lengths_hold_whatever_the_target_does() -> None:
    rng = np.random.default_rng(0)
    time, positions, rotations = _standing(90)
    positions = positions + 0.2 * rng.standard_normal(positions.shape)
    result = PhysicsFilter(BODY).run(time, positions, rotations)
    assert bone_length_cv(result.positions, BODY) < 1e-9
    assert jitter(time, result.positions) < jitter(time, positions)
    assert np.isfinite(result.positions).all()


def test_forces_stay_within_their_bound() -> None:
    _, positions, rotations = _standing(2)
    character = PhysicsFilter(BODY)
    character.start(positions[0], rotations[0])
    character.step(positions[1] + [2.0, 2.0, 2.0], rotations[1], 1 / 30)
    forces = character.data.actuator_force[: 3 * len(KINECT_V1)].reshape(-1, 3)
    pulls = np.linalg.norm(forces, axis=1)
    bound = joint_masses(BODY) * Tracking().largest_acceleration
    assert np.all(pulls <= bound * (1 + 1e-9))
    assert pulls.max() == pytest.approx(bound.max(), rel=0.05)


def test_a_diverging_simulation_is_reset_reported_and_never_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    time, positions, rotations = _standing(40)
    positions[20:, :, 0] += 1.0
    wild = Tracking(natural_frequency=5000.0, largest_acceleration=1e9)
    result = PhysicsFilter(BODY, wild).run(time, positions, rotations)
    assert result.trace.reset.any()
    assert "reset" in result.trace.status
    assert np.isfinite(result.positions).all()
    after = np.flatnonzero(result.trace.reset)[0]
    np.testing.assert_allclose(result.positions[after], positions[after], atol=1e-9)
    assert list(tmp_path.iterdir()) == []  # the engine keeps no log


def test_a_long_gap_takes_more_steps_not_longer_ones() -> None:
    assert substeps_in(1 / 30) == 8
    assert substeps_in(1.0) == 240
    time, positions, rotations = _standing(3)
    time = np.array([0.0, 1 / 30, 2.0])
    positions[2, :, 0] += 0.5
    result = PhysicsFilter(BODY).run(time, positions, rotations)
    assert result.trace.status == "ok"
    np.testing.assert_allclose(result.positions[2], positions[2], atol=0.02)


def test_rotations_and_positions_agree() -> None:
    act = perform("squat", _tall(), seed=2)
    result = PhysicsFilter(_tall()).run(act.time, act.positions, act.rotations)
    root = result.positions[:, KINECT_V1.root]
    np.testing.assert_allclose(
        positions_from_rotations(result.rotations, root, _tall()),
        result.positions,
        atol=1e-12,
    )


def test_the_result_turns_with_the_target() -> None:
    time, positions, rotations = _standing(30)
    turn = about_y(np.pi / 3)
    turned = positions_from_rotations(
        multiply(turn, rotations), positions[:, KINECT_V1.root], BODY
    )
    result = PhysicsFilter(BODY).run(time, turned, multiply(turn, rotations))
    np.testing.assert_allclose(result.positions[-1], turned[-1], atol=0.01)


def _tall() -> Body:
    return standard_body(KINECT_V1, height=1.95)
