"""Trains the prior for hidden limbs on recordings in which the limbs were visible.

``python -m kinefilter.pipeline.lab.limb_lessons OUT.npz RECORDINGS...`` writes the
weights of ``reconstruct.prior``; recordings are pairs files, takes, or mocap in BVH. It
then prints, for each person and each third of the movements in the pairs, the errors of
networks trained without them, in percent of the errors without networks.
"""

import sys
import zlib
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from sklearn.neural_network import MLPRegressor

from kinefilter.characters import KINECT_V1, standard_body
from kinefilter.characters.arrays import Array, Singles
from kinefilter.characters.motion import distinct_stamps, values_at
from kinefilter.characters.rotations import unit
from kinefilter.characters.skeleton import SIDES
from kinefilter.pipeline.cleaner import Cleaner
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.formats.npz import write_arrays
from kinefilter.pipeline.networks import Network
from kinefilter.pipeline.pairs import PairedTake
from kinefilter.pipeline.reconstruct import Reconstruct
from kinefilter.pipeline.reconstruct.hidden_limbs import bridged_motion
from kinefilter.pipeline.reconstruct.prior import (
    HANGING,
    OUTPUT,
    PARTS,
    Mode,
    MotionPrior,
    inputs_of,
    network_name,
    part_of,
    posture_inputs,
    standing_height,
)
from kinefilter.pipeline.reconstruct.stage import hidden_joints
from kinefilter.pipeline.reconstruct.unseen_steps import (
    GAIT_TIMES,
    PACE,
    WALKS,
    gait_inputs,
)
from kinefilter.pipeline.reconstruct.windows import (
    BridgedMotion,
    Limb,
    Stretches,
    describe,
    limb_of,
    limbs,
)
from kinefilter.pipeline.workers import workers

from .recorded_acts import NamedTake, recordings_in

_SHORTEST, _LONGEST = 0.4, 4.0  # s for which a limb is hidden
_CONTEXT = 6  # frames before and after a stretch in which the limb is visible
_SAMPLES = 6  # frames per stretch
_FEWEST, _MOST, _FRAMES_PER_STRETCH = 8, 240, 10  # stretches of a take
_VISIBLE = 0.97  # share of a stretch's frames in which each segment must be visible
_OPPOSITE_VISIBLE = 0.8  # share of the stretches with a visible opposite limb
# Chosen on s02, s03, s04, two thirds of their movements, and a quarter of the others.
_LAYERS, _PENALTY, _EPOCHS, _BATCH = (128, 64), 0.25, 20, 512
_AVERAGED = 10  # last epochs, whose weights are averaged
_NOISE = 0.2  # standard deviations added to each input, against overfitting
_SHRINKAGE = {"arm": 0.8, "forearm": 0.8, "leg": 1.0, "shin": 0.5}
"""Factors of the networks' outputs, chosen on unseen movements."""
# Of limbs that are never seen: chosen by leaving out s02, s03 and s04, four movements,
# all CMU mocap, all other takes, or all people with two sensors.
_UNSEEN_NOISE = 0.3
_UNSEEN_SHRINKAGE = {"arm": 0.7, "forearm": 1.0, "leg": 0.85, "shin": 0.7}
# Of the gait: s over which ankles are smoothed, Hz of the frames, and the penalty,
# chosen on CMU's 02, 05, 07, 10, 16, 29 and 32 and on p00 to p08.
_GAIT_SMOOTHED, _GAIT_RATE, _GAIT_PENALTY = 0.05, 30.0, 0.1
_SMALL = 0.02  # m: smaller errors count as their squares, as in the pseudo-Huber loss
_LARGE = 0.06  # m: error for which the loss is about one; the penalty is relative to it
_SPREAD_FLOOR = 0.1  # added to the spread of inputs, to ignore nearly constant ones


class Rows(NamedTuple):
    """Training data: frames of hidden limbs, right ones mirrored to the left."""

    inputs: Singles  # of the network, shape (N, F)
    base: Singles  # directions of the segments, predicted without networks, (N, H, 3)
    truth: Singles  # true directions of the segments, shape (N, H, 3)


Floats = NDArray[np.floating[Any]]
Lessons = dict[str, Rows]  # training data by the name of the network


class Lesson(NamedTuple):
    """Training data from one recording."""

    person: str
    movement: str
    rows: Lessons


