"""Every correction method by its name on the command line."""

from __future__ import annotations

from collections.abc import Callable

from kinefilter.characters import Skeleton
from kinefilter.pipeline.database import PostureDatabase
from kinefilter.pipeline.lab.methods.clustered_gp import ClusteredGP
from kinefilter.pipeline.lab.methods.exemplar import Exemplar
from kinefilter.pipeline.lab.methods.kalman import ConstantLengthKalman
from kinefilter.pipeline.lab.methods.low_rank import LowRank
from kinefilter.pipeline.lab.methods.shum_baselines import Nearest, NoReliability

from .filters import Butterworth, OneEuro, SavitzkyGolay
from .full_gp import FullGP
from .hold import Hold
from .interface import Corrector, LearnedCorrector, WholeTakeCorrector
from .joint_offsets import JointOffsets
from .local_gp import LocalGP
from .local_pca import LocalPCA
from .personal_gp import PersonalGP

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
