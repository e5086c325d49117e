"""The ways to score reliability, by name."""

from __future__ import annotations

from .chiang_reliability import ChiangReliabilityScorer
from .learned_reliability import LearnedReliabilityScorer
from .noise_reliability import NoiseReliabilityScorer
from .reliability import ReliabilityScorer

__all__ = ["SCORERS"]

SCORERS: dict[str, type[ReliabilityScorer]] = {
    "shum": ReliabilityScorer,
    "chiang": ChiangReliabilityScorer,
    "noise": NoiseReliabilityScorer,
    "learned": LearnedReliabilityScorer,
}
"""After Shum 2013, after Chiang 2017, by noise and segment lengths, and as learned."""
