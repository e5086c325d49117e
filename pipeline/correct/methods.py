"""Every correction method by its name on the command line."""

from __future__ import annotations

from collections.abc import Callable

from kinefilter.characters import Skeleton
from kinefilter.pipeline.database import PostureDatabase

from .filters import Butterworth, OneEuro, SavitzkyGolay
from .hold import Hold
from .interface import Corrector, WholeTakeCorrector
from .kalman import ConstantLengthKalman
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

LEARNED: dict[str, type[PersonalGP]] = {
    "best": PersonalGP,
}
"""Methods that learn from pairs of Kinect and mocap."""
