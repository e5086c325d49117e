"""What no contact with the floor explains, on motions whose forces are known."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from known_motions import BODY, Array, polynomial, stamps, standing
from real_data import TAKES, recorded

from kinefilter import clean, read_take
from kinefilter.characters import KINECT_V1
from kinefilter.characters.anthropometry import GRAVITY, joint_masses
from kinefilter.characters.humanoid import build_humanoid, from_mujoco, to_mujoco
from kinefilter.characters.rotations import inverse, multiply
from kinefilter.pipeline.metrics import required_wrench, unexplained
from kinefilter.scenes.library import perform


def test_the_floor_explains_who_stands_and_nothing_who_hangs_in_the_air() -> None:
    time, path = stamps(30), standing(30)
    for found in unexplained(time, path, BODY):
        np.testing.assert_allclose(found[1:-1], 0.0, atol=1e-9)
        assert np.isnan(found[[0, -1]]).all()
    force, moment = unexplained(time, path + np.array([0.0, 0.5, 0.0]), BODY)
    np.testing.assert_allclose(force[1:-1], 1.0)
    np.testing.assert_allclose(moment[1:-1], 0.0, atol=1e-9)


def test_nothing_has_to_explain_a_free_fall() -> None:
    time = stamps(30)
    path = polynomial(time, [0, 3, 0], [1.0, 2.0, -1.0], [0.0, -0.5 * GRAVITY, 0.0])
    force, moment = unexplained(time, path, BODY)
    np.testing.assert_allclose([force[1:-1], moment[1:-1]], 0.0, atol=1e-6)


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_who_leans_over_the_feet_needs_a_moment(way: float) -> None:
    """One force f at the edge of the soles, d off and h below the center of mass.

    It leaves (W - f)^2 + (a f)^2, with a = (h, d), which is least for
    f = W - a (a W) / (1 + a^2).
    """
    time, path = stamps(30), standing(30)
    feet = [
        KINECT_V1.index(f"{part}{s}")
        for part in ("Ankle", "Foot")
        for s in ("Left", "Right")
    ]
    others = np.setdiff1d(np.arange(len(KINECT_V1)), feet)
    path[:, others, 2] += 0.4 * way
    masses = joint_masses(BODY)
    _, height, ahead = masses @ path[0] / masses.sum()
    reach = {1.0: 0.114, -1.0: -0.038}[way] * BODY.height
    beyond = abs(ahead - path[0, feet[0], 2] - reach)
    assert beyond > 0.05
    force, moment = unexplained(time, path, BODY)
    lever = np.hypot(height, beyond)
    np.testing.assert_allclose(moment[1:-1], beyond / (1.0 + lever**2), rtol=1e-6)
    np.testing.assert_allclose(force[1:-1], lever * moment[1:-1], rtol=1e-6)


def test_a_floor_gives_no_more_than_friction_aslant() -> None:
    """Crouched on the floor, so that moments ask for little, at 1.5 g sideways."""
    time = stamps(30)
    path = standing(30) * [1.0, 0.0, 1.0]
    path += 0.5 * 1.5 * GRAVITY * (time**2)[:, None, None] * [1.0, 0.0, 0.0]
    path[..., 1] = BODY.radii.max()
    force, moment = unexplained(time, path, BODY)
    assert np.all((force[1:-1] > 0.2) & (force[1:-1] < 0.5))
    assert np.all(moment[1:-1] < 0.1)


def test_the_wrench_is_that_of_the_humanoids_momentum() -> None:
    act = perform("punch", BODY, seed=3)
    model = build_humanoid(BODY).compile()
    data, bones = mujoco.MjData(model), BODY.skeleton
    balls = [model.joint(bones.joints[j]).qposadr[0] for j in bones.segments]
    poses = np.zeros((len(act.time), model.nq))
    turns = to_mujoco(act.rotations)
    poses[:, :3], poses[:, 3:7] = (
        to_mujoco(act.positions[:, bones.root]),
        turns[:, bones.root],
    )
    relative = multiply(
        inverse(turns[:, bones.segment_parents]), turns[:, bones.segments]
    )
    for ball, turn in zip(balls, relative.swapaxes(0, 1), strict=True):
        poses[:, ball : ball + 4] = turn
    steps, momenta = np.diff(act.time), []
    for k, step in enumerate(steps):
        mujoco.mj_differentiatePos(model, data.qvel, step, poses[k], poses[k + 1])
        data.qpos[:] = poses[k]
        mujoco.mj_integratePos(model, data.qpos, data.qvel, 0.5 * step)
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_subtreeVel(model, data)
        root = model.body(bones.joints[bones.root]).id
        momenta.append(
            [BODY.mass * data.subtree_linvel[root], 1.0 * data.subtree_angmom[root]]
        )
    rates = np.diff(from_mujoco(np.array(momenta)), axis=0) / steps[1:, None, None]
    _, wrench = required_wrench(act.time, act.positions, BODY)
    needed = wrench.reshape(-1, 2, 3) * BODY.mass * GRAVITY
    needed[:, 0, 1] -= BODY.mass * GRAVITY
    for ours, theirs in zip(needed.swapaxes(0, 1), rates.swapaxes(0, 1), strict=True):
        assert theirs.std() > 3.0
        assert np.abs(ours - theirs).std() < 0.25 * theirs.std()
        assert np.corrcoef(ours.ravel(), theirs.ravel())[0, 1] > 0.97


def test_missing_joints_and_long_gaps_leave_it_open() -> None:
    time, path = stamps(90), standing(90)
    time[60:] += 3.0
    path[20, 4] = np.nan
    force, _ = unexplained(time, path, BODY)
    open_ = [0, 19, 20, 21, 59, 60, 89]
    assert np.flatnonzero(np.isnan(force)).tolist() == open_
    assert np.nanmax(force) < 1e-9
    empty: Array = np.full((2, len(KINECT_V1), 3), np.nan)
    assert np.isnan(unexplained(time[:2], empty, BODY)[0]).all()


@recorded
def test_the_floor_explains_a_recorded_squat_whatever_pulls_it() -> None:
    found = clean(read_take(TAKES / "ui-prmd" / "m01_s02_e05.csv"))
    assert found.stages["physics"].unexplained_force < 0.02
    assert found.stages["physics"].unexplained_moment < 0.02
