"""Joints that leap by meters throw nobody into the floor."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from kinefilter import Avatar, CleanConfig, clean, read_take
from kinefilter.characters import KINECT_V1, Body, Take, standard_body
from kinefilter.pipeline.metrics import bone_length_cv, lowest_point
from kinefilter.scenes import SAMPLE

DEEPEST = 0.01 + 1e-6  # m, and rounding


def damaged(seed: int) -> Take:
    """Return 20 recorded frames in which some 30 coordinates are any of a few."""
    take, rng = read_take(SAMPLE), np.random.default_rng(seed)
    positions = take.positions[40:60].copy()
    places = rng.choice(positions.size, 30, replace=False)
    positions.reshape(-1)[places] = rng.choice([0.0, -1.5, 3.7, 12.0, 40.0], 30)
    return Take(take.time[40:60], positions, take.state[40:60], KINECT_V1)


def deepest(positions: NDArray[np.float64], body: Body) -> float:
    return -float(lowest_point(positions, body).min())


@pytest.mark.parametrize(
    ("seed", "physics"), [(0, True), (5, True), (28, True), (7, True), (7, False)]
)
def test_leaping_joints_leave_a_clip_over_its_floor(seed: int, physics: bool) -> None:
    config = CleanConfig(method="none", physics=physics)
    clip = clean(damaged(seed), config).clip
    assert deepest(clip.positions, clip.body) < DEEPEST
    assert bone_length_cv(clip.positions, clip.body) < 1e-9


@pytest.mark.parametrize("seed", [5, 6, 30])
def test_leaping_joints_leave_an_avatar_over_its_floor(seed: int) -> None:
    take, avatar = damaged(seed), Avatar(standard_body(KINECT_V1))
    poses = [
        avatar.step(frame, time).positions
        for frame, time in zip(take.positions, take.time, strict=True)
    ]
    assert deepest(np.array(poses), avatar.body) < DEEPEST
