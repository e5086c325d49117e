"""The physics filter on motions whose outcome is known."""

from __future__ import annotations

from math import prod
from pathlib import Path

import mujoco
import numpy as np
import pytest
from known_motions import pulled_through
from numpy.typing import NDArray

from kinefilter.characters import (
    KINECT_V1,
    Body,
    InputError,
    Tracking,
    positions_from_rotations,
    standard_body,
)
from kinefilter.characters.anthropometry import GRAVITY, joint_masses, joint_range
from kinefilter.characters.humanoid import from_mujoco
from kinefilter.characters.rotations import (
    IDENTITY,
    about_y,
    inverse,
    multiply,
    rotation_vector,
)
from kinefilter.pipeline.metrics import bone_length_cv, jitter, lowest_point
from kinefilter.pipeline.physics.pulled_character import PulledCharacter
from kinefilter.pipeline.physics.world import steps_in
from kinefilter.retarget import HeadingFrame
from kinefilter.retarget.limbs import bent_limb
from kinefilter.scenes.library import perform

Array = NDArray[np.float64]
BODY = standard_body(KINECT_V1)


def _standing(count: int, lift: float = 0.0) -> tuple[Array, Array, Array]:
    time = np.arange(count) / 30.0
    positions = np.tile(BODY.rest_positions, (count, 1, 1))
    positions[..., 1] += lift
    return time, positions, np.tile(IDENTITY, (count, len(KINECT_V1), 1))


def test_in_the_air_the_pull_carries_the_weight_and_does_not_sag() -> None:
    time, positions, rotations = _standing(60, lift=1.0)
    result = pulled_through(PulledCharacter(BODY), time, positions, rotations)
    np.testing.assert_allclose(result.positions[-1], positions[-1], atol=1e-4)


def test_a_weight_more_than_expected_sags_by_gravity_over_frequency_squared() -> None:
    _, positions, rotations = _standing(1, lift=1.0)
    character = PulledCharacter(BODY, Tracking(natural_frequency=50.0))
    character.model.opt.gravity[2] *= 2.0
    character.start(positions[0], rotations[0])
    for _ in range(60):
        character.step(positions[0], rotations[0], 1 / 30)
    sag = positions[0, :, 1] - character.positions[:, 1]
    np.testing.assert_allclose(sag, 9.81 / 50.0**2, rtol=0.01)


def test_in_the_air_the_external_force_is_one_body_weight() -> None:
    time, positions, rotations = _standing(60, lift=1.0)
    result = pulled_through(PulledCharacter(BODY), time, positions, rotations)
    assert result.trace.external_force[-1] == pytest.approx(1.0, rel=0.01)
    assert result.trace.contacts[-1] == 0


def test_on_the_floor_the_floor_carries() -> None:
    time, positions, rotations = _standing(60)
    positions[..., 1] -= 0.02
    result = pulled_through(PulledCharacter(BODY), time, positions, rotations)
    assert result.trace.contacts[-1] >= 2
    assert lowest_point(result.positions, BODY).min() > -0.002


def test_who_stands_is_carried_by_the_floor_alone() -> None:
    time, positions, rotations = _standing(60)
    stands = np.ones((60, 2), dtype=bool)
    result = pulled_through(
        PulledCharacter(BODY), time, positions, rotations, stands=stands
    )
    assert result.trace.external_force[-1] < 0.06
    assert result.trace.contacts[-1] >= 4  # heels and toes
    np.testing.assert_allclose(result.positions, positions, atol=1e-3)


def test_a_foot_that_steps_in_a_gap_is_not_held_where_it_was() -> None:
    time, positions, rotations = _standing(60)
    stands, toes = np.ones((60, 2), dtype=bool), BODY.skeleton.sides("Foot")
    time[30:] += 0.8
    positions[30:, :, 2] += 0.3
    character = PulledCharacter(BODY)
    result = pulled_through(character, time, positions, rotations, stands=stands)
    away = np.linalg.norm((result.positions - positions)[:, toes], axis=2)
    assert away[30:].max() < 0.02


