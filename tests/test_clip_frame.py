"""A take in the frame of its clip: exactly, and no other take."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import MakeClip
from numpy.typing import NDArray

from kinefilter import CleanConfig, clean, read_take
from kinefilter.characters import KINECT_V1, InputError, State, Take, standard_body
from kinefilter.pipeline.clean_result import CleanResult
from kinefilter.pipeline.failures import FailureKind, lost_joints, unmirrored
from kinefilter.pipeline.formats import read_clip, write_clip, write_take_csv
from kinefilter.pipeline.formats.export import resampled
from kinefilter.pipeline.look.comparison import (
    compare,
    in_clip_frame,
    raw_positions,
    same_stamps,
)
from kinefilter.pipeline.metrics import METRICS
from kinefilter.retarget import HeadingFrame
from kinefilter.scenes.library import perform

Array = NDArray[np.float64]

DATA = Path(__file__).parents[1].parent / "shared" / "data" / "takes"
recorded = pytest.mark.skipif(not DATA.is_dir(), reason="no recordings in ../shared")

QUICK = CleanConfig(method="none", physics=False)
WITH_PHYSICS = CleanConfig(method="none")
BODY = standard_body(KINECT_V1)


def _turned(positions: Array, tilt: float) -> Array:
    """Return positions turned about x by an angle [rad], from y to z."""
    cos, sin = np.cos(tilt), np.sin(tilt)
    return positions @ np.array([[1, 0, 0], [0, cos, -sin], [0, sin, cos]]).T


def _seen(motion: str, tilt: float, floor: float, *, noise: int = 0) -> Take:
    """Return a noisy take of a sensor; tilt [degrees] and floor [m] level it."""
    act = perform(motion, BODY, seed=2)
    there = act.positions[:120] + np.array([0.0, floor, 2.0])
    rng = np.random.default_rng(noise)
    there = _turned(there, -np.radians(tilt)) + rng.normal(0.0, 0.01, there.shape)
    there[30:40, 7] = np.nan
    state = np.where(np.isnan(there[..., 0]), State.NOT_TRACKED, State.TRACKED)
    return Take(act.time[:120], there, state.astype(np.uint8), KINECT_V1, motion)


def _mirrored(take: Take, frames: slice) -> Take:
    positions, state = take.positions.copy(), take.state.copy()
    positions[frames] = positions[frames][:, KINECT_V1.mirror]
    state[frames] = state[frames][:, KINECT_V1.mirror]
    return replace(take, positions=positions, state=state)


def _holds(result: CleanResult, take: Take) -> None:
    """Assert that a take is placed where the pipeline measured distances from."""
    away = np.linalg.norm(result.target - in_clip_frame(take, result.clip), axis=2)
    away[lost_joints(result.failures, take)] = np.nan  # what was removed
    np.testing.assert_allclose(away, result.clip.moved_by_correction, atol=1e-12)


@pytest.mark.parametrize("tilt", [-12.0, 0.0, 8.0])
@pytest.mark.parametrize("floor", [-0.9, 0.4])
def test_a_take_is_placed_where_the_pipeline_saw_it(
    tilt: float, floor: float, tmp_path: Path
) -> None:
    take = _seen("walk", tilt, floor)
    result = clean(take, QUICK)
    assert np.degrees(result.clip.tilt) == pytest.approx(tilt, abs=1.5)
    write_clip(result.clip, tmp_path / "clip.npz")
    _holds(replace(result, clip=read_clip(tmp_path / "clip.npz")), take)


@pytest.mark.parametrize("tilt", [-20.0, 0.0, 5.0])
def test_tilt_and_floor_that_are_given_are_those_taken_off(tilt: float) -> None:
    take = _seen("squat", tilt, -0.7)
    result = clean(take, replace(QUICK, tilt=tilt, floor=-0.75))
    assert result.clip.tilt == np.radians(tilt)
    assert result.clip.floor == -0.75
    expected = _turned(take.positions, np.radians(tilt)) - [0.0, -0.75, 0.0]
    found = in_clip_frame(take, result.clip)
    np.testing.assert_allclose(found, expected, atol=1e-12)
    _holds(result, take)


def test_a_floor_that_is_raised_is_all_that_changes() -> None:
    low, high = _seen("squat", 0.0, -0.7), _seen("squat", 0.0, 0.6)
    clips = [clean(take, QUICK).clip for take in (low, high)]
    assert clips[1].floor - clips[0].floor == pytest.approx(1.3, abs=1e-6)
    places = [in_clip_frame(t, c) for t, c in zip((low, high), clips, strict=True)]
    np.testing.assert_allclose(*places, atol=1e-6)


def test_exchanged_sides_stay_as_they_were_recorded() -> None:
    take = _mirrored(_seen("squat", 0.0, -0.9), slice(40, 70))
    result = clean(take, QUICK)
    mended = unmirrored(take, result.failures)
    assert not np.array_equal(mended.positions, take.positions, equal_nan=True)
    found = in_clip_frame(take, result.clip)
    np.testing.assert_array_equal(found, take.positions - [0, result.clip.floor, 0])
    np.testing.assert_array_equal(result.clip.state, take.state)
    away = np.linalg.norm(
        result.target - (mended.positions - [0, result.clip.floor, 0]), axis=2
    )
    np.testing.assert_allclose(away, result.clip.moved_by_correction, atol=1e-12)


def test_the_take_of_an_inverted_sensor_matches_also_where_a_trunk_was_turned() -> None:
    take = _seen("squat", 0.0, -0.9)
    frames = np.arange(len(take)) >= 60
    frame = HeadingFrame(take.positions[:, 0], np.where(frames, np.radians(120.0), 0.0))
    posture = frame.unturned.remove(take.positions)
    turned = replace(take, positions=frame.restore(posture)).swapped(frames)
    inverted = replace(turned, positions=turned.positions * [-1.0, -1.0, 1.0])
    result = clean(inverted, QUICK)
    assert FailureKind.MIRRORED in {failure.kind for failure in result.failures}
    assert abs(result.clip.roll) > 3.0
    in_clip_frame(inverted, result.clip)
    moved = inverted.positions + np.array([0.2, 0.0, 0.0])
    with pytest.raises(InputError, match="most joints of the take are not where"):
        in_clip_frame(replace(inverted, positions=moved), result.clip)


def test_clean_and_report_measure_the_same_raw_take() -> None:
    take = _mirrored(_seen("squat", 0.0, -0.9), slice(40, 70))
    result = clean(take, WITH_PHYSICS)
    found = compare(result.clip, take)
    for figures, stage in ((found.before, "raw"), (found.after, "physics")):
        for name in METRICS.keys() - {"skate"}:
            expected = getattr(result.stages[stage], name)
            assert figures[name] == pytest.approx(expected, nan_ok=True), name


@recorded
@pytest.mark.parametrize(
    "name", ["labanotation/joints.csv", "ui-prmd/m03_s04_e06_inc_failure.csv"]
)
def test_a_recorded_take_is_placed_where_the_pipeline_saw_it(name: str) -> None:
    take = read_take(DATA / name)
    _holds(clean(take, WITH_PHYSICS), take)


def test_another_take_with_the_same_time_stamps_is_refused() -> None:
    take, other = (_seen("walk", 0.0, -0.9, noise=seed) for seed in (0, 1))
    result = clean(take, QUICK)
    with pytest.raises(InputError, match="most joints of the take are not where"):
        in_clip_frame(other, result.clip)
    nobody = replace(take, positions=np.full_like(take.positions, np.nan))
    with pytest.raises(InputError, match="most joints of the take are not where"):
        in_clip_frame(nobody, result.clip)


def test_what_repeats_a_time_stamp_made_nothing_of_the_clip() -> None:
    take = _seen("squat", 0.0, -0.9)
    frames = np.sort(np.append(np.arange(120), [20, 20]))
    positions = take.positions[frames]
    positions[21:23] += 1.0
    take = Take(take.time[frames], positions, take.state[frames], KINECT_V1)
    clip = clean(take, QUICK).clip
    found = in_clip_frame(take, clip)
    np.testing.assert_allclose(found, positions - [0, clip.floor, 0], atol=1e-12)


def test_at_another_rate_the_take_is_placed_as_exactly(tmp_path: Path) -> None:
    take = _seen("walk", -12.0, -0.9)
    clip = clean(take, QUICK).clip
    write_take_csv(take, tmp_path / "take.csv")
    found = raw_positions(tmp_path / "take.csv", resampled(clip, 15.0), take.time)
    np.testing.assert_allclose(found, in_clip_frame(take, clip), atol=1e-8)


@pytest.mark.parametrize(("suffix", "off"), [(".usdc", 1e-5), (".bvh", 0.02)])
def test_files_that_start_at_0_show_a_take_that_starts_later(
    suffix: str, off: float, tmp_path: Path
) -> None:
    take = _seen("walk", 0.0, -0.9)
    take = replace(take, time=take.time + 1.5)
    write_take_csv(take, tmp_path / "take.csv")
    clip = clean(take, QUICK).clip
    write_clip(clip, tmp_path / f"clip{suffix}")
    shown = read_clip(tmp_path / f"clip{suffix}")
    assert shown.time[0] == 0.0
    frames = np.arange(40, 80)
    found = raw_positions(tmp_path / "take.csv", shown, shown.time[frames])
    expected = in_clip_frame(take, clip)[frames]
    np.testing.assert_allclose(found, expected, atol=off)


def test_a_clip_that_does_not_know_its_floor_says_so(
    make_clip: MakeClip, tmp_path: Path
) -> None:
    clip = replace(make_clip(20), tilt=np.nan, floor=np.nan)
    take = Take(clip.time, clip.positions, clip.state, clip.skeleton)
    path = tmp_path / "clip.npz"
    write_clip(clip, path)
    read = read_clip(path)
    assert np.isnan([read.tilt, read.floor]).all()
    with pytest.raises(InputError, match=r"where its floor was.*clean the take again"):
        in_clip_frame(take, read)
    with np.load(path) as archive:
        arrays = {k: v for k, v in archive.items() if k != "floor"}
    np.savez(path, **arrays)
    with pytest.raises(InputError, match=r"clip\.npz.*floor"):
        read_clip(path)


@pytest.mark.parametrize(
    ("frames", "late", "same"),
    [(20, 0.0, True), (20, 1e-7, True), (20, 5e-4, False), (19, 0.0, False)],
)
def test_stamps_are_the_same_where_every_frame_has_its_own(
    frames: int, late: float, same: bool, make_clip: MakeClip
) -> None:
    clip = make_clip(20)
    take = Take(
        clip.time[:frames] + late,
        clip.positions[:frames],
        clip.state[:frames],
        clip.skeleton,
    )
    assert same_stamps(clip, take) == same


def test_usd_of_a_take_with_repeated_time_stamps_shows_its_take(tmp_path: Path) -> None:
    take = _seen("walk", 0.0, -0.9)
    frames = np.sort(np.append(np.arange(120), [20, 20, 50]))
    take = replace(
        take,
        **{n: getattr(take, n)[frames] for n in ("positions", "state")},
        time=take.time[frames] + 1.5,
    )
    write_take_csv(take, tmp_path / "take.csv")
    clip = clean(take, QUICK).clip
    write_clip(clip, tmp_path / "clip.usdc")
    shown = read_clip(tmp_path / "clip.usdc")
    assert len(shown) == 120
    found = raw_positions(tmp_path / "take.csv", shown, shown.time)
    expected = in_clip_frame(take, clip)[np.unique(frames, return_index=True)[1]]
    np.testing.assert_allclose(found, expected, atol=1e-3)
