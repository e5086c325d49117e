"""Pairs of Kinect and mocap: a take and the ground truth of its frames."""

import os
from collections.abc import Sequence
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
from kinefilter.characters.arrays import Array, Lengths, check_arrays, check_kind

from .formats.files import check_file
from .formats.npz import read_arrays
from .formats.recording import FARTHEST


@dataclass(frozen=True, eq=False)
class PairedTake:
    """A take and the simultaneous marker mocap of its frames, the ground truth.

    Attributes:
        take: The recording.
        truth: Mocap joints [m], the take's frame, NaN where missing, (T, J, 3).
        subject: Name of the person.
        clip: Name of the clip, which begins with that of its movement: m01_s02_e05.
    """

    take: Take
    truth: Array
    subject: str
    clip: str

    @property
    def movement(self) -> str:
        """The beginning of the clip's name: m01 of m01_s02_e05."""
        return self.clip.split("_")[0]

    def __post_init__(self) -> None:
        check_kind(self.take, Take, "the take of a pair")
        for name in ("subject", "clip"):
            check_kind(getattr(self, name), str, f"the {name} of a pair")
        shapes: dict[str, Lengths] = {"truth": self.take.positions.shape}
        check_arrays(self, self.take.source, shapes)
        if np.isinf(self.truth).any():
            raise InputError(f"{self.take.source}: truth is inf; use NaN if missing")


def check_same_skeleton(take: Take, first: Take, hint: str) -> None:
    """Raise an InputError that ends in a hint if two takes have different skeletons."""
    if take.skeleton != first.skeleton:
        raise InputError(
            f"{take.source}: the skeleton is {take.skeleton.name}, but that of "
            f"{first.source} is {first.skeleton.name}; {hint}"
        )


def one_skeleton(pairs: Sequence[PairedTake]) -> Skeleton:
    """Return the skeleton of pairs; raises InputError if they have different ones."""
    first = pairs[0].take
    for pair in pairs:
        check_same_skeleton(pair.take, first, "give pairs of one skeleton")
    return first.skeleton


def read_pairs(path: str | os.PathLike[str]) -> list[PairedTake]:
    """Read the clips of a pairs file (npz), or raise an InputError.

    Arrays: ``joints`` (names), ``fps``, ``subject``, ``kinect`` and ``mocap`` (N, J, 3)
    in meters with NaN for missing joints, ``clip`` names with their rows ``start`` to
    ``stop``; optionally ``state`` (N, J).
    """
    path = check_file(path)
    arrays = read_arrays(path, "a pairs file (npz of arrays)")
    try:
        return _clips_of(path, arrays)
    except KeyError as error:
        hint = "make pairs by 'kinefilter pair'"
        raise InputError(f"{path}: no array {error}; {hint}") from None
    except (ValueError, TypeError, IndexError, OverflowError) as error:
        wrong = f"its arrays are not pairs ({type(error).__name__})"
        raise InputError(f"{path}: {wrong}; write it again") from None


def _clips_of(path: Path, arrays: dict[str, NDArray[Any]]) -> list[PairedTake]:
    kinect, mocap = arrays["kinect"].astype(float), arrays["mocap"].astype(float)
    for name, positions in (("kinect", kinect), ("mocap", mocap)):
        if (far := np.nanmax(np.abs(positions), initial=0.0)) > FARTHEST:
            raise InputError(
                f"{path}: {name} has a joint {far:.3g} m away, expected at most "
                f"{FARTHEST:g} m; convert to meters, or set the joint to NaN"
            )
    if kinect.shape != mocap.shape:
        shapes = f"kinect has shape {kinect.shape} but mocap {mocap.shape}"
        raise InputError(f"{path}: {shapes}; both need the same frames and joints")
    joints = arrays["joints"].tolist()
    known = {skeleton.joints: skeleton for skeleton in SKELETONS.values()}
    skeleton = known.get(tuple(joints))
    if skeleton is None or kinect.shape[1:] != (len(joints), 3):
        raise InputError(
            f"{path}: joints {', '.join(map(str, joints[:3]))}, ... are not a known "
            "skeleton; expected the SDK's names in its order, such as "
            f"{', '.join(KINECT_V1.joints)}"
        )
    missing = np.isnan(kinect).any(axis=2)
    state = arrays.get("state", np.full(missing.shape, State.TRACKED))
    state = np.where(missing, State.NOT_TRACKED, state).astype(np.uint8)
    fps, subject = float(arrays["fps"].item()), str(arrays["subject"])
    if not 0.01 < fps < 1e4:
        raise InputError(f"{path}: fps is {fps:g}, expected 0.01 to 10000 Hz")
    pairs, columns = [], (arrays[name] for name in ("clip", "start", "stop"))
    for clip, start, stop in zip(*columns, strict=True):
        if not 0 <= start < stop <= len(kinect):
            wrong = f"clip {clip} is rows {start} to {stop} of {len(kinect)}"
            raise InputError(f"{path}: {wrong}; correct start and stop")
        rows, time = slice(int(start), int(stop)), np.arange(stop - start) / fps
        take = Take(time, kinect[rows], state[rows], skeleton, f"{path}:{clip}")
        pairs.append(PairedTake(take, mocap[rows], subject, str(clip)))
    return pairs
