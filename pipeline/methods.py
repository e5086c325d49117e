"""Correction methods, reliability scorers and the papers' presets, by name."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, Literal, NamedTuple, TypeAlias


@dataclass(frozen=True)
class Method:
    """The location of a correction method, and what it is constructed from."""

    where: str  # ``module:name`` below ``kinefilter.pipeline``
    requires: Literal["skeleton", "database", "pairs"]
    """What its constructor takes; for ``pairs`` a skeleton, then ``fit`` trains it."""
    options: tuple[str, ...] = ()  # fields of ``CleanConfig`` that it also takes
    constants: Mapping[str, Any] = field(default_factory=dict)  # its other defaults

    def load(self) -> Any:
        """Import the method's class or factory when it is used, and return it."""
        return load(self.where)

    def make(self, base: Any, **keywords: Any) -> Any:
        """Return a corrector for what the method ``requires``."""
        return self.load()(base, **{**self.constants, **keywords})


def load(where: str) -> Any:
    """Import and return the object at ``module:name`` below ``kinefilter.pipeline``."""
    module, _, name = where.partition(":")
    return getattr(import_module(f"kinefilter.pipeline.{module}"), name)


_PRINTED = {"neighbors": 30, "memory": 0.0}  # the paper's; it queries the frame alone
METHODS = {
    "default": Method("factory:default_corrector", "database", ("search", "seed")),
    "local-pca": Method("correct.local_pca:LocalPCA", "database", ("search", "seed")),
    "learned": Method("correct.fourier_ridge:FourierRidge", "pairs"),
    "local-gp": Method("lab.methods.local_gp:LocalGP", "pairs", ("adapt",)),
    "joint-offsets": Method("lab.methods.baselines:JointOffsets", "pairs"),
    "clustered-gp": Method("lab.methods.clustered_gp:ClusteredGP", "pairs"),
    "full-gp": Method("lab.methods.baselines:FullGP", "pairs"),
    "exemplar": Method("lab.methods.baselines:Exemplar", "pairs"),
    "none": Method("correct.hold:Hold", "skeleton"),
    "butterworth": Method("lab.methods.filters:Butterworth", "skeleton"),
    "savgol": Method("lab.methods.filters:SavitzkyGolay", "skeleton"),
    "one-euro": Method("lab.methods.filters:OneEuro", "skeleton"),
    "kalman": Method("lab.methods.filters:ConstantLengthKalman", "skeleton"),
    "low-rank": Method("lab.methods.baselines:LowRank", "skeleton"),
    "nearest": Method("lab.methods.baselines:Nearest", "database"),
    "posture-space": Method(
        "lab.methods.baselines:LeastEnergy", "database", ("seed",), _PRINTED
    ),
    "no-reliability": Method(
        "lab.methods.baselines:NoReliability", "database", ("seed",), _PRINTED
    ),
}
LEARNED = {name: m for name, m in METHODS.items() if m.requires == "pairs"}
SCORERS = {
    "shum": "reliability:ReliabilityScorer",
    "chiang": "lab.scorers:ChiangReliabilityScorer",
    "noise": "lab.scorers:NoiseReliabilityScorer",
    "learned": "lab.scorers:LearnedReliabilityScorer",
}
"""Reliability scorers: after Shum 2013, after Chiang 2017, from noise and segment
lengths, and trained on simulated people."""
# Choices of the command line, which type checkers cannot follow.
MethodName: TypeAlias = Literal[tuple(METHODS)]  # type: ignore[valid-type]
LearnedName: TypeAlias = Literal[tuple(LEARNED)]  # type: ignore[valid-type]
ScorerName: TypeAlias = Literal[tuple(SCORERS)]  # type: ignore[valid-type]


@dataclass(frozen=True)
class Preset:
    """A paper's system: scoring, correction and the stages after them."""

    method: str  # name of its method in ``METHODS``
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Constants of the method: the paper's, or our choice where it gives none."""
    scoring: str = "shum"  # name in ``SCORERS``; also selects the training data
    physics: bool = False  # whether a simulated character follows the corrected joints

    @property
    def stages(self) -> dict[str, Any]:
        """Fields of ``CleanConfig`` that the preset decides."""
        # No paper smooths, plants feet or reconstructs hidden limbs.
        own = {"method": self.method, "scoring": self.scoring, "physics": self.physics}
        return own | {"reconstruct": False, "cutoff": 0.0, "feet": "never"}


_TABLE_V = {"neighbors": 30, "dimensions": 20, "steps": 20, "samples": 100}
_WEIGHTS = {"control": 1.0, "style": 0.5, "kinematics": 1.5, "continuity": 0.25}
_SHUM = {**_TABLE_V, **_WEIGHTS, "search": "stochastic", "memory": 0.0}
_EQUATION_22 = {"spatial": 0.6, "temporal": 0.2, "reliability": 0.2}
# Chosen on drifting limbs; the papers assume constant velocity of all joints.
_DRIFT = {"likelihood": "density", "carry": 0.5, "spared": 1.0}
PRESETS = {
    # Shum, Ho, Jiang & Takagi 2013
    "shum-2013": Preset("posture-space", _SHUM, physics=True),
    # Shum & Ho 2012: method A of Shum 2013
    "shum-2012": Preset("nearest", physics=True),
    # Method B of Shum 2013
    "shum-no-reliability": Preset("no-reliability", _SHUM, physics=True),
    # Liu, Zhou, Leung & Shum 2016
    "liu-2016": Preset(
        "local-gp",
        {"clusters": 30, "samples": 50, "blended": 9, **_EQUATION_22}
        | {"frames": 2501, "trend": False, "votes": "precision", **_DRIFT}
        | {"adapt": True},
    ),
    # Zhou, Liu, Leung & Shum 2014, which Liu 2016 builds on
    "zhou-2014": Preset(
        "full-gp", {"samples": 2501, "variance": "exact", **_EQUATION_22, **_DRIFT}
    ),
    # Shen, Deng, Bai, Leyvand, Guo & Tu 2012, as compared in Liu 2016
    "shen-2012": Preset("exemplar", {"samples": 16500, "neighbors": 10}),
    # Chiang, Chen, Li, Wang & Fu 2017
    "chiang-2017": Preset(
        "clustered-gp",
        {"centroids": 800, "smallest_reliability": 0.7}
        | {"predicts": "positions", "lengths": "own"},
        scoring="chiang",
    ),
    # Wang, Li, Wu, Lai & Yang
    "wang-low-rank": Preset(
        "low-rank", {"sparsity": 1.0, "growth": 1.05, "iterations": 1000}
    ),
}
PresetName: TypeAlias = Literal[tuple(PRESETS)]  # type: ignore[valid-type]


class Parameters(NamedTuple):
    """Parameters from ``--set`` and a preset, by what they configure."""

    method: dict[str, Any]
    given: dict[str, Any]  # those of the method from ``--set`` alone
    scorer: dict[str, Any]
    tracking: dict[str, Any]
    stages: dict[str, Any]
