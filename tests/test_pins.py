"""Pins: where joints are put by hand, and what is then told of them."""

from __future__ import annotations

import numpy as np
import pytest

from kinefilter import CleanConfig, Cleaner, read_take
from kinefilter.pipeline.clean_result import CleanResult
from kinefilter.pipeline.draft import Unedited
from kinefilter.pipeline.edits import Edit
from kinefilter.scenes import SAMPLE

TAKE = read_take(SAMPLE)
CLEANER = Cleaner(CleanConfig(method="none", physics=False))


@pytest.fixture(scope="module")
def unedited() -> Unedited:
    return CLEANER.unedited(TAKE)


@pytest.fixture(scope="module")
def before(unedited: Unedited) -> CleanResult:
    return CLEANER.clean(TAKE, edits=(), before=unedited)


def pinned(before: CleanResult, joint: str, frame: int, off: tuple[float, ...]) -> Edit:
    place = before.clip.positions[frame, TAKE.skeleton.index(joint)] + off
    when = float(TAKE.time[frame] - TAKE.time[0])
    return Edit("pin", when, when, (joint,), position=tuple(place.tolist()))


def test_a_limb_moved_by_pins_is_no_tracker_failure() -> None:
    take = TAKE.at(slice(140))  # later, a limb is at the threshold of displaced ones
    unedited = CLEANER.unedited(take)
    before = CLEANER.clean(take, edits=(), before=unedited)
    for joint in ("WristLeft", "HandLeft", "ElbowRight"):
        off = (0.0, 0.15, 0.15)
        pins = [pinned(before, joint, frame, off) for frame in (90, 100, 110)]
        found = CLEANER.clean(take, edits=pins, before=unedited)
        assert found.damage == before.damage, joint


@pytest.mark.parametrize("off", [(0.0, 0.0, 0.0), (0.03, 0.05, -0.04)])
@pytest.mark.parametrize("joint", ["HandLeft", "WristRight", "ElbowLeft"])
def test_what_is_pinned_stays_there_where_bone_lengths_move_the_trunk(
    unedited: Unedited, before: CleanResult, joint: str, off: tuple[float, ...]
) -> None:
    for frame in (100, 200):
        pin = pinned(before, joint, frame, off)
        found = CLEANER.clean(TAKE, edits=[pin], before=unedited)
        there = found.clip.positions[frame, TAKE.skeleton.index(joint)]
        assert np.linalg.norm(there - pin.position) < 0.01  # m; 2 cm with the trunk
