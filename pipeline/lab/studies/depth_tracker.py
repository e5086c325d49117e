"""The tracker of depth images beside the error model (Liu 2016, section 5.4)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from functools import partial
from itertools import product
from typing import NamedTuple

import numpy as np

from kinefilter.characters import KINECT_V1, State
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.factory import make_corrector
from kinefilter.pipeline.lab.accuracy import FAR, LIMBS
from kinefilter.pipeline.lab.evaluate import tallied
from kinefilter.pipeline.lab.methods.fourier_ridge_learner import FourierRidgeLearner
from kinefilter.pipeline.lab.recorded_acts import Pair, pairs_of, seen_by
from kinefilter.pipeline.lab.simulate import simulated_pair
from kinefilter.pipeline.lab.training import training_set
from kinefilter.pipeline.pairs import PairedTake
from kinefilter.pipeline.progress import Progress
from kinefilter.pipeline.workers import workers
from kinefilter.scenes.library import MOTIONS, perform, random_body
from kinefilter.scenes.sensor import Tracker

from .study import Cell, Options, Panel, Series, Study, series_of
from .takes import clips_of, first_person, recorded_people

_TOLD = ("s06", "s07", "s08")
"""People on whom figures are told: the error model was fitted to the others."""
_CLIPS = 200  # of each of them, about
_TRACKERS: tuple[Tracker, ...] = ("model", "depth")
_RECORDED = "recorded"
_GROUPS = {
    "shoulders": "Shoulder",
    "elbows": "Elbow",
    "wrists": "Wrist",
    "hips": "Hip",
    "knees": "Knee",
    "ankles": "Ankle",
    "all": "",
}
"""Groups of limb joints, and how their names begin."""
_RATE = 30.0  # 1/s, of the clips
_LONGEST = 45  # frames apart at which errors are still compared


def tracker_errors(options: Options, *, clips: int = 16) -> Study:
    """Compare how trackers err on movements that were recorded with marker mocap.

    The two trackers of the virtual Kinect look at what marker mocap saw of three
    people, ``clips`` of each, beside what a Kinect v2 recorded of them. The tracker of
    depth images has met neither them nor their movements; the model was set by hand to
    the size of errors of these three. Errors are relative to the middle of the hips:
    the constant offset over a clip; what moves (root mean square, and the time after
    which its autocorrelation is under 1/e); how often that is over 7 cm; its
    correlation with the recorded Kinect's in the same frames; and how many joints are
    not tracked, which the recordings do not tell. Without recordings, simulated people
    do scripted motions.
    """
    pairs = _acts(options, clips)
    seen = {_RECORDED: pairs} if options.data is not None else {}
    with workers() as pool:
        for tracker in _TRACKERS:
            look = partial(seen_by, tracker=tracker)
            found = pool.map(look, pairs)
            steps = options.progress(tracker, len(pairs))
            seen[tracker] = [next(found) for _ in steps]
    errors = {name: [_error(pair) for pair in found] for name, found in seen.items()}
    rows: list[tuple[Cell, ...]] = []
    for (group, part), name in product(_GROUPS.items(), seen):
        joints = [KINECT_V1.index(j) for j in LIMBS if j.startswith(part)]
        own = [error[:, joints] for error in errors[name]]
        beside, unsure = None, None
        if name != _RECORDED:
            flags = [
                p.inferred[:, joints] for p in seen[name] if p.inferred is not None
            ]
            unsure = 100.0 * float(np.concatenate(flags).mean())
            if _RECORDED in seen:
                beside = [error[:, joints] for error in errors[_RECORDED]]
        rows.append((f"{group}, {name}", *error_figures(own, beside), unsure))
    bars = []
    for name in seen:
        sizes = [float(row[2] or 0.0) for row in rows if row[0] in _named(name)]
        bars.append(Series(name, list(_GROUPS), sizes, "bars"))
    return Study(
        title=f"How trackers err: {len(pairs)} clips, errors from the hips' middle",
        columns=(
            *("joints, tracker", "offset_cm", "moving_cm", "time_s"),
            *("over_7_cm_percent", "like_recorded", "inferred_percent"),
        ),
        rows=rows,
        panels=[Panel("joints", "moving error, cm", bars)],
    )


def _named(tracker: str) -> list[str]:
    return [f"{group}, {tracker}" for group in _GROUPS]


def _acts(options: Options, clips: int) -> list[Pair]:
    """Return what people did before the sensor, with what a Kinect made of it."""
    if options.data is not None:
        files = [options.data / "ui-prmd" / f"{person}.npz" for person in _TOLD]
        return [p for file in files for p in pairs_of(file, max(_CLIPS // clips, 1))]
    pairs, first = [], first_person(options.seed)
    for k in range(clips):
        body = random_body(KINECT_V1, np.random.default_rng(first + k))
        act = perform(MOTIONS[k % len(MOTIONS)], body, seed=first + k)
        clip = f"m{k:02d}_s{k:02d}"
        pairs.append(Pair(clip, act.positions, act.positions, act))
    return pairs


def _error(pair: Pair) -> Array:
    """Return errors relative to the middle of the hips [m], (T, J, 3)."""
    error = pair.error
    return np.asarray(error - error[:, KINECT_V1.hips].mean(axis=1, keepdims=True))


class ErrorFigures(NamedTuple):
    """How a tracker errs."""

    offset: float
    """Mean size of what is constant over a clip [cm]."""
    moving: float
    """Root mean square of the rest [cm]."""
    time: float
    """Time after which the autocorrelation of that is under 1/e [s]."""
    far: float
    """How often it is over 7 cm [%]."""
    alike: float | None
    """Its correlation with that of another tracker; None without one."""


def error_figures(
    clips: Sequence[Array], beside: Sequence[Array] | None = None
) -> ErrorFigures:
    """Return how a tracker errs.

    Args:
        clips: Errors [m] at 30 frames a second, NaN where unknown, each (T, J, 3).
        beside: Those of another tracker in the same frames.
    """
    offsets = [np.nanmean(clip, axis=0) for clip in clips]
    moving = [clip - mean for clip, mean in zip(clips, offsets, strict=True)]
    size = np.concatenate([np.linalg.norm(one, axis=-1).ravel() for one in moving])
    size = size[np.isfinite(size)]
    constant = np.concatenate([np.linalg.norm(one, axis=-1) for one in offsets])
    alike = None
    if beside is not None:
        others = [clip - np.nanmean(clip, axis=0) for clip in beside]
        both = np.stack([np.concatenate([*map(np.ravel, m)]) for m in (moving, others)])
        alike = float(np.corrcoef(both[:, np.isfinite(both).all(axis=0)])[0, 1])
    return ErrorFigures(
        100.0 * float(np.nanmean(constant)),
        100.0 * float(np.sqrt(np.mean(size**2))),
        _time(moving),
        100.0 * float(np.mean(size > FAR)),
        alike,
    )


def _time(moving: Sequence[Array]) -> float:
    """Return after what time [s] the autocorrelation of errors is under 1/e."""
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
    """Teach the method learned by simulated takes, and test it on recorded people.

    Each simulated person performs another motion of the library on a bare floor. Both
    trackers see the same performances; ``perfect`` sees the truth, and with offsets off
    each joint's constant offset over a take is taken out of what is taught. Tested are
    three people whom the error model was not fitted to, ``clips`` of each, as they pass
    through ``clean`` without physics. In the last rows the three others teach, too.
    Without recordings, simulated people stand in.
    """
    known, test = _people(options, clips)
    skeleton = test[0].take.skeleton
    with workers() as pool:
        taken: dict[str, list[PairedTake]] = {}
        for tracker in _TRACKERS:
            take = partial(simulated_pair, skeleton=skeleton.name, tracker=tracker)
            found = pool.map(take, range(people))
            taken[tracker] = [next(found) for _ in options.progress(tracker, people)]
        for tracker in _TRACKERS:
            known_offsets = [_without_offsets(pair) for pair in taken[tracker]]
            taken[f"{tracker}, offsets off"] = known_offsets
        taken["perfect"] = [_without_errors(pair) for pair in taken["model"]]
        figures = _taught(pool, taken, known, test, options.progress)
    base = figures["none"]
    rows: list[tuple[Cell, ...]] = []
    for name, errors in figures.items():
        changes = [100.0 * (a / b - 1.0) for a, b in zip(errors, base, strict=True)]
        rows.append((name, *errors, *changes))
    bars = series_of(rows, {"E": 1, "E_var": 2}, kind="bars")
    return Study(
        title=f"What simulated takes teach, on {len(test)} clips of other people",
        columns=("taught_by", "E_cm", "E_var_cm", "E_percent", "E_var_percent"),
        rows=rows,
        panels=[Panel("taught by", "error, cm", bars)],
    )


def _people(options: Options, clips: int) -> tuple[list[PairedTake], list[PairedTake]]:
    """Return clips to learn from, and clips to test on."""
    people = recorded_people(options.data)
    told = [who for who in people if who in _TOLD] or people[len(people) // 2 :]
    taught = [who for who in people if who not in told]
    known = clips_of(taught, 10, options)
    test = []
    for who in told:
        own = clips_of([who], 10, options)
        test += own[:: max(len(own) // clips, 1)]
    return known, test


def _without_errors(pair: PairedTake) -> PairedTake:
    """Return what a perfect sensor would have recorded."""
    state = np.full_like(pair.take.state, State.TRACKED)
    return replace(pair, take=replace(pair.take, positions=pair.truth, state=state))


def _without_offsets(pair: PairedTake) -> PairedTake:
    """Return what a tracker would have recorded that agrees where joints lie."""
    away = pair.take.positions - pair.truth
    seen = ~np.isnan(away)
    count = np.maximum(seen.sum(axis=0), 1)
    offset = np.where(seen, away, 0.0).sum(axis=0) / count
    return replace(
        pair, take=replace(pair.take, positions=pair.take.positions - offset)
    )


def _taught(
    pool: Executor,
    taken: Mapping[str, list[PairedTake]],
    known: list[PairedTake],
    test: list[PairedTake],
    progress: Progress,
) -> dict[str, tuple[float, float]]:
    """Return E and E_var [cm] by who taught."""
    lessons: dict[str, tuple[list[PairedTake], list[PairedTake]]] = {"none": ([], [])}
    lessons |= {name: (pairs, []) for name, pairs in taken.items()}
    lessons["recorded"] = (known, [])
    lessons |= {f"recorded and {name}": (known, taken[name]) for name in _TRACKERS}
    jobs = [pool.submit(_measured, *pairs, test) for pairs in lessons.values()]
    steps = progress("teach", len(jobs))
    found = [job.result() for job, _ in zip(jobs, steps, strict=True)]
    return dict(zip(lessons, found, strict=True))


def _measured(
    pairs: list[PairedTake], simulated: list[PairedTake], test: list[PairedTake]
) -> tuple[float, float]:
    """Return E and E_var [cm] of what pairs teach; without any: of no correction."""
    skeleton = test[0].take.skeleton
    config = CleanConfig("learned" if pairs else "none", physics=False)
    if pairs:
        more = training_set(simulated) if simulated else None
        method = FourierRidgeLearner(skeleton).fit(training_set(pairs), simulated=more)
        summary = tallied(test, method, config).summary()
    else:
        summary = tallied(test, make_corrector(skeleton, config), config).summary()
    return summary["E"], summary["E_var"]
