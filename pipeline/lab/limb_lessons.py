"""Learns what people mostly do with a limb while it is hidden.

``python -m kinefilter.pipeline.lab.limb_lessons OUT.npz RECORDINGS...`` writes the
weights of ``reconstruct.prior`` again. Recordings are pairs files, takes, or mocap in
BVH; limbs that were seen are taken to be hidden for a while. Then it prints, for each
person and each third of the movements in the pairs, how far hidden limbs end from where
they were by networks that learned from all others, in per cent of going on without
networks.
"""

from __future__ import annotations

import sys
import zlib
from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
from sklearn.neural_network import MLPRegressor

from kinefilter.characters import KINECT_V1, State, Take
from kinefilter.characters.arrays import Array, Singles
from kinefilter.characters.rotations import unit
from kinefilter.pipeline.cleaner import Cleaner
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.formats.mocap import RIGS, kinect_motion, read_mocap
from kinefilter.pipeline.formats.npz import write_arrays
from kinefilter.pipeline.formats.takes import read_take
from kinefilter.pipeline.pairs import PairedTake, read_pairs
from kinefilter.pipeline.reconstruct import Reconstruct
from kinefilter.pipeline.reconstruct.hidden_limbs import seen_motion
from kinefilter.pipeline.reconstruct.limbs import limb_of, limbs
from kinefilter.pipeline.reconstruct.prior import (
    OUTPUT,
    MotionPrior,
    Network,
    inputs_of,
    network_name,
    part_of,
)
from kinefilter.pipeline.reconstruct.stage import hidden_joints
from kinefilter.pipeline.reconstruct.windows import Limb, Seen, Stretches, describe
from kinefilter.pipeline.workers import workers

from .database_build import mocap_body, whole_frames

_SHORTEST, _LONGEST = 0.4, 4.0  # s hidden
_CONTEXT = 6  # frames in which a limb is seen before and after
_SAMPLES = 6  # frames of a stretch
_FEWEST, _MOST, _FOR_EACH = 8, 240, 10  # stretches of a take, one for so many frames
_SEEN = 0.97  # share of a stretch's frames in which each segment is seen
_ALONE = 0.8  # share of the stretches in which the opposite limb is seen
_TREMBLE = 0.008  # m: mocap trembles less than what a sensor sees. A guess.
_MOCAP_RATE = 30.0  # Hz
# Chosen on one of six people, thirds of their movements, and other recordings.
_LAYERS, _PENALTY, _EPOCHS, _BATCH = (128, 64), 1.0, 12, 512
_NOISE = 0.5  # of each input's spread, lest movements be learned by heart
_TAKEN = {"arm": 0.8, "forearm": 0.8, "leg": 1.0, "shin": 0.5}
"""How much of what the networks say is taken, for the sake of such movements."""
_ODD = 0.1  # added to the spread of inputs, lest those that hardly vary count


class Rows(NamedTuple):
    """Frames of limbs that are taken to be hidden, told as of left ones."""

    inputs: Singles
    """What the networks are told, shape (N, F)."""
    base: Singles
    """Directions of the segments as they would go on, shape (N, H, 3)."""
    truth: Singles
    """Their directions, shape (N, H, 3)."""


Lessons = dict[str, Rows]
"""Rows by the name of the network that learns from them."""


class Lesson(NamedTuple):
    """What a recording teaches."""

    person: str
    movement: str
    rows: Lessons


