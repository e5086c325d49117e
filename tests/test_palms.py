"""Hands aim by all of their joints, and forearms turn with the thumbs."""

from __future__ import annotations

from copy import copy

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
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
    about_z,
    inverse,
    multiply,
    rotate,
    rotation_vector,
    unit,
)
from kinefilter.pipeline.cleaner import Cleaner
from kinefilter.pipeline.draft import Draft
from kinefilter.pipeline.lab.simulation import simulate
from kinefilter.pipeline.progress import silent
from kinefilter.pipeline.target.aim_stages import AimHands
from kinefilter.pipeline.target.floor import to_world
from kinefilter.retarget import Palms

Array = NDArray[np.float64]

FIRM = 1e9  # weight of joints that are taken at their word


def beyond(skeleton: Skeleton) -> list[int]:
    """Return the joints of both hands."""
    return np.flatnonzero(skeleton.hands).tolist()


def angles(one: Array, other: Array) -> Array:
    """Return the angles between rotations [rad]."""
    turn = rotation_vector(multiply(one, inverse(other)))
    return np.asarray(np.linalg.norm(turn, axis=-1))


def turned(skeleton: Skeleton, twist: float, bend: float) -> tuple[Array, Array, Array]:
    """Return joints of a T-pose with turned arms, and rotations: untwisted and true."""
    plain = np.tile([1.0, 0.0, 0.0, 0.0], (len(skeleton), 1))
    true = plain.copy()
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        wrist = skeleton.index("Wrist" + side)
        plain[wrist] = about_y(0.7 * sign)
        true[wrist] = multiply(plain[wrist], about_x(sign * twist))
        hand = multiply(true[wrist], about_z(-sign * bend))
        true[skeleton.descendants(wrist)] = hand
    body = standard_body(skeleton)
    return positions_from_rotations(true, np.zeros(3), body), plain, true


def found(skeleton: Skeleton, joints: Array, plain: Array, weight: float) -> Array:
    """Return the rotations, after checking that the joints agree with them."""
    body = standard_body(skeleton)
    palms, weights = Palms(body), np.full(joints.shape[:-1], weight)
    hands = palms.straightened(*palms.aims(joints, plain, weights))
    twist = np.zeros(hands.shape[:-1])
    if palms.has_thumbs:
        twist = palms.twist(*palms.thumbs(joints, plain, weights, hands))
    there, rotations = palms.posed(joints, plain, hands, twist)
    parents = np.array(skeleton.parents)
    rest = np.broadcast_to(body.rest_offsets, joints.shape)
    bones = there - there[..., parents, :]
    ends = beyond(skeleton)
    np.testing.assert_allclose(
        bones[..., ends, :], rotate(rotations, rest)[..., ends, :], atol=1e-12
    )
    return rotations


@pytest.mark.parametrize(("twist", "bend"), [(0.0, 0.0), (0.6, 0.3), (-0.9, -0.5)])
def test_firm_joints_give_back_the_pose_they_came_from(
    twist: float, bend: float
) -> None:
    joints, plain, true = turned(KINECT_V2, twist, bend)
    assert angles(found(KINECT_V2, joints, plain, FIRM), true).max() < 1e-6


@every_skeleton
def test_the_less_reliable_the_joints_the_straighter_the_hand(
    skeleton: Skeleton,
) -> None:
    joints, plain, _ = turned(skeleton, 0.6, 0.6)
    wrists, hands = skeleton.sides("Wrist"), skeleton.sides("Hand")
    bends = []
    for weight in (FIRM, 1.0, 0.3, 0.01):
        rotations = found(skeleton, joints, plain, weight)
        bends.append(angles(rotations[hands], rotations[wrists]))
    assert (np.diff(bends, axis=0) < 0.0).all()
    assert bends[0].min() > 0.55
    assert bends[-1].max() < 0.05


@every_skeleton
def test_hands_and_forearms_turn_no_farther_than_peoples(skeleton: Skeleton) -> None:
    rng, count = np.random.default_rng(5), 500
    joints, plain, _ = turned(skeleton, 0.0, 0.0)
    joints, plain = np.tile(joints, (count, 1, 1)), np.tile(plain, (count, 1, 1))
    wrists, hands = skeleton.sides("Wrist"), skeleton.sides("Hand")
    for wrist in wrists:
        hand = skeleton.descendants(wrist)
        turns = Rotation.random(count, random_state=rng).as_matrix()
        away = joints[:, hand] - joints[:, [wrist]]
        joints[:, hand] = joints[:, [wrist]] + away @ turns
    rotations = found(skeleton, joints, plain, FIRM)
    bend = np.degrees(angles(rotations[:, hands], rotations[:, wrists]))
    twist = np.degrees(angles(rotations[:, wrists], plain[:, wrists]))
    assert 40.0 < bend.max() < 55.0
    assert twist.max() < 80.0


def test_a_turn_of_the_thumb_all_the_way_round_has_no_jump() -> None:
    body, turns = standard_body(KINECT_V2), np.linspace(0.0, 2.0 * np.pi, 721)
    ring = np.stack([np.cos(turns), np.sin(turns)], axis=1)
    thumbs = np.repeat(ring[:, None], 2, axis=1)
    twist = Palms(body).twist(thumbs, np.full((721, 2), 5.0))
    assert np.abs(np.diff(twist, axis=0)).max() < np.radians(0.6)
    assert np.degrees(twist).max() > 70.0


@pytest.mark.parametrize("by_frame", [False, True])
def test_hands_are_nearer_to_the_truth_than_their_bones(
    by_frame: bool,
) -> None:
    errors = []
    wrist, hand = KINECT_V2.sides("Wrist"), KINECT_V2.sides("Hand")
    for motion, seed in (("talk", 7001), ("point", 7006)):
        pair = simulate("basic", motion, seed=seed)
        before = Cleaner().until("orientation").whole(pair.take)
        after = frame_by_frame(before) if by_frame else copy(before)
        if not by_frame:
            AimHands().run(after, silent)
        tilt, roll = before.turn.tilt + before.tilt, before.turn.roll
        truth = to_world(pair.truth, tilt, before.floor, roll)
        true = unit(truth[:, hand] - truth[:, wrist])
        for joints in (after.positions, before.positions):
            bones = unit(joints[:, hand] - joints[:, wrist])
            errors.append(np.arccos(np.vecdot(bones, true)).mean())
    aimed, before_that = np.reshape(errors, (-1, 2)).mean(axis=0)
    assert aimed < 0.8 * before_that


def frame_by_frame(draft: Draft) -> Draft:
    """Return the draft with hands aimed as in live motion."""
    stage, joints = AimHands(), []
    stage.start(draft.body)
    for k, time in enumerate(draft.time):
        frame = Draft(draft.skeleton, time, draft.measured[k], draft.state[k])
        for name in ("positions", "rotations", "reliability", "bone_weights"):
            setattr(frame, name, getattr(draft, name)[k])
        stage.step(frame)
        joints.append(frame.positions)
    after = copy(draft)
    after.positions = np.array(joints)
    return after


def test_nothing_but_hands_and_forearms_turns() -> None:
    take = simulate("basic", "talk", seed=7001).take
    before = Cleaner().until("orientation").whole(take)
    after = copy(before)
    AimHands().run(after, silent)
    kept = ~KINECT_V2.hands
    np.testing.assert_array_equal(after.positions[:, kept], before.positions[:, kept])
    kept[KINECT_V2.sides("Wrist")] = False
    turns = angles(after.rotations[:, kept], before.rotations[:, kept])
    assert turns.max() < 1e-9
