"""Correction methods and reliability scorers by name: a line each, loaded when used.

Whoever adds a method writes one file and adds one line here; the command line's choices
and the tests read these tables.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any, Literal

_PACKAGE = "kinefilter.pipeline"


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
        return load(self.where)


def load(where: str) -> Any:
    """Import and return what is at ``module:name`` below ``kinefilter.pipeline``."""
    module, _, name = where.partition(":")
    return getattr(import_module(f"{_PACKAGE}.{module}"), name)


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
    "nearest": Method("lab.methods.shum:Nearest", "database"),
    "posture-space": Method("lab.methods.shum:LeastEnergy", "database", ("seed",)),
    "no-reliability": Method("lab.methods.shum:NoReliability", "database", ("seed",)),
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
