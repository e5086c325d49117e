"""The simulated takes of the studies: situations of Shum 2013's Table IV, and lessons.

Nobody in them has taught anything: the built-in database draws its people from seeds
under 10, takes that are tested on from seeds of 1000 and more, and pairs that methods
learn from within a study from seeds 500 higher than those.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Literal, NamedTuple

from kinefilter.pipeline.lab.simulate import simulate
from kinefilter.pipeline.pairs import PairedTake
from kinefilter.pipeline.progress import Progress, silent

Kind = Literal["a", "b", "c"]
"""Classes of movement (Shum 2013, Table IV)."""

_PEOPLE = 1000  # first seed of the people of a study; and between two studies' seeds
_AGAIN = 1_000_000  # what is added to a person's seed for another performance
_LEARNERS = 500  # how much higher the seeds of the people are that methods learn from


class Setting(NamedTuple):
    """What is recorded."""

    scene: str
    """One of SCENES."""
    motion: str
    """One of MOTIONS."""
    sensor: str
    """One of SENSORS."""


CLASSES: dict[Kind, tuple[Setting, ...]] = {
    "a": (
        Setting("basic", "cross_arms", "v1"),
        Setting("basic", "cross_arms", "v2"),
        Setting("basic", "turn", "v1"),
        Setting("basic", "turn", "v2"),
        Setting("basic", "squat", "v1"),
        Setting("basic", "squat", "v2"),
        Setting("basic", "tai_chi", "v1"),
        Setting("basic", "tai_chi", "v2"),
        Setting("basic", "wave", "v1"),
        Setting("basic", "punch", "v2"),
        Setting("basic", "march", "v1"),
        Setting("basic", "bend", "v2"),
    ),
    "b": (
        Setting("office", "wave", "v1"),
        Setting("office", "talk", "v2"),
        Setting("office", "cross_arms", "v1"),
        Setting("office", "turn", "v2"),
        Setting("flip_chart", "wave", "v1"),
        Setting("flip_chart", "clasp_and_spread", "v2"),
        Setting("flip_chart", "side_lunge", "v1"),
        Setting("flip_chart", "side_lunge", "v2"),
        Setting("box", "wave", "v1"),
        Setting("box", "raise_arms", "v2"),
        Setting("box", "turn", "v1"),
        Setting("box", "turn", "v2"),
    ),
    "c": (
        Setting("box", "lift_box", "v1"),
        Setting("flip_chart", "flip_chart", "v1"),
        Setting("flip_chart", "flip_chart", "v2"),
        Setting("box", "lift_box", "v2"),
        Setting("basketball", "basketball", "v1"),
        Setting("basketball", "basketball", "v2"),
        Setting("chair", "chair", "v1"),
        Setting("chair", "chair", "v2"),
        Setting("chair", "sit_to_stand", "v1"),
        Setting("office", "office", "v1"),
        Setting("office", "office", "v2"),
        Setting("office", "office", "v2"),
    ),
}
"""(a) self-occluded and un-occluded movements; (b) movements with a thing before the
person that nobody touches: a desk, a flip chart, a box (a chair stands behind and hides
nothing); (c) movements with a thing, hidden by it. Under seed 0 those who use the flip
chart stand beside it with the right hand, as the chart does."""


def people_of(seed: int, *, learners: bool = False) -> int:
    """Return the seed of the first person of a study.

    Args:
        seed: Of the study.
        learners: The people whom methods learn from, not those they are tested on.
    """
    return _PEOPLE * (1 + seed) + (_LEARNERS if learners else 0)


def study_takes(
    kind: Kind, *, seed: int = 0, count: int = 12, progress: Progress = silent
) -> list[PairedTake]:
    """Return the takes of a class, each of another person, and their truth.

    The frame is the sensor's, the proportions are the person's own.

    Args:
        kind: Which class of movement.
        seed: Draws people, performances and the sensor's errors.
        count: How many takes; fewer than 12 are spread over the class.
        progress: Wraps the loop over the takes, for a progress bar.
    """
    settings = CLASSES[kind]
    first = people_of(seed) + len(settings) * list(CLASSES).index(kind)
    chosen = [k * len(settings) // count for k in range(min(count, len(settings)))]
    return [
        _recorded(settings[chosen[k]], first + chosen[k], first + chosen[k])
        for k in progress(f"record ({kind})", len(chosen))
    ]


@lru_cache(maxsize=256)  # studies share takes: 0.4 s and 0.4 MB each
def _recorded(setting: Setting, seed: int, person: int) -> PairedTake:
    scene, motion, sensor = setting
    return simulate(scene, motion, sensor=sensor, seed=seed, person=person)


def performed_by(
    people: Sequence[int],
    motions: Sequence[str],
    *,
    sensor: str = "v2",
    again: bool = False,
    progress: Progress = silent,
) -> list[PairedTake]:
    """Return every motion by every person on a bare floor, and the truth.

    Args:
        people: Seeds of the people.
        motions: Out of MOTIONS.
        sensor: One of SENSORS.
        again: Other performances than without this.
        progress: Wraps the loop over the takes, for a progress bar.
    """
    pairs = []
    for k in progress("record", len(people) * len(motions)):
        person, motion = people[k // len(motions)], motions[k % len(motions)]
        setting, seed = Setting("basic", motion, sensor), person + _AGAIN * again
        pairs.append(_recorded(setting, seed, person))
    return pairs
