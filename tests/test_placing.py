"""A take where its clip is: which frames belong together."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import MakeClip
from hypothesis import given, settings
from hypothesis import strategies as st

from kinefilter.characters import Take
from kinefilter.pipeline.placing import nearest_frames, same_stamps


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 30))
def test_the_nearest_frame_is_that_of_least_distance_in_time(
    seed: int, count: int
) -> None:
    rng = np.random.default_rng(seed)
    stamps, times = np.sort(rng.random(count)), rng.uniform(-0.5, 1.5, 40)
    expected = np.abs(times[:, None] - stamps).argmin(axis=1)
    np.testing.assert_array_equal(nearest_frames(stamps, times), expected)


@pytest.mark.parametrize(
    ("frames", "late", "same"), [(20, 0.0, True), (20, 0.01, False), (19, 0.0, False)]
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
