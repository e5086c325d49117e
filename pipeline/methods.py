"""Correction methods and reliability scorers by name, imported when used."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, Literal, TypeAlias


@dataclass(frozen=True)
class Method:
    """The location of a correction method, and what it is constructed from."""

    where: str  # ``module:name`` below ``kinefilter.pipeline``
    requires: Literal["skeleton", "database", "pairs"]
    """What its constructor takes; for ``pairs`` a skeleton, then ``fit`` trains it."""
    options: tuple[str, ...] = ()  # fields of ``CleanConfig`` that it also takes
    constants: Mapping[str, Any] = field(default_factory=dict)  # its other defaults

    def load(self) -> Any:
        """Import and return the method's class or factory."""
        return load(self.where)

    def make(self, base: Any, **keywords: Any) -> Any:
        """Return a corrector for what the method ``requires``."""
        return self.load()(base, **{**self.constants, **keywords})


def load(where: str) -> Any:
    """Import and return the object at ``module:name`` below ``kinefilter.pipeline``."""
    module, _, name = where.partition(":")
    return getattr(import_module(f"kinefilter.pipeline.{module}"), name)


_SHUM = {"neighbors": 30, "memory": 0.0}  # the paper's; it queries the frame alone
METHODS = {
    "default": Method("factory:default_corrector", "database", ("search", "seed")),
    "local-pca": Method("correct.local_pca:LocalPCA", "database", ("search", "seed")),
    "learned": Method("correct.fourier_ridge:FourierRidge", "pairs"),
    "local-gp": Method("lab.methods.local_gp:LocalGP", "pairs", ("adapt",)),
    "joint-offsets": Method("lab.methods.joint_offsets:JointOffsets", "pairs"),
    "clustered-gp": Method("lab.methods.clustered_gp:ClusteredGP", "pairs"),
    "full-gp": Method("lab.methods.baselines:FullGP", "pairs"),
    "exemplar": Method("lab.methods.baselines:Exemplar", "pairs"),
    "none": Method("correct.hold:Hold", "skeleton"),
    "butterworth": Method("lab.methods.filters:Butterworth", "skeleton"),
    "savgol": Method("lab.methods.filters:SavitzkyGolay", "skeleton"),
    "one-euro": Method("correct.one_euro:OneEuro", "skeleton"),
    "kalman": Method("lab.methods.filters:ConstantLengthKalman", "skeleton"),
    "low-rank": Method("lab.methods.low_rank:LowRank", "skeleton"),
    "nearest": Method("lab.methods.posture:Nearest", "database"),
    "posture-space": Method(
        "lab.methods.posture:LeastEnergy", "database", ("seed",), _SHUM
    ),
    "no-reliability": Method(
        "lab.methods.posture:NoReliability", "database", ("seed",), _SHUM
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
