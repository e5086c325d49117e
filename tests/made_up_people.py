"""Made-up people before a sensor, and what readers say of their files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from kinefilter.characters import KINECT_V2, InputError, Skeleton, State, Take
from kinefilter.pipeline.formats import read_recording

__all__ = ["Array", "complaint", "made_up", "without"]

Array = NDArray[np.float64]


def made_up(
    frames: int = 6, skeleton: Skeleton = KINECT_V2, *, seed: int = 0, fps: float = 30.0
) -> Take:
    rng = np.random.default_rng(seed)
    place = np.array([0.8 * seed, 0.2, 2.5])
    shape = rng.uniform(-0.5, 0.5, (len(skeleton), 3))
    positions = place + shape + rng.normal(0.0, 0.01, (frames, *shape.shape))
    state = rng.integers(1, 3, positions.shape[:2]).astype(np.uint8)
    return Take(np.arange(frames) / fps, positions, state, skeleton)


def without(take: Take, frames: list[int]) -> Take:
    positions, state = take.positions.copy(), take.state.copy()
    positions[frames], state[frames] = np.nan, State.NOT_TRACKED
    return replace(take, positions=positions, state=state)


def complaint(path: Path, **options: str) -> str:
    with pytest.raises(InputError) as caught:
        read_recording(path, **options)
    message = str(caught.value)
    assert str(path) in message
    assert "\n" not in message
    return message
