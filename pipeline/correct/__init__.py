"""Correction methods, one a file, behind one interface."""

from .hold import Hold
from .interface import Correction, Corrector, Observation
from .local_pca import LocalPCA

__all__ = ["Correction", "Corrector", "Hold", "LocalPCA", "Observation"]
