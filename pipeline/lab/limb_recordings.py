"""Recordings to learn the prior for hidden limbs from: pairs, takes and mocap."""

import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple, Self

import numpy as np

from kinefilter.characters import KINECT_V1, State, Take
from kinefilter.pipeline.formats.mocap import RIGS, kinect_motion, read_mocap
from kinefilter.pipeline.formats.takes import read_take
from kinefilter.pipeline.pairs import PairedTake, read_pairs

from .database_build import mocap_body, whole_frames

_JITTER = 0.008  # m, added to mocap, which jitters less than a sensor. A guess.
_MOCAP_RATE = 30.0  # Hz
# Share of the frames of pairs that unseen arms are learned from: with all of them, the
# unseen arms of any take do the few exercises of the pairs.
_SHARE_OF_PAIRS = 0.15


class NamedTake(NamedTuple):
    """A take with the names of the person, movement and clip."""

    person: str
    movement: str
    name: str
    take: Take
    share: float = 1.0  # of its frames, to learn unseen arms from

    @classmethod
    def of(cls, pair: PairedTake) -> Self:
        """Return the Kinect take of a pair."""
        names = pair.subject, pair.movement, pair.clip
        return cls(*names, pair.take, _SHARE_OF_PAIRS)


def recordings_in(file: Path) -> Iterator[NamedTake]:
    """Yield the recordings in a pairs file (.npz), mocap (.bvh) or a take."""
    name = file.name.partition(".")[0]
    if file.suffix == ".npz":
        yield from map(NamedTake.of, read_pairs(file))
    else:
        is_mocap = ".bvh" in file.suffixes
        take = _take_of_mocap(file, name) if is_mocap else read_take(file)
        yield NamedTake(name, name, name, take)


def _take_of_mocap(file: Path, name: str) -> Take:
    mocap = read_mocap(file, [])
    positions = kinect_motion(mocap, KINECT_V1, RIGS).positions
    meters, _ = mocap_body(positions, KINECT_V1)
    step = max(1, round(1.0 / (_MOCAP_RATE * mocap.frame_time)))
    # The first frame is skipped, because it often is a T-pose.
    frames = np.flatnonzero(whole_frames(positions))[1::step]
    positions = meters * positions[frames]
    rng = np.random.default_rng(zlib.crc32(name.encode()))
    positions += rng.normal(scale=_JITTER, size=positions.shape)
    time = np.arange(float(len(positions))) * step * mocap.frame_time
    state = np.full(positions.shape[:2], State.TRACKED, dtype=np.uint8)
    return Take(time, positions, state, KINECT_V1, str(file))
