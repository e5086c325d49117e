"""Correction methods, one file each; ``pipeline.methods`` lists them by name."""

from .hold import Hold
from .interface import Correction, Corrector, CorrectorChain, Observation
from .learned import LearnedCorrector
from .local_pca import LocalPCA

__all__ = [
    "Correction",
    "Corrector",
    "CorrectorChain",
    "Hold",
    "LearnedCorrector",
    "LocalPCA",
    "Observation",
]
