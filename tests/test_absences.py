"""Frames of a file in which nobody is in view."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_gaps import FRAMES, a_walk

from kinefilter.characters import State, Take
from kinefilter.pipeline.formats.sheets import write_take_csv
from kinefilter.pipeline.formats.takes import read_recording


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
