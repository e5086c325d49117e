"""Errors of systems on recorded people with hidden limbs."""

import zlib
from collections.abc import Callable, Collection, Sequence
from functools import partial

import numpy as np

from kinefilter.characters import Take
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.cleaner import Cleaner
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.correct import Corrector, Hold
from kinefilter.pipeline.lab.accuracy import LIMBS, Accuracy
from kinefilter.pipeline.lab.hidden_limb_evaluation import middle
from kinefilter.pipeline.lab.limb_guesses import HIDDEN, Guess, hide
from kinefilter.pipeline.lab.limb_lessons import train_prior_on, with_prior
from kinefilter.pipeline.lab.systems import CorrectorFactory, System, systems_of
from kinefilter.pipeline.pairs import PairedTake
from kinefilter.pipeline.progress import over
from kinefilter.pipeline.reconstruct import MotionPrior
from kinefilter.pipeline.target.floor import leveled
from kinefilter.pipeline.workers import workers

from .study import Options
from .study_takes import recorded_people
from .trial import correction, recorded_folds

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
_EVERY = 20  # one in this many clips is tested
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
    every: int = _EVERY,
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
