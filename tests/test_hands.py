"""Hands that nobody saw turn with their forearms, those that were seen do not."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from skeletons import every_skeleton

from kinefilter import clean
from kinefilter.characters import KINECT_V2, Skeleton, standard_body
from kinefilter.characters.rotations import about_y, rotate, unit
from kinefilter.retarget import Hands
from kinefilter.scenes.sensor import sample_take

Array = NDArray[np.float64]


def _bent(skeleton: Skeleton) -> tuple[Array, Array, list[int], list[int]]:
    """Return rest and a left forearm turned to the front, its hand left behind."""
    before = standard_body(skeleton).rest_positions
    elbow, wrist = (skeleton.index(f"{part}Left") for part in ("Elbow", "Wrist"))
    hand = skeleton.descendants(wrist)
    forearm = [wrist, *hand]
    after, turned = before.copy(), before.copy()
    swung = rotate(about_y(-0.5 * np.pi), before[forearm] - before[elbow])
    turned[forearm] = before[elbow] + swung
    after[wrist] = turned[wrist]
    return after, turned, [elbow, wrist], hand


@every_skeleton
def test_an_invented_hand_turns_with_its_forearm(skeleton: Skeleton) -> None:
    body = standard_body(skeleton)
    after, turned, _, _ = _bent(skeleton)
    hands, rest = Hands(skeleton), body.rest_positions
    carried = hands.carried(rest, after, np.zeros(len(skeleton)), body)
    np.testing.assert_allclose(carried, turned, atol=1e-12)


@every_skeleton
def test_a_measured_hand_stays_as_far_as_its_bones_let_it(skeleton: Skeleton) -> None:
    body = standard_body(skeleton)
    after, _, (_, wrist), hand = _bent(skeleton)
    confidence = np.ones(len(skeleton))
    carried = Hands(skeleton).carried(body.rest_positions, after, confidence, body)
    first = hand[0]
    aim, found = after[first] - after[wrist], carried[first] - carried[wrist]
    np.testing.assert_allclose(np.linalg.norm(found), body.lengths[first])
    np.testing.assert_allclose(found / np.linalg.norm(found), aim / np.linalg.norm(aim))
    others = [j for j in range(len(skeleton)) if j not in hand]
    np.testing.assert_allclose(carried[others], after[others], atol=1e-12)


def test_no_hand_of_the_sample_hangs_bent() -> None:
    clip = clean(sample_take()).clip
    index = clip.skeleton.index
    for side in ("Left", "Right"):
        elbow, wrist, hand = (
            clip.positions[:, index(part + side)] for part in ("Elbow", "Wrist", "Hand")
        )
        forearm, bone = wrist - elbow, hand - wrist
        lengths = np.linalg.norm([forearm, bone], axis=2).prod(axis=0)
        assert np.degrees(np.arccos(np.vecdot(forearm, bone) / lengths)).max() < 45.0


def test_straight_hands_lie_along_their_forearms_as_far_as_said() -> None:
    rng = np.random.default_rng(0)
    body, index = standard_body(KINECT_V2), KINECT_V2.index
    positions = body.rest_positions + 0.1 * rng.standard_normal((7, len(KINECT_V2), 3))
    share = np.zeros((7, len(KINECT_V2)))
    share[3:, index("HandLeft")] = np.linspace(0.25, 1.0, 4)
    straight = Hands(KINECT_V2).straightened(positions, share, body)
    elbow, wrist, hand = (index(part + "Left") for part in ("Elbow", "Wrist", "Hand"))
    moved = [hand, *KINECT_V2.descendants(hand)]
    others = [j for j in range(len(KINECT_V2)) if j not in moved]
    np.testing.assert_array_equal(straight[:, others], positions[:, others])
    np.testing.assert_array_equal(straight[:3], positions[:3])
    forearm = unit(straight[:, wrist] - straight[:, elbow])
    bone = straight[:, hand] - straight[:, wrist]
    was = unit(positions[:, hand] - positions[:, wrist])
    np.testing.assert_allclose(bone[-1], body.lengths[hand] * forearm[-1], atol=1e-12)
    nearer = np.vecdot(unit(bone), forearm) - np.vecdot(was, forearm)
    assert (nearer[3:] > 0.0).all()
