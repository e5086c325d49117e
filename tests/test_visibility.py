"""What a sensor sees of a body: rays past the body itself and props."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from posed_people import BODY, EXACT, NO_ERRORS, index, posed, room_with
from skeletons import every_skeleton

from kinefilter.characters import InputError, Motion, Skeleton, State, standard_body
from kinefilter.characters.humanoid import to_mujoco
from kinefilter.characters.rotations import IDENTITY
from kinefilter.scenes.library import perform
from kinefilter.scenes.sensor import Sensor, in_world_frame, observe
from kinefilter.scenes.sensor.visibility import Sight, look

Array = NDArray[np.float64]


def seen(act: Motion, joint: str, **options: Any) -> float:
    sight = look(act, options.pop("sensor", Sensor()), **options)
    return float(sight.visible[0, act.body.skeleton.index(joint)])


# What is seen ------------------------------------------------------------------


@every_skeleton
def test_everything_of_a_t_pose_before_the_sensor_is_seen(skeleton: Skeleton) -> None:
    sight = look(posed(body=standard_body(skeleton)), Sensor())
    assert sight.visible.min() > 0.9
    np.testing.assert_array_equal(sight.prop, 0.0)
    whole = sight.visible == 1.0
    assert whole.sum() > 18
    np.testing.assert_allclose(sight.pull[whole], 0.0, atol=1e-12)


def test_what_is_behind_the_trunk_is_not_seen() -> None:
    behind = posed(ElbowLeft=[-0.25, -0.6, -0.8], WristLeft=[-1.0, 0.0, -0.1])
    before = posed(ElbowLeft=[-0.25, -0.6, 0.8], WristLeft=[-1.0, 0.0, 0.1])
    assert seen(behind, "WristLeft") == 0.0
    assert seen(before, "WristLeft") == 1.0


def test_the_nearer_of_two_arms_hides_the_other() -> None:
    down = posed(yaw=np.pi / 2, ElbowLeft=[0, -1, 0], ElbowRight=[0, -1, 0])
    x = down.positions[0, [index("ElbowLeft"), index("ElbowRight")], 2]
    near, far = ("Left", "Right") if x[0] > x[1] else ("Right", "Left")
    assert seen(down, f"Wrist{near}") == 1.0
    assert seen(down, f"Wrist{far}") == 0.0
    sight = look(down, Sensor())
    assert sight.rival[0, index(f"Wrist{far}")] > 0.1
    assert sight.rival[0, index(f"Wrist{near}")] == 0.0


def test_a_limb_that_points_at_the_sensor_shows_its_near_end() -> None:
    forward = look(posed(ElbowLeft=[0, 0, 1]), Sensor())
    assert forward.front[0, index("ElbowLeft")] > 0.1
    assert abs(forward.front[0, index("ElbowRight")]) < 0.03


def test_a_half_hidden_part_pulls_towards_what_is_seen() -> None:
    act = posed()
    knee = act.positions[0, index("KneeLeft")]
    scene = room_with("screen", (0.01, 0.5, 0.5))  # thin in x, MuJoCo's forward
    edge = knee + np.array([-0.5, 0.0, 0.5])  # its edge before the middle of the knee
    edge[0] = (edge[0] + 0.5) * (2.7 - 0.5) / 2.7 - 0.5
    poses = {"screen": np.concatenate([to_mujoco(edge), IDENTITY])[None]}
    sight = look(act, Sensor(), scene=scene, prop_poses=poses)
    assert 0.2 < sight.visible[0, index("KneeLeft")] < 0.8
    assert sight.pull[0, index("KneeLeft"), 0] > 0.01
    assert sight.visible[0, index("KneeRight")] == 0.0


def test_a_box_in_front_hides_the_legs_while_it_is_there() -> None:
    act = posed(2)
    poses = np.tile([1.0, 0.0, 0.3, 1.0, 0.0, 0.0, 0.0], (2, 1))
    poses[1, 1] = 5.0
    scene = room_with("box", (0.1, 0.8, 0.3))
    sight = look(act, Sensor(), scene=scene, prop_poses={"box": poses})
    for joint in ("AnkleLeft", "FootRight"):
        assert sight.visible[0, index(joint)] == 0.0
        assert sight.visible[1, index(joint)] == 1.0
    np.testing.assert_array_equal(sight.visible[:, index("Head")], 1.0)
    take = observe(act, seed=0, sensor=EXACT, scene=scene, prop_poses={"box": poses})
    np.testing.assert_array_equal(
        take.state[:, index("AnkleLeft")], [State.INFERRED, State.TRACKED]
    )


def test_a_prop_in_the_hand_is_a_prop_near_the_hand() -> None:
    act = posed()
    hand = act.positions[0, index("HandLeft")] + np.array([0.12, 0.0, 0.0])
    poses = {"ball": np.concatenate([to_mujoco(hand), IDENTITY])[None]}
    scene = room_with("ball", (0.08, 0.08, 0.08))
    sight = look(act, Sensor(), scene=scene, prop_poses=poses)
    assert sight.prop[0, index("HandLeft")] > 0.1
    assert sight.prop_pull[0, index("HandLeft"), 0] > 0.03
    assert sight.prop[0, index("HandRight")] == 0.0
    errors = replace(NO_ERRORS, prop=0.5)
    scenery = {"scene": scene, "prop_poses": poses}
    take = observe(act, seed=0, sensor=EXACT, errors=errors, **scenery)
    away = in_world_frame(take.positions, EXACT) - act.positions
    assert away[0, index("HandLeft"), 0] > 0.002
    np.testing.assert_allclose(away[0, index("HandRight")], 0.0, atol=1e-12)


def test_a_part_at_the_depth_of_what_surrounds_it_merges_with_it() -> None:
    act = posed()
    hand = act.positions[0, index("HandLeft")] - np.array([0.0, 0.0, 0.03])
    poses = {"wall": np.concatenate([to_mujoco(hand), IDENTITY])[None]}
    scene = room_with("wall", (0.01, 0.5, 0.5))
    near = look(act, Sensor(), scene=scene, prop_poses=poses)
    assert near.merged[0, index("HandLeft")] > 0.4
    assert look(act, Sensor()).merged[0, index("HandLeft")] == 0.0


def test_a_frame_is_seen_alike_alone_and_among_others() -> None:
    act = perform("cross_arms", BODY, seed=0)
    sight = look(act, Sensor())
    frame = int(np.argmin(sight.visible.mean(axis=1)))
    one = look(act.at(slice(frame, frame + 1)), Sensor())
    for field in fields(Sight):
        whole, single = getattr(sight, field.name), getattr(one, field.name)
        np.testing.assert_allclose(whole[[frame]], single, atol=1e-12)
    assert sight.visible[frame].min() < 0.5


@every_skeleton
@pytest.mark.parametrize("motion", ["sit", "turn", "punch"])
def test_shares_are_shares(motion: str, skeleton: Skeleton) -> None:
    sight = look(perform(motion, standard_body(skeleton), seed=1), Sensor())
    for name in ("visible", "merged", "rival", "prop"):
        share = getattr(sight, name)
        assert share.min() >= 0.0
        assert share.max() <= 1.0
    assert np.isfinite(sight.pull).all()
    hidden = sight.visible == 0.0
    assert hidden.any()
    np.testing.assert_array_equal(sight.pull[hidden], 0.0)


@pytest.mark.parametrize(
    ("poses", "message"),
    [
        ({"sofa": np.zeros((1, 7))}, "sofa.*it has box"),
        ({"box": np.zeros((3, 7))}, r"box.*\(3, 7\).*\(1, 7\)"),
    ],
)
def test_a_prop_that_does_not_fit_is_refused(
    poses: dict[str, Array], message: str
) -> None:
    scene = room_with("box", (0.1, 0.1, 0.1))
    with pytest.raises(InputError, match=message):
        observe(posed(), seed=0, scene=scene, prop_poses=poses)


def test_the_scene_handed_over_is_not_changed() -> None:
    scene = room_with("box", (0.1, 0.1, 0.1))
    before = scene.to_xml()
    poses = {"box": np.tile([1.0, 0.0, 0.3, 1.0, 0.0, 0.0, 0.0], (1, 1))}
    look(posed(), Sensor(), scene=scene, prop_poses=poses)
    assert scene.to_xml() == before
