"""Gross failures of the tracker are found, reported and mended."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kinefilter.characters import KINECT_V1, KINECT_V2, State, Take, random_body
from kinefilter.pipeline import CleanConfig, clean, read_take
from kinefilter.pipeline.failures import FailureKind, find_failures, unmirrored
from kinefilter.pipeline.summary import as_json
from kinefilter.pipeline.training import read_pairs
from kinefilter.scenes import MOTIONS, perform

DATA = Path(__file__).parents[1].parent / "shared" / "data"
recorded = pytest.mark.skipif(not DATA.is_dir(), reason="no recordings in ../shared")


def _take(motion: str, seed: int = 0, skeleton: object = KINECT_V1) -> Take:
    kind = KINECT_V2 if skeleton is KINECT_V2 else KINECT_V1
    body = random_body(kind, np.random.default_rng(seed))
    act = perform(motion, body, seed=seed)
    state = np.full(act.positions.shape[:2], State.TRACKED, dtype=np.uint8)
    return Take(act.time, act.positions, state, kind, motion)


def _mirrored(take: Take, frames: slice) -> Take:
    positions = take.positions.copy()
    positions[frames] = positions[frames][:, take.skeleton.mirror]
    return replace(take, positions=positions)


def _broken(take: Take, frames: slice) -> Take:
    """Return a take whose left shank is folded forwards, as no knee allows."""
    positions, index = take.positions.copy(), take.skeleton.index
    knee = positions[:, index("KneeLeft")]
    for joint in ("AnkleLeft", "FootLeft"):
        down = positions[frames, index(joint)] - knee[frames]
        down[:, 1], down[:, 2] = 0.5 * down[:, 1], 0.8 * np.abs(down[:, 1])
        positions[frames, index(joint)] = knee[frames] + down
    return replace(take, positions=positions)


@pytest.mark.parametrize("motion", MOTIONS)
def test_no_motion_is_a_failure(motion: str) -> None:
    assert find_failures(_take(motion)) == ()


@pytest.mark.parametrize("skeleton", [KINECT_V1, KINECT_V2], ids=lambda s: s.name)
def test_exchanged_sides_are_found_and_put_back(skeleton: object) -> None:
    take = _take("squat", skeleton=skeleton)
    wrong = _mirrored(take, slice(40, 71))
    (failure,) = find_failures(wrong)
    assert failure.kind is FailureKind.MIRRORED
    assert (failure.first, failure.last) == (40, 70)
    again = unmirrored(wrong, (failure,))
    np.testing.assert_array_equal(again.positions, take.positions)


def test_two_stretches_and_one_that_reaches_the_end_are_found() -> None:
    take = _take("wave")
    wrong = _mirrored(_mirrored(take, slice(20, 40)), slice(len(take) - 15, None))
    found = find_failures(wrong)
    assert [f.first for f in found] == [20, len(take) - 15]
    assert found[-1].last == len(take) - 1


def test_a_leg_bent_forwards_at_the_knee_is_found() -> None:
    wrong = _broken(_take("wave"), slice(30, 90))
    (failure,) = find_failures(wrong)
    assert failure.kind is FailureKind.BENT_BACKWARDS
    assert failure.part == "left leg"
    assert abs(failure.first - 30) < 5
    assert abs(failure.last - 89) < 5
    assert find_failures(_broken(_take("wave"), slice(30, 45))) == ()


def test_missing_joints_are_no_failure() -> None:
    take = _take("walk")
    positions = take.positions.copy()
    positions[10:60, take.skeleton.index("KneeLeft")] = np.nan
    positions[:, take.skeleton.index("ShoulderRight")] = np.nan
    assert find_failures(replace(take, positions=positions)) == ()


def test_a_failure_is_mended_and_told() -> None:
    take = _take("wave")
    result = clean(_mirrored(take, slice(40, 60)), CleanConfig(physics=False))
    whole = clean(take, CleanConfig(physics=False))
    apart = result.clip.positions - whole.clip.positions
    assert np.abs(apart).max() < 0.02
    (told,) = as_json(result)["failures"]
    assert told["kind"] == "mirrored"
    assert told["start_s"] == pytest.approx(take.time[40])
    assert as_json(whole)["failures"] == []


def test_a_broken_leg_is_invented_anew() -> None:
    take = _take("wave")
    ankle = take.skeleton.index("AnkleLeft")
    wrong = _broken(take, slice(30, 120))
    result = clean(wrong, CleanConfig(physics=False))
    frames = slice(50, 100)

    def off(positions: np.ndarray) -> float:
        relative = positions - positions[:, [0]]
        truth = take.positions - take.positions[:, [0]]
        return float(np.linalg.norm(relative - truth, axis=2)[frames, ankle].mean())

    assert off(result.clip.positions) < 0.5 * off(wrong.positions)


@recorded
@pytest.mark.parametrize(
    "name",
    [
        "m01_s06_e05_inc_failure",
        "m04_s04_e05_inc_failure",
        "m08_s02_e04_failure",
        "m08_s06_e02_failure",
    ],
)
def test_recorded_failures_are_found(name: str) -> None:
    assert find_failures(read_take(DATA / "takes" / "ui-prmd" / f"{name}.csv"))


@recorded
def test_recordings_that_mocap_agrees_with_hardly_ever_alarm() -> None:
    clips = read_pairs(DATA / "ui-prmd" / "s07.npz")
    clips += read_pairs(DATA / "ui-prmd" / "s08.npz")
    alarms = [pair.clip for pair in clips if find_failures(pair.take)]
    assert len(alarms) <= 0.01 * len(clips)
