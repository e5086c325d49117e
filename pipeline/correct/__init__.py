"""Correction methods, one a file, behind one interface."""

from .hold import Hold
from .interface import (
    Correction,
    Corrector,
    LearnedCorrector,
    Observation,
    ObservedTake,
    WholeTakeCorrector,
)
from .local_pca import LocalPCA
from .take import CorrectedTake, correct_take

__all__ = [
    "CorrectedTake",
    "Correction",
    "Corrector",
    "Hold",
    "LearnedCorrector",
    "LocalPCA",
    "Observation",
    "ObservedTake",
    "WholeTakeCorrector",
    "correct_take",
]