def lessons_of(take: Take, seed: int, modes: Sequence[bool]) -> Lessons:
    """Return stretches of a take in which a limb is taken to be hidden.

    Args:
        take: The recording.
        seed: Draws the stretches.
        modes: Whether what comes after them is known: either or both.
    """
    draft = Cleaner().until("measure").whole(take)
    skeleton, rng = draft.skeleton, np.random.default_rng(seed)
    blind = hidden_joints(draft.measured, draft.state, skeleton)
    places = np.where(blind[..., None], np.nan, draft.measured)
    seen = seen_motion(draft.time, places, skeleton)
    count, found = len(places), dict[str, list[Rows]]()
    least, most = (round(s * seen.rate) for s in (_SHORTEST, _LONGEST))
    most = min(count - 2 * _CONTEXT - 1, most)
    stretches = min(max(_FEWEST, count // _FOR_EACH), _MOST) if most >= least else 0
    for joints, outer in product(limbs(skeleton), (1, 2)):
        limb, alone = (_limb(seen, joints, outer, alone=a) for a in (False, True))
        if limb is None or alone is None:
            continue
        known = seen.known[:, [*limb.hidden, *limb.visible]]
        for _ in range(stretches):
            length = int(rng.integers(least, most + 1))
            start = int(rng.integers(_CONTEXT, count - _CONTEXT - length))
            one = limb if rng.random() < _ALONE else alone
            at = np.sort(rng.choice(length, min(_SAMPLES, length), replace=False))
            around = slice(start - _CONTEXT, start + length + _CONTEXT)
            joined = seen.joined[around][1:].all()
            if joined and known[around].mean(axis=0).min() > _SEEN:
                for ahead in modes:
                    starts, few = np.array([start]), at[None]
                    name, rows = _rows(Stretches(seen, one, starts, length, few, ahead))
                    found.setdefault(name, []).append(rows)
    return {name: _joined(rows) for name, rows in found.items()}


def _limb(
    seen: Seen, joints: tuple[int, int, int], outer: int, *, alone: bool
) -> Limb | None:
    """Return a limb hidden from a joint on, and its opposite too if it is alone."""
    hidden = list(joints[outer:])
    known = np.where(np.isnan(seen.lengths), np.nan, 1.0)
    if np.isnan(known[hidden]).any():
        return None
    known[hidden] = 0.0
    if alone:
        known[seen.skeleton.mirror[hidden]] = 0.0
    return limb_of(seen.skeleton, joints, known)


def _rows(stretch: Stretches) -> tuple[str, Rows]:
    """Return the name of a stretch's network and what it learns."""
    part, mirrored = part_of(stretch.seen.skeleton, stretch.limb)
    found = describe(stretch)
    base, truth = found.base[0].copy(), found.truth[0].copy()
    if mirrored:
        base[..., 0] *= -1.0
        truth[..., 0] *= -1.0
    told = (inputs_of(stretch, found)[0], base, truth)
    return network_name(part, ahead=stretch.ahead), Rows(
        *(a.astype(np.float32) for a in told)
    )


def _joined(parts: Iterable[Rows]) -> Rows:
    return Rows(*(np.concatenate(some) for some in zip(*parts, strict=True)))


def joined(lessons: Iterable[Lesson]) -> Lessons:
    """Return the rows of many recordings by network."""
    parts: dict[str, list[Rows]] = {}
    for lesson in lessons:
        for name, rows in lesson.rows.items():
            parts.setdefault(name, []).append(rows)
    return {name: _joined(rows) for name, rows in parts.items()}


def teach_limbs(lessons: Lessons) -> MotionPrior:
    """Return the prior that rows teach."""
    return MotionPrior({name: _network(name, rows) for name, rows in lessons.items()})


def _network(name: str, rows: Rows) -> tuple[Array, Network]:
    there = np.isfinite(rows.inputs)
    mean = np.mean(rows.inputs, axis=0, where=there, dtype=float)
    spread = np.std(rows.inputs, axis=0, where=there, dtype=float) + _ODD
    inputs = np.where(there, (rows.inputs - mean) / spread, 0.0).astype(np.float32)
    departure = (rows.truth - rows.base).reshape(len(inputs), -1) / OUTPUT
    taught = MLPRegressor(
        hidden_layer_sizes=_LAYERS,
        alpha=_PENALTY,
        batch_size=min(_BATCH, len(inputs)),
        random_state=0,
    )
    rng = np.random.default_rng(0)
    for _ in range(_EPOCHS):
        noise = rng.normal(scale=_NOISE, size=inputs.shape).astype(np.float32)
        taught.partial_fit(inputs + noise, departure)
    layers = list(zip(taught.coefs_, taught.intercepts_, strict=True))
    layers[0] = (layers[0][0] / spread[:, None], layers[0][1])
    taken = _TAKEN[name.partition("_")[0]]
    layers[-1] = (taken * layers[-1][0], taken * layers[-1][1])
    return mean, layers


class Recording(NamedTuple):
    """A take, and who moves how in it."""

    person: str
    movement: str
    name: str
    take: Take

    @classmethod
    def of(cls, pair: PairedTake) -> Recording:
        """Return that of a clip."""
        return cls(pair.subject, pair.movement, pair.clip, pair.take)


def recordings_in(file: Path) -> Iterator[Recording]:
    """Yield what is in a pairs file (.npz), mocap (.bvh) or a take."""
    name = file.name.partition(".")[0]
    if file.suffix == ".npz":
        yield from map(Recording.of, read_pairs(file))
    elif ".bvh" in file.suffixes:
        yield Recording(name, name, name, _seen_mocap(file, name))
    else:
        yield Recording(name, name, name, read_take(file))


def lesson_of(recording: Recording, modes: Sequence[bool]) -> Lesson:
    """Return what a recording teaches; ``modes`` as those of ``lessons_of``."""
    person, movement, name, take = recording
    return Lesson(person, movement, lessons_of(take, zlib.crc32(name.encode()), modes))


def read_lessons(
    recordings: Iterable[Recording], modes: Sequence[bool]
) -> list[Lesson]:
    """Return what recordings teach, several read side by side."""
    with workers() as pool:
        read = partial(lesson_of, modes=modes)
        return list(pool.map(read, recordings, chunksize=8))


def taught_by(pairs: Iterable[PairedTake]) -> MotionPrior:
    """Return what limbs do in gaps after which they are seen, as clips teach it."""
    some = (lesson_of(Recording.of(pair), (True,)) for pair in pairs)
    return teach_limbs(joined(some))


def knowing(cleaner: Cleaner, config: CleanConfig, prior: MotionPrior) -> Cleaner:
    """Return a cleaner in which hidden limbs do what a prior says.

    One that reconstructs no limbs is returned as it is.
    """
    if all(stage.name != Reconstruct.name for stage in cleaner.stages):
        return cleaner
    return cleaner.replaced(Reconstruct(config, prior))


def _seen_mocap(file: Path, name: str) -> Take:
    """Return mocap as a sensor might see it."""
    mocap = read_mocap(file, [])
    positions = kinect_motion(mocap, KINECT_V1, RIGS).positions
    unit_length, _ = mocap_body(positions, KINECT_V1)
    step = max(1, round(1.0 / (_MOCAP_RATE * mocap.frame_time)))
    # The first frame of many a file is a T-pose.
    positions = (
        unit_length * positions[np.flatnonzero(whole_frames(positions))[1::step]]
    )
    rng = np.random.default_rng(zlib.crc32(name.encode()))
    positions += rng.normal(scale=_TREMBLE, size=positions.shape)
    time = np.arange(float(len(positions))) * step * mocap.frame_time
    state = np.full(positions.shape[:2], State.TRACKED, dtype=np.uint8)
    return Take(time, positions, state, KINECT_V1, str(file))


def worth(prior: MotionPrior, lessons: Lessons) -> dict[str, float]:
    """Return errors of directions by each network, in per cent of those without."""
    found = {}
    for name, rows in lessons.items():
        said = prior.change(name, rows.inputs.astype(float)).reshape(rows.base.shape)
        errors = [
            np.linalg.norm(unit(d) - rows.truth, axis=-1).mean()
            for d in (rows.base + said, rows.base.astype(float))
        ]
        found[name] = round(float(errors[0] / errors[1] * 100), 1)
    return found


def _without(some: set[str], lessons: Sequence[Lesson]) -> dict[str, float]:
    """Return what networks are worth to some people or movements left out."""
    mine = [one for one in lessons if some & {one.person, one.movement}]
    others = [one for one in lessons if not some & {one.person, one.movement}]
    return worth(teach_limbs(joined(others)), joined(mine))


def main(out: Path, files: Sequence[str]) -> None:
    """Learn from recordings, write the weights, and print what they are worth."""
    recordings = [r for file in files for r in recordings_in(Path(file))]
    lessons = read_lessons(recordings, (False, True))
    write_arrays(out, teach_limbs(joined(lessons)).arrays())
    pairs = [Path(file) for file in files if file.endswith(".npz")]
    people = sorted({one.person for file in pairs for one in recordings_in(file)})
    movements = sorted({one.movement for one in lessons if one.person in people})
    left_out = [{person} for person in people] + [
        set(movements[k::3]) for k in range(3)
    ]
    for some in left_out:
        print(", ".join(sorted(some)), _without(some, lessons), flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
