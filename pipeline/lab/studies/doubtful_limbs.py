"""Recorded people whose limbs the sensor guesses: what terms of an energy are worth."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from kinefilter.characters import Take
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.cleaner import Cleaner
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.correct import Corrector, Hold
from kinefilter.pipeline.lab.accuracy import LIMBS, Accuracy
from kinefilter.pipeline.lab.hidden_limbs import middle
from kinefilter.pipeline.lab.limb_guesses import HIDDEN, Guess, hide
from kinefilter.pipeline.lab.limb_lessons import knowing, taught_by
from kinefilter.pipeline.lab.systems import System, systems_of
from kinefilter.pipeline.pairs import PairedTake
from kinefilter.pipeline.progress import silent
from kinefilter.pipeline.reconstruct import MotionPrior
from kinefilter.pipeline.target.floor import leveled
from kinefilter.pipeline.workers import workers

from .study import Options
from .takes import recorded_people
from .trial import corrects, school_of, split

GUESSES: dict[str, Guess | None] = {
    "drifting": "drift",
    "leaping": "hang",
    "missing": "none",
    "seen": None,
}
"""What the sensor says of a limb in the middle of a clip: it drifts away by 20 cm/s,
hangs down from the first frame on, is not told; nothing is hidden."""

_LIMBS = ("right-arm", "left-arm", "arms", "left-leg")  # hidden in turn
_GAP = "55%"
_EVERY = 20  # one in this many clips is tested
Errors = dict[str, dict[str, float]]
"""Errors [cm] by method and situation."""
Turn = tuple[float, float]
"""Tilt and roll [rad] that were taken out of a motion."""
Maker = Callable[[Take], tuple[Array, Turn]]
"""Makes joint positions [m] of a take, and says how they were turned."""


def errors_in_doubt(
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
    """Return errors of systems and of their rivals, by situation.

    Means are over frames, joints and clips, then over people. Each of them is tested
    with a limb of every twentieth clip hidden; what learns, learns from the others, in
    whose takes nothing is hidden; ``known people`` teach by repetitions 1 to 7 and are
    tested on 8 to 10. Errors are those of the hidden joints in the frames in which they
    are hidden, of ``all joints`` of limbs in those frames, and for ``seen`` of all in
    the whole clip. ``none`` is what ``clean --method none`` does without physics; it
    looks ahead, and bridges gaps from both ends.

    Args:
        options: Where the recordings are.
        methods: Names as ``systems_of`` has them.
        presets: Likewise.
        whole: Measure clips as ``clean`` makes them, in the place of what correction
            gives.
        guesses: Which of ``GUESSES``.
        every: One in this many clips is tested.
        count: People at most.
        most: Clips of a person at most.
    """
    people = recorded_people(options.data)[:count]
    quiet = replace(options, progress=silent)
    systems = systems_of(methods, presets)
    sizes = every, most, guesses
    run = partial(_errors_of, people, systems, whole, sizes, quiet)
    with workers() as pool:
        parts = pool.map(run, [*people, None])
        found = [next(parts) for _ in options.progress("people", len(people) + 1)]
    *new, known = found
    return {
        name: {
            where: float(np.mean([part[name][where] for part in new]))
            for where in errors
        }
        | {f"{where}, known people": error for where, error in known[name].items()}
        for name, errors in new[0].items()
    }


def _errors_of(
    people: Sequence[str],
    systems: Sequence[System],
    whole: bool,
    sizes: tuple[int, int, Collection[str]],
    options: Options,
    person: str | None,
) -> Errors:
    """Return the errors on somebody; None: on everybody's late repetitions."""
    train, test = split(people, person, options)
    test = test[:: sizes[0]][: sizes[1]]
    school, prior = school_of(train, options), taught_by(train)
    smoothed = _made(CleanConfig("none", physics=False), None, prior)
    makers: dict[str, Maker] = {"raw": _raw, "none": smoothed}
    for system in systems:
        corrector = school.corrector(system)
        makers[system.label] = partial(_corrected, system.config, corrector)
        if whole:
            makers[system.label] = _made(system.config, corrector, prior)
    return {name: _means(test, maker, sizes[2]) for name, maker in makers.items()}


def _raw(take: Take) -> tuple[Array, Turn]:
    """Return a take's joints, missing ones on their last bones, unturned."""
    return Hold(take.skeleton).fill(take.positions), (0.0, 0.0)


def _made(
    config: CleanConfig, corrector: Corrector | None, prior: MotionPrior
) -> Maker:
    cleaner = knowing(Cleaner(config, corrector=corrector), config, prior)

    def cleaned(take: Take) -> tuple[Array, Turn]:
        clip = cleaner.clean(take).clip
        return clip.positions, (clip.tilt, clip.roll)

    return cleaned


def _corrected(
    config: CleanConfig, corrector: Corrector, take: Take
) -> tuple[Array, Turn]:
    return corrects(config, corrector)(take), (0.0, 0.0)


def _means(
    clips: Sequence[PairedTake],
    maker: Maker,
    guesses: Collection[str] = tuple(GUESSES),
) -> dict[str, float]:
    """Return the errors [cm] on some clips, by situation."""
    found: dict[str, list[float]] = {}
    for k, pair in enumerate(clips):
        span = middle(pair.take, _GAP)
        if span is None:
            continue
        accuracy = Accuracy(pair.take.skeleton)
        names = HIDDEN[_LIMBS[k % len(_LIMBS)]]
        hidden = [limb in names for limb in LIMBS]
        skeleton = pair.take.skeleton
        joints = [skeleton.index(j) for j in names if j in skeleton.joints]
        seed = zlib.crc32(pair.clip.encode())
        for where in guesses:
            guess = GUESSES[where]
            take = pair.take
            if guess is not None:
                take = hide(take, joints, span, guess, seed)
            positions, turn = maker(take)
            away = 100.0 * accuracy.distances(positions, leveled(pair.truth, *turn))
            if guess is None:
                found.setdefault(where, []).append(float(np.nanmean(away)))
                continue
            blind = away[span]
            found.setdefault(where, []).append(float(np.nanmean(blind[:, hidden])))
            found.setdefault(f"{where}, all joints", []).append(
                float(np.nanmean(blind))
            )
    return {where: float(np.mean(errors)) for where, errors in found.items()}
