"""The capsule humanoid as MuJoCo compiles it."""

from __future__ import annotations

from dataclasses import fields

import mujoco
import numpy as np
import pytest
from skeletons import every_skeleton

from kinefilter import clean
from kinefilter.characters import (
    KINECT_V1,
    InputError,
    Skeleton,
    Tracking,
    standard_body,
)
from kinefilter.characters.anthropometry import joint_masses, joint_range
from kinefilter.characters.humanoid import PULLS, build_humanoid, from_mujoco, to_mujoco
from kinefilter.characters.rotations import (
    about_y,
    inverse,
    multiply,
    rotate,
    rotation_vector,
)
from kinefilter.pipeline.lab.simulation import simulate


def test_forward_left_and_up_are_the_axes_of_mujoco() -> None:
    forward, left, up = np.eye(3)[[2, 0, 1]]
    np.testing.assert_array_equal(to_mujoco(np.array([forward, left, up])), np.eye(3))


def test_coming_back_from_mujoco_changes_nothing() -> None:
    rng = np.random.default_rng(0)
    for width in (3, 4):
        values = rng.standard_normal((5, width))
        np.testing.assert_array_equal(from_mujoco(to_mujoco(values)), values)


def test_rotating_and_going_to_mujoco_commute() -> None:
    rng = np.random.default_rng(1)
    vectors = rng.standard_normal((7, 3))
    turns = about_y(rng.uniform(-3, 3, 7))
    np.testing.assert_allclose(
        to_mujoco(rotate(turns, vectors)),
        rotate(to_mujoco(turns), to_mujoco(vectors)),
        atol=1e-12,
    )


@every_skeleton
def test_the_compiled_model_has_the_bodys_masses_lengths_and_radii(
    skeleton: Skeleton,
) -> None:
    body = standard_body(skeleton, height=1.62, mass=55.0)
    model = build_humanoid(body).compile()
    compared = 0
    for j in skeleton.segments:
        name = skeleton.joints[j]
        geom = model.geom(name)
        assert model.body(name).mass[0] == pytest.approx(body.masses[j])
        assert geom.type[0] == mujoco.mjtGeom.mjGEOM_CAPSULE
        assert 2 * geom.size[1] == pytest.approx(body.lengths[j])
        assert geom.size[0] == pytest.approx(body.radii[j])
        assert model.joint(name).type[0] == mujoco.mjtJoint.mjJNT_BALL
        compared += 1
    assert compared == len(skeleton) - 1
    moving = [model.body(name).id for name in skeleton.joints]
    assert model.body_mass[moving].sum() == pytest.approx(55.0)
    assert model.joint(skeleton.joints[skeleton.root]).type[0] == (
        mujoco.mjtJoint.mjJNT_FREE
    )


@every_skeleton
def test_it_stands_in_t_pose_with_its_soles_on_the_floor(skeleton: Skeleton) -> None:
    body = standard_body(skeleton)
    model = build_humanoid(body).compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    sites = [model.site(name).id for name in skeleton.joints]
    np.testing.assert_allclose(
        from_mujoco(data.site_xpos[sites]), body.rest_positions, atol=1e-9
    )


@every_skeleton
def test_joint_masses_sum_to_the_body(skeleton: Skeleton) -> None:
    body = standard_body(skeleton, mass=81.0)
    assert joint_masses(body).sum() == pytest.approx(81.0)


def test_gains_and_bounds_follow_from_mass_and_frequency() -> None:
    body = standard_body(KINECT_V1)
    tracking = Tracking(natural_frequency=50.0, largest_acceleration=120.0)
    model = build_humanoid(body, tracking).compile()
    compared = 0
    for joint, mass in zip(KINECT_V1.joints, joint_masses(body), strict=True):
        for axis in "xyz":
            actuator = model.actuator(f"pull:{joint}:{axis}")
            assert -actuator.biasprm[1] == pytest.approx(mass * 50.0**2)
            assert -actuator.biasprm[2] == pytest.approx(2 * mass * 50.0)
            # Three axes at their limit stay within the bound of the vector.
            assert actuator.forcerange[1] * np.sqrt(3) == pytest.approx(mass * 120.0)
            compared += 1
    assert compared == 60


@pytest.mark.parametrize("field", [field.name for field in fields(Tracking)])
@pytest.mark.parametrize("wrong", [-60.0, 0.0, np.nan, np.inf])
def test_a_pull_without_strength_is_refused_by_name(field: str, wrong: float) -> None:
    with pytest.raises(InputError, match=f"{field} of the tracking is {wrong:g}"):
        Tracking(**{field: wrong})


