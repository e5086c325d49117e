"""The whole pipeline, on the sample, on takes with holes, and on recordings."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from numpy.typing import NDArray
from real_data import PAIRS, TAKES, paired, recorded
from skeletons import every_skeleton
from usd_positions import read_usd_positions

from kinefilter import CleanConfig, Cleaner, CleanResult, clean, read_take
from kinefilter.characters import (
    KINECT_V1,
    KINECT_V2,
    InputError,
    Origin,
    Skeleton,
    State,
    Take,
    positions_from_rotations,
    standard_body,
)
from kinefilter.pipeline.correct.hold import Hold
from kinefilter.pipeline.formats import read_bvh, write_clip
from kinefilter.pipeline.lab.simulation import simulate, truth_of
from kinefilter.pipeline.pairs import read_pairs
from kinefilter.scenes.library import perform
from kinefilter.scenes.sensor import observe, sample_take

Array = NDArray[np.float64]
REHABILITATION = {
    re.sub(r"_s\d+_e\d+", "", path.name): path
    for path in sorted(TAKES.glob("ui-prmd/*.csv"))
}
"""One take of each movement and kind of failure: the last person's last repetition."""
RECORDED = [
    *sorted(TAKES.glob("labanotation/*.csv")),
    *REHABILITATION.values(),
    *(TAKES / "precog16" / f"Seq{k}_{k}.csv.gz" for k in range(1, 7)),
]


@pytest.fixture(scope="module")
def sample() -> CleanResult:
    return clean(sample_take())


def _perfect(name: str, skeleton: Skeleton = KINECT_V1, seed: int = 9) -> Take:
    """Return a motion as a sensor without any error would give it."""
    act = perform(name, standard_body(skeleton), seed=seed)
    state = np.full(act.positions.shape[:2], State.TRACKED, dtype=np.uint8)
    return Take(act.time, act.positions, state, skeleton, name)


def _holds(result: CleanResult, raw_jitter: float) -> None:
    """Assert what every cleaned take must hold."""
    clip, physics = result.clip, result.stages["physics"]
    for array in (clip.positions, clip.rotations, clip.reliability):
        assert np.isfinite(array).all()
    assert physics.bone_length_cv < 1e-6
    assert physics.jitter < raw_jitter
    assert physics.lowest_point_mm > -20.0
    np.testing.assert_allclose(
        positions_from_rotations(
            clip.rotations, clip.positions[:, clip.skeleton.root], clip.body
        ),
        clip.positions,
        atol=1e-9,
    )


def test_the_sample_is_cleaned(sample: CleanResult) -> None:
    _holds(sample, sample.stages["raw"].jitter)
    assert sample.share_outside < 0.5
    assert len(sample.clip) == len(sample_take())


def test_the_clip_says_where_every_joint_came_from(sample: CleanResult) -> None:
    take, clip = sample_take(), sample.clip
    missing = np.isnan(take.positions[..., 0])
    assert missing.any()
    np.testing.assert_array_equal(clip.origin == Origin.FILLED, missing)
    np.testing.assert_array_equal(np.isnan(clip.moved_by_correction), missing)
    assert (clip.origin == Origin.CORRECTED).any()
    assert np.mean(clip.origin == Origin.MEASURED) > 0.5


def test_same_take_same_bytes(tmp_path: Path) -> None:
    first, again = (clean(sample_take().at(slice(40))).clip for _ in range(2))
    for suffix in (".usda", ".usdc", ".bvh", ".csv", ".npz"):
        one, two = tmp_path / f"one{suffix}", tmp_path / f"two{suffix}"
        write_clip(first, one)
        write_clip(again, two)
        assert one.read_bytes() == two.read_bytes(), suffix


def test_the_stochastic_search_cleans_the_sample() -> None:
    take = sample_take().at(slice(90))
    result = clean(take, CleanConfig(search="stochastic"))
    _holds(result, result.stages["raw"].jitter)


