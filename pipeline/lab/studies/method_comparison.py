"""Methods and presets against mocap: new people, new repetitions, hidden limbs."""

import zlib
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from kinefilter.characters import Take
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.cleaner import Cleaner
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.correct import Corrector, Hold
from kinefilter.pipeline.lab.accuracy import LIMBS, Accuracy
from kinefilter.pipeline.lab.evaluate import evaluate
from kinefilter.pipeline.lab.hidden_limb_evaluation import middle
from kinefilter.pipeline.lab.limb_guesses import HIDDEN, Guess, hide
from kinefilter.pipeline.lab.limb_lessons import train_prior_on, with_prior
from kinefilter.pipeline.lab.systems import CorrectorFactory, System, systems_of
from kinefilter.pipeline.methods import PRESETS
from kinefilter.pipeline.pairs import PairedTake
from kinefilter.pipeline.progress import over, silent
from kinefilter.pipeline.reconstruct import MotionPrior
from kinefilter.pipeline.target.floor import leveled
from kinefilter.pipeline.workers import workers

from .study import Options, Panel, Row, Study, series_of
from .study_takes import (
    clips_of,
    correction,
    recorded_folds,
    recorded_people,
    view_lessons,
)

GUESSES: dict[str, Guess | None] = {
    "drifting": "drift",
    "leaping": "hang",
    "missing": "none",
    "seen": None,
}
"""What the sensor reports of a limb in the middle of a clip: it drifts away at 20 cm/s,
hangs straight down from the first frame on, is missing, or is visible after all."""

_LIMBS = ("right-arm", "left-arm", "arms", "left-leg")  # hidden in turn
_GAP = "55%"
_ONE_IN = 20  # one in this many clips is tested
Errors = dict[str, dict[str, float]]  # [cm] by method and situation
Turn = tuple[float, float]  # tilt and roll [rad] by which a motion was leveled
Runner = Callable[[Take], tuple[Array, Turn]]  # to joint positions [m], leveled


def hidden_limb_errors(
    options: Options,
    *,
    methods: Sequence[str] = (),
    presets: Sequence[str] = (),
    whole: bool = False,
    guesses: Collection[str] = tuple(GUESSES),
    every: int = _ONE_IN,
    count: int,
    most: int,
) -> Errors:
    """Return errors of systems by situation, with ``raw`` and ``none`` for comparison.

    Means are over frames, joints and clips, then over people. Each person is tested
    with a limb of every twentieth clip hidden, by systems trained on the others, with
    nothing hidden. ``known people`` are in the training data with repetitions 1 to 7
    and are tested on 8 to 10. Errors are those of the hidden joints while they are
    hidden; with ``all joints``, of all limb joints then; for ``seen``, of all limb
    joints in the whole clip. ``none`` is ``clean --method none`` without physics.

    ``methods`` and ``presets`` are as for ``systems_of``. With ``whole``, complete
    clips from ``clean`` are measured instead of the corrected joints; ``guesses`` is a
    selection from ``GUESSES``. One in ``every`` clips is tested, of at most ``count``
    people and ``most`` clips of each.
    """
    people = recorded_people(options.data)[:count]
    run = partial(_errors_on, systems_of(methods, presets), whole, guesses)
    with workers() as pool:
        jobs = [
            pool.submit(run, train, test[::every][:most])
            for _, train, test in recorded_folds(people, options)
        ]
        *new, known = (job.result() for job in over(jobs, "people", options.progress))
    return {
        name: {
            where: float(np.mean([part[name][where] for part in new]))
            for where in errors
        }
        | {f"{where}, known people": error for where, error in known[name].items()}
        for name, errors in new[0].items()
    }


def _errors_on(
    systems: Sequence[System],
    whole: bool,
    guesses: Collection[str],
    train: Sequence[PairedTake],
    test: Sequence[PairedTake],
) -> Errors:
    trainer, prior = CorrectorFactory(train), train_prior_on(train)
    none = _whole(CleanConfig("none", physics=False), None, prior)
    runners: dict[str, Runner] = {"raw": _raw, "none": none}
    for system in systems:
        corrector = trainer.corrector(system)
        runners[system.label] = (
            _whole(system.config, corrector, prior)
            if whole
            else _unleveled(correction(system.config, corrector))
        )
    return {name: _means(test, run, guesses) for name, run in runners.items()}


