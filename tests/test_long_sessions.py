"""Clocks of sensors that drift apart for a long time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kinefilter.characters import KINECT_V2, State, Take, standard_body
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import about_y, rotate
from kinefilter.pipeline.merge import align

FPS, SECONDS, DRIFT = 10.0, 1200.0, 4e-4


def moving(time: Array) -> Array:
    """Return joints [m] of somebody who wanders and waves limbs, at any times [s]."""
    rng, body = np.random.default_rng(3), standard_body(KINECT_V2)
    rest = body.rest_positions - body.rest_positions[KINECT_V2.root]

    def wave(size: float, slow: float, fast: float, *shape: int) -> Array:
        rates = rng.uniform(slow, fast, (12, *shape))
        phases = rng.uniform(0.0, 2.0 * np.pi, (12, *shape))
        angles = 2.0 * np.pi * rates * time.reshape(-1, *[1] * (len(shape) + 1))
        return np.asarray(size * np.sin(angles + phases).mean(axis=1))

    turned = rotate(about_y(wave(1.0, 0.01, 0.1))[:, None], rest)
    limbs = wave(0.4, 0.1, 0.7, len(KINECT_V2), 3)
    limbs[:, [KINECT_V2.root, *KINECT_V2.hips]] = 0.0
    path = wave(2.0, 0.01, 0.1, 1, 3) * [1.0, 0.1, 1.0] + [0.0, 0.0, 3.0]
    return np.asarray(turned + limbs + path)


@pytest.mark.parametrize("away", [0.0, 350.0])
def test_clocks_that_drift_for_twenty_minutes_agree_at_both_ends(away: float) -> None:
    """One that gains 0.4 ms a second is half a second ahead at the end.

    Nobody is there for some time in the middle.
    """
    time = np.arange(0.0, SECONDS, 1.0 / FPS)
    state = np.full((len(time), len(KINECT_V2)), State.TRACKED, dtype=np.uint8)
    state[np.abs(time - 0.5 * SECONDS) < 0.5 * away] = State.NOT_TRACKED
    rng = np.random.default_rng(4)
    noise = rng.normal(0.0, 0.005, (2, len(time), len(KINECT_V2), 3))
    noise[:, state[:, 0] == State.NOT_TRACKED] = np.nan
    first = Take(time, moving(time) + noise[0], state, KINECT_V2, "first")
    later = time + 0.037
    there = rotate(about_y(1.2), moving(later)) + noise[1] + [1.0, 0.0, 2.0]
    second = replace(first, time=7.0 + (1.0 + DRIFT) * later, positions=there)
    clock = align(first, replace(second, source="second")).clock
    expected = 7.0 + (1.0 + DRIFT) * time[[0, -1]]
    np.testing.assert_allclose(clock.at(time[[0, -1]]), expected, atol=0.005)
