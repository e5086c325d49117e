"""The virtual Kinect's two trackers compared (Liu 2016, section 5.4)."""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import product

import numpy as np

from kinefilter.characters import KINECT_V1
from kinefilter.characters.arrays import Array
from kinefilter.characters.skeleton import LIMB_PARTS
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.correct import Corrector
from kinefilter.pipeline.factory import make_corrector
from kinefilter.pipeline.lab.accuracy import FAR, LIMBS, mean_of_known
from kinefilter.pipeline.lab.evaluate import tally_clips
from kinefilter.pipeline.lab.methods.fourier_ridge_learner import FourierRidgeLearner
from kinefilter.pipeline.lab.recorded_acts import Pair, pairs_of, seen_by
from kinefilter.pipeline.lab.simulation import simulated_pair, truth_of
from kinefilter.pipeline.lab.training import training_set
from kinefilter.pipeline.pairs import PairedTake
from kinefilter.pipeline.progress import over
from kinefilter.pipeline.workers import workers
from kinefilter.scenes.library import MOTIONS, perform, random_body
from kinefilter.scenes.sensor import Tracker

from .study import Options, Panel, Row, Series, Study, series_of
from .study_takes import clips_of, first_person, recorded_people

_TEST_PEOPLE = ("s06", "s07", "s08")  # the error model was fitted to the others
_CLIPS = 200  # per person, approximately
_TRACKERS: tuple[Tracker, ...] = ("model", "depth")
_RECORDED = "recorded"
_GROUPS = {**{f"{part.lower()}s": part for part in LIMB_PARTS}, "all": ""}
"""Groups of limb joints, by the beginning of their names."""
_RATE = 30.0  # frames per second of the clips
_LONGEST = 45  # largest lag of the autocorrelation, in frames


def tracker_errors(options: Options, *, clips: int = 16) -> Study:
    """Compare the errors of trackers on movements recorded with marker mocap.

    The virtual Kinect's two trackers record the mocap of three people, ``clips`` of
    each, beside a real Kinect v2. Neither the people nor their movements were in the
    training data of the tracker of depth images; the size of the model's errors was
    adjusted by hand to these people. The figures are those of ``error_figures`` and the
    share of joints that are inferred, which the recordings do not have. Without
    recordings, simulated people perform scripted motions.
    """
    pairs = _acts(options, clips)
    recorded = {_RECORDED: pairs} if options.data is not None else {}
    with workers() as pool:
        for tracker in _TRACKERS:
            found = pool.map(partial(seen_by, tracker=tracker), pairs)
            steps = options.progress(tracker, len(pairs))
            recorded[tracker] = [next(found) for _ in steps]
    errors = {name: [_error(pair) for pair in own] for name, own in recorded.items()}
    rows: list[Row] = []
    for (group, part), name in product(_GROUPS.items(), recorded):
        joints = [KINECT_V1.index(j) for j in LIMBS if j.startswith(part)]
        own = [error[:, joints] for error in errors[name]]
        other, inferred = None, None
        if name != _RECORDED:
            flags = [p.inferred for p in recorded[name] if p.inferred is not None]
            inferred = 100.0 * float(np.concatenate(flags)[:, joints].mean())
            if _RECORDED in recorded:
                other = [error[:, joints] for error in errors[_RECORDED]]
        rows.append((f"{group}, {name}", *error_figures(own, other), inferred))
    bars: list[Series] = []
    for k, name in enumerate(recorded):
        own_rows = rows[k :: len(recorded)]
        bars += series_of(own_rows, {name: 2}, x=[*_GROUPS], kind="bars")
    title = f"Errors of trackers, relative to the hips, in {len(pairs)} clips"
    header = (
        *("joints, tracker", "offset_cm", "moving_cm", "time_s"),
        *("over_7_cm_percent", "like_recorded", "inferred_percent"),
    )
    return Study(title, header, rows, [Panel("joints", "moving error, cm", bars)])


