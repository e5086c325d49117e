"""The ways to score reliability, by name."""

from __future__ import annotations

from .chiang import ChiangReliabilityScorer
from .learned import LearnedReliabilityScorer
from .noise import NoiseReliabilityScorer
from .shum import ReliabilityScorer

__all__ = ["SCORERS"]

SCORERS: dict[str, type[ReliabilityScorer]] = {
    "shum": ReliabilityScorer,
    "chiang": ChiangReliabilityScorer,
    "noise": NoiseReliabilityScorer,
    "learned": LearnedReliabilityScorer,
}
"""After Shum 2013, after Chiang 2017, by noise and segment lengths, and as learned."""
