"""Pairs of Kinect and mocap, brought to the standard body to learn from."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import (
    KINECT_V1,
    SKELETONS,
    InputError,
    Skeleton,
    State,
    Take,
)
from kinefilter.characters.arrays import Array
from kinefilter.retarget import measured_body

from .formats.npz import read_arrays
from .reliability import ReliabilityScorer, measure_reference
from .spool import Spool
from .standard import standardize_take

_BLOCK = 100_000  # frames looked at at a time; 200 MB of the largest skeleton


@dataclass(frozen=True, eq=False)
class PairedTake:
    """A take and what marker mocap saw at the same time."""

    take: Take
    """The recording."""
    truth: Array
    """Joint positions of the mocap [m], the take's frame, NaN where none, (T, J, 3)."""
    subject: str
    """Who moves."""
    clip: str
    """Name of the clip, such as m01_s02_e05 or m01_s02_e05_inc."""


@dataclass(frozen=True, eq=False)
class TrainingSet:
    """Frames on the standard body, root at the origin, facing +z, and their truth."""

    positions: Array
    """Measured joint positions [m], NaN where missing, shape (N, J, 3)."""
    rate: Array
    """Reliability rate, shape (N, J)."""
    truth: Array
    """Mocap's joint positions [m] in the same view and scale, NaN where none; moved so
    that the hips' middle is where the measurement has it, shape (N, J, 3)."""
    first: NDArray[np.bool_]
    """The frame begins a take, shape (N,)."""
    skeleton: Skeleton
    """The joints, in the order of the arrays."""
    source: str
    """What the pairs are, for the model file."""
    lengths: Array | None = None
    """The person's own segment lengths in each frame [m], shape (N, J)."""

    def __len__(self) -> int:
        return len(self.positions)

    def blocks(self) -> Iterator[slice]:
        """Yield slices of the frames, so that a part at a time is in memory."""
        for start in range(0, len(self), _BLOCK):
            yield slice(start, min(start + _BLOCK, len(self)))


def read_pairs(path: str | os.PathLike[str]) -> list[PairedTake]:
    """Read the clips of a pairs file (npz).

    Arrays: ``joints`` (names), ``fps``, ``subject``, ``kinect`` and ``mocap`` (N, J, 3)
    in meters, ``clip`` names with their rows ``start`` to ``stop``; optionally
    ``state`` (N, J). NaN is a joint that the recording does not have.

    Raises:
        InputError: The file is missing, is no pairs file, or its two sides differ.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: there is no such file; check the name")
    arrays = read_arrays(path, "a pairs file (npz of arrays)")
    needed = ("joints", "fps", "subject", "kinect", "mocap", "clip", "start", "stop")
    for key in needed:
        if key not in arrays:
            raise InputError(
                f"{path}: no array {key!r}; a pairs file holds {', '.join(needed)}"
            )
    try:
        return _clips_of(path, arrays)
    except (ValueError, TypeError, IndexError, OverflowError) as error:
        raise InputError(
            f"{path}: its arrays are no pairs ({type(error).__name__}); write it again"
        ) from None


def _clips_of(path: Path, arrays: dict[str, NDArray[Any]]) -> list[PairedTake]:
    """Return the clips that the arrays of a pairs file hold."""
    kinect, mocap = arrays["kinect"].astype(float), arrays["mocap"].astype(float)
    if kinect.shape != mocap.shape:
        raise InputError(
            f"{path}: kinect has shape {kinect.shape} but mocap {mocap.shape}; both "
            "sides need the same frames and joints"
        )
    skeleton = _skeleton_of(path, arrays["joints"].tolist(), kinect)
    missing = np.isnan(kinect).any(axis=2)
    state = arrays.get("state", np.full(missing.shape, State.TRACKED))
    state = np.where(missing, State.NOT_TRACKED, state).astype(np.uint8)
    fps, subject = float(arrays["fps"].item()), str(arrays["subject"])
    if not 0.01 < fps < 1e4:
        raise InputError(
            f"{path}: fps is {fps:g}, expected frames a second, such as 30"
        )
    pairs = []
    spans = zip(arrays["clip"], arrays["start"], arrays["stop"], strict=True)
    for clip, start, stop in spans:
        if not 0 <= start < stop <= len(kinect):
            raise InputError(
                f"{path}: clip {clip} is rows {start} to {stop} of {len(kinect)}"
            )
        rows = slice(int(start), int(stop))
        time = np.arange(stop - start) / fps
        name = f"{path}:{clip}"
        take = Take(time, kinect[rows], state[rows], skeleton, name)
        pairs.append(PairedTake(take, mocap[rows], subject, str(clip)))
    return pairs


def _skeleton_of(path: Path, joints: list[str], kinect: Array) -> Skeleton:
    for skeleton in SKELETONS.values():
        if tuple(joints) == skeleton.joints and kinect.shape[1:] == (len(joints), 3):
            return skeleton
    raise InputError(
        f"{path}: joints {', '.join(map(str, joints[:3]))}, ... are no known skeleton; "
        f"expected the SDK's names in its order, such as {', '.join(KINECT_V1.joints)}"
    )


def training_set(pairs: Iterable[PairedTake]) -> TrainingSet:
    """Bring pairs to the standard body, as a corrector will see them.

    The frames are put aside on a disk, so that there may be more than memory holds.

    Raises:
        InputError: No pairs, or pairs of different skeletons.
    """
    skeleton: Skeleton | None = None
    parts = [Spool(np.float64) for _ in range(4)]
    counts, subjects = [], set()
    for pair in pairs:
        skeleton = skeleton or pair.take.skeleton
        if pair.take.skeleton != skeleton:
            raise InputError(
                f"{pair.take.source}: {pair.take.skeleton.name}, but the first pairs "
                f"are {skeleton.name}; train one model a skeleton"
            )
        for part, rows in zip(parts, _standardized(pair), strict=True):
            part.add(rows)
        counts.append(len(pair.take))
        subjects.add(pair.subject)
    if skeleton is None:
        raise InputError("no clips to learn from; give pairs files with clips in them")
    first = np.zeros(sum(counts), dtype=bool)
    first[np.concatenate([[0], np.cumsum(counts)[:-1]])] = True
    people = sorted(subjects) if len(subjects) <= 20 else [f"{len(subjects)} people"]
    source = f"{len(counts)} clips of {', '.join(people)}"
    positions, rate, truth, lengths = (part.array() for part in parts)
    return TrainingSet(positions, rate, truth, first, skeleton, source, lengths)


def _standardized(pair: PairedTake) -> tuple[Array, Array, Array, Array]:
    """Return postures, rates, truths and the person's lengths of a clip's frames."""
    take, skeleton = pair.take, pair.take.skeleton
    reference = measure_reference(take)
    body = measured_body(skeleton, reference.lengths, reference.directions)
    reliability = ReliabilityScorer(skeleton, reference).score(take)
    standard = standardize_take(take, body, reliability)
    hips = skeleton.hips
    # E is relative to the hips' middle, so that is what the two sides share.
    shift = take.positions[:, hips].mean(axis=1) - pair.truth[:, hips].mean(axis=1)
    truth = standard.alongside(pair.truth + shift[:, None], take.positions)
    lengths = np.tile(body.lengths, (len(take), 1))
    return standard.positions, reliability.rate, truth, lengths
