"""Sensors that do not stand level."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from real_data import TAKES, recorded

from kinefilter import CleanConfig, clean, read_take
from kinefilter.characters import KINECT_V1, State, Take, standard_body
from kinefilter.pipeline.target.feet import find_stance
from kinefilter.pipeline.target.floor import Stood, leveled, sensor_tilt
from kinefilter.retarget import HeadingFrame
from kinefilter.scenes.library import perform

Array = NDArray[np.float64]
BODY = standard_body(KINECT_V1)


def walking(tilt: float, noise: float) -> tuple[Array, Array]:
    """Return someone who walks in front of a sensor that is 0.9 m high."""
    act = perform("walk", BODY, seed=2)
    there = act.positions[:120] - np.array([0.0, 0.9, 2.0])
    there = there + np.random.default_rng(0).normal(scale=noise, size=there.shape)
    return act.time[:120], leveled(there, -np.radians(tilt))


@pytest.mark.parametrize("tilt", [-12.0, -5.0, 8.0])
def test_the_tilt_is_found_under_someone_who_walks(tilt: float) -> None:
    time, positions = walking(tilt, 0.01)
    confidence = np.ones(positions.shape[:2])
    stands = find_stance(time, positions, confidence, KINECT_V1)
    found = np.degrees(sensor_tilt([Stood(positions, confidence, stands, BODY)]))
    assert found == pytest.approx(tilt, abs=1.0)


def test_a_level_sensor_stays_as_it_is() -> None:
    time, positions = walking(0.0, 0.01)
    confidence = np.ones(positions.shape[:2])
    stands = find_stance(time, positions, confidence, KINECT_V1)
    person = Stood(positions, confidence, stands, BODY)
    assert abs(np.degrees(sensor_tilt([person]))) < 0.5


@pytest.mark.parametrize("raised", [0.0, 0.15])
def test_people_of_a_recording_share_the_tilt(raised: float) -> None:
    """The sensor may have misplaced the feet of one by a height of their own."""
    time, positions = walking(-5.0, 0.01)
    confidence = np.ones(positions.shape[:2])
    stands = find_stance(time, positions, confidence, KINECT_V1)
    walker = Stood(positions, confidence, stands, BODY)
    still = np.repeat(positions[:1] + np.array([0.5, raised, 0.0]), len(time), axis=0)
    bystander = Stood(still, confidence, ~np.zeros_like(stands), BODY)
    assert sensor_tilt([bystander]) == 0.0
    for people in ([walker, bystander], [bystander, walker]):
        assert np.degrees(sensor_tilt(people)) == pytest.approx(-5.0, abs=1.0)


def standing(lean: float = 3.0, turned: float = 0.0) -> Array:
    """Return someone who stands before the sensor and leans forward [degrees]."""
    posture = BODY.rest_positions.copy()
    for shoulder in KINECT_V1.sides("Shoulder"):
        for j in KINECT_V1.descendants(shoulder):  # the arms hang
            posture[j] = posture[KINECT_V1.parents[j]] - [0.0, BODY.lengths[j], 0.0]
    posture -= posture[list(KINECT_V1.sides("Ankle"))].mean(axis=0)
    posture = leveled(posture, np.radians(lean))
    facing = HeadingFrame(np.array([0.2, -0.8, -2.5]), np.radians(turned))
    return np.tile(facing.restore(posture), (60, 1, 1))


def _tilt_of(positions: Array, confidence: float = 1.0) -> float:
    known = np.full(positions.shape[:2], confidence)
    always = np.ones((len(positions), 2), dtype=bool)
    return float(np.degrees(sensor_tilt([Stood(positions, known, always, BODY)])))


@pytest.mark.parametrize("tilt", [-12.0, -6.0, -3.0, 5.0, 9.0])
@pytest.mark.parametrize("turned", [-20.0, 0.0, 15.0])
def test_the_tilt_is_found_by_someone_who_stands(tilt: float, turned: float) -> None:
    positions = leveled(standing(turned=turned), -np.radians(tilt))
    assert _tilt_of(positions) == pytest.approx(tilt, abs=1.5)


def test_who_leans_a_little_or_stands_otherwise_shows_no_tilt() -> None:
    assert _tilt_of(standing()) == 0.0
    assert _tilt_of(standing(lean=0.0)) == pytest.approx(0.0, abs=0.1)
    assert -0.7 < _tilt_of(standing(lean=4.6)) < 0.0  # as far as anyone in mocap
    tilted = leveled(standing(), np.radians(8.0))
    assert _tilt_of(tilted) != 0.0
    assert _tilt_of(tilted, confidence=0.0) == 0.0  # feet that were never seen
    assert _tilt_of(tilted[:10]) == 0.0
    assert _tilt_of(leveled(standing(turned=60.0), np.radians(8.0))) == 0.0
    swaying = np.concatenate([leveled(tilted, np.radians(a)) for a in (0.0, 4.0)])
    assert _tilt_of(swaying) == 0.0


@recorded
@pytest.mark.parametrize("tilt", [-8.0, -4.0])
def test_a_recorded_gesture_before_a_tilted_sensor_stands_upright(tilt: float) -> None:
    take = read_take(TAKES / "labanotation" / "Ges05_demopoint.csv")
    turned = replace(take, positions=leveled(take.positions, np.radians(tilt)))
    level, tilted = (
        np.degrees(clean(one, CleanConfig(physics=False)).clip.tilt)
        for one in (take, turned)
    )
    assert level == pytest.approx(4.5, abs=1.0)
    assert tilted == pytest.approx(level - tilt, abs=2.5)


def test_leveling_turns_and_keeps_lengths_and_the_array() -> None:
    positions = np.random.default_rng(1).normal(size=(5, 20, 3))
    before = positions.copy()
    turned = leveled(positions, 0.3)
    np.testing.assert_array_equal(positions, before)
    np.testing.assert_allclose(
        np.linalg.norm(turned, axis=-1), np.linalg.norm(positions, axis=-1)
    )
    np.testing.assert_allclose(leveled(turned, -0.3), positions, atol=1e-12)


def test_a_clip_from_a_tilted_sensor_stands_on_a_level_floor() -> None:
    time, positions = walking(-8.0, 0.005)
    state = np.full(positions.shape[:2], State.TRACKED, dtype=np.uint8)
    take = Take(time, positions, state, KINECT_V1)
    found = clean(take, CleanConfig(method="none", physics=False))
    assert any("tilted by -" in note for note in found.notes)
    kept = clean(take, CleanConfig(method="none", physics=False, tilt=0.0))
    assert not any("tilted" in note for note in kept.notes)

    def slope(root: Array) -> float:
        return float(np.polyfit(root[:, 2], root[:, 1], 1)[0])

    root = KINECT_V1.root
    assert abs(slope(found.clip.positions[:, root])) < 0.02
    assert abs(slope(kept.clip.positions[:, root])) > 0.05
