"""The takes of the studies: recordings where there are any, and simulated people.

Simulated people in tests are in no training data: the built-in database draws people
from seeds below 10, test takes from 1000 up, and training data from 500 higher.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from kinefilter.characters import InputError
from kinefilter.pipeline.draft import Draft
from kinefilter.pipeline.lab.simulation import simulate
from kinefilter.pipeline.lab.training import observed
from kinefilter.pipeline.pairs import PairedTake, read_pairs
from kinefilter.pipeline.progress import Progress, over, silent

from .study import Options

RECORDINGS = Path("../shared/data")  # default folder; not part of kinefilter
_PEOPLE = 1000  # first seed of a study's people; also the distance between studies
_AGAIN = 1_000_000  # added to a person's seed for another performance
_LEARNERS = 500  # added to the seeds of people in the training data

_STAND_INS = 4  # simulated people in place of recorded ones
_MOVEMENTS = ("squat", "side_lunge", "raise_arms")  # theirs, as in rehabilitation
_REPETITIONS = 10  # of each movement, as in the recordings

Setting = tuple[str, str, str]  # one of SCENES, of MOTIONS and of SENSORS


def _settings(listed: str) -> list[Setting]:
    return [(s, m, v) for s, m, v in (one.split("/") for one in listed.split())]


CLASSES: dict[str, list[Setting]] = {
    "a": _settings(
        "basic/cross_arms/v1 basic/cross_arms/v2 basic/turn/v1 basic/turn/v2 "
        "basic/squat/v1 basic/squat/v2 basic/tai_chi/v1 basic/tai_chi/v2 "
        "basic/wave/v1 basic/punch/v2 basic/march/v1 basic/bend/v2"
    ),
    "b": _settings(
        "office/wave/v1 office/talk/v2 office/cross_arms/v1 office/turn/v2 "
        "flip_chart/wave/v1 flip_chart/clasp_and_spread/v2 flip_chart/side_lunge/v1 "
        "flip_chart/side_lunge/v2 box/wave/v1 box/raise_arms/v2 box/turn/v1 box/turn/v2"
    ),
    "c": _settings(
        "box/lift_box/v1 flip_chart/flip_chart/v1 flip_chart/flip_chart/v2 "
        "box/lift_box/v2 basketball/basketball/v1 basketball/basketball/v2 "
        "chair/chair/v1 chair/chair/v2 chair/sit_to_stand/v1 "
        "office/office/v1 office/office/v2 office/office/v2"
    ),
}
"""Classes of movement (Shum 2013, Table IV): (a) self-occluded and unoccluded ones;
(b) those behind a prop that no one touches: a desk, a flip chart, a box (the chair
stands behind the person and hides nothing); (c) those with a prop that hides the
person. With seed 0, all users of the flip chart use it on their right, where it is."""


def first_person(seed: int, *, learners: bool = False) -> int:
    """Return the seed of a study's first test person, or of its first learner."""
    return _PEOPLE * (1 + seed) + (_LEARNERS if learners else 0)


def study_takes(kind: str, options: Options, *, count: int = 12) -> list[PairedTake]:
    """Return takes of a class with their ground truth, each of a different person."""
    settings = CLASSES[kind]
    first = first_person(options.seed) + len(settings) * list(CLASSES).index(kind)
    chosen = [k * len(settings) // count for k in range(min(count, len(settings)))]
    return [
        _recorded(settings[k], first + k, first + k)
        for k in over(chosen, f"record ({kind})", options.progress)
    ]


def performed_by(
    people: Sequence[int],
    motions: Sequence[str],
    *,
    sensor: str = "v2",
    again: bool = False,
    progress: Progress = silent,
) -> list[PairedTake]:
    """Return each person's take of each motion on a bare floor; ``again``: a repeat."""
    acts = [(person, motion) for person in people for motion in motions]
    return [
        _recorded(("basic", motion, sensor), person + _AGAIN * again, person)
        for person, motion in over(acts, "record", progress)
    ]


@lru_cache(maxsize=256)  # studies share takes; each costs 0.4 s and 0.4 MB
def _recorded(setting: Setting, seed: int, person: int) -> PairedTake:
    scene, motion, sensor = setting
    return simulate(scene, motion, sensor=sensor, seed=seed, person=person)


def recordings_folder(data: Path | None) -> Path | None:
    """Return the given folder, or InputError; without, the default one if it exists."""
    if data is None:
        return RECORDINGS if RECORDINGS.is_dir() else None
    if not data.is_dir():
        raise InputError(f"{data}: folder not found; give the folder of the recordings")
    return data


def recorded_takes(data: Path | None) -> list[Path]:
    """Return the files of the recorded takes, sorted; none without recordings."""
    if data is None:
        return []
    folder = data / "takes"
    return sorted([*folder.glob("*/*.csv"), *folder.glob("*/*.csv.gz")])


def recorded_people(data: Path | None) -> list[str]:
    """Return the names of the people recorded with marker mocap, or of stand-ins."""
    if data is None:
        return [f"simulated {k + 1}" for k in range(_STAND_INS)]
    names = sorted(path.stem for path in (data / "ui-prmd").glob("s*.npz"))
    if not names:
        raise InputError(f"{data}: no ui-prmd/s*.npz in this folder of recordings")
    return names


def clips_of(
    people: Iterable[str], movements: int, options: Options
) -> list[PairedTake]:
    """Return the clips of some ``recorded_people`` in their first movements."""
    clips: list[PairedTake] = []
    for name in people:
        if options.data is None:
            clips += _simulated_clips(name, movements, options.seed)
        else:
            own = read_pairs(options.data / "ui-prmd" / f"{name}.npz")
            known = sorted({pair.clip[:3] for pair in own})[:movements]
            clips += [pair for pair in own if pair.clip[:3] in known]
    return clips


def _simulated_clips(name: str, movements: int, seed: int) -> Iterator[PairedTake]:
    k = recorded_people(None).index(name)
    person = first_person(seed) + k
    for n in range(len(_MOVEMENTS[:movements]) * _REPETITIONS):
        m, e = divmod(n, _REPETITIONS)
        pair = simulate("basic", _MOVEMENTS[m], seed=person + 100 * n, person=person)
        clip = f"m{m + 1:02d}_s{k + 1:02d}_e{e + 1:02d}"  # named like recorded clips
        yield replace(pair, subject=name, clip=clip)


def standardized(pair: PairedTake) -> Draft:
    """Return a take on the standard body, with reliability 0 where joints miss."""
    draft = observed(pair)
    missing = np.isnan(draft.standard[..., 0])
    draft.reliability = np.where(missing, 0.0, draft.reliability)
    return draft
