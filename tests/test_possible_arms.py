"""Arms are kept out of the trunk, and those that are out of it stay as they are."""

from __future__ import annotations

import numpy as np
import pytest
from known_motions import Array
from real_data import DATA, recorded
from skeletons import every_skeleton

from kinefilter import CleanConfig, clean, read_take
from kinefilter.characters import KINECT_V2, Skeleton, standard_body
from kinefilter.pipeline.target.possible_postures import possible_arms
from kinefilter.scenes.library import perform

MIRRORED = np.array([-1.0, 1.0, 1.0])


def within(positions: Array, skeleton: Skeleton, points: int = 9) -> Array:
    """Return frames with points of a forearm's axis within a thin upright trunk."""
    hips = positions[:, skeleton.hips]
    shoulders = positions[:, skeleton.sides("Shoulder")]
    low, high = hips.mean(axis=1), shoulders.mean(axis=1)
    left = hips[:, 0] - hips[:, 1] + shoulders[:, 0] - shoulders[:, 1]
    left[:, 1] = 0.0
    left /= np.linalg.norm(left, axis=1, keepdims=True)
    ends = (positions[:, skeleton.sides(part)] for part in ("Elbow", "Wrist"))
    elbow, wrist = ends
    found = np.zeros(len(positions), dtype=np.bool_)
    for share in np.linspace(0.0, 1.0, points):
        points = elbow + share * (wrist - elbow)
        height = (points - low[:, None])[..., 1] / (high - low)[:, None, 1]
        middle = low[:, None] + height[..., None] * (high - low)[:, None]
        aside = np.vecdot(points - middle, left[:, None])
        ahead = np.linalg.norm(
            points - middle - aside[..., None] * left[:, None], axis=2
        )
        inside = (aside / 0.13) ** 2 + (ahead / 0.085) ** 2 < 1.0
        found |= (inside & (height > 0.0) & (height < 0.8)).any(axis=1)
    return found


@every_skeleton
def test_hands_in_the_trunk_are_brought_out_to_their_own_side(
    skeleton: Skeleton,
) -> None:
    body, rng = standard_body(skeleton), np.random.default_rng(0)
    positions = np.tile(body.rest_positions, (300, 1, 1))
    middle = positions[0, [skeleton.root, skeleton.girdle]].mean(axis=0)
    for side in ("Left", "Right"):
        place = middle + rng.uniform(-1.0, 1.0, (300, 3)) * [0.1, 0.12, 0.07]
        for part in ("Elbow", "Wrist", "Hand"):
            near = place + rng.uniform(-0.03, 0.03, (300, 3))
            positions[:, skeleton.index(part + side)] = near
    moved = possible_arms(positions, body)
    assert within(positions, skeleton).mean() > 0.9
    assert not within(moved, skeleton, points=3).any()
    wrists = skeleton.sides("Wrist")
    way = (moved - positions)[:, wrists, 0] * [1.0, -1.0]
    assert way.mean() > 0.05
    hands = skeleton.sides("Hand")
    np.testing.assert_allclose(*((moved - positions)[:, j] for j in (hands, wrists)))
    others = np.isin(skeleton.kinds, ("Elbow", "Wrist", "Hand", "HandTip", "Thumb"))
    assert (moved == positions)[:, ~others].all()
    mirrored = possible_arms((positions * MIRRORED)[:, skeleton.mirror], body)
    np.testing.assert_allclose((mirrored * MIRRORED)[:, skeleton.mirror], moved)


def test_small_changes_move_arms_little() -> None:
    """No frame of an arm that swings through the trunk jumps."""
    skeleton, body = KINECT_V2, standard_body(KINECT_V2)
    positions = np.tile(body.rest_positions, (400, 1, 1))
    hand = [skeleton.index(part + "Left") for part in ("Elbow", "Wrist", "Hand")]
    middle = positions[0, [skeleton.root, skeleton.girdle]].mean(axis=0)
    swing = middle + np.linspace(-0.3, 0.3, 400)[:, None] * [0.1, 0.0, 1.0]
    positions[:, hand] = swing[:, None]
    moved = possible_arms(positions, body)[:, hand]
    steps = np.linalg.norm(np.diff(moved, axis=0), axis=-1)
    assert steps.max() < 5.0 * np.linalg.norm(swing[1] - swing[0])


@pytest.mark.parametrize("motion", ["walk", "squat", "wave", "punch"])
def test_possible_arms_stay_as_they_are(motion: str) -> None:
    act = perform(motion, standard_body(KINECT_V2), seed=0)
    assert possible_arms(act.positions, act.body) is act.positions


@recorded
@pytest.mark.parametrize("name", ["p00_90deg_walk", "p06_45deg_walk"])
def test_cleaned_walkers_keep_arms_out_of_the_trunk(name: str) -> None:
    take = read_take(DATA / "two-kinects" / f"{name}_A.csv.gz")
    clip = clean(take, CleanConfig(physics=False)).clip
    assert within(clip.positions, clip.skeleton).mean() < 0.04
