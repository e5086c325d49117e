"""Builds posture databases from mocap files, pairs, or scripted motions."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from kinefilter.characters import Body, InputError, Skeleton, State, Take, standard_body
from kinefilter.characters.arrays import Array, Flags
from kinefilter.pipeline.database import PostureDatabase, filter_to_count
from kinefilter.pipeline.formats.mocap import RIGS, kinect_motion, read_mocap
from kinefilter.pipeline.formats.recording import Mocap
from kinefilter.pipeline.pairs import PairedTake
from kinefilter.pipeline.progress import Progress, over, silent
from kinefilter.pipeline.reliability import (
    column_medians,
    measure_body,
    segment_lengths,
)
from kinefilter.retarget import Standardizer, fill_missing_joints
from kinefilter.scenes.library import MOTIONS, perform, random_body

from .spool import Spool

POSTURES_PER_SECOND = 30.0  # at which motions are sampled
FILTERED_POSTURES = 2574  # kept by default by the threshold rule (Shum 2013, table V)
BUILTIN_POSTURES = 5000
"""Approximate size of the built-in database: twice that of Shum et al., so that half of
the postures in real mocap are within 8 cm of one."""
_PEOPLE = 6  # who perform it
_PAIRS_STEP = 2  # frames between samples of pairs; the filter drops more than that


def database_from_mocap(
    files: Sequence[Path],
    skeleton: Skeleton,
    *,
    count: int = FILTERED_POSTURES,
    progress: Progress = silent,
) -> PostureDatabase:
    """Build a database for the takes of a skeleton from mocap files.

    Files are BVH, AMC with its ASF, C3D or TRC, in any unit, with the joint names of
    ``retarget/source_rigs``; InputError without any, or if one lacks a joint. The
    threshold rule keeps about ``count`` postures.
    """
    skeletons = [file for file in files if file.suffix.lower() == ".asf"]
    motions = [file for file in files if file not in skeletons]
    if not motions:
        raise InputError("no BVH, AMC, C3D or TRC files; give one or more")

    def postures_of(file: Path) -> tuple[str, Array]:
        mocap = read_mocap(file, skeletons)
        return file.name.split(".")[0], mocap_postures(mocap, skeleton)

    parts = map(postures_of, over(motions, "read", progress))
    return filtered_database(parts, skeleton, f"{len(motions)} mocap files", count)


def database_from_pairs(
    pairs: Iterable[PairedTake], skeleton: Skeleton, *, count: int = FILTERED_POSTURES
) -> PostureDatabase:
    """Build a database from the mocap in pairs, like ``database_from_mocap``."""
    people: set[str] = set()
    truths = _truths(pairs, skeleton, people)
    database = filtered_database(truths, skeleton, "pairs", count)
    return replace(database, source=f"mocap of {', '.join(sorted(people))}")


def _truths(
    pairs: Iterable[PairedTake], skeleton: Skeleton, people: set[str]
) -> Iterator[tuple[str, Array]]:
    """Yield the name and postures of each clip's mocap; add to ``people``."""
    for pair in pairs:
        if pair.take.skeleton != skeleton:
            raise InputError(
                f"{pair.take.source}: the pairs are of {pair.take.skeleton.name}, but "
                f"the database is for {skeleton.name}; add --skeleton "
                f"{pair.take.skeleton.name}"
            )
        people.add(pair.subject)
        truth = pair.truth[::_PAIRS_STEP]
        truth = truth[whole_frames(truth)]
        if not len(truth):
            continue
        missing = np.asarray(np.isnan(truth).any(axis=2))
        state = np.where(missing, State.NOT_TRACKED, State.TRACKED).astype(np.uint8)
        time = np.arange(len(truth)) * _PAIRS_STEP / POSTURES_PER_SECOND
        seen = np.where(missing[..., None], np.nan, truth)
        body = measure_body(Take(time, seen, state, skeleton, pair.take.source))
        yield pair.clip, standard_postures(seen, body)


