"""Left and right of people whom the sensor takes for others who face it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from real_data import DATA, recorded
from skeletons import every_skeleton

from kinefilter import read_take
from kinefilter.characters import KINECT_V2, Skeleton, State, Take
from kinefilter.pipeline.failures.sides import swapped_back, swapped_frames
from kinefilter.retarget import HeadingFrame, find_yaw
from kinefilter.scenes.library import perform, random_body

Array = NDArray[np.float64]


def _walk(skeleton: Skeleton = KINECT_V2, motion: str = "walk", seed: int = 0) -> Take:
    body = random_body(skeleton, np.random.default_rng(seed))
    act = perform(motion, body, seed=seed)
    state = np.full(act.positions.shape[:2], State.TRACKED, dtype=np.uint8)
    return Take(act.time, act.positions, state, skeleton, motion)


def _yaw(take: Take) -> Array:
    return find_yaw(take.positions, np.ones(take.state.shape), take.skeleton)


@every_skeleton
def test_who_walks_forward_with_sides_swapped_is_found(skeleton: Skeleton) -> None:
    take = _walk(skeleton)
    assert not swapped_frames(take).any()
    assert swapped_frames(take.swapped()).all()
    part = slice(40, 90)
    found = swapped_frames(take.swapped(part))
    for swapped in found.T:  # trunk and arms, legs
        np.testing.assert_array_equal(np.flatnonzero(swapped), np.arange(40, 90))


@every_skeleton
@pytest.mark.parametrize("early", [False, True])
def test_legs_change_sides_before_or_after_the_arms(
    skeleton: Skeleton, early: bool
) -> None:
    take = _walk(skeleton, seed=2)
    legs = [j for hip in skeleton.hips for j in skeleton.descendants(hip) if j != hip]
    swapped = np.zeros((len(take), 2), dtype=bool)
    swapped[60:, 0] = True
    swapped[52 if early else 68 :, 1] = True
    seen = take.swapped(swapped[:, 0]).positions.copy()
    seen[:, legs] = take.swapped(swapped[:, 1]).positions[:, legs]
    seen = replace(take, positions=seen)
    np.testing.assert_array_equal(swapped_frames(seen), swapped)
    feet = list(skeleton.sides("Foot"))  # their toes are turned
    others = np.setdiff1d(np.arange(len(skeleton)), feet)
    mended = swapped_back(seen, swapped).positions
    np.testing.assert_allclose(mended[:, others], take.positions[:, others], atol=1e-9)


def test_who_stands_beside_the_sensor_keeps_sides() -> None:
    """It shows the trunk turned toward itself, so hands seem to be behind."""
    stand = _walk(motion="stand_idle")
    frame = HeadingFrame(stand.positions[:, 0], np.full(len(stand), np.radians(110.0)))
    trunk = [*KINECT_V2.hips, *KINECT_V2.sides("Shoulder")]
    turned = frame.restore(frame.unturned.remove(stand.positions))
    turned[:, trunk] = stand.positions[:, trunk]
    assert not swapped_frames(replace(stand, positions=turned)).any()


@pytest.mark.parametrize("motion", ["walk", "run"])
@pytest.mark.parametrize("seed", range(3))
def test_who_walks_backward_is_left_alone(motion: str, seed: int) -> None:
    take = _walk(motion=motion, seed=seed)
    assert not swapped_frames(replace(take, positions=take.positions[::-1])).any()


def test_hidden_arms_or_legs_leave_enough_to_see() -> None:
    take = _walk()
    for names in (("Elbow", "Wrist", "Hand"), ("Knee", "Ankle", "Foot")):
        joints = [j for name in names for j in KINECT_V2.sides(name)]
        positions = take.positions.copy()
        positions[:, joints] = np.nan
        hidden = replace(take, positions=positions)
        assert not swapped_frames(hidden).any()
        assert swapped_frames(hidden.swapped()).all()


def test_toes_that_point_at_the_sensor_are_turned_forward() -> None:
    take = _walk()
    feet = list(KINECT_V2.sides("Foot"))
    ankles = take.positions[:, [KINECT_V2.parents[foot] for foot in feet]]
    yaw = _yaw(take)
    forward = np.stack([np.sin(yaw), np.zeros(len(yaw)), np.cos(yaw)], axis=1)
    true, seen = take.positions.copy(), take.positions.copy()
    true[:, feet] = ankles + 0.1 * forward[:, None] + [0.02, -0.06, 0.0]
    seen[:, feet] = (
        true[:, feet]
        - 2.0
        * np.vecdot(true[:, feet] - ankles, forward[:, None])[..., None]
        * forward[:, None]
    )
    mended = swapped_back(
        replace(take, positions=seen).swapped(), np.ones((len(take), 2), dtype=bool)
    )
    np.testing.assert_allclose(mended.positions, true, atol=1e-9)
    kept = swapped_back(
        replace(take, positions=true).swapped(), np.ones((len(take), 2), dtype=bool)
    )
    np.testing.assert_allclose(kept.positions, true, atol=1e-9)


def test_the_trunk_turns_evenly_where_its_heading_jumps() -> None:
    take = _walk(motion="stand_idle")
    jump, change = np.radians(140.0), 60
    frames = np.arange(len(take)) >= change
    frame = HeadingFrame(take.positions[:, 0], np.where(frames, jump, 0.0))
    positions = frame.unturned.remove(take.positions)
    turned = replace(take, positions=frame.restore(positions))
    mended = swapped_back(turned.swapped(frames), np.stack([frames, frames], 1))
    away = np.unwrap(_yaw(mended)) - np.unwrap(_yaw(take))
    around = np.abs(take.time - take.time[change]) < 0.2
    speed = np.diff(away)[around[1:]] / np.diff(take.time)[around[1:]]
    np.testing.assert_allclose(speed, jump / 0.5, rtol=0.15)
    assert np.abs(away[:50]).max() < 1e-9
    assert np.abs(away[70:] - jump).max() < 1e-9


@recorded
def test_recorded_people_walk_forward() -> None:
    """They were on their way away from the sensor, which had them walk backward."""
    shares = []
    for name in ("p10_90deg_walk_A", "p14_90deg_walk_A", "p16_45deg_walk_B"):
        take = read_take(DATA / "two-kinects" / f"{name}.csv.gz")
        take = take.at(np.unique(take.time, return_index=True)[1])
        mended = swapped_back(take, swapped_frames(take))
        step = 10
        way = np.zeros_like(take.positions[:, 0])
        way[step:-step] = take.positions[2 * step :, 0] - take.positions[: -2 * step, 0]
        fast = np.linalg.norm(way[:, [0, 2]], axis=1) > 0.25
        course = np.arctan2(way[:, 0], way[:, 2])
        shares.append(
            [(np.cos(course - _yaw(t))[fast] < -0.5).mean() for t in (take, mended)]
        )
    before, after = np.mean(shares, axis=0)
    assert before > 0.2
    assert after < 0.4 * before
