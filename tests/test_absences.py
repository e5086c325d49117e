"""Frames of a file in which nobody is in view."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_gaps import FRAMES, a_walk

from kinefilter import CleanConfig, Cleaner
from kinefilter.characters import State, Take
from kinefilter.pipeline.formats.sheets import write_take_csv
from kinefilter.pipeline.formats.takes import read_recording
from kinefilter.pipeline.lab.simulation import simulate


def _empty_for(take: Take, frames: slice) -> Take:
    positions, state = take.positions.copy(), take.state.copy()
    positions[frames], state[frames] = np.nan, State.NOT_TRACKED
    return replace(take, positions=positions, state=state)


@pytest.mark.parametrize(
    ("empty", "left_out"),
    [(slice(10, 20), ""), (slice(10, 31), "1.0 to 3.0"), (slice(31), "0.0 to 3.0")],
)
def test_frames_of_a_file_with_nobody_for_long_are_left_out(
    tmp_path: Path, empty: slice, left_out: str
) -> None:
    """As if the sensor had written none: nothing is invented there."""
    whole = replace(a_walk(), time=np.arange(FRAMES) * 0.1)
    path = tmp_path / "take.csv"
    write_take_csv(_empty_for(whole, empty), path)
    recording = read_recording(path)
    gone = np.zeros(FRAMES, dtype=bool)
    gone[empty] = bool(left_out)
    take = recording.take(None)
    np.testing.assert_allclose(take.time, whole.time[~gone], atol=1e-6)
    told = [f"nobody in view, left out: {left_out} s"] if left_out else []
    assert [*recording.notes] == told


@pytest.mark.parametrize("seed", [127, 151, 185, 267])
def test_any_joints_may_be_missing(seed: int) -> None:
    """Such seeds left shoulders without a neck, or ankles without a hip."""
    rng, kind = np.random.default_rng(seed), ("kinect_v1", "kinect_v2")[seed % 2]
    simulated = simulate("basic", "walk", skeleton=kind, seed=1, stay_in_view=True)
    take = simulated.take.at(slice(70))
    gone = rng.random(take.state.shape) < rng.choice([0.0, 0.05, 0.3])
    gone |= rng.random(len(take.skeleton)) < rng.choice([0.0, 0.2, 0.5, 0.8])
    for _ in range(rng.integers(0, 4)):
        start, length = rng.integers(0, 60), rng.integers(1, 30)
        some = rng.random(len(take.skeleton)) < rng.choice([0.2, 0.6, 1.0])
        gone[start : start + length, some] = True
    positions = np.where(gone[..., None], np.nan, take.positions)
    state = np.where(gone, State.NOT_TRACKED, take.state).astype(np.uint8)
    blind = replace(take, positions=positions, state=state)
    clip = Cleaner(CleanConfig(physics=False)).clean(blind).clip
    assert np.isfinite(clip.positions).all()