def _raw(take: Take) -> tuple[Array, Turn]:
    """Return a take's joints, with missing ones on their last bones, not leveled."""
    return Hold(take.skeleton).fill(take.positions), (0.0, 0.0)


def _whole(config: CleanConfig, method: Corrector | None, prior: MotionPrior) -> Runner:
    cleaner = with_prior(Cleaner(config, corrector=method), config, prior)

    def run(take: Take) -> tuple[Array, Turn]:
        clip = cleaner.clean(take).clip
        return clip.positions, (clip.tilt, clip.roll)

    return run


def _unleveled(run: Callable[[Take], Array]) -> Runner:
    return lambda take: (run(take), (0.0, 0.0))


def _means(
    clips: Sequence[PairedTake], run: Runner, guesses: Collection[str] = tuple(GUESSES)
) -> dict[str, float]:
    found: dict[str, list[float]] = {}
    for k, pair in enumerate(clips):
        take, skeleton = pair.take, pair.take.skeleton
        span = middle(take, _GAP)
        if span is None:
            continue
        accuracy = Accuracy(skeleton)
        names = HIDDEN[_LIMBS[k % len(_LIMBS)]]
        hidden = [limb in names for limb in LIMBS]
        joints = [skeleton.index(j) for j in names if j in skeleton.joints]
        seed = zlib.crc32(pair.clip.encode())
        for where in guesses:
            guess = GUESSES[where]
            shown = take if guess is None else hide(take, joints, span, guess, seed)
            positions, turn = run(shown)
            errors = 100.0 * accuracy.distances(positions, leveled(pair.truth, *turn))
            parts = {where: errors}
            if guess is not None:
                gap = errors[span]
                parts = {where: gap[:, hidden], f"{where}, all joints": gap}
            for name, part in parts.items():
                found.setdefault(name, []).append(float(np.nanmean(part)))
    return {where: float(np.mean(errors)) for where, errors in found.items()}


_METHODS = (
    *("none", "butterworth", "savgol", "one-euro", "kalman", "low-rank", "local-pca"),
    *("exemplar", "full-gp", "local-gp", "clustered-gp", "learned"),
    # Shum's methods A and B, and local-gp without terms of its energy (Liu, Table 5).
    *("nearest", "no-reliability", "local-gp:temporal=0:reliability=0"),
    *("local-gp:reliability=0", "local-gp:temporal=0"),
)
_ERRORS = ("E", "E_std", "E_var")
_EVERY = 5  # one in this many test clips is cleaned, with every method
_RIVALS = ("joint-offsets", "local-pca", "learned")
_BOUND = "zhou-2014:variance=bound"
_PRESETS_EVERY = 60  # one in this many clips
_SITUATIONS = ("seen", "seen, known people", "drifting", "missing")
_CUTS = {
    "shum-2013": 31.6,  # table IV, the median of its three classes
    "shen-2012": 28.0,  # Liu 2016, table 3: mean of its four motions
    _BOUND: 44.4,
    "liu-2016": 43.4,
    "liu-2016:adapt=false": 39.8,
    "chiang-2017": 74.7,  # table 2, all samples: mean of its four exercises
}
"""Reduction of Kinect's error in the papers [%]."""
_People = dict[str, dict[str, float]]  # errors [cm] by person and name


def methods_new_people(
    options: Options, *, count: int = 1000, movements: int = 10
) -> Study:
    """Test every method on each person, trained on all the others.

    As ``kinefilter evaluate --train PEOPLE --mocap-database``, but ``learned`` learns
    from people before two sensors too, as the default has. Errors are means over
    frames and joints, then over people. One in five clips is tested, through the whole
    cleaner. Without recordings, simulated people stand in. At most ``count`` people in
    their first ``movements`` are used.
    """
    people = recorded_people(options.data)[:count]
    quiet = replace(options, progress=silent)  # worker processes show no progress
    run = partial(_on_person, people, movements, quiet)
    merged: dict[str, _People] = {}
    with workers() as pool:
        parts = pool.map(run, people)
        for _ in options.progress("people", len(people)):
            for method, errors in next(parts).items():
                merged.setdefault(method, {}).update(errors)
    return _study("Methods on people who are not in their training data", merged)