def test_on_one_foot_the_other_does_not_press() -> None:
    _, positions, rotations = _standing(1)
    character = PulledCharacter(BODY)
    character.start(positions[0], rotations[0])
    for _ in range(30):
        character.step(
            positions[0], rotations[0], 1 / 30, stands=np.array([True, False])
        )
    model, data = character.model, character.data
    borne, force = np.zeros(model.nbody), np.zeros(6)
    for k, contact in enumerate(data.contact):
        mujoco.mj_contactForce(model, data, k, force)
        borne[model.geom_bodyid[contact.geom]] += force[0]
    left, right = (model.body(f"Foot{side}").id for side in ("Left", "Right"))
    assert borne[left] == pytest.approx(BODY.mass * GRAVITY, rel=0.02)
    assert borne[right] < 0.02 * BODY.mass * GRAVITY
    assert data.xfrc_applied[right, 2] == 0.0


def test_quick_movement_is_followed_within_millimeters_and_without_lag() -> None:
    time, positions, rotations = _standing(120, lift=1.0)
    positions[..., 0] += 0.3 * np.sin(2.0 * np.pi * 1.5 * time)[:, None]
    result = pulled_through(PulledCharacter(BODY), time, positions, rotations)
    behind = (positions - result.positions)[10:, :, 0]
    assert np.abs(behind).max() < 0.005


def test_no_knee_folds_farther_than_people_can() -> None:
    time, positions, rotations = _standing(60, lift=1.0)
    hip, knee, ankle = (KINECT_V1.index(f"{j}Left") for j in ("Hip", "Knee", "Ankle"))
    angle = np.radians(178.0) * np.minimum(time, 1.0)
    shank = BODY.lengths[ankle]
    positions[:, ankle] = positions[:, knee] + shank * np.stack(
        [0.0 * angle, -np.cos(angle), -np.sin(angle)], axis=1
    )
    foot = KINECT_V1.index("FootLeft")
    positions[:, foot] = positions[:, ankle] + [0.0, -0.1, 0.0]
    rotations[:, ankle, 0], rotations[:, ankle, 1] = (
        np.cos(angle / 2),
        np.sin(angle / 2),
    )
    result = pulled_through(PulledCharacter(BODY), time, positions, rotations)
    assert not result.trace.reset.any()
    thigh = result.positions[-1, knee] - result.positions[-1, hip]
    lower = result.positions[-1, ankle] - result.positions[-1, knee]
    cosine = thigh @ lower / (np.linalg.norm(thigh) * np.linalg.norm(lower))
    folded = np.degrees(np.arccos(cosine))
    # Ligaments give way a little under the strongest pull that there is.
    assert 130.0 < folded < np.degrees(joint_range("AnkleLeft")) + 10.0


def test_limbs_that_are_left_behind_when_the_body_turns_at_once_are_let_go() -> None:
    """Forearms twisted by more than elbows allow would stay so for ever."""
    _, positions, rotations = _standing(60, lift=1.0)
    character, root = PulledCharacter(BODY), positions[0, BODY.skeleton.root]
    character.start(positions[0], rotations[0])
    for k in range(1, 60):
        turned = HeadingFrame(root, np.array(np.pi * (k > 5)))
        target = turned.restore_rotations(rotations[k])
        character.step(turned.restore(positions[k] - root), target, 1 / 30)
    assert np.abs(np.vecdot(character.rotations, target)).min() > 0.95


