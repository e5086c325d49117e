"""What stands in a scene comes into the clip, as and where it was simulated."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from known_motions import pulled_through

from kinefilter import CleanConfig, clean
from kinefilter.characters import KINECT_V1, Prop, standard_body
from kinefilter.characters.humanoid import from_mujoco
from kinefilter.characters.rotations import IDENTITY, about_y, multiply, rotate
from kinefilter.pipeline.lab.simulation import simulate
from kinefilter.pipeline.physics.pulled_character import PulledCharacter
from kinefilter.retarget import HeadingFrame

BODY = standard_body(KINECT_V1)
HERE = HeadingFrame(np.zeros(3), np.zeros(()))
SCENE = """
<mujoco model="things">
  <worldbody>
    <geom name="wall" type="box" size="0.1 2 1" pos="-2 0 1"/>
    <body name="shelf" pos="1 0.5 0.3" euler="0 0 90">
      <geom type="box" size="0.1 0.2 0.3"/>
      <geom type="cylinder" size="0.05 0.4" pos="0 0 0.7" rgba="1 0 0 1"/>
      <geom type="sphere" size="0.05" group="4"/>
    </body>
    <body name="ball" pos="1.5 -1 2">
      <freejoint/><geom type="sphere" size="0.1"/>
    </body>
  </worldbody>
</mujoco>
"""


def things(
    tmp_path: Path, seconds: float, place: HeadingFrame = HERE
) -> dict[str, Prop]:
    (tmp_path / "things.xml").write_text(SCENE)
    time = np.arange(round(seconds * 30)) / 30.0
    positions = np.tile(BODY.rest_positions, (len(time), 1, 1))
    rotations = np.tile(IDENTITY, (len(time), len(KINECT_V1), 1))
    character = PulledCharacter(BODY, scene=tmp_path / "things.xml")
    result = pulled_through(character, time, positions, rotations)
    return {prop.name: prop for prop in result.scene_props.props(place)}


def test_what_is_seen_is_there_and_what_is_not_is_not(tmp_path: Path) -> None:
    props = things(tmp_path, 0.2)
    assert set(props) == {"world", "shelf", "ball"}
    assert [shape.kind for shape in props["shelf"].shapes] == ["box", "cylinder"]
    assert {name for name, prop in props.items() if prop.moves} == {"ball"}
    np.testing.assert_allclose(props["shelf"].shapes[1].color, [1.0, 0.0, 0.0])


def test_shapes_are_as_large_and_where_the_scene_has_them(tmp_path: Path) -> None:
    shelf = things(tmp_path, 0.2)["shelf"]
    np.testing.assert_allclose(shelf.positions, [[0.5, 0.3, 1.0]], atol=1e-9)
    box, pole = shelf.shapes
    # Across, up, ahead; then turned by a quarter about the vertical.
    np.testing.assert_allclose(box.size, [0.2, 0.3, 0.1])
    np.testing.assert_allclose(pole.size, [0.05, 0.4, 0.05])
    np.testing.assert_allclose(pole.position, [0.0, 0.7, 0.0])
    across = rotate(shelf.rotations[0], np.array([1.0, 0.0, 0.0]))
    np.testing.assert_allclose(np.abs(across), [0.0, 0.0, 1.0], atol=1e-9)


def test_a_ball_that_nobody_holds_falls_freely(tmp_path: Path) -> None:
    ball = things(tmp_path, 1.0)["ball"]
    # The character is settled for half a second before the first frame.
    height, time = ball.positions[:, 1], np.arange(30) / 30.0
    speed = np.diff(height[:4]).mean() * 30.0
    assert speed < -3.0
    np.testing.assert_allclose(ball.positions[0, [0, 2]], [-1.0, 1.5], atol=1e-6)
    fallen = height[0] + (speed + 9.81 * 1.5 / 30.0) * time - 0.5 * 9.81 * time**2
    np.testing.assert_allclose(height[:4], fallen[:4], atol=0.01)


def test_a_place_moves_and_turns_everything(tmp_path: Path) -> None:
    place = HeadingFrame(np.array([3.0, 0.0, -1.0]), np.array(0.7))
    here, there = things(tmp_path, 0.2), things(tmp_path, 0.2, place)
    for name, prop in there.items():
        moved = rotate(about_y(0.7), here[name].positions) + place.root
        np.testing.assert_allclose(prop.positions, moved, atol=1e-12)
        turned = multiply(about_y(0.7), here[name].rotations)
        dots = np.abs(np.sum(turned * prop.rotations, axis=-1))
        np.testing.assert_allclose(dots, 1.0)


def test_without_a_scene_there_is_nothing() -> None:
    time = np.arange(3) / 30.0
    positions = np.tile(BODY.rest_positions, (3, 1, 1))
    rotations = np.tile(IDENTITY, (3, len(KINECT_V1), 1))
    result = pulled_through(PulledCharacter(BODY), time, positions, rotations)
    assert result.scene_props.props(HERE) == ()


@pytest.fixture(scope="module")
def lifted() -> dict[str, Prop]:
    take = simulate("box", "lift_box", seed=5).take
    clip = clean(take, CleanConfig(scene="box", method="none")).clip
    assert all(len(prop.positions) in (1, len(clip)) for prop in clip.props)
    root = clip.positions[0, clip.skeleton.root]
    table = next(prop for prop in clip.props if prop.name == "table")
    # The table stands 0.5 m ahead and 0.95 m to the right of where the person began.
    away = np.linalg.norm((table.positions[0] - root)[[0, 2]])
    assert away == pytest.approx(np.hypot(0.5, 0.95), abs=0.1)
    return {prop.name: prop for prop in clip.props}


def test_the_scene_of_a_cleaned_take_is_in_its_clip(lifted: dict[str, Prop]) -> None:
    assert set(lifted) == {"box", "table"}
    box = lifted["box"]
    assert box.moves
    assert box.positions[0, 1] == pytest.approx(0.15, abs=0.02)
    size = from_mujoco(np.array([0.15, 0.2, 0.15]))
    np.testing.assert_allclose(box.shapes[0].size, size)
    np.testing.assert_allclose(np.linalg.norm(box.rotations, axis=-1), 1.0)
