"""Knees that bend backward."""

from __future__ import annotations

import numpy as np
import pytest
from known_motions import performed
from real_data import DATA, recorded
from skeletons import every_skeleton

from kinefilter import CleanConfig, clean, read_take
from kinefilter.characters import KINECT_V2, Skeleton, standard_body
from kinefilter.pipeline.target.possible_postures import possible_knees
from kinefilter.scenes.library import MOTIONS


@every_skeleton
@pytest.mark.parametrize("side", ["Left", "Right"])
@pytest.mark.parametrize(("ahead", "left"), [(-0.2, -0.03), (-0.02, -0.02), (0.2, 0.2)])
def test_knees_do_not_bend_backward(
    skeleton: Skeleton, side: str, ahead: float, left: float
) -> None:
    rest = standard_body(skeleton).rest_positions[None]
    knee, ankle, hip = (skeleton.index(p + side) for p in ("Knee", "Ankle", "Hip"))
    bent = rest.copy()
    bent[:, ankle, 2] = bent[:, hip, 2]
    bent[:, knee, 2] = bent[:, hip, 2] + ahead
    found = possible_knees(bent, skeleton)
    assert found[0, knee, 2] - bent[0, hip, 2] == pytest.approx(left, abs=5e-3)
    others = np.arange(len(skeleton)) != knee
    np.testing.assert_array_equal(found[:, others], bent[:, others])


def test_a_leg_that_points_sideways_does_not_tell_which_way_its_knee_bends() -> None:
    body = standard_body(KINECT_V2)
    skeleton, bent = body.skeleton, body.rest_positions[None].copy()
    hip, knee, ankle = (skeleton.index(f"{p}Left") for p in ("Hip", "Knee", "Ankle"))
    bent[:, knee] = bent[:, hip] + [0.4, 0.1, -0.1]
    bent[:, ankle] = bent[:, hip] + [0.8, 0.0, 0.0]
    np.testing.assert_array_equal(possible_knees(bent, skeleton), bent)


@pytest.mark.parametrize("motion", MOTIONS)
def test_knees_of_people_stay_as_they_are(motion: str) -> None:
    take = performed(motion)
    found = possible_knees(take.positions, take.skeleton)
    np.testing.assert_array_equal(found, take.positions)


@recorded
def test_cleaned_walkers_bend_their_knees_forward() -> None:
    take = read_take(DATA / "two-kinects" / "p04_parallel_walk_A.csv.gz")
    clip = clean(take, CleanConfig(physics=False)).clip
    moved = possible_knees(clip.positions, take.skeleton) - clip.positions
    assert np.linalg.norm(moved, axis=2).max() < 0.1
