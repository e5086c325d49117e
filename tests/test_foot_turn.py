"""Feet that would point backward."""

from __future__ import annotations

import numpy as np
import pytest
from known_motions import BODY, Array, performed, plant, stamps, standing
from skeletons import every_skeleton

from kinefilter.characters import KINECT_V1, Skeleton, standard_body
from kinefilter.characters.rotations import about_y, rotate, wrapped
from kinefilter.pipeline.target.feet import ankles_and_toes, find_stance
from kinefilter.pipeline.target.possible_postures import (
    hips_yaw,
    standing_direction,
    turned_ahead,
)

MOST = np.radians(75.0)


def _off_hips(positions: Array, skeleton: Skeleton) -> Array:
    """Return how far feet point off the heading of the hips [rad], (T, 2)."""
    ankles, toes = ankles_and_toes(skeleton)
    ahead = positions[:, toes] - positions[:, ankles]
    yaw = hips_yaw(positions, skeleton)[:, None]
    return wrapped(np.arctan2(ahead[..., 0], ahead[..., 2]) - yaw)


def _twisted(path: Array, foot: int, angles: Array) -> Array:
    """Return a path with a foot turned about its ankle by angles [rad], (T,)."""
    path, (ankles, toes) = path.copy(), ankles_and_toes(KINECT_V1)
    ankle, toe = ankles[foot], toes[foot]
    ahead = rotate(about_y(angles), path[:, toe] - path[:, ankle])
    path[:, toe] = path[:, ankle] + ahead
    return path


@pytest.mark.parametrize("degrees", [0.0, 60.0, -75.0])
def test_feet_that_people_can_have_are_left_alone(degrees: float) -> None:
    angles = np.full(40, np.radians(degrees))
    path, (ankles, toes) = standing(40), ankles_and_toes(KINECT_V1)
    path[:, toes[0], 0] = path[:, ankles[0], 0]  # straight ahead
    path = _twisted(path, 0, angles)
    foot = path[:, [ankles[0], toes[0]]]
    found = turned_ahead(foot, hips_yaw(path, KINECT_V1), np.ones(40))
    np.testing.assert_allclose(found, foot, atol=1e-12)


def test_a_foot_that_turns_all_around_never_points_backward_nor_jumps() -> None:
    angles = np.linspace(0.0, 2.0 * np.pi, 721)
    path, (ankles, toes) = standing(721), ankles_and_toes(KINECT_V1)
    path = _twisted(path, 1, angles)
    foot = path[:, [ankles[1], toes[1]]]
    found = turned_ahead(foot, hips_yaw(path, KINECT_V1), np.ones(721))
    path[:, toes[1]] = found[:, 1]
    assert np.abs(_off_hips(path, KINECT_V1)).max() < MOST + 1e-9
    assert np.linalg.norm(np.diff(found, axis=0), axis=2).max() < 0.002
    np.testing.assert_allclose(found[:, 0], foot[:, 0])
    lying = turned_ahead(foot, hips_yaw(path, KINECT_V1), np.zeros(721))
    np.testing.assert_allclose(lying, foot, atol=1e-12)


@pytest.mark.parametrize("planted", [True, False])
def test_feet_turned_backward_are_put_right(*, planted: bool) -> None:
    path = _twisted(standing(40), 0, np.full(40, np.radians(160.0)))
    stands = np.ones((40, 2), dtype=np.bool_)
    if not planted:
        stands[5:35, 0] = False
    found, _ = plant(stamps(40), path, np.ones(path.shape[:2]), stands, BODY)
    assert np.abs(_off_hips(path, KINECT_V1)).max() > np.radians(120.0)
    assert np.abs(_off_hips(found, KINECT_V1)).max() < MOST + 0.01


@every_skeleton
def test_who_turns_about_on_a_foot_has_it_between_both_headings(
    skeleton: Skeleton,
) -> None:
    yaw = np.linspace(0.0, np.radians(120.0), 40)
    path = rotate(about_y(yaw)[:, None], standing(40, skeleton))
    stands = np.ones((40, 2), dtype=np.bool_)
    weights = np.ones(path.shape[:2])
    found, _ = plant(stamps(40), path, weights, stands, standard_body(skeleton))
    assert np.abs(_off_hips(found, skeleton)[4:-4]).max() < MOST
    far = standing_direction(np.array([0.0, -1.0]), np.radians([0.0, 170.0]))
    assert np.degrees(np.arctan2(*far)) == pytest.approx(85.0, abs=10.0)


@pytest.mark.parametrize("motion", ["walk", "run", "dance", "kick", "squat"])
def test_feet_of_performers_are_left_alone(
    motion: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    take = performed(motion, KINECT_V1)
    path, weights = take.positions, np.ones(take.state.shape)
    stands = find_stance(take.time, path, weights, KINECT_V1)
    found, _ = plant(take.time, path, weights, stands, BODY)
    module = "kinefilter.pipeline.target.possible_postures"
    monkeypatch.setattr(f"{module}._SPLAYED", np.pi - 1e-6)
    free, _ = plant(take.time, path, weights, stands, BODY)
    assert np.linalg.norm(found - free, axis=2).max() < 0.01
