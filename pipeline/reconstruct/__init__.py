"""Reconstruction of limbs that the sensor did not see."""

from .hidden_limbs import fill_hidden, in_limbs
from .tracker import HiddenLimbTracker

__all__ = ["HiddenLimbTracker", "fill_hidden", "in_limbs"]
