"""Chairs bear whoever sits on them, wherever the performer's own seat is."""

from __future__ import annotations

import numpy as np
import pytest

from kinefilter import CleanConfig, clean
from kinefilter.pipeline.lab.simulation import simulate, truth_of
from kinefilter.pipeline.physics.seat import Seat


@pytest.mark.parametrize("seed", [3, 5001])
def test_a_chair_bears_the_weight_and_the_pulls_add_little(
    monkeypatch: pytest.MonkeyPatch, seed: int
) -> None:
    take = truth_of(simulate("chair", "chair", seed=seed))
    forces, hips = [], []
    for bears in (True, False):
        if not bears:
            monkeypatch.setattr(Seat, "_is_borne", lambda *_: False)
        clip = clean(take, CleanConfig(scene="chair")).clip
        height = clip.positions[:, clip.skeleton.root, 1]
        sits = height < 0.75 * height.max()
        assert sits.sum() > 60
        forces.append(np.median(clip.external_force[sits]))
        hips.append(height[sits].min())
    assert forces[0] < 0.5
    assert forces[1] > 2.0 * forces[0]
    assert abs(hips[0] - hips[1]) < 0.05  # on the same chair


def test_a_chair_that_nobody_touches_changes_nothing() -> None:
    take = truth_of(simulate("basic", "wave", seed=3)).at(slice(60))
    clips = [clean(take, CleanConfig(scene=scene)).clip for scene in ("basic", "chair")]
    positions = [clip.positions - clip.positions[0, 0] for clip in clips]
    np.testing.assert_allclose(*positions, atol=1e-6)
