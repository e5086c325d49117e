"""What ``evaluate`` compares: methods and presets, with their parameters."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from kinefilter.characters import InputError, Skeleton
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.correct import Corrector, InTurn, LearnedCorrector
from kinefilter.pipeline.database import PostureDatabase
from kinefilter.pipeline.factory import make_corrector
from kinefilter.pipeline.methods import LEARNED, METHODS
from kinefilter.pipeline.pairs import PairedTake
from kinefilter.pipeline.presets import PRESETS
from kinefilter.pipeline.progress import Progress, over, silent

from .methods.lessons import TrainingSet
from .teach import teach
from .training import training_set


@dataclass(frozen=True)
class System:
    """A way to clean: methods one after the other, or a preset."""

    label: str
    """As it was asked for: ``learned+local-pca``, ``liu-2016:clusters=50``."""
    config: CleanConfig
    """How it cleans."""
    methods: tuple[str, ...]
    """Its methods, in their order."""

    @property
    def learns(self) -> bool:
        """Whether it has to be taught."""
        return any(method in LEARNED for method in self.methods)


def systems_of(
    methods: Sequence[str],
    presets: Sequence[str] = (),
    assigned: Sequence[str] = (),
    *,
    physics: bool = True,
) -> list[System]:
    """Return the systems that are asked for.

    Args:
        methods: Names out of ``METHODS``, several joined by ``+`` to follow each other,
            and after each name what is assigned: ``local-pca:neighbors=30:memory=0``.
        presets: Names out of ``PRESETS``, likewise; ``all``: each of them.
        assigned: NAME=VALUE, of every system with such a parameter.
        physics: Pull the simulated character through what methods give, as ``clean``
            does, and through what the presets give that have one.

    Raises:
        InputError: An unknown name, or a parameter that none of them has.
    """
    known: dict[str, Collection[str]] = {"method": METHODS, "preset": PRESETS}
    asked = [("method", text) for text in methods]
    for text in presets:
        every = PRESETS if text.partition(":")[0] == "all" else [text]
        rest = text.removeprefix("all") if every is PRESETS else ""
        asked += [("preset", name + rest) for name in every]
    found, used = [], set[str]()
    for what, text in asked:
        name, *own = text.split(":")
        names = name.split("+") if what == "method" else [name]
        if unknown := [one for one in names if one not in known[what]]:
            raise InputError(
                f"unknown {what} {unknown[0]!r}; known: {', '.join(known[what])}"
            )
        fitting = [one for one in assigned if _config(what, names[0], one) is not None]
        used |= {*fitting}
        given = [*fitting, *own]
        if what == "preset":
            still = [] if physics else ["physics=false"]
            config = CleanConfig(preset=name, set=(*given, *still))
            names = [PRESETS[name].method]
        else:
            config = CleanConfig(names[0], set=tuple(given), physics=physics)
        found.append(System(text, config, tuple(names)))
    if lost := [one for one in assigned if one not in used]:
        raise InputError(
            f"--set {lost[0]}: none of {', '.join(s.label for s in found)} has such a "
            "parameter; 'kinefilter clean --preset NAME --set help' lists those of one"
        )
    return found


def _config(what: str, name: str, assignment: str) -> CleanConfig | None:
    """Return the config of a method or preset with a parameter, None without it."""
    named: dict[str, Any] = {what: name}
    try:
        return CleanConfig(**named, set=(assignment,))
    except InputError:
        return None


def check_untaught(methods: Sequence[str]) -> None:
    """Raise an InputError for a method that is not known, or learns from pairs."""
    for name in methods:
        if name not in METHODS or name in LEARNED:
            known = ", ".join(m for m in METHODS if m not in LEARNED)
            raise InputError(
                f"method {name!r} cannot be measured so, only those that do not learn "
                f"from pairs: {known}"
            )


def as_step(every: int) -> int:
    """Return a step through clips; an InputError unless it is 1 or more."""
    if every < 1:
        raise InputError(f"--every {every}: expected 1 or more")
    return every


class School:
    """Makes the correctors of systems, those that learn from the same clips.

    Args:
        train: Clips to learn from.
        skeleton: That of the takes.
        people: Learn also what is each person's own, as they will be met again.
        database: Natural postures, but for ``default``.
        progress: Wraps the loops, for a progress bar.
    """

    def __init__(
        self,
        train: Iterable[PairedTake],
        skeleton: Skeleton,
        *,
        people: bool,
        database: PostureDatabase,
        progress: Progress = silent,
    ) -> None:
        self._train, self._skeleton = [*train], skeleton
        self._people, self._database = people, database
        self._progress = progress
        self._lessons: dict[str, TrainingSet] = {}
        self._learned: dict[str, LearnedCorrector] = {}

    def corrector(self, system: System) -> Corrector:
        """Return what corrects in a system, taught where it learns."""
        made = [self._made(system.config, name) for name in system.methods]
        return made[0] if len(made) == 1 else InTurn(*made, skeleton=self._skeleton)

    def _made(self, config: CleanConfig, name: str) -> Corrector:
        first = config.method == name
        settings = config.parameters.method if first else {}
        method = METHODS[name]
        if name in LEARNED:
            return self._taught(config, name, settings)
        if method.made_of == "skeleton":
            made: Corrector = method.load()(self._skeleton, **settings)
        elif name == "default":  # exactly what clean does
            made = make_corrector(self._skeleton, CleanConfig())
        else:
            made = method.load()(self._database, **settings)
        return made

    def _taught(
        self, config: CleanConfig, name: str, settings: dict[str, Any]
    ) -> LearnedCorrector:
        """Return a method taught, once for settings that learn the same."""
        seen = (config.scoring, config.preset is None, config.parameters.scorer)
        key = str(seen)
        if key not in self._lessons:
            clips = over(self._train, "standardize", self._progress)
            self._lessons[key] = training_set(clips, config)
        free = LEARNED[name].load().adjustable
        fixed = {k: value for k, value in settings.items() if k not in free}
        key = str((key, name, sorted(fixed.items())))
        if key not in self._learned:
            self._learned[key] = teach(
                name,
                self._lessons[str(seen)],
                people=self._people,
                settings=fixed,
                progress=self._progress,
            )
        learned = self._learned[key]
        return learned.adjusted(**settings) if settings else learned