def test_a_hand_pulled_into_the_trunk_stays_outside() -> None:
    time, positions, rotations = _standing(60, lift=1.0)
    spine, center = KINECT_V1.index("Spine"), KINECT_V1.index("ShoulderCenter")
    inside = 0.5 * (positions[0, spine] + positions[0, center])
    arm = [KINECT_V1.index(f"{part}Left") for part in ("Elbow", "Wrist", "Hand")]
    upper, forearm, fingers = BODY.lengths[arm]
    shoulder = positions[0, KINECT_V1.index("ShoulderLeft")]
    elbow, hand = bent_limb(
        shoulder,
        inside,
        np.array([0.5, -0.5, 1.0]),
        np.array([upper, forearm + fingers]),
    )
    wrist = hand + fingers / (forearm + fingers) * (elbow - hand)
    share = np.minimum(time / 1.0, 1.0)[:, None, None]
    positions[:, arm] += share * (np.array([elbow, wrist, hand]) - positions[:, arm])
    result = pulled_through(PulledCharacter(BODY), time, positions, rotations)
    hand = result.positions[-1, KINECT_V1.index("HandLeft")]
    trunk = result.positions[-1, [spine, center]]
    along = trunk[1] - trunk[0]
    share = np.clip((hand - trunk[0]) @ along / (along @ along), 0.0, 1.0)
    apart = np.linalg.norm(hand - trunk[0] - share * along)
    touching = BODY.radii[KINECT_V1.index("HandLeft")] + BODY.radii[center]
    assert apart > touching - 0.04  # flesh gives way


def test_constant_velocity_is_followed_without_lag() -> None:
    time, positions, rotations = _standing(60, lift=1.0)
    positions[..., 0] += 1.5 * time[:, None]
    result = pulled_through(PulledCharacter(BODY), time, positions, rotations)
    behind = positions[-1, :, 0] - result.positions[-1, :, 0]
    np.testing.assert_allclose(behind, 0.0, atol=5e-4)


def test_a_performed_motion_is_followed_closely() -> None:
    act = perform("wave", BODY, seed=3)
    result = pulled_through(
        PulledCharacter(BODY), act.time, act.positions, act.rotations
    )
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
    result = pulled_through(PulledCharacter(BODY), time, positions, rotations)
    turned = rotation_vector(multiply(result.rotations, inverse(rotations)))
    assert np.degrees(np.linalg.norm(turned[:, arm], axis=2)).max() < 6.0


def test_bone_lengths_hold_whatever_the_target_does() -> None:
    rng = np.random.default_rng(0)
    time, positions, rotations = _standing(90)
    positions = positions + 0.2 * rng.standard_normal(positions.shape)
    result = pulled_through(PulledCharacter(BODY), time, positions, rotations)
    assert bone_length_cv(result.positions, BODY) < 1e-9
    assert jitter(time, result.positions) < jitter(time, positions)
    assert np.isfinite(result.positions).all()


def test_forces_stay_within_their_bound() -> None:
    _, positions, rotations = _standing(2)
    character = PulledCharacter(BODY)
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
    result = pulled_through(PulledCharacter(BODY, wild), time, positions, rotations)
    assert result.trace.reset.any()
    assert "reset" in result.trace.status
    assert np.isfinite(result.positions).all()
    after = np.flatnonzero(result.trace.reset)[0]
    np.testing.assert_allclose(result.positions[after], positions[after], atol=1e-9)
    assert list(tmp_path.iterdir()) == []  # the engine keeps no log


def test_starting_again_forgets_the_last_frames_and_pushes() -> None:
    _, positions, rotations = _standing(1)

    def followed(character: PulledCharacter) -> Array:
        character.start(positions[0], rotations[0])
        for _ in range(10):
            character.step(positions[0] + [0.05, 0.0, 0.0], rotations[0], 1 / 30)
        return character.positions.copy()

    character = PulledCharacter(BODY)
    first = followed(character)
    character.push("Head", np.array([300.0, 0.0, 0.0]), 60.0)
    character.step(positions[0], rotations[0], 1 / 30)
    np.testing.assert_array_equal(followed(character), first)


@pytest.mark.parametrize("rate", [30.0, 60.0])
@pytest.mark.parametrize("seconds", [0.01, 0.1])
def test_a_push_gives_force_times_time_at_any_frame_rate(
    rate: float, seconds: float
) -> None:
    _, positions, rotations = _standing(1, lift=1.0)
    character = PulledCharacter(BODY)
    character.limp = True
    character.model.opt.gravity[:] = 0.0
    character.start(positions[0], rotations[0])
    force = np.array([30.0, 0.0, 100.0])
    character.push("ShoulderCenter", force, seconds)
    for _ in range(10):
        character.step(positions[0], rotations[0], 1.0 / rate)
    mujoco.mj_forward(character.model, character.data)
    mujoco.mj_subtreeVel(character.model, character.data)
    root = character.model.body("HipCenter").id
    momentum = BODY.mass * from_mujoco(character.data.subtree_linvel[root])
    given = force * seconds
    # The engine's steps keep the momentum of spinning arms and legs to about a percent.
    np.testing.assert_allclose(momentum, given, atol=0.02 * np.linalg.norm(given))


