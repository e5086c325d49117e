"""Errors against mocap, and what does not count as one."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from kinefilter.characters import KINECT_V1, Body, standard_body
from kinefilter.pipeline.lab.accuracy import Accuracy
from kinefilter.scenes.library import perform

Array = NDArray[np.float64]


@pytest.mark.parametrize("measure", ["distances", "standardized", "varying"])
def test_the_truth_is_no_error_away_from_itself(measure: str) -> None:
    act = perform("bend", standard_body(KINECT_V1), seed=0)
    error = getattr(Accuracy(KINECT_V1), measure)(act.positions, act.positions)
    np.testing.assert_allclose(error, 0.0, atol=1e-12)


def test_a_constant_offset_is_an_error_but_no_varying_one() -> None:
    act = perform("bend", standard_body(KINECT_V1), seed=0)
    moved = act.positions.copy()
    wrist = KINECT_V1.index("WristLeft")
    moved[:, wrist] += [0.0, 0.12, 0.0]
    accuracy = Accuracy(KINECT_V1)
    column = accuracy.limbs.index(wrist)
    assert accuracy.distances(moved, act.positions)[:, column] == pytest.approx(0.12)
    assert accuracy.varying(moved, act.positions)[:, column] == pytest.approx(0.0)


def test_hips_are_off_by_their_speed_and_not_by_their_place() -> None:
    act = perform("walk", standard_body(KINECT_V1), seed=0)
    ahead = act.positions + [0.3, 0.0, 0.0] + 0.2 * act.time[:, None, None]
    away = Accuracy(KINECT_V1).hips(act.time, ahead, act.positions)
    np.testing.assert_allclose(away, 0.2 * np.sqrt(3.0))


def test_size_is_an_error_but_no_standardized_one() -> None:
    small, tall = (_standing(h) for h in (1.5, 1.9))
    accuracy = Accuracy(KINECT_V1)
    assert accuracy.distances(small, tall).max() > 0.1
    np.testing.assert_allclose(accuracy.standardized(small, tall), 0.0, atol=1e-12)


def _standing(height: float) -> Array:
    body: Body = standard_body(KINECT_V1, height=height)
    return body.rest_positions[None]