@every_skeleton
def test_the_compiled_joints_turn_as_far_as_people_do(skeleton: Skeleton) -> None:
    model = build_humanoid(standard_body(skeleton)).compile()
    for j in skeleton.segments:
        name = skeleton.joints[j]
        joint = model.joint(name)
        assert joint.limited[0]
        assert list(joint.range) == pytest.approx([0.0, joint_range(name)])


def test_joints_turn_as_far_as_the_table_of_their_ranges_says() -> None:
    ranges = {
        "SpineMid": 50,
        "SpineShoulder": 45,
        "Neck": 45,
        "Head": 75,
        "ShoulderLeft": 50,
        "ElbowLeft": 160,
        "WristLeft": 165,
        "HandLeft": 56,
        "HandTipLeft": 90,
        "ThumbLeft": 90,
        "HipLeft": 60,
        "KneeLeft": 140,
        "AnkleLeft": 150,
        "FootLeft": 80,
        "Spine": 80,
        "ShoulderCenter": 45,
    }
    for name, degrees in ranges.items():
        right = name.replace("Left", "Right")
        assert np.degrees(joint_range(name)) == pytest.approx(degrees), name
        assert joint_range(right) == joint_range(name)


@pytest.mark.parametrize(
    ("one", "other", "meet"),
    [
        ("WristLeft", "Spine", True),
        ("HandRight", "ShoulderCenter", True),
        ("HandLeft", "Head", True),
        ("WristLeft", "WristRight", True),
        ("HandRight", "KneeLeft", True),
        ("HandLeft", "AnkleRight", True),
        ("AnkleLeft", "FootRight", True),
        ("ElbowLeft", "Spine", False),
        ("KneeLeft", "KneeRight", False),
        ("AnkleLeft", "Spine", False),
        ("WristLeft", "HandLeft", False),
        ("AnkleRight", "FootRight", False),
    ],
)
def test_hands_meet_all_but_the_own_arm_and_shanks_each_other(
    one: str, other: str, meet: bool
) -> None:
    model = build_humanoid(standard_body(KINECT_V1)).compile()
    bits = [
        (int(geom.contype[0]), int(geom.conaffinity[0]))
        for geom in (model.geom(one), model.geom(other))
    ]
    (type_one, like_one), (type_other, like_other) = bits
    assert bool(type_one & like_other or type_other & like_one) == meet


def test_without_forces_it_falls_freely() -> None:
    body = standard_body(KINECT_V1)
    model = build_humanoid(body).compile()
    model.actuator_forcerange[:] = [-1e-12, 1e-12]
    data = mujoco.MjData(model)
    data.qpos[2] += 5.0
    before = data.qpos[2]
    steps = 120
    for _ in range(steps):
        mujoco.mj_step(model, data)
    # Semi-implicit Euler falls g dt^2 n (n + 1) / 2.
    dt = model.opt.timestep
    fallen = 9.81 * dt**2 * steps * (steps + 1) / 2
    assert before - data.qpos[2] == pytest.approx(fallen, rel=1e-9)


def test_without_forces_it_ends_lying_on_the_floor() -> None:
    body = standard_body(KINECT_V1)
    model = build_humanoid(body).compile()
    model.actuator_forcerange[:] = [-1e-12, 1e-12]
    data = mujoco.MjData(model)
    for _ in range(5 * 240):
        mujoco.mj_step(model, data)
    sites = [model.site(name).id for name in KINECT_V1.joints]
    heights = data.site_xpos[sites, 2]
    assert heights[KINECT_V1.index("Head")] < 0.35
    assert heights.min() > 0.0


@pytest.mark.parametrize(("motion", "seed"), [("deep_squat", 1), ("lunge", 4)])
def test_no_joint_of_a_clip_leaves_its_range(motion: str, seed: int) -> None:
    clip = clean(simulate("basic", motion, seed=seed).take).clip
    ends, starts = clip.skeleton.segments, clip.skeleton.segment_parents
    relative = multiply(inverse(clip.rotations[:, starts]), clip.rotations[:, ends])
    bend = np.linalg.norm(rotation_vector(relative), axis=-1).max(axis=0)
    most = [joint_range(clip.skeleton.joints[j]) for j in ends]
    assert np.degrees(bend - most).max() < 1.5


def test_a_leg_does_not_whirl_the_hip_that_carries_it() -> None:
    model = build_humanoid(standard_body(KINECT_V1)).compile()
    model.opt.gravity[:] = 0.0
    model.opt.disableactuator = 1 << PULLS
    data = mujoco.MjData(model)
    hip = int(model.joint("HipLeft").dofadr[0])
    data.qvel[hip + 2] = 40.0  # rad/s
    while data.time < 0.1:
        mujoco.mj_step(model, data)
    assert np.linalg.norm(data.qvel[hip : hip + 3]) < 2.0
