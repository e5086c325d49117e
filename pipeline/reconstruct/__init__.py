"""Reconstruction of limbs that the sensor did not see."""

from .hidden_limbs import fill_hidden
from .stage import Reconstruct
from .tracker import HiddenLimbTracker

__all__ = ["HiddenLimbTracker", "Reconstruct", "fill_hidden"]
