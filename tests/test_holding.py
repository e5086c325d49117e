"""The character and things: sitting, holding, kicking, nothing passing through."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinefilter import CleanConfig, clean
from kinefilter.characters import KINECT_V1, standard_body
from kinefilter.characters.anthropometry import GRAVITY
from kinefilter.pipeline.lab.simulation import simulate
from kinefilter.pipeline.physics import PhysicsFilter
from kinefilter.retarget import BoneLengths, rotations_from_positions

Array = NDArray[np.float64]
BODY = standard_body(KINECT_V1)
PARCEL = """
<mujoco model="parcel">
  <worldbody>
    <body name="stand" pos="0.42 0 0.45">
      <geom name="stand" type="box" size="0.12 0.05 0.45"/>
    </body>
    <body name="parcel" pos="0.42 0 1.0">
      <freejoint/><geom name="parcel" type="box" size="0.1 0.12 0.1" mass="2"/>
    </body>
  </worldbody>
</mujoco>
"""


def reaching(apart: Array, height: Array) -> tuple[Array, Array]:
    """Return a person with hands in front of the chest, (T, J, 3) and (T, J, 4)."""
    positions = np.tile(BODY.rest_positions, (len(apart), 1, 1))
    firm = np.ones(positions.shape[:2])
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        elbow, wrist, hand = (
            KINECT_V1.index(part + side) for part in ("Elbow", "Wrist", "Hand")
        )
        x = sign * apart
        positions[:, hand] = np.stack([x, height, 0.42 + 0.0 * x], axis=1)
        positions[:, wrist] = np.stack([x, height, 0.34 + 0.0 * x], axis=1)
        positions[:, elbow] = np.stack(
            [x + sign * 0.12, height - 0.05, 0.10 + 0.0 * x], axis=1
        )
        firm[:, [wrist, hand]] = 50.0
    positions = BoneLengths(BODY).project(positions, firm)
    return positions, rotations_from_positions(positions, BODY)


def test_two_hands_lift_a_parcel_and_let_it_go(tmp_path: Path) -> None:
    scene = tmp_path / "parcel.xml"
    scene.write_text(PARCEL)
    time = np.arange(180) / 30.0
    touch = 0.12 + BODY.radii[KINECT_V1.index("HandLeft")]
    apart = np.interp(time, [0.0, 1.0, 4.0, 4.5], [0.25, touch, touch, 0.3])
    height = np.interp(time, [0.0, 1.5, 3.0], [1.0, 1.0, 1.35])
    positions, rotations = reaching(apart, height)
    character = PhysicsFilter(BODY, scene=scene)
    character.start(positions[0], rotations[0])
    stands = np.ones(2, dtype=bool)
    heights = []
    for k in range(1, len(time)):
        character.step(positions[k], rotations[k], 1 / 30, stands=stands)
        heights.append(character.data.body("parcel").xpos[2])
    held = heights[int(3.5 * 30)]
    assert held > 1.2, held
    assert heights[-1] < 1.05  # dropped when the hands part


def test_hands_let_go_when_they_are_to_part_and_not_when_they_tremble(
    tmp_path: Path,
) -> None:
    scene = tmp_path / "parcel.xml"
    scene.write_text(PARCEL)
    touch = 0.12 + BODY.radii[KINECT_V1.index("HandLeft")]
    apart = np.append(np.linspace(0.25, touch, 40), [touch + 0.02, touch + 0.1])
    positions, rotations = reaching(apart, np.full(len(apart), 1.0))
    character = PhysicsFilter(BODY, scene=scene)
    character.start(positions[0], rotations[0])
    grips = []
    for posture, turned in zip(positions[1:], rotations[1:], strict=True):
        character.step(posture, turned, 1 / 30, stands=np.ones(2, dtype=bool))
        grips.append(character.data.actuator("grip:HandLeft").ctrl[0])
    # As they come, as they hold, as they tremble, as they are to be 20 cm wider apart.
    np.testing.assert_array_equal([grips[0], *grips[-3:]], [0.0, 1.0, 1.0, 0.0])


def test_who_sits_rests_on_the_chair_and_does_not_sink_in() -> None:
    take = simulate("chair", "chair", seed=5).take
    hips = []
    for scene in (None, "chair"):
        clip = clean(take, CleanConfig(scene=scene)).clip
        hips.append(clip.positions[:, clip.skeleton.root, 1].min())
    assert hips[1] > hips[0] + 0.01  # as seen, the sitter sinks into the seat
    assert 0.45 < hips[1] < 0.75  # whose top is at 0.45 m


def test_the_grip_of_a_hand_is_no_external_force(tmp_path: Path) -> None:
    scene = tmp_path / "parcel.xml"
    scene.write_text(PARCEL)
    touch = 0.12 + BODY.radii[KINECT_V1.index("HandLeft")]
    apart = np.append(np.linspace(0.25, touch, 40), np.full(60, touch))
    positions, rotations = reaching(apart, np.full(len(apart), 1.0))
    character = PhysicsFilter(BODY, scene=scene)
    character.start(positions[0], rotations[0])
    for k in range(1, len(apart)):
        character.step(
            positions[k], rotations[k], 1 / 30, stands=np.ones(2, dtype=bool)
        )
    assert character.data.ctrl[character._grips].all()
    character.model.actuator_gainprm[character._grips[0], 0] = 0.0  # one hand alone
    for _ in range(30):
        character.step(
            positions[-1], rotations[-1], 1 / 30, stands=np.ones(2, dtype=bool)
        )
    # At rest, the last substep says what all of them do. The feet press on the floor.
    pressed = -character.data.xfrc_applied[:, 2].sum()
    pulls = character.data.actuator_force[: 3 * len(KINECT_V1)].reshape(-1, 3)
    wanted = np.linalg.norm(pulls.sum(axis=0) - [0.0, 0.0, pressed])
    assert abs(character.external_force - wanted / (BODY.mass * GRAVITY)) < 0.01
