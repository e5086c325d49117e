"""The head aims by all joints above the shoulders, and the neck shares its bend."""

from __future__ import annotations

from copy import copy

import numpy as np
import pytest
from numpy.typing import NDArray
from skeletons import every_skeleton

from kinefilter.characters import (
    KINECT_V2,
    Skeleton,
    positions_from_rotations,
    standard_body,
)
from kinefilter.characters.rotations import (
    about_x,
    about_y,
    inverse,
    multiply,
    rotation_vector,
    unit,
)
from kinefilter.pipeline.cleaner import Cleaner
from kinefilter.pipeline.lab.simulation import simulate
from kinefilter.pipeline.progress import silent
from kinefilter.pipeline.target.aim_stages import AimHead
from kinefilter.pipeline.target.floor import to_world
from kinefilter.retarget import Neck

Array = NDArray[np.float64]


def nodded(skeleton: Skeleton, angle: float) -> tuple[Array, Array]:
    """Return the joints and rotations of a turned body whose whole neck nods."""
    turn = about_y(0.8)
    rotations = np.tile(turn, (len(skeleton), 1))
    head = skeleton.index("Head")
    above = [j for j in skeleton.ancestors(head) if j not in ancestors(skeleton)]
    rotations[above] = multiply(turn, about_x(angle))
    body = standard_body(skeleton)
    return positions_from_rotations(rotations, np.zeros(3), body), rotations


def ancestors(skeleton: Skeleton) -> list[int]:
    """Return the spine's joints up to where the shoulders branch off."""
    return skeleton.ancestors(skeleton.girdle)


def aimed(skeleton: Skeleton, angle: float, weight: float) -> tuple[Array, Array]:
    """Return joints and bends [rad], neck first, of a nod seen with a weight."""
    joints, rotations = nodded(skeleton, angle)
    neck = Neck(standard_body(skeleton))
    weights = np.full(len(skeleton), weight)
    heads = neck.straightened(*neck.aims(joints, rotations, weights))
    there, found = neck.posed(joints, rotations, heads)
    chain = [row[0] for row in neck.joints]
    turns = multiply(inverse(found[skeleton.girdle]), found[chain])
    rest = positions_from_rotations(
        found, there[skeleton.root], standard_body(skeleton)
    )
    np.testing.assert_allclose(there[chain], rest[chain], atol=1e-12)
    return there, np.linalg.norm(rotation_vector(turns), axis=-1)


@every_skeleton
@pytest.mark.parametrize("angle", [0.0, 0.4, -0.6])
def test_firm_joints_give_back_the_nod(skeleton: Skeleton, angle: float) -> None:
    _, bends = aimed(skeleton, angle, 1e9)
    np.testing.assert_allclose(bends[-1], abs(angle), atol=1e-6)
    if len(bends) > 1:
        assert bends[0] <= 0.5 * bends[1]


@every_skeleton
def test_the_less_reliable_the_joints_the_straighter_the_neck(
    skeleton: Skeleton,
) -> None:
    bends = [aimed(skeleton, 0.6, weight)[1][-1] for weight in (1e9, 1.0, 0.3, 0.01)]
    assert (np.diff(bends) < 0.0).all()
    assert bends[-1] < 0.05


@every_skeleton
def test_no_head_folds(skeleton: Skeleton) -> None:
    bends = [aimed(skeleton, angle, 1e9)[1][-1] for angle in np.linspace(0, 3.1, 30)]
    assert (np.diff(bends) >= 0.0).all()
    assert np.degrees(bends[-1]) < 70.0


def test_the_head_is_nearer_to_the_truth_than_its_bones() -> None:
    errors = []
    neck, head = KINECT_V2.index("Neck"), KINECT_V2.index("Head")
    for motion, seed in (("talk", 7001), ("point", 7006), ("scratch", 7008)):
        pair = simulate("basic", motion, seed=seed)
        before = Cleaner().until("orientation").whole(pair.take)
        after = copy(before)
        AimHead().run(after, silent)
        tilt, roll = before.turn.tilt + before.tilt, before.turn.roll
        truth = to_world(pair.truth, tilt, before.floor, roll)
        for joints in (after.posed, before.posed):
            bones, true = (unit(x[:, head] - x[:, neck]) for x in (joints, truth))
            errors.append(np.arccos(np.vecdot(bones, true)).mean())
    aim, bone = np.reshape(errors, (-1, 2)).mean(axis=0)
    assert aim < 0.9 * bone
