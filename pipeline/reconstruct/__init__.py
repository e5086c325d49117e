"""Reconstruction of limbs that the sensor did not see."""

from .hidden_limbs import fill_hidden
from .prior import MotionPrior
from .stage import HiddenLimbTracker, Reconstruct

__all__ = ["HiddenLimbTracker", "MotionPrior", "Reconstruct", "fill_hidden"]
