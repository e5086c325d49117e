"""Correction methods and reliability scorers by name: a line each, loaded when used.

Whoever adds a method writes one file and adds one line here; the command line's choices
and the tests read these tables.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module, resources
from typing import TYPE_CHECKING, Any, Literal

from kinefilter.characters import InputError, Skeleton

if TYPE_CHECKING:
    from .config import CleanConfig
    from .correct import Corrector
    from .database import PostureDatabase
    from .models import Model
    from .reliability import Reference, ReliabilityScorer

_PACKAGE = "kinefilter.pipeline"
_MODEL_RATE = 0.5
"""Least reliability of what a model made of a measured joint: it then counts a fifth.
In simulated takes 0.5 to 0.75 do about as well."""


@dataclass(frozen=True)
class Method:
    """Where a correction method is, and what makes it."""

    where: str
    """``module:name`` below ``kinefilter.pipeline``."""
    made_of: Literal["skeleton", "database", "pairs"]
    """What its constructor takes: a skeleton, a motion database, or a skeleton before
    ``fit`` learns from pairs of Kinect and mocap."""
    options: tuple[str, ...] = ()
    """Fields of ``CleanConfig`` that are options of its own."""

    def load(self) -> Any:
        """Import and return what makes the method."""
        return _load(self.where)


METHODS = {
    "default": Method("methods:default_corrector", "database", ("search", "seed")),
    "local-pca": Method("correct.local_pca:LocalPCA", "database", ("search", "seed")),
    "best": Method("correct.personal_gp:PersonalGP", "pairs"),
    "local-gp": Method("correct.local_gp:LocalGP", "pairs", ("adapt",)),
    "joint-offsets": Method("correct.joint_offsets:JointOffsets", "pairs"),
    "clustered-gp": Method("lab.methods.clustered_gp:ClusteredGP", "pairs"),
    "full-gp": Method("lab.methods.baselines:FullGP", "pairs"),
    "exemplar": Method("lab.methods.baselines:Exemplar", "pairs"),
    "none": Method("correct.hold:Hold", "skeleton"),
    "butterworth": Method("lab.methods.filters:Butterworth", "skeleton"),
    "savgol": Method("lab.methods.filters:SavitzkyGolay", "skeleton"),
    "one-euro": Method("correct.one_euro:OneEuro", "skeleton"),
    "kalman": Method("lab.methods.filters:ConstantLengthKalman", "skeleton"),
    "low-rank": Method("lab.methods.low_rank:LowRank", "skeleton"),
    "nearest": Method("lab.methods.baselines:Nearest", "database"),
    "no-reliability": Method("lab.methods.baselines:NoReliability", "database"),
}
"""Correction methods."""

LEARNED = {name: m for name, m in METHODS.items() if m.made_of == "pairs"}
"""Correction methods that learn from pairs."""

SCORERS = {
    "shum": "reliability:ReliabilityScorer",
    "chiang": "lab.scorers.chiang:ChiangReliabilityScorer",
    "noise": "lab.scorers.noise:NoiseReliabilityScorer",
    "learned": "lab.scorers.learned:LearnedReliabilityScorer",
}
"""Reliability scorers: after Shum 2013, after Chiang 2017, by noise and segment
lengths, and as learned on simulated people."""

if TYPE_CHECKING:
    MethodName = str
    LearnedName = str
    ScorerName = str
else:
    MethodName = Literal[tuple(METHODS)]
    LearnedName = Literal[tuple(LEARNED)]
    ScorerName = Literal[tuple(SCORERS)]


def make_scorer(
    name: str, skeleton: Skeleton, reference: Reference
) -> ReliabilityScorer:
    """Return a reliability scorer by its name, for one person's segment lengths."""
    scorer: ReliabilityScorer = _load(SCORERS[name])(skeleton, reference)
    return scorer


def make_corrector(skeleton: Skeleton, config: CleanConfig) -> Corrector:
    """Return the correction method that a config names, for a skeleton.

    Raises:
        InputError: The database or model is of another skeleton, or missing.
    """
    from .models import load_model

    if config.model is not None:
        return _from_model(skeleton, config, load_model(config.model))
    if config.adapt:
        raise InputError("--adapt needs --model with a model of method local-gp")
    name = config.method or "default"
    method = METHODS[name]
    if method.made_of == "pairs":
        raise InputError(
            f"--method {name} learns: give --model with a file of 'kinefilter train'"
        )
    of = skeleton if method.made_of == "skeleton" else _database(skeleton, config)
    options = {option: getattr(config, option) for option in method.options}
    made: Corrector = method.load()(of, **options)
    return made


def default_corrector(database: PostureDatabase, **options: Any) -> Corrector:
    """Return the shipped joint offsets, then local PCA.

    The shipped model knows constant offsets alone. Whole postures can be learned from
    simulated people too (``kinefilter train --simulated``); no study shows that
    recorded people gain from it, so it is not the default.

    Args:
        database: Natural postures.
        options: Of local PCA.
    """
    from .correct import InTurn, LocalPCA
    from .models import load_model

    folder = resources.files(_PACKAGE).joinpath("embedded")
    with resources.as_file(folder / f"{database.skeleton.name}.npz") as path:
        offsets = load_model(path).corrector
    return InTurn(offsets, LocalPCA(database, **options))


def _load(where: str) -> Any:
    module, _, name = where.partition(":")
    return getattr(import_module(f"{_PACKAGE}.{module}"), name)


def _database(skeleton: Skeleton, config: CleanConfig) -> PostureDatabase:
    from .database import PostureDatabase, builtin_database

    if config.database is None:
        return builtin_database(skeleton)
    database = PostureDatabase.load(config.database)
    if database.skeleton.name != skeleton.name:
        raise InputError(
            f"{config.database}: a database of {database.skeleton.name} postures, but "
            f"the take is {skeleton.name}; build one with 'kinefilter database build "
            f"--skeleton {skeleton.name}'"
        )
    return database


def _from_model(skeleton: Skeleton, config: CleanConfig, model: Model) -> Corrector:
    from .correct import InTurn

    if model.skeleton.name != skeleton.name:
        raise InputError(
            f"{config.model}: a model for {model.skeleton.name}, but the take is "
            f"{skeleton.name}; train one on pairs of that skeleton"
        )
    if config.method not in (None, model.method, "local-pca"):
        raise InputError(
            f"{config.model}: a model of method {model.method}, but --method says "
            f"{config.method}; leave one of the two out, or let --method local-pca "
            "follow the model"
        )
    corrector: Any = model.corrector
    if config.adapt:
        if "adapt" not in METHODS[model.method].options:
            raise InputError(
                f"{config.model}: a model of method {model.method} cannot --adapt; "
                "train one of method local-gp"
            )
        corrector.adapt = True
    if config.method != "local-pca":
        learned: Corrector = corrector
        return learned
    database, pca = _database(skeleton, config), METHODS["local-pca"]
    options = {option: getattr(config, option) for option in pca.options}
    follower = pca.load()(database, **options)
    return InTurn(corrector, follower, least_rate=_MODEL_RATE)