def scripted_database(
    skeleton: Skeleton, progress: Progress = silent
) -> PostureDatabase:
    """Return the built-in database: postures of all scripted motions that differ."""
    parts, count = scripted_postures(skeleton, progress), BUILTIN_POSTURES
    return filtered_database(parts, skeleton, "built-in", count, recorded=False)


def scripted_postures(
    skeleton: Skeleton, progress: Progress = silent, *, people: int = _PEOPLE
) -> Iterator[tuple[str, Array]]:
    """Yield the name and postures of every scripted performance.

    The performers differ in height and build, and the postures are on the standard
    body, 30 a second.
    """
    # All motions by one person, then by the next: the filter keeps earlier postures.
    for k in progress("motion database", people * len(MOTIONS)):
        seed, name = k // len(MOTIONS), MOTIONS[k % len(MOTIONS)]
        body = random_body(skeleton, np.random.default_rng(seed))
        act = perform(name, body, seed=seed, fps=POSTURES_PER_SECOND)
        yield name, standard_postures(act.positions, body)


def filtered_database(
    parts: Iterable[tuple[str, Array]],
    skeleton: Skeleton,
    source: str,
    count: int = FILTERED_POSTURES,
    *,
    recorded: bool = True,
) -> PostureDatabase:
    """Return a database of about ``count`` postures, chosen by the threshold rule.

    All postures are buffered on disk, because they may not fit into memory.
    """
    # In the file's precision, so that saving and loading change nothing.
    positions, names, ends = Spool(np.float32), [], []
    for name, postures in parts:
        positions.add(postures)
        names.append(name)
        ends.append(len(positions))
    if len(positions) < 2:
        raise InputError(
            f"{source}: a database needs 2 postures or more, found {len(positions)}; "
            "give files that contain motion"
        )
    kept = filter_to_count(positions.array(), count)
    return PostureDatabase(
        positions.array()[kept],
        np.array(names)[np.searchsorted(ends, kept, side="right")],
        skeleton,
        source,
        recorded,
    )


def standard_postures(positions: Array, body: Body) -> Array:
    """Return postures on the standard body, without yaw."""
    weights = np.ones(positions.shape[:2])
    postures, _ = Standardizer(body).steps(positions, weights)
    return fill_missing_joints(postures, standard_body(body.skeleton))


def mocap_postures(mocap: Mocap, skeleton: Skeleton) -> Array:
    """Return postures on the standard body, 30 per second."""
    motion = kinect_motion(mocap, skeleton, RIGS)
    positions, step = motion.positions, 1.0 / POSTURES_PER_SECOND
    whole = whole_frames(positions)
    frames = np.flatnonzero(whole)[:: max(1, round(step / mocap.frame_time))]
    if not len(frames):
        raise InputError(
            f"{mocap.source}: no frame has all joints; give mocap of the whole body"
        )
    unit, body = mocap_body(positions, skeleton)
    return standard_postures(unit * positions[frames], body)


def mocap_body(positions: Array, skeleton: Skeleton) -> tuple[float, Body]:
    """Return the file's unit [m] and the performer's body by positions (T, J, 3).

    Bones that the mocap lacks have average lengths.
    """
    lengths = column_medians(segment_lengths(positions, skeleton))
    ends, average = skeleton.segments, standard_body(skeleton)
    with np.errstate(divide="ignore"):  # some rigs have coincident joints
        unit = float(np.nanmedian(average.lengths[ends] / lengths[ends]))
    known = unit * lengths > 1e-3
    lengths = np.where(known, unit * lengths, average.lengths)
    return unit, replace(average, lengths=lengths)


def whole_frames(positions: Array) -> Flags:
    """Return a mask of the frames that have every joint the motion ever has, (T,)."""
    missing = np.isnan(positions).any(axis=2)
    return np.asarray((missing == missing.all(axis=0)).all(axis=1))