def methods_known_people(
    options: Options, *, count: int = 1000, movements: int = 10
) -> Study:
    """Test every method on new repetitions by the people in its training data.

    As ``kinefilter evaluate --train PEOPLE --protocol repetitions``. Otherwise like
    ``methods_new_people``.
    """
    people, progress = recorded_people(options.data)[:count], options.progress
    clips = clips_of(people, movements, options)
    figures = evaluate(
        clips,
        [],
        _METHODS,
        protocol="repetitions",
        views=view_lessons(options),
        every=_EVERY,
        progress=progress,
    )
    title = "Methods on new repetitions by the people in their training data"
    return _study(title, _errors(figures))


def _on_person(
    people: Sequence[str], movements: int, options: Options, name: str
) -> dict[str, _People]:
    test = clips_of([name], movements, options)[::_EVERY]
    train = clips_of([other for other in people if other != name], movements, options)
    views = view_lessons(options)
    return _errors(evaluate(train, test, _METHODS, database="mocap", views=views))


def _errors(figures: dict[str, Any]) -> dict[str, _People]:
    return {method: found["people"] for method, found in figures["methods"].items()}


def _study(title: str, errors: dict[str, _People]) -> Study:
    by_method = {
        method: np.array(
            [[found[person][key] for key in _ERRORS] for person in errors["raw"]]
        )
        for method, found in errors.items()
    }
    raw = by_method["raw"]
    rows: list[Row] = []
    for method, found in by_method.items():
        mean, worst = found.mean(axis=0), (found / raw).max(axis=0)
        changes = [100.0 * (ratio - 1.0) for ratio in (mean / raw.mean(axis=0), worst)]
        rows.append((method, *np.concatenate([mean, *changes]).tolist()))
    bars = series_of(rows, {"E": 1, "E_std": 2, "E_var": 3}, kind="bars")
    figures = ("cm", "change_percent", "worst_person_percent")
    header = ("method", *(f"{key}_{figure}" for figure in figures for key in _ERRORS))
    panels = [Panel("method", "error, cm", bars)]
    return Study(f"{title}: {len(raw)} people", header, rows, panels)


def presets(options: Options, *, count: int = 1000, clips: int = 1000) -> Study:
    """Test the papers' systems beside methods, on recorded people and hidden limbs.

    Errors are those of clips from ``clean``: ``all_cm`` with nothing hidden,
    ``hidden_cm`` of the joints of a limb while the sensor guesses it (it drifts at 20
    cm/s) or does not see it. Each person is left out of training in turn; ``known`` are
    new repetitions by people in the training data, to whom the papers' reductions
    refer. At most ``count`` people take part, with ``clips`` each. The process over all
    samples uses a bound on its variance, in a fiftieth of the time.
    """
    named = [_BOUND if name == "zhou-2014" else name for name in PRESETS]
    found = hidden_limb_errors(
        options,
        methods=_RIVALS,
        presets=[*named, "liu-2016:adapt=false"],
        whole=True,
        guesses=("seen", "drifting", "missing"),
        every=_PRESETS_EVERY,
        count=count,
        most=clips,
    )
    raw = found["raw"]["seen, known people"]
    rows: list[Row] = []
    for name, errors in found.items():
        figures = [errors[where] for where in _SITUATIONS]
        cut = 100.0 * (1.0 - errors["seen, known people"] / raw)
        rows.append((name, *figures, cut, _CUTS.get(name)))
    bars = series_of(rows, {"new": 1, "known": 2, "drifting": 3}, kind="bars")
    title = "The papers' systems on recorded people and hidden limbs"
    header = (
        *("system", "new_all_cm", "known_all_cm", "drifting_hidden_cm"),
        *("missing_hidden_cm", "known_cut_percent", "paper_cut_percent"),
    )
    return Study(title, header, rows, [Panel("system", "error, cm", bars)])
