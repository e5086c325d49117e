"""Limbs whose left and right a sensor exchanges while the rest of the body stays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from real_data import DATA, recorded
from skeletons import every_skeleton

from kinefilter.characters import KINECT_V2, Skeleton, State, Take
from kinefilter.pipeline.failures import FailureKind, find_failures, unmirrored
from kinefilter.pipeline.failures.exchanged_limbs import EXCHANGED, put_back
from kinefilter.pipeline.formats import read_recording
from kinefilter.scenes.library import perform, random_body


def _take(motion: str, skeleton: Skeleton = KINECT_V2) -> Take:
    body = random_body(skeleton, np.random.default_rng(0))
    act = perform(motion, body, seed=0)
    state = np.full(act.positions.shape[:2], State.TRACKED, dtype=np.uint8)
    return Take(act.time, act.positions, state, skeleton, motion)


def _swaps(take: Take) -> list[tuple[str, int, int]]:
    found = [f for f in find_failures(take) if f.kind is FailureKind.MIRRORED]
    return [(failure.part, failure.first, failure.last) for failure in found]


@every_skeleton
@pytest.mark.parametrize("part", EXCHANGED)
@pytest.mark.parametrize(("first", "last"), [(40, 50), (30, 89), (0, 44)])
def test_exchanged_limbs_are_found_and_put_back(
    skeleton: Skeleton, part: str, first: int, last: int
) -> None:
    take = _take("squat", skeleton)
    wrong = put_back(take, part, slice(first, last + 1))
    assert _swaps(wrong) == [(part, first, last)]
    again = unmirrored(wrong, find_failures(wrong))
    np.testing.assert_array_equal(again.positions, take.positions)


@pytest.mark.parametrize("motion", ["walk", "clap", "wave", "punch"])
def test_nobody_has_limbs_exchanged(motion: str) -> None:
    assert _swaps(_take(motion)) == []


def test_missing_joints_show_no_exchange() -> None:
    take = _take("squat")
    state = take.state.copy()
    state[::3, KINECT_V2.sides("Wrist")] = State.NOT_TRACKED
    state[50:60] = State.NOT_TRACKED
    assert _swaps(replace(take, state=state)) == []


@recorded
def test_arms_exchanged_for_a_second_in_a_recorded_walk_are_put_back() -> None:
    name = "p12_parallel_walk_A.csv.gz"
    take = read_recording(DATA / "two-kinects" / name).take()
    take = take.at(np.unique(take.time, return_index=True)[1])
    time = take.time - take.time[0]
    frames = np.flatnonzero((time >= 4.0) & (time <= 5.0))
    for part in ("arms from the shoulders", "arms from the elbows"):
        wrong = put_back(take, part, slice(frames[0], frames[-1] + 1))
        again = unmirrored(wrong, find_failures(wrong))
        right = unmirrored(take, find_failures(take))
        np.testing.assert_allclose(again.positions, right.positions, atol=1e-9)