def test_a_new_character_stands_in_t_pose_and_can_be_led_from_there() -> None:
    character = PulledCharacter(BODY)
    np.testing.assert_allclose(character.positions, BODY.rest_positions, atol=1e-9)
    _, positions, rotations = _standing(1)
    assert character.step(positions[0], rotations[0], 1 / 30)


@pytest.mark.parametrize("dt", [0.0, -0.1, np.nan, np.inf])
def test_a_step_without_time_is_refused(dt: float) -> None:
    _, positions, rotations = _standing(1)
    with pytest.raises(InputError, match="time since the last"):
        PulledCharacter(BODY).step(positions[0], rotations[0], dt)


@pytest.mark.parametrize("wrong", [np.nan, np.inf])
def test_a_target_that_is_not_finite_is_refused_and_harms_nothing(wrong: float) -> None:
    _, positions, rotations = _standing(1)
    character = PulledCharacter(BODY)
    for broken in (positions[0].copy(), rotations[0].copy()):
        broken[3] = wrong
        frame = {3: positions[0], 4: rotations[0]} | {broken.shape[1]: broken}
        with pytest.raises(InputError, match="not finite"):
            character.start(frame[3], frame[4])
        with pytest.raises(InputError, match="not finite"):
            character.step(frame[3], frame[4], 1 / 30)
    assert character.step(positions[0], rotations[0], 1 / 30)
    np.testing.assert_allclose(character.positions, positions[0], atol=0.01)


def test_a_limp_character_falls_and_one_that_is_held_does_not() -> None:
    _, positions, rotations = _standing(1, lift=0.5)
    character = PulledCharacter(BODY)
    fallen = []
    for limp in (False, True, False):
        character.limp = limp
        assert character.limp is limp
        character.start(positions[0], rotations[0])
        for _ in range(6):
            character.step(positions[0], rotations[0], 1 / 30)
        fallen.append(float((positions[0] - character.positions)[:, 1].mean()))
    # Six thirtieths of a second of free fall.
    assert fallen[1] == pytest.approx(0.5 * GRAVITY * 0.2**2, rel=0.1)
    np.testing.assert_allclose([fallen[0], fallen[2]], 0.0, atol=1e-3)


@pytest.mark.parametrize(
    ("dt", "steps"), [(1e-4, 1), (1 / 240, 1), (1 / 120, 2), (1 / 60, 4), (1 / 24, 12)]
)
def test_no_step_is_longer_than_it_may_be(dt: float, steps: int) -> None:
    assert prod(steps_in(dt)) == steps


def test_a_long_gap_takes_more_steps_not_longer_ones() -> None:
    assert prod(steps_in(1 / 30)) == 8
    assert prod(steps_in(1.0)) == 240
    time, positions, rotations = _standing(3)
    time = np.array([0.0, 1 / 30, 2.0])
    positions[2, :, 0] += 0.5
    result = pulled_through(PulledCharacter(BODY), time, positions, rotations)
    assert result.trace.status == "ok"
    np.testing.assert_allclose(result.positions[2], positions[2], atol=0.02)


def test_rotations_and_positions_agree() -> None:
    act = perform("squat", _tall(), seed=2)
    result = pulled_through(
        PulledCharacter(_tall()), act.time, act.positions, act.rotations
    )
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
    result = pulled_through(
        PulledCharacter(BODY), time, turned, multiply(turn, rotations)
    )
    np.testing.assert_allclose(result.positions[-1], turned[-1], atol=0.01)


def _tall() -> Body:
    return standard_body(KINECT_V1, height=1.95)
