"""Every correction method by its name on the command line."""

from __future__ import annotations

from collections.abc import Callable

from kinefilter.characters import Skeleton
from kinefilter.pipeline.database import PostureDatabase

from .clustered_gp import ClusteredGP
from .exemplar import Exemplar
from .filters import Butterworth, OneEuro, SavitzkyGolay
from .full_gp import FullGP
from .hold import Hold
from .interface import Corrector, LearnedCorrector, WholeTakeCorrector
from .joint_offsets import JointOffsets
from .kalman import ConstantLengthKalman
from .local_gp import LocalGP
from .local_pca import LocalPCA
from .low_rank import LowRank
from .personal_gp import PersonalGP
from .shum_baselines import Nearest, NoReliability

__all__ = ["FILTERS", "FROM_DATABASE", "LEARNED"]

FILTERS: dict[str, Callable[[Skeleton], Corrector | WholeTakeCorrector]] = {
    "none": Hold,
    "butterworth": lambda _: Butterworth(),
    "savgol": lambda _: SavitzkyGolay(),
    "one-euro": OneEuro,
    "kalman": ConstantLengthKalman,
    "low-rank": lambda _: LowRank(),
}
"""Methods that need nothing but the take."""

FROM_DATABASE: dict[str, Callable[[PostureDatabase], Corrector]] = {
    "local-pca": LocalPCA,
    "nearest": Nearest,
    "no-reliability": NoReliability,
}
"""Methods that need natural postures."""

LEARNED: dict[str, type[LearnedCorrector]] = {
    "best": PersonalGP,
    "local-gp": LocalGP,
    "clustered-gp": ClusteredGP,
    "full-gp": FullGP,
    "exemplar": Exemplar,
    "joint-offsets": JointOffsets,
}
"""Methods that learn from pairs of Kinect and mocap."""