def lesson_of(recording: NamedTake, modes: Sequence[Mode]) -> Lesson:
    """Hide limbs in stretches of a recording, drawn by its name, or in all of it."""
    draft = Cleaner().until("measure").whole(recording.take)
    rng = np.random.default_rng(zlib.crc32(recording.name.encode()))
    skeleton = draft.skeleton
    hidden = hidden_joints(draft.measured, draft.state, skeleton)
    visible = np.where(hidden[..., None], np.nan, draft.measured)
    seen = bridged_motion(draft.time, visible, skeleton)
    count, parts = len(visible), list[Lessons]()
    least, most = (round(s * seen.rate) for s in (_SHORTEST, _LONGEST))
    most = min(count - 2 * _CONTEXT - 1, most)
    wanted = min(max(_FEWEST, count // _FRAMES_PER_STRETCH), _MOST)
    for joints, outer in product(limbs(skeleton), (1, 2)):
        limb, alone = (_limb(seen, joints, outer, alone=a) for a in (False, True))
        if limb is None or alone is None or most < least:
            continue
        known = seen.known[:, [*limb.hidden, *limb.visible]]
        for _ in range(wanted):
            length = int(rng.integers(least, most + 1))
            start = int(rng.integers(_CONTEXT, count - _CONTEXT - length))
            one = limb if rng.random() < _OPPOSITE_VISIBLE else alone
            at = np.sort(rng.choice(length, min(_SAMPLES, length), replace=False))
            around = slice(start - _CONTEXT, start + length + _CONTEXT)
            joined = seen.joined[around][1:].all()
            if joined and known[around].mean(axis=0).min() > _VISIBLE:
                starts, at = np.array([start]), at[None]
                stretch = Stretches(seen, one, starts, length, at, ahead=True)
                parts.extend(_hidden_rows(stretch, modes))
    if "unseen" in modes:
        parts.extend(_unseen_rows(seen, recording.share, rng))
        parts.extend(_gait_rows(draft.time, seen))
    return Lesson(recording.person, recording.movement, _concatenated(parts))


def _hidden_rows(stretch: Stretches, modes: Sequence[Mode]) -> Iterator[Lessons]:
    """Yield training data of a limb, forward and backward in time: 2 % better."""
    for one, mode in product((stretch, stretch.backward()), modes):
        if mode != "unseen":
            yield _rows(replace(one, ahead=mode == "between"))


def _unseen_rows(
    seen: BridgedMotion, share: float, rng: np.random.Generator
) -> Iterator[Lessons]:
    """Yield training data of unseen limbs; half of it without the opposite one, too."""
    skeleton, heights = seen.skeleton, seen.heading.root[:, 1]
    count, parents = len(heights), list(skeleton.parents)
    most = min(max(_FEWEST, count // _FRAMES_PER_STRETCH), _MOST, count)
    bones = seen.positions - seen.positions[:, parents]
    bones[~seen.known] = np.nan
    lower = heights - standing_height(heights)
    for joints, outer in product(limbs(skeleton), (1, 2)):
        hidden = joints[outer:]
        part, mirrored = part_of(skeleton, hidden)
        wanted = max(round(share * most), 1) if "arm" in part else most
        frames = np.sort(rng.choice(count, wanted, replace=False))
        frames = frames[seen.known[frames][:, hidden].all(axis=1)]
        if not len(frames):
            continue
        shown = bones[frames]
        alone = np.flatnonzero(rng.random(len(frames)) < 0.5)
        shown[np.ix_(alone, skeleton.mirror[list(hidden)])] = np.nan
        inputs = posture_inputs(skeleton, hidden, shown, lower[frames])
        flip = np.array([-1.0 if mirrored else 1.0, 1.0, 1.0])
        truth = flip * seen.directions[frames][:, hidden]
        base = np.broadcast_to(HANGING, truth.shape)
        rows = Rows(*(a.astype(np.float32) for a in (inputs, base, truth)))
        yield {network_name(part, "unseen"): rows}


def _gait_rows(time: Array, seen: BridgedMotion) -> Iterator[Lessons]:
    """Yield training data of the gait of people who walk forward.

    The truth is how far the left ankle is ahead of the right one [m], and the rate of
    that, divided by that of the walk's cycle.
    """
    skeleton, new = seen.skeleton, distinct_stamps(time)
    positions, time = seen.heading.restore(seen.positions)[new], time[new]
    ankles = skeleton.sides("Ankle")
    level = positions[:, ankles][..., [0, 2]]
    spread = _GAIT_SMOOTHED * seen.rate
    apart = gaussian_filter1d(level[:, 0] - level[:, 1], spread, axis=0)
    faster = np.gradient(apart, time, axis=0) / PACE
    shown = seen.known[new][:, ankles].all(axis=1)
    shown &= np.isfinite(positions).all(axis=(1, 2))
    every = max(round(seen.rate / _GAIT_RATE), 1)
    for mode, around in GAIT_TIMES.items():
        inside = (time >= time[0] - around[0]) & (time <= time[-1] - around[-1])
        frames = np.flatnonzero(inside & shown)[::every]
        if not len(frames):
            continue
        motion = values_at(time, positions, time[frames, None] + around)
        inputs, ahead, way = gait_inputs(motion, skeleton)
        legs = apart[frames], faster[frames]
        truth = np.stack([np.sum(part * ahead, axis=1) for part in legs], axis=1)
        walks = way > WALKS * (around[-1] - around[0])
        if walks.any():
            arrays = inputs[walks], np.zeros_like(truth[walks]), truth[walks]
            rows = Rows(*(array.astype(np.float32) for array in arrays))
            yield {network_name("gait", mode): rows}


def _limb(
    seen: BridgedMotion, joints: tuple[int, int, int], outer: int, *, alone: bool
) -> Limb | None:
    """Return a limb hidden from a joint outward; if alone, its opposite is as well."""
    hidden = list(joints[outer:])
    known = np.where(np.isnan(seen.lengths), np.nan, 1.0)
    if np.isnan(known[hidden]).any():
        return None
    known[hidden] = 0.0
    if alone:
        known[seen.skeleton.mirror[hidden]] = 0.0
    return limb_of(seen.skeleton, joints, known)


def _rows(stretch: Stretches) -> Lessons:
    part, mirrored = part_of(stretch.seen.skeleton, stretch.limb.hidden)
    found = describe(stretch)
    flip = np.array([-1.0 if mirrored else 1.0, 1.0, 1.0])
    arrays = inputs_of(stretch, found)[0], flip * found.base[0], flip * found.truth[0]
    rows = Rows(*(array.astype(np.float32) for array in arrays))
    mode: Mode = "between" if stretch.ahead else "before"
    return {network_name(part, mode): rows}


def joined(lessons: Iterable[Lesson]) -> Lessons:
    """Return the training data of many recordings by network."""
    return _concatenated(lesson.rows for lesson in lessons)


def _concatenated(parts: Iterable[Lessons]) -> Lessons:
    by_network: dict[str, list[Rows]] = {}
    for part in parts:
        for name, rows in part.items():
            by_network.setdefault(name, []).append(rows)
    return {
        name: Rows(*(np.concatenate(arrays) for arrays in zip(*rows, strict=True)))
        for name, rows in by_network.items()
    }


def train_prior(lessons: Lessons, executor: Executor | None = None) -> MotionPrior:
    """Train a network on each set of training data, at the same time by an executor."""
    each = map if executor is None else executor.map
    networks = each(_trained, lessons, lessons.values())
    return MotionPrior(dict(zip(lessons, networks, strict=True)))


def _trained(name: str, rows: Rows) -> Network:
    if name.startswith("gait"):
        return _gait_map(rows)
    return _network(name, rows)


def _gait_map(rows: Rows) -> Network:
    """Return ridge regression without an offset, for mirrored gaits are opposite."""
    inputs, truth = rows.inputs.astype(float), rows.truth.astype(float)
    size = np.sqrt(np.mean(inputs**2, axis=0))
    given = inputs / size
    gram = given.T @ given + _GAIT_PENALTY * len(given) * np.eye(len(size))
    weights = np.linalg.solve(gram, given.T @ truth) / size[:, None]
    layer = (weights / OUTPUT).astype(np.float32), np.zeros(truth.shape[1], np.float32)
    return Network(np.zeros(len(size)), [layer])


def _network(name: str, rows: Rows) -> Network:
    known = np.isfinite(rows.inputs)
    mean = np.mean(rows.inputs, axis=0, where=known, dtype=float)
    spread = np.std(rows.inputs, axis=0, where=known, dtype=float) + _SPREAD_FLOOR
    inputs = np.where(known, (rows.inputs - mean) / spread, 0.0).astype(np.float32)
    part = name.partition("_")[0]
    scale, factor = _NOISE, _SHRINKAGE[part]
    if name == network_name(part, "unseen"):
        scale, factor = _UNSEEN_NOISE, _UNSEEN_SHRINKAGE[part]
    body = standard_body(KINECT_V1)
    limb = [body.skeleton.index(joint + SIDES[0]) for joint in PARTS[part]]
    lengths = body.lengths[limb].astype(np.float32)
    size = min(_BATCH, len(inputs))
    network = MLPRegressor(
        hidden_layer_sizes=_LAYERS, alpha=_PENALTY, batch_size=size, random_state=0
    )
    network.partial_fit(inputs[:size], np.zeros((size, 3 * len(limb)), np.float32))
    rng, kept = np.random.default_rng(0), []
    for epoch in range(_EPOCHS):
        order = rng.permutation(len(inputs))
        for batch in order[: len(order) // size * size].reshape(-1, size):
            noise = rng.standard_normal((size, inputs.shape[1]), np.float32)
            given = inputs[batch] + scale * noise
            outputs = network.predict(given)
            # The library knows squared errors only, of which the gradient is outputs -
            # targets: with these targets it is that of the joints' error.
            base, truth = rows.base[batch], rows.truth[batch]
            _, gradient = joint_error(outputs, base, truth, lengths)
            network.partial_fit(given, outputs - gradient)
        if epoch >= _EPOCHS - _AVERAGED:
            arrays = (*network.coefs_, *network.intercepts_)
            kept.append([array.copy() for array in arrays])
    averaged = [np.mean(arrays, axis=0) for arrays in zip(*kept, strict=True)]
    count = len(_LAYERS) + 1
    layers = list(zip(averaged[:count], averaged[count:], strict=True))
    layers[0] = (layers[0][0] / spread[:, None], layers[0][1])
    layers[-1] = (factor * layers[-1][0], factor * layers[-1][1])
    return Network(mean, layers)


def joint_error(
    outputs: Floats, base: Floats, truth: Floats, lengths: Floats
) -> tuple[Floats, Floats]:
    """Return the error of hidden joints and its gradient for a network's outputs.

    The error, shape (N,), is the mean pseudo-Huber loss of the joints' distances to
    where segments of ``lengths`` [m], shape (H,), put them with the true directions,
    each on the one before. Outputs and gradient have shape (N, 3 H).
    """
    moved = base + OUTPUT * outputs.reshape(base.shape)
    size = np.linalg.norm(moved, axis=-1, keepdims=True)
    directions = moved / size
    away = np.cumsum(lengths[:, None] * (directions - truth), axis=1)
    loss = np.sqrt(np.sum(away**2, axis=-1, keepdims=True) + _SMALL**2)
    scale = _LARGE * len(lengths)
    # A segment moves its own end and all ends after it.
    turned = lengths[:, None] * np.cumsum((away / loss)[:, ::-1], axis=1)[:, ::-1]
    along = np.sum(turned * directions, axis=-1, keepdims=True) * directions
    gradient = OUTPUT * (turned - along) / size / scale
    return loss.sum(axis=(1, 2)) / scale, gradient.reshape(outputs.shape)


def read_lessons(recorded: Iterable[NamedTake], modes: Sequence[Mode]) -> list[Lesson]:
    """Return ``lesson_of`` for every recording, computed on all cores."""
    with workers() as pool:
        return list(pool.map(partial(lesson_of, modes=modes), recorded))


def train_prior_on(pairs: Iterable[PairedTake]) -> MotionPrior:
    """Train a prior on clips."""
    modes = get_args(Mode)
    return train_prior(joined(lesson_of(NamedTake.of(pair), modes) for pair in pairs))


def with_prior(cleaner: Cleaner, config: CleanConfig, prior: MotionPrior) -> Cleaner:
    """Return the cleaner with a prior for hidden limbs, if it reconstructs them."""
    if all(stage.name != Reconstruct.name for stage in cleaner.stages):
        return cleaner
    return cleaner.replaced(Reconstruct(config, prior))


def relative_errors(prior: MotionPrior, lessons: Lessons) -> dict[str, float]:
    """Return each network's error, of directions or the gait, in percent without it."""
    percent = {}
    for name, rows in lessons.items():
        change = prior.change(name, rows.inputs.astype(float)).reshape(rows.base.shape)
        found = rows.base + change, rows.base.astype(float)
        if not name.startswith("gait"):
            found = unit(found[0]), unit(found[1])
        error, plain = (np.linalg.norm(f - rows.truth, axis=-1).mean() for f in found)
        percent[name] = round(float(error / plain * 100), 1)
    return percent


def main(out: Path, files: Sequence[str]) -> None:
    """Train on recordings, write the weights, and print ``relative_errors``."""
    recordings = [r for file in files for r in recordings_in(Path(file))]
    lessons = read_lessons(recordings, get_args(Mode))
    pairs = [Path(file) for file in files if file.endswith(".npz")]
    people = sorted({one.person for file in pairs for one in recordings_in(file)})
    movements = sorted({one.movement for one in lessons if one.person in people})
    thirds = [set(movements[k::3]) for k in range(3)]
    with workers() as pool:
        write_arrays(out, train_prior(joined(lessons), pool).arrays())
        for names in (*({person} for person in people), *thirds):
            left_out = [one for one in lessons if names & {one.person, one.movement}]
            others = [one for one in lessons if not names & {one.person, one.movement}]
            prior = train_prior(joined(others), pool)
            percent = relative_errors(prior, joined(left_out))
            print(", ".join(sorted(names)), percent, flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
