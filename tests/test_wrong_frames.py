"""Frames in which a tracker was wrong for a moment do not spoil the others."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from kinefilter.characters import Take
from kinefilter.pipeline.cleaner import Cleaner
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.failures.gross import FailureKind, find_failures
from kinefilter.pipeline.formats import read_take

Array = NDArray[np.float64]
SAMPLE = Path(__file__).parent.parent / "scenes/takes/wave_punch_bend.csv"
LEFT_ARM = ("ElbowLeft", "WristLeft", "HandLeft")


@pytest.fixture(scope="module")
def take() -> Take:
    return read_take(SAMPLE)


def moved(take: Take, frames: slice, by: list[float], joints: tuple[str, ...]) -> Take:
    positions = take.positions.copy()
    for joint in joints:
        positions[frames, take.skeleton.index(joint)] += by
    return replace(take, positions=positions)


@pytest.mark.parametrize("frames", [slice(1), slice(3), slice(40, 42), slice(296, 298)])
def test_a_body_that_is_elsewhere_for_a_moment_is_removed(
    take: Take, frames: slice
) -> None:
    wrong = moved(take, frames, [0.3, 0.0, 0.3], take.skeleton.joints)
    found = [f for f in find_failures(wrong) if f.part == "body"]
    assert [f.kind for f in found] == [FailureKind.ELSEWHERE]
    assert found[0].frames == slice(frames.start or 0, frames.stop)
    assert not [f for f in find_failures(take) if f.part == "body"]


def test_a_runner_is_not_elsewhere(take: Take) -> None:
    run = take.time[:, None, None] * [9.0, 0.0, 0.0]
    found = find_failures(replace(take, positions=take.positions + run))
    assert not [f for f in found if f.part == "body"]


@pytest.mark.parametrize("last", [False, True])
def test_one_wrong_frame_at_an_end_changes_little_elsewhere(
    take: Take, last: bool
) -> None:
    def cleaned(seen: Take) -> Array:
        cleaner = Cleaner(CleanConfig(physics=False))
        return cleaner.until("correct").whole(seen).positions

    frames, others = slice(1), slice(15, None)
    if last:
        frames, others = slice(len(take) - 1, None), slice(-15)
    wrong = moved(take, frames, [0.1, 0.5, 0.1], LEFT_ARM)
    away = np.linalg.norm(cleaned(wrong) - cleaned(take), axis=2)[others]
    assert away.mean() < 0.001


@pytest.mark.parametrize("frames", [slice(1), slice(3), slice(296, 298)])
def test_a_limb_that_is_elsewhere_at_an_end_is_filled_in(
    take: Take, frames: slice
) -> None:
    wrong = moved(take, frames, [0.1, 0.5, 0.1], LEFT_ARM)
    off = [f for f in find_failures(wrong) if f.kind is FailureKind.OFF_AT_END]
    assert [f.part for f in off] == list(LEFT_ARM)
    assert all(f.frames == slice(frames.start or 0, frames.stop) for f in off)
    found, right = (Cleaner().whole(one).positions for one in (wrong, take))
    assert np.linalg.norm(found - right, axis=2).max() < 0.05


def test_a_punch_at_an_end_stays(take: Take) -> None:
    # A fist that a boxer speeds up by 200 m/s^2, until the take ends.
    positions = take.positions.copy()
    hand = [take.skeleton.index(joint) for joint in ("WristRight", "HandRight")]
    since = np.maximum(take.time - take.time[-1] + 0.06, 0.0)
    positions[:, hand, 2] += 100.0 * since[:, None] ** 2
    assert not [
        f
        for f in find_failures(replace(take, positions=positions))
        if f.kind is FailureKind.OFF_AT_END
    ]
