"""A character that follows frame by frame."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest
from known_motions import standing
from numpy.typing import NDArray

from kinefilter import Avatar, Pose, SharedScene, read_take
from kinefilter.characters import (
    KINECT_V1,
    KINECT_V2,
    InputError,
    Tracking,
    TrackingName,
    standard_body,
)
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.correct import LocalPCA
from kinefilter.pipeline.database import builtin_database
from kinefilter.scenes import SAMPLE
from kinefilter.scenes.library import perform

Array = NDArray[np.float64]
BODY = standard_body(KINECT_V1)


def follow(avatar: Avatar, positions: Array) -> list[Pose]:
    return [avatar.step(frame, k / 30.0) for k, frame in enumerate(positions)]


def test_joints_of_another_tracker_stay_where_they_are_with_local_pca() -> None:
    act, method = perform("wave", BODY, seed=3), LocalPCA(builtin_database(KINECT_V1))
    poses = follow(Avatar(BODY, floor=0.0, corrector=method), act.positions)
    found = np.array([pose.positions for pose in poses])[30:]
    apart = (found - found[:, :1]) - (act.positions - act.positions[:, :1])[30:]
    assert np.linalg.norm(apart, axis=-1).mean() < 0.01


def test_a_performance_is_followed_in_the_same_frame() -> None:
    act = perform("wave", BODY, seed=3)
    poses = follow(Avatar(BODY, floor=0.0), act.positions)
    hand = KINECT_V1.index("HandRight")
    truth = act.positions[20:, hand, 1]
    found = np.array([pose.positions[hand, 1] for pose in poses[20:]])
    lags = [
        np.corrcoef(truth[: -5 or None], np.roll(found, -k)[:-5])[0, 1]
        for k in range(5)
    ]
    assert int(np.argmax(lags)) <= 1
    assert not any(pose.reset for pose in poses)


def test_who_stands_still_is_carried_by_the_floor() -> None:
    noise = np.random.default_rng(0).normal(scale=0.01, size=(90, 20, 3))
    poses = follow(Avatar(BODY), standing(90) + noise + [0.3, -0.8, 2.5])
    assert all(pose.stands.all() for pose in poses[1:])
    feet = [KINECT_V1.index("FootLeft"), KINECT_V1.index("FootRight")]
    path = np.array([pose.positions[feet] for pose in poses[30:]])
    assert np.ptp(path, axis=0).max() < 0.004
    assert np.median([pose.external_force for pose in poses[30:]]) < 0.5


def test_a_push_moves_a_soft_character_and_passes() -> None:
    avatar = Avatar(BODY, floor=0.0, tracking=Tracking(natural_frequency=15.0))
    frames = standing(150)
    before = follow(avatar, frames[:30])[-1]
    avatar.push("ShoulderCenter", [0.0, 0.0, 300.0], 0.3)
    poses = [avatar.step(frame, 1.0 + k / 30.0) for k, frame in enumerate(frames[30:])]
    chest = KINECT_V1.index("ShoulderCenter")
    ahead = np.array(
        [p.positions[chest, 2] - before.positions[chest, 2] for p in poses]
    )
    assert ahead.max() > 0.05
    assert abs(ahead[-1]) < 0.01


def test_let_go_it_falls_and_held_again_it_stands_up() -> None:
    avatar = Avatar(BODY, floor=0.0)
    frames = standing(240)
    follow(avatar, frames[:10])
    avatar.let_go()
    head = KINECT_V1.index("Head")
    fallen = [avatar.step(f, 1.0 + k / 30.0) for k, f in enumerate(frames[:90])][-1]
    assert fallen.positions[head, 1] < 0.5
    assert fallen.external_force == 0.0
    avatar.take_hold()
    up = [avatar.step(f, 5.0 + k / 30.0) for k, f in enumerate(frames[:60])][-1]
    assert up.positions[head, 1] > 0.95 * BODY.rest_positions[head, 1]


@pytest.mark.parametrize(
    ("scene", "tracking", "limp"),
    [
        ("basic", "faithful", False),
        ("basic", "ragdoll", True),
        (SharedScene("basic", "game"), None, False),
    ],
)
def test_started_again_it_is_no_longer_let_go(
    scene: str | SharedScene, tracking: TrackingName | None, limp: bool
) -> None:
    avatar = Avatar(BODY, scene, tracking=tracking)
    follow(avatar, standing(2))
    avatar.let_go()
    avatar.start()
    follow(avatar, standing(2))
    assert avatar.physics.limp is limp


def test_nothing_seen_at_first_or_for_seconds_leaves_a_finite_pose() -> None:
    frames = standing(60)
    frames[:5] = np.nan
    frames[30:50] = np.nan
    poses = follow(Avatar(BODY), frames)
    assert all(np.isfinite(pose.positions).all() for pose in poses)


def test_in_a_scene_the_person_begins_at_its_origin() -> None:
    frames = standing(20) + np.array([1.5, 0.0, 2.5])
    pose = follow(Avatar(BODY, "chair", floor=0.0), frames)[-1]
    root = pose.positions[KINECT_V1.root]
    np.testing.assert_allclose(root[[0, 2]], 0.0, atol=0.02)


def test_a_performer_in_millimeters_is_told() -> None:
    take = read_take(SAMPLE)
    for scale, noted in ((1.0, False), (1000.0, True)):
        avatar = Avatar(standard_body(take.skeleton))
        for row in range(40):
            seen = scale * take.positions[row]
            avatar.step(seen, float(take.time[row]), take.state[row])
        assert ("meters" in " ".join(avatar.notes)) is noted


def test_a_joint_at_infinity_says_nothing_about_units() -> None:
    avatar, frames = Avatar(BODY), standing(5)
    frames[2, 0] = np.inf
    follow(avatar, frames)
    assert avatar.notes == ()


def test_wrong_frames_are_refused() -> None:
    avatar = Avatar(BODY)
    with pytest.raises(InputError, match=r"expected \(20, 3\)"):
        avatar.step(np.zeros((25, 3)), 0.0)
    avatar.step(BODY.rest_positions, 1.0)
    with pytest.raises(InputError, match="comes after"):
        avatar.step(BODY.rest_positions, 1.0)
    with pytest.raises(InputError, match="no joint"):
        avatar.push("Tail", [1.0, 0.0, 0.0], 0.1)


def test_a_body_and_a_measured_one_of_other_joints_are_refused() -> None:
    with pytest.raises(InputError, match=r"kinect_v1.*kinect_v2; give two"):
        Avatar(BODY, measured=standard_body(KINECT_V2))


@pytest.mark.parametrize("copied", [copy.deepcopy, pickle.dumps])
def test_copies_are_refused(copied: Callable[[object], object]) -> None:
    avatar = Avatar(BODY)
    for one in (avatar, avatar.physics, avatar.physics.world):
        with pytest.raises(TypeError, match="cannot be copied"):
            copied(one)


def test_the_character_command_writes_what_plain_mujoco_loads(tmp_path: Path) -> None:
    file = tmp_path / "avatar.xml"
    arguments = ["character", "--height", "1.82", "--mass", "80", "-o", str(file)]
    assert main(arguments) == 0
    model = mujoco.MjModel.from_xml_path(str(file))
    moving = [model.body(name).id for name in KINECT_V2.joints]
    assert model.body_mass[moving].sum() == pytest.approx(80.0, rel=1e-4)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert data.site("Head").xpos[2] == pytest.approx(
        standard_body(KINECT_V2, height=1.82).rest_positions[3, 1], abs=1e-4
    )
    assert main(["character", "--height", "9", "-o", str(tmp_path / "b.xml")]) == 2
    assert main(["character", "-o", str(tmp_path / "b.txt")]) == 2
    assert sorted(path.name for path in tmp_path.iterdir()) == ["avatar.xml"]