def test_the_sampling_is_not_the_solver_and_depends_on_its_seed() -> None:
    take = sample_take().at(slice(20))

    def cleaned(search: Literal["solver", "stochastic"], seed: int) -> Array:
        config = CleanConfig(
            method="local-pca",
            search=search,
            seed=seed,
            physics=False,
            reconstruct=False,
        )
        return clean(take, config).clip.positions

    solved, sampled = cleaned("solver", 0), cleaned("stochastic", 0)
    assert np.abs(solved - sampled).max() > 1e-4
    assert np.abs(cleaned("stochastic", 1) - sampled).max() > 1e-5
    np.testing.assert_array_equal(cleaned("stochastic", 0), sampled)


@pytest.mark.parametrize(
    "method", ["butterworth", "savgol", "one-euro", "kalman", "low-rank", "nearest"]
)
def test_every_baseline_cleans_the_sample(method: str) -> None:
    config = CleanConfig(method=method, scoring="chiang")
    result = clean(sample_take().at(slice(90)), config)
    assert np.isfinite(result.clip.positions).all()
    assert result.stages["physics"].bone_length_cv < 1e-6
    assert result.stages["physics"].lowest_point_mm > -20.0


@every_skeleton
@pytest.mark.parametrize("motion", ["walk", "squat", "punch"])
def test_a_perfect_take_is_left_as_it_is(skeleton: Skeleton, motion: str) -> None:
    take = _perfect(motion, skeleton).at(slice(90))
    result = clean(take, CleanConfig(method="local-pca"))
    away = np.linalg.norm(result.clip.positions - take.positions, axis=2)
    assert away.mean() < 0.015
    assert result.stages["physics"].amplitude_kept > 0.97
    assert (result.clip.origin == Origin.MEASURED).mean() > 0.99


@pytest.mark.parametrize("motion", ["walk", "bend", "squat"])
def test_simulated_takes_end_nearer_to_the_truth(motion: str) -> None:
    """On average over performances: some errors look like another posture."""
    before, after = [], []
    for seed in (21, 22):
        act = perform(motion, standard_body(KINECT_V1), seed=seed).at(slice(90))
        take = observe(act, seed=4)
        paths = (act.positions - act.positions[:, [0]]).reshape(len(act), -1).T
        columns = [np.interp(take.time, act.time, path) for path in paths]
        truth = np.transpose(columns).reshape(len(take), -1, 3)
        # Who walks on leaves the picture.
        seen = np.isfinite(take.positions[..., 0])
        seen &= seen.mean(axis=0) > 0.1

        def error(positions: Array, truth: Array = truth, seen: Any = seen) -> float:
            relative = positions - positions[:, [0]]
            yaw = np.array([-1.0, 1.0, -1.0])  # the person faces the sensor
            away = np.where(seen[..., None], relative * yaw - truth, 0.0)
            return float(np.linalg.norm(away, axis=2)[seen].mean())

        before.append(error(np.nan_to_num(take.positions)))
        after.append(error(clean(take).clip.positions))
    assert np.mean(after) < 0.9 * np.mean(before)


