"""The systems that ``evaluate`` compares: methods and presets with parameters."""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from kinefilter.characters import InputError, Skeleton
from kinefilter.characters.arrays import check_choice
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.correct import Corrector, CorrectorChain, LearnedCorrector
from kinefilter.pipeline.database import PostureDatabase, builtin_database
from kinefilter.pipeline.factory import make_corrector
from kinefilter.pipeline.methods import LEARNED, METHODS, PRESETS
from kinefilter.pipeline.pairs import PairedTake
from kinefilter.pipeline.progress import Progress, over, silent

from .methods.training_data import TrainingSet
from .training import teach, training_set


@dataclass(frozen=True)
class System:
    """A chain of methods, or a preset."""

    label: str  # as requested: learned+local-pca, liu-2016:clusters=50
    config: CleanConfig  # configuration of the cleaner
    methods: tuple[str, ...]  # names of its methods, in order

    @property
    def learns(self) -> bool:
        """Whether it learns from pairs."""
        return any(method in LEARNED for method in self.methods)


def systems_of(
    methods: Sequence[str],
    presets: Sequence[str] = (),
    assigned: Sequence[str] = (),
    *,
    physics: bool = True,
) -> list[System]:
    """Parse the systems named on the command line.

    ``methods`` are names from ``METHODS``, joined by ``+`` to form a chain, followed by
    assignments to parameters: ``local-pca:neighbors=30:memory=0``. ``presets`` are
    names from ``PRESETS`` with assignments; ``all`` stands for all names. Assignments
    that are ``assigned``, NAME=VALUE, are for every system that has such a parameter.
    With ``physics``, the character is simulated after methods, as ``clean`` does, and
    in the presets that include it. Raises an InputError if a name is unknown, or if no
    system has an assigned parameter.
    """
    known: dict[str, Collection[str]] = {"method": METHODS, "preset": PRESETS}
    requested = [("method", text) for text in methods]
    for text in presets:
        name, colon, own = text.partition(":")
        names = list(PRESETS) if name == "all" else [name]
        requested += [("preset", name + colon + own) for name in names]
    systems, used = [], set[str]()
    for kind, text in requested:
        name, *settings = text.split(":")
        names = name.split("+") if kind == "method" else [name]
        for one in names:
            check_choice(one, known[kind], kind)
        fitting = [one for one in assigned if _has_parameter(kind, names[0], one)]
        used |= {*fitting}
        settings = [*fitting, *settings]
        if kind == "preset":
            settings += [] if physics else ["physics=false"]
            config = CleanConfig(preset=name, set=tuple(settings))
            names = [PRESETS[name].method]
        else:
            config = CleanConfig(names[0], set=tuple(settings), physics=physics)
        systems.append(System(text, config, tuple(names)))
    if unused := [one for one in assigned if one not in used]:
        raise InputError(
            f"--set {unused[0]}: none of {', '.join(s.label for s in systems)} has "
            "such a parameter; 'kinefilter clean --preset NAME --set help' lists the "
            "parameters of a preset"
        )
    return systems


def _has_parameter(kind: str, name: str, assignment: str) -> bool:
    named: dict[str, Any] = {kind: name}
    try:
        CleanConfig(**named, set=(assignment,))
    except InputError:
        return False
    return True


def check_untrained(methods: Sequence[str]) -> None:
    """Raise an InputError for a method that is unknown, or learns from pairs."""
    for name in methods:
        if name not in METHODS or name in LEARNED:
            known = ", ".join(m for m in METHODS if m not in LEARNED)
            raise InputError(
                f"method {name!r}: expected one that does not learn from pairs: {known}"
            )


def as_step(every: int) -> int:
    """Return a step through clips, or raise an InputError unless it is 1 or more."""
    if every < 1:
        raise InputError(f"--every {every}: expected 1 or more")
    return every


class CorrectorFactory:
    """Makes the correctors of systems, and trains those that learn on the same clips.

    With ``people`` they also learn each person's own offsets, and with ``views``
    ``learned`` learns from people before two sensors, too. All methods except
    ``default`` take their postures from ``database``, by default the built-in one;
    ``skeleton`` is by default that of the clips.
    """

    def __init__(
        self,
        train: Iterable[PairedTake],
        skeleton: Skeleton | None = None,
        *,
        people: bool = False,
        views: TrainingSet | None = None,
        database: PostureDatabase | None = None,
        progress: Progress = silent,
    ) -> None:
        self._train, self._people, self._progress = [*train], people, progress
        self._views = views
        self._skeleton = skeleton or self._train[0].take.skeleton
        self._database = database or builtin_database(self._skeleton)
        self._lessons: dict[str, TrainingSet] = {}
        self._learned: dict[str, LearnedCorrector] = {}

    def corrector(self, system: System) -> Corrector:
        """Return the corrector of a system, trained if it learns."""
        made = [self._make(system.config, name) for name in system.methods]
        return made[0] if len(made) == 1 else CorrectorChain(*made)

    def _make(self, config: CleanConfig, name: str) -> Corrector:
        settings = config.parameters.method if config.method == name else {}
        if name in LEARNED:
            return self._trained(config, name, settings)
        if name == "default":  # exactly as in clean
            return make_corrector(self._skeleton, CleanConfig())
        method = METHODS[name]
        basis = self._skeleton if method.requires == "skeleton" else self._database
        corrector: Corrector = method.make(basis, **settings)
        return corrector

    def _trained(
        self, config: CleanConfig, name: str, settings: dict[str, Any]
    ) -> LearnedCorrector:
        if not self._train:
            raise InputError(f"method {name} learns: give pairs files with --train")
        scoring = (config.scoring, config.preset is None, config.parameters.scorer)
        lessons_key = str(scoring)
        if lessons_key not in self._lessons:
            clips = over(self._train, "standardize", self._progress)
            self._lessons[lessons_key] = training_set(clips, config)
        free = LEARNED[name].load().adjustable
        fixed = {k: value for k, value in settings.items() if k not in free}
        key = str((lessons_key, name, sorted(fixed.items())))
        if key not in self._learned:
            self._learned[key] = teach(
                name,
                self._lessons[lessons_key],
                views=self._views,
                people=self._people,
                settings=fixed,
                progress=self._progress,
            )
        learned = self._learned[key]
        return learned.adjusted(**settings) if settings else learned
