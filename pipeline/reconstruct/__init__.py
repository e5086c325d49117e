"""Reconstruction of limbs that the sensor did not see."""

from .hidden_limbs import fill_hidden
from .tracker import HiddenLimbTracker

__all__ = ["HiddenLimbTracker", "fill_hidden"]
