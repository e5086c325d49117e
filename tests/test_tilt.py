"""Sensors that do not stand level."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from kinefilter import CleanConfig, clean
from kinefilter.characters import KINECT_V1, State, Take, standard_body
from kinefilter.pipeline.target.feet import find_stance
from kinefilter.pipeline.target.floor import leveled, sensor_tilt
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
    found = np.degrees(sensor_tilt(positions, confidence, stands, BODY))
    assert found == pytest.approx(tilt, abs=1.0)


def test_a_level_sensor_and_someone_who_stands_stay_as_they_are() -> None:
    time, positions = walking(0.0, 0.01)
    confidence = np.ones(positions.shape[:2])
    stands = find_stance(time, positions, confidence, KINECT_V1)
    assert abs(np.degrees(sensor_tilt(positions, confidence, stands, BODY))) < 0.5
    still = np.tile(leveled(BODY.rest_positions, np.radians(10.0)), (60, 1, 1))
    always = np.ones((60, 2), dtype=bool)
    assert sensor_tilt(still, np.ones(still.shape[:2]), always, BODY) == 0.0


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