def test_the_skeleton_is_not_bent_the_wrong_way(sample: CleanResult) -> None:
    """Shins fold behind the thighs: seen from the pelvis, knees are in front."""
    clip = sample.clip
    for side in ("Left", "Right"):
        hip, knee, ankle = (
            clip.positions[:, clip.skeleton.index(f"{j}{side}")]
            for j in ("Hip", "Knee", "Ankle")
        )
        straight = ankle - hip
        along = np.sum((knee - hip) * straight, axis=1) / np.sum(straight**2, axis=1)
        out = knee - hip - along[:, None] * straight
        pelvis = clip.rotations[:, clip.skeleton.root]
        w, x, y, z = pelvis.T
        front = np.stack(
            [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=1
        )
        assert np.sum(out * front, axis=1).min() > -0.04


def test_repeated_stamps_dropped_frames_and_holes_are_normal() -> None:
    take = _perfect("wave").at(slice(120))
    rng = np.random.default_rng(0)
    keep = np.sort(rng.choice(len(take), len(take) - 20, replace=False))
    rows = np.sort(np.concatenate([keep, keep[50:55]]))
    positions, state = take.positions[rows].copy(), take.state[rows].copy()
    holes = rng.random(state.shape) < 0.05
    lost = KINECT_V1.index("FootRight")
    holes[:, lost] = True
    positions[holes], state[holes] = np.nan, State.NOT_TRACKED
    holey = Take(take.time[rows], positions, state, KINECT_V1)
    result = clean(holey)
    assert len(result.clip) == len(rows)
    assert np.isfinite(result.clip.positions).all()
    repeated = np.flatnonzero(np.diff(holey.time) == 0)
    assert len(repeated) == 5
    np.testing.assert_array_equal(
        result.clip.positions[repeated], result.clip.positions[repeated + 1]
    )
    assert np.all(result.clip.origin[:, lost] == Origin.FILLED)


def test_seconds_without_the_person_in_frames_that_are_there_are_told() -> None:
    take = _perfect("squat").at(slice(150))
    positions, state = take.positions.copy(), take.state.copy()
    positions[60:105], state[60:105] = np.nan, State.NOT_TRACKED
    notes = clean(replace(take, positions=positions, state=state)).notes
    begin, end = take.time[[60, 104]] - take.time[0]
    told = f"nobody in view, so a guess: {begin:.1f} to {end:.1f} s"
    assert told in notes
    assert not any("nobody in view" in note for note in clean(take).notes)


def test_a_second_without_the_person_is_bridged() -> None:
    take = _perfect("squat").at(slice(150))
    positions, state = take.positions.copy(), take.state.copy()
    positions[60:90], state[60:90] = np.nan, State.NOT_TRACKED
    result = clean(Take(take.time, positions, state, KINECT_V1))
    assert np.isfinite(result.clip.positions).all()
    steps = np.linalg.norm(np.diff(result.clip.positions, axis=0), axis=2)
    assert steps.max() < 0.25


def test_two_frames_are_enough() -> None:
    take = _perfect("wave")
    two = Take(take.time[:2], take.positions[:2], take.state[:2], KINECT_V1)
    assert np.isfinite(clean(two).clip.positions).all()


def test_without_physics_and_correction_only_lengths_and_noise_change() -> None:
    take = _perfect("clap")
    result = clean(take, CleanConfig(method="none", physics=False))
    assert "physics" not in result.stages
    assert result.trace is None
    away = np.linalg.norm(result.clip.positions - take.positions, axis=2)
    assert away.mean() < 0.005


def test_the_person_keeps_size_and_weight_that_are_given() -> None:
    take = _perfect("stand_idle").at(slice(40))
    result = clean(take, CleanConfig(height=1.9, mass=95.0))
    assert result.clip.body.height == 1.9
    assert result.clip.body.masses.sum() == pytest.approx(95.0)


def test_stature_is_found_from_the_take() -> None:
    body = standard_body(KINECT_V2, height=1.60)
    act = perform("wave", body, seed=2).at(slice(90))
    state = np.full(act.positions.shape[:2], State.TRACKED, dtype=np.uint8)
    take = Take(act.time, act.positions, state, KINECT_V2)
    result = clean(take, CleanConfig(method="local-pca"))
    assert result.clip.body.height == pytest.approx(1.60, abs=0.02)


def test_stature_is_found_from_what_a_kinect_sees() -> None:
    """On average: every tracker has its own idea of every person."""
    away = []
    for seed in range(1400, 1406):
        pair, some = simulate("basic", "cross_arms", seed=seed), slice(60)
        pair = replace(pair, take=pair.take.at(some), truth=pair.truth[some])
        plain = CleanConfig(method="none", physics=False)
        truth = clean(truth_of(pair), plain).clip.body.height
        found = clean(pair.take, CleanConfig(physics=False)).clip.body.height
        away.append(abs(found - truth))
    assert np.mean(away) < 0.06


def test_a_take_in_centimeters_is_refused_by_its_name() -> None:
    take = _perfect("stand_idle")
    wrong = replace(take, positions=100.0 * take.positions, source="in_cm.csv")
    with pytest.raises(InputError, match=r"^in_cm\.csv: .* divide .* by 100"):
        Cleaner(corrector=Hold(KINECT_V1)).clean(wrong)


def test_a_take_of_nothing_is_refused() -> None:
    take = _perfect("wave")
    nothing = np.full_like(take.positions, np.nan)
    with pytest.raises(InputError, match="no joint is tracked"):
        clean(Take(take.time, nothing, np.zeros_like(take.state), KINECT_V1))
    frozen = np.full_like(take.time, 3.0)
    with pytest.raises(InputError, match="one distinct time stamp"):
        clean(Take(frozen, take.positions, take.state, KINECT_V1))


@recorded
@pytest.mark.parametrize("path", RECORDED, ids=lambda p: p.name.split(".")[0])
def test_every_recorded_take_is_cleaned(path: Path, tmp_path: Path) -> None:
    take = read_take(path)
    middle = len(take) // 2  # where people do what they do
    take = take.at(slice(max(0, middle - 60), middle + 60))
    result = clean(take)
    _holds(result, result.stages["raw"].jitter)
    joints = list(take.skeleton.joints)
    write_clip(result.clip, tmp_path / "clip.usdc")
    _, names, positions = read_usd_positions(tmp_path / "clip.usdc")
    columns = [names.index(joint) for joint in joints]
    distinct = np.concatenate([np.diff(result.clip.time) > 0, [True]])
    np.testing.assert_allclose(
        positions[:, columns], result.clip.positions[distinct], atol=1e-3
    )
    write_clip(result.clip, tmp_path / "clip.bvh")
    bvh = read_bvh(tmp_path / "clip.bvh")
    columns = [bvh.names.index(joint) for joint in joints]
    np.testing.assert_allclose(
        bvh.positions[:, columns], result.clip.positions, atol=1e-3
    )
    write_clip(result.clip, tmp_path / "clip.csv")
    again = read_take(tmp_path / "clip.csv")
    np.testing.assert_allclose(again.positions, result.clip.positions, atol=1e-6)


@paired
@pytest.mark.parametrize("person", ["s06", "s08"])
def test_correction_does_no_harm_to_real_people(person: str) -> None:
    """Offset-free error against marker mocap; confidence was chosen on others."""
    limbs = [
        KINECT_V1.index(part + side)
        for part in ("Shoulder", "Elbow", "Wrist", "Hip", "Knee", "Ankle")
        for side in ("Left", "Right")
    ]
    hips = [KINECT_V1.index("HipLeft"), KINECT_V1.index("HipRight")]

    def varying(positions: Array, truth: Array) -> Array:
        """Return distances [m] without each joint's constant offset, (T, 12)."""
        away = positions - positions[:, hips].mean(axis=1, keepdims=True)
        away = (away - truth + truth[:, hips].mean(axis=1, keepdims=True))[:, limbs]
        mean = np.nanmean(away, axis=0)
        return np.asarray(np.linalg.norm(away - mean, axis=2))

    errors: dict[str, list[Array]] = {"raw": [], "none": [], "local-pca": []}
    for pair in read_pairs(PAIRS / f"{person}.npz")[::12]:
        if np.isnan(pair.truth[:, limbs]).all(axis=(0, 2)).any():
            continue
        errors["raw"].append(varying(pair.take.positions, pair.truth))
        methods: tuple[str, ...] = ("none", "local-pca")
        for method in methods:
            clip = clean(pair.take, CleanConfig(method=method, physics=False)).clip
            errors[method].append(varying(clip.positions, pair.truth))
    mean = {name: np.nanmean(np.concatenate(e)) for name, e in errors.items()}
    assert mean["local-pca"] < mean["raw"]
    # Filling in what is hidden costs a little where nothing is.
    assert mean["local-pca"] < 1.01 * mean["none"]
