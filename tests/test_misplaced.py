"""Limbs that a sensor places wrongly, as a second sensor in front of the person saw."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest
from real_data import DATA
from sklearn.metrics import roc_auc_score

from kinefilter.characters import KINECT_V2, Take, standard_body
from kinefilter.pipeline.lab import misplaced as module
from kinefilter.pipeline.lab.misplaced import (
    FEATURES,
    describe_limbs,
    fit,
    learn_misplaced,
    lessons,
    misplaced,
)
from kinefilter.pipeline.lab.view_sessions import find_sessions
from kinefilter.scenes.library import perform
from kinefilter.scenes.sensor import Sensor, in_sensor_frame

SESSIONS = DATA / "two-kinects"
viewed = pytest.mark.skipif(
    not SESSIONS.is_dir(), reason="no sessions of two sensors in ../shared/data"
)


def wave(mirrored: bool = False) -> Take:
    act = perform("wave", standard_body(KINECT_V2), seed=1)
    positions = in_sensor_frame(act.positions, Sensor())
    if mirrored:
        positions = positions[:, KINECT_V2.mirror] * [-1.0, 1.0, 1.0]
    state = np.full(positions.shape[:2], 2, dtype=np.uint8)
    return Take(act.time, positions, state, KINECT_V2)


def test_a_mirrored_person_has_mirrored_features() -> None:
    found, other = describe_limbs(wave()), describe_limbs(wave(mirrored=True))
    np.testing.assert_allclose(other, found[:, KINECT_V2.mirror], atol=1e-6)


def test_a_limb_that_drifts_away_is_likelier_to_be_misplaced() -> None:
    take, wrist = wave(), KINECT_V2.index("WristRight")
    positions = take.positions.copy()
    half = len(take) // 2
    away = np.linspace(0.0, 1.5, len(take) - half)[:, None]
    positions[half:, wrist] += away * np.array([0.0, 0.5, 0.5])
    wrong = Take(take.time, positions, take.state, KINECT_V2)
    before, after = misplaced(take)[half:, wrist], misplaced(wrong)[half:, wrist]
    assert after.mean() > before.mean() + 0.2


def test_repeated_stamps_and_missing_joints_are_no_trouble() -> None:
    take = wave()
    time, positions = take.time.copy(), take.positions.copy()
    time[5], positions[3:9, 4:] = time[4], np.nan
    state = np.where(np.isnan(positions[..., 0]), 0, 2).astype(np.uint8)
    found = misplaced(Take(time, positions, state, KINECT_V2))
    assert np.isfinite(found).all()
    assert 0.0 <= found.min() <= found.max() <= 1.0


@viewed
def test_people_left_out_are_told_by_what_others_teach(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And the weights that are shipped are those that the sessions give."""
    sessions = find_sessions([SESSIONS / "*_90deg_*"], None)
    taught = lessons(sessions)
    monkeypatch.setattr(module, "lessons", lambda _: taught)
    learn_misplaced(sessions, tmp_path / "weights.toml")
    shipped = Path(__file__).parents[1] / "pipeline" / "lab" / "misplaced.toml"
    ours, again = (
        tomllib.loads(path.read_text("utf-8"))
        for path in (shipped, tmp_path / "weights.toml")
    )
    for part, weights in again.items():
        np.testing.assert_allclose(ours[part], weights, rtol=0.02, atol=0.02)
    truth, scores = [], []
    for features, wrong, names in taught.values():
        assert features.shape[1] == len(FEATURES)
        people = np.array([name.split("_")[0] for name in names])
        for person in np.unique(people):
            bias, *weights = fit(features[people != person], wrong[people != person])
            truth.append(wrong[people == person])
            scores.append(bias + features[people == person] @ np.array(weights))
    area = roc_auc_score(np.concatenate(truth), np.concatenate(scores))
    assert area > 0.85
