"""A mug that one hand takes and puts down, a drawer and a door that it opens."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from test_holding import BODY

from kinefilter.characters import KINECT_V1
from kinefilter.pipeline.physics.pulled_character import PulledCharacter
from kinefilter.retarget import BoneLengths, rotations_from_positions

Array = NDArray[np.float64]
RADIUS = float(BODY.radii[KINECT_V1.index("HandRight")])
# In MuJoCo's world the person looks along x, and their right is -y.
SCENE = """
<mujoco model="things">
  <worldbody>
    <body name="table" pos="0.5 -0.2 0.45">
      <geom name="table" type="box" size="0.15 0.25 0.45"/>
    </body>
    {}
  </worldbody>
</mujoco>
"""
MUG = """
<body name="mug" pos="0.45 -0.2 0.95">
  <freejoint/><geom name="mug" type="cylinder" size="0.035 0.05" mass="0.4"/>
</body>
"""
DRAWER = """
<body name="drawer" pos="0.45 -0.2 0.95">
  <joint name="drawer" type="slide" axis="1 0 0" range="-0.3 0" limited="true"
         damping="5"/>
  <geom name="drawer" type="box" size="0.02 0.06 0.02" mass="1"/>
</body>
"""
DOOR = """
<body name="door" pos="0.45 -0.8 0.95">
  <joint name="door" type="hinge" axis="0 0 1" damping="1"/>
  <geom name="door" type="box" size="0.015 0.3 0.3" pos="0 0.35 0" mass="5"/>
</body>
"""


def along(*places: tuple[float, float, float, float]) -> tuple[Array, Array]:
    """Return a person whose right hand goes through (seconds, x, y, z)."""
    stops = np.array(places)
    time = np.arange(int(stops[-1, 0] * 30)) / 30.0
    hand = np.stack([np.interp(time, stops[:, 0], c) for c in stops.T[1:]], axis=1)
    positions = np.tile(BODY.rest_positions, (len(time), 1, 1))
    firm = np.ones(positions.shape[:2])
    palm, wrist, elbow = (
        KINECT_V1.index(f"{part}Right") for part in ("Hand", "Wrist", "Elbow")
    )
    positions[:, palm] = hand
    positions[:, wrist] = hand - [0.0, 0.0, 0.08]
    positions[:, elbow] = hand - [0.05, 0.1, 0.3]
    for part, x in (("Elbow", 0.25), ("Wrist", 0.3), ("Hand", 0.3)):
        height = {"Elbow": 1.05, "Wrist": 0.85, "Hand": 0.75}[part]
        positions[:, KINECT_V1.index(f"{part}Left")] = [x, height, 0.0]
    firm[:, [palm, wrist]] = 50.0
    positions = BoneLengths(BODY).project(positions, firm)
    return positions, rotations_from_positions(positions, BODY)


def played(
    path: Path, thing: str, motion: tuple[Array, Array]
) -> tuple[PulledCharacter, list[Array], list[str | None], list[float]]:
    """Return the character; where the thing is, what is held, how upright it is."""
    path.write_text(SCENE.format(thing))
    name = thing.split('"')[1]
    character = PulledCharacter(BODY, scene=path)
    character.start(motion[0][0], motion[1][0])
    places, held, ups = [], [], []
    for posture, turned in zip(*(m[1:] for m in motion), strict=True):
        character.step(posture, turned, 1 / 30, stands=np.ones(2, dtype=bool))
        body = character.data.body(name)
        places.append(body.xpos.copy())
        ups.append(float(body.xmat.reshape(3, 3)[2, 2]))
        holds = character.grasp.held
        held.append(holds and holds.name)
    return character, places, held, ups


BEFORE, AT = (-0.2, 1.0, 0.2), (-0.2, 0.95, 0.44 - 0.035 - RADIUS)


def test_a_mug_is_lifted_carried_and_put_down(tmp_path: Path) -> None:
    motion = along(
        (0.0, *BEFORE),
        (1.0, *AT),
        (1.6, *AT),
        (2.4, -0.1, 1.25, 0.35),
        (3.2, -0.1, 1.25, 0.35),
        (4.2, *AT),
        (5.0, *AT),
        (6.0, *BEFORE),
    )
    character, places, held, ups = played(tmp_path / "mug.xml", MUG, motion)
    assert held[90] == "mug"
    assert places[92][2] > 1.15
    assert min(ups) > 0.95  # it is level all the time
    assert held[-1] is None
    assert abs(places[-1][2] - 0.95) < 0.01
    assert character.external_force < 0.1


def test_a_hand_that_passes_takes_nothing(tmp_path: Path) -> None:
    beyond = (0.3, 0.95, AT[2])
    motion = along((0.0, -0.5, 0.95, AT[2] - 0.02), (1.2, *beyond), (2.0, *beyond))
    _, _, held, _ = played(tmp_path / "mug.xml", MUG, motion)
    assert not any(held)


@pytest.mark.parametrize(("thing", "size"), [(DRAWER, 0.02), (DOOR, 0.015)])
def test_what_is_on_a_rail_or_a_hinge_moves_with_the_hand(
    tmp_path: Path, thing: str, size: float
) -> None:
    here = (-0.2, 0.95, 0.45 - size - RADIUS)
    back = (-0.2, 0.95, here[2] - 0.15)
    motion = along(
        (0.0, *BEFORE), (1.0, *here), (1.6, *here), (2.6, *back), (3.0, *back)
    )
    character, _, held, _ = played(tmp_path / "thing.xml", thing, motion)
    assert held[-1] == thing.split('"')[1]
    joint = character.data.joint(held[-1])
    moved = joint.qpos[0] * (0.6 if thing is DOOR else 1.0)
    assert 0.1 < abs(moved) < 0.2


def test_a_hinge_that_gives_no_more_tears_itself_from_the_hand(tmp_path: Path) -> None:
    here = (-0.2, 0.95, 0.45 - 0.02 - RADIUS)
    away = (-0.2, 1.0, -0.1)
    motion = along(
        (0.0, *BEFORE), (1.0, *here), (1.6, *here), (2.8, *away), (3.5, *away)
    )
    stuck = DRAWER.replace("-0.3 0", "-0.05 0")
    character, _, held, _ = played(tmp_path / "thing.xml", stuck, motion)
    assert "drawer" in held
    assert held[-1] is None
    hand = character.positions[KINECT_V1.index("HandRight")]
    assert np.abs(hand - motion[0][-1, KINECT_V1.index("HandRight")]).max() < 0.05
