"""Hands moved elsewhere by the arms, the trunk and the knees."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from skeletons import every_skeleton

from kinefilter.characters import Skeleton, positions_from_rotations, standard_body
from kinefilter.characters.rotations import IDENTITY, about_x, multiply
from kinefilter.retarget.limbs import Reach

Array = NDArray[np.float64]


def _standing(skeleton: Skeleton, bow: float) -> tuple[Array, Array]:
    """Return somebody who bows [rad] with arms to the sides and bent elbows."""
    body = standard_body(skeleton)
    rotations = np.tile(IDENTITY, (len(skeleton), 1))
    legs = [skeleton.descendants(int(hip)) for hip in skeleton.hips]
    upper = np.setdiff1d(range(len(skeleton)), [*legs[0], *legs[1]])
    rotations[upper] = multiply(about_x(bow), rotations[upper])
    for side in ("Left", "Right"):
        wrist = skeleton.index("Wrist" + side)
        for j in (wrist, *skeleton.descendants(wrist)):
            rotations[j] = multiply(about_x(-0.6), rotations[j])
    return positions_from_rotations(rotations, body.rest_positions[0], body), rotations


@every_skeleton
@pytest.mark.parametrize(
    "move", [(-0.15, -0.1, 0.1), (-0.3, 0.0, 0.35), (-0.3, -0.4, 0.2)]
)
def test_hands_get_where_they_are_moved(
    skeleton: Skeleton, move: tuple[float, float, float]
) -> None:
    positions, rotations = _standing(skeleton, 0.4)
    moves = np.array([move, move]) * [[1.0, 1.0, 1.0], [-1.0, 1.0, 1.0]]
    moved, turned = Reach(standard_body(skeleton))(positions, rotations, moves)
    hands = skeleton.sides("Hand")
    np.testing.assert_allclose(moved[hands], positions[hands] + moves, atol=0.02)
    planted = [*skeleton.sides("Ankle"), *skeleton.sides("Foot")]
    np.testing.assert_array_equal(moved[planted], positions[planted])
    ends, starts = skeleton.segments, skeleton.segment_parents
    lengths = [np.linalg.norm(p[ends] - p[starts], axis=1) for p in (positions, moved)]
    np.testing.assert_allclose(*lengths, atol=1e-9)
    # The rotations belong to the positions.
    body = standard_body(skeleton)
    again = positions_from_rotations(turned, moved[skeleton.root], body)
    np.testing.assert_allclose(again, moved, atol=1e-9)


def test_what_is_out_of_reach_is_reached_as_far_as_it_goes() -> None:
    for skeleton in every_skeleton.args[1]:
        positions, rotations = _standing(skeleton, 0.4)
        far = np.tile([0.0, 0.0, 3.0], (2, 1))
        moved, _ = Reach(standard_body(skeleton))(positions, rotations, far)
        away = moved[skeleton.root] - positions[skeleton.root]
        assert np.linalg.norm(away) <= 0.2 + 1e-9


@every_skeleton
def test_feet_stay_when_hands_are_moved_as_high_as_they_go(skeleton: Skeleton) -> None:
    positions, rotations = _standing(skeleton, 0.1)
    high = np.tile([0.0, 1.5, 0.2], (2, 1))
    moved, _ = Reach(standard_body(skeleton))(positions, rotations, high)
    planted = [*skeleton.sides("Ankle"), *skeleton.sides("Foot")]
    np.testing.assert_allclose(moved[planted], positions[planted], atol=1e-9)
