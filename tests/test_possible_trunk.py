"""Trunks that correction would fold or twist."""

from __future__ import annotations

import numpy as np
import pytest
from known_motions import Array, performed
from real_data import DATA, recorded
from skeletons import every_skeleton

from kinefilter import CleanConfig, clean, read_take
from kinefilter.characters import KINECT_V2, Body, Skeleton, Take, standard_body
from kinefilter.characters.rotations import wrapped
from kinefilter.pipeline.reliability import measure_body, measure_reference
from kinefilter.pipeline.target.possible_postures import even_turns, possible_trunk
from kinefilter.retarget import HeadingFrame
from kinefilter.scenes.library import MOTIONS


def _body(take: Take) -> Body:
    return measure_body(take, measure_reference(take))


def _line(positions: Array, skeleton: Skeleton, part: str) -> Array:
    left, right = skeleton.sides(part)
    return positions[:, left] - positions[:, right]


def _twist(positions: Array, skeleton: Skeleton) -> Array:
    """Return the angle between hips and shoulders [degrees], (T,)."""
    hips, shoulders = (_line(positions, skeleton, part) for part in ("Hip", "Shoulder"))
    yaw = [np.arctan2(-line[:, 2], line[:, 0]) for line in (hips, shoulders)]
    return np.degrees(np.abs(wrapped(yaw[1] - yaw[0])))


@every_skeleton
@pytest.mark.parametrize("part", ["Hip", "Shoulder"])
@pytest.mark.parametrize(("share", "turn"), [(0.3, 0.0), (1.0, 80.0), (0.1, -100.0)])
def test_trunks_are_unfolded_and_untwisted(
    skeleton: Skeleton, part: str, share: float, turn: float
) -> None:
    body = standard_body(skeleton)
    rest, ends = body.rest_positions[None], skeleton.sides(part)
    middle = rest[:, ends].mean(axis=1)
    frame, moved = HeadingFrame(middle, np.full(1, np.radians(turn))), rest.copy()
    moved[:, ends] = frame.restore(share * (rest[:, ends] - middle[:, None]))
    found = possible_trunk(moved, body)
    assert _twist(found, skeleton)[0] < 45.0 + 1e-6
    for name in ("Hip", "Shoulder"):
        width, usual = (np.linalg.norm(_line(x, skeleton, name)) for x in (found, rest))
        assert width > 0.75 * usual - 1e-9
    middles = found[:, ends].mean(axis=1)
    np.testing.assert_allclose(middles, middle, atol=1e-12)
    others = np.setdiff1d(
        np.arange(len(skeleton)), [*skeleton.hips, *skeleton.sides("Shoulder")]
    )
    np.testing.assert_array_equal(found[:, others], rest[:, others])
    if share < 0.5:  # the other line says which way the trunk faces
        line = _line(found, skeleton, part)[0]
        assert abs(np.degrees(np.arctan2(-line[2], line[0]))) < 20.0


@pytest.mark.parametrize("motion", MOTIONS)
def test_possible_trunks_stay_as_they_are(motion: str) -> None:
    take = performed(motion)
    found = possible_trunk(take.positions, _body(take))
    np.testing.assert_allclose(found, take.positions, atol=1e-9)


@recorded
@pytest.mark.parametrize("name", ["p10_90deg_walk_A", "p12_parallel_walk_A"])
def test_cleaned_walkers_do_not_wring_their_trunks(name: str) -> None:
    take = read_take(DATA / "two-kinects" / f"{name}.csv.gz")
    clip = clean(take, CleanConfig(physics=False)).clip
    assert _twist(clip.positions, take.skeleton).max() < 55.0


@pytest.mark.parametrize("aside", [True, False])
@pytest.mark.parametrize("seconds", [0.03, 0.9])
def test_only_fast_turns_beside_the_sensor_are_evened(
    *, aside: bool, seconds: float
) -> None:
    """Who faces the sensor is seen to turn, and who turns slowly may do so."""
    body, count = standard_body(KINECT_V2), 120
    time, jump = np.arange(count) / 30.0, np.radians(36.0)
    yaw = np.interp(time, [2.0, 2.0 + seconds], [0.0, jump])
    yaw += np.radians(60.0 if aside else -18.0)
    place = HeadingFrame(np.tile([0.0, 0.0, -3.0], (count, 1)), yaw)
    positions = place.restore(np.tile(body.rest_positions, (count, 1, 1)))
    even = even_turns(positions, body, time)
    if seconds > 0.5 or not aside:
        np.testing.assert_allclose(even, positions, atol=1e-9)
        return
    speeds = []
    for joints in (positions, even):
        left, right = (joints[:, j] for j in body.skeleton.sides("Shoulder"))
        yaw = np.unwrap(np.arctan2((right - left)[:, 2], (left - right)[:, 0]))
        np.testing.assert_allclose(np.ptp(yaw), jump)
        speeds.append(np.abs(np.diff(yaw)).max())
    assert speeds[1] < 0.4 * speeds[0]