def _acts(options: Options, clips: int) -> list[Pair]:
    if options.data is not None:
        files = [options.data / "ui-prmd" / f"{person}.npz" for person in _TEST_PEOPLE]
        return [p for file in files for p in pairs_of(file, max(_CLIPS // clips, 1))]
    pairs, first = [], first_person(options.seed)
    for k in range(clips):
        body = random_body(KINECT_V1, np.random.default_rng(first + k))
        act = perform(MOTIONS[k % len(MOTIONS)], body, seed=first + k)
        pairs.append(Pair(f"m{k:02d}_s{k:02d}", act.positions, act.positions, act))
    return pairs


def _error(pair: Pair) -> Array:
    error = pair.error
    return np.asarray(error - error[:, KINECT_V1.hips].mean(axis=1, keepdims=True))


def error_figures(
    clips: Sequence[Array], other: Sequence[Array] | None = None
) -> tuple[float, float, float, float, float | None]:
    """Return figures of a tracker's errors.

    ``clips`` are errors [m] at 30 frames per second, NaN where unknown, each (T, J, 3),
    ``other`` those of another tracker in the same frames. The figures are the mean size
    of the constant part over a clip [cm]; of the rest, the moving error, the root mean
    square [cm], the time after which its autocorrelation is below 1/e [s], how often it
    is over 7 cm [%], and its correlation with that of the other tracker.
    """
    offsets = [np.nanmean(clip, axis=0) for clip in clips]
    moving = [clip - mean for clip, mean in zip(clips, offsets, strict=True)]
    size = np.concatenate([np.linalg.norm(e, axis=-1).ravel() for e in moving])
    size = size[np.isfinite(size)]
    constant = np.concatenate([np.linalg.norm(e, axis=-1) for e in offsets])
    alike = None
    if other is not None:
        others = [clip - np.nanmean(clip, axis=0) for clip in other]
        both = np.stack([np.concatenate([*map(np.ravel, m)]) for m in (moving, others)])
        alike = float(np.corrcoef(both[:, np.isfinite(both).all(axis=0)])[0, 1])
    return (
        100.0 * float(np.nanmean(constant)),
        100.0 * float(np.sqrt(np.mean(size**2))),
        _correlation_time(moving),
        100.0 * float(np.mean(size > FAR)),
        alike,
    )


def _correlation_time(moving: Sequence[Array]) -> float:
    """Return the time [s] after which the autocorrelation of errors is below 1/e."""
    for lag in range(1, _LONGEST):
        products = squares = 0.0
        for clip in moving:
            early, late = clip[:-lag], clip[lag:]
            known = np.isfinite(early + late)
            products += float(np.sum((early * late)[known]))
            squares += 0.5 * float(np.sum((early**2 + late**2)[known]))
        if products < squares / math.e:
            return lag / _RATE
    return _LONGEST / _RATE


def tracker_lessons(
    options: Options, *, people: int = len(MOTIONS), clips: int = 16
) -> Study:
    """Train the method learned on simulated takes, and test it on recorded people.

    Each simulated person performs another motion on a bare floor. Both trackers record
    the same performances; ``perfect`` records the truth, and with ``offsets off`` each
    joint's constant offset over a take is removed from the training data. Three people
    whom the error model was not fitted to are tested, ``clips`` of each, through
    ``clean`` without physics. The last rows also train on the three other people.
    Without recordings, simulated people stand in.
    """
    known, test = _people(options, clips)
    skeleton = test[0].take.skeleton
    with workers() as pool:
        simulated: dict[str, list[PairedTake]] = {}
        for tracker in _TRACKERS:
            record = partial(simulated_pair, skeleton=skeleton.name, tracker=tracker)
            takes = pool.map(record, range(people))
            steps = options.progress(tracker, people)
            simulated[tracker] = [next(takes) for _ in steps]
        for tracker in _TRACKERS:
            without = [_without_offsets(pair) for pair in simulated[tracker]]
            simulated[f"{tracker}, offsets off"] = without
        perfect = [replace(p, take=truth_of(p)) for p in simulated["model"]]
        simulated["perfect"] = perfect
        sets: dict[str, tuple[list[PairedTake], list[PairedTake]]] = {"none": ([], [])}
        sets |= {name: (pairs, []) for name, pairs in simulated.items()}
        sets["recorded"] = (known, [])
        sets |= {f"recorded and {name}": (known, simulated[name]) for name in _TRACKERS}
        jobs = [pool.submit(_train_and_test, *pairs, test) for pairs in sets.values()]
        found = [job.result() for job in over(jobs, "train", options.progress)]
    base = found[0]
    rows: list[Row] = []
    for name, errors in zip(sets, found, strict=True):
        changes = [100.0 * (a / b - 1.0) for a, b in zip(errors, base, strict=True)]
        rows.append((name, *errors, *changes))
    bars = series_of(rows, {"E": 1, "E_var": 2}, kind="bars")
    title = f"Training on simulated takes, tested on {len(test)} recorded clips"
    header = ("taught_by", "E_cm", "E_var_cm", "E_percent", "E_var_percent")
    return Study(title, header, rows, [Panel("training data", "error, cm", bars)])


def _people(options: Options, clips: int) -> tuple[list[PairedTake], list[PairedTake]]:
    people = recorded_people(options.data)
    held_out = [p for p in people if p in _TEST_PEOPLE] or people[len(people) // 2 :]
    known = clips_of([p for p in people if p not in held_out], 10, options)
    test = []
    for person in held_out:
        own = clips_of([person], 10, options)
        test += own[:: max(len(own) // clips, 1)]
    return known, test


def _without_offsets(pair: PairedTake) -> PairedTake:
    offsets = mean_of_known(pair.take.positions - pair.truth)
    positions = pair.take.positions - np.nan_to_num(offsets)
    return replace(pair, take=replace(pair.take, positions=positions))


def _train_and_test(
    pairs: list[PairedTake], simulated: list[PairedTake], test: list[PairedTake]
) -> tuple[float, float]:
    skeleton = test[0].take.skeleton
    config = CleanConfig("learned" if pairs else "none", physics=False)
    if pairs:
        more = training_set(simulated) if simulated else None
        learner = FourierRidgeLearner(skeleton)
        method: Corrector = learner.fit(training_set(pairs), simulated=more)
    else:
        method = make_corrector(skeleton, config)
    summary = tally_clips(test, method, config).summary()
    return summary["E"], summary["E_var"]
