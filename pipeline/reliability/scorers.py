"""The ways to score reliability, by name."""

from __future__ import annotations

from kinefilter.pipeline.lab.scorers.chiang import ChiangReliabilityScorer
from kinefilter.pipeline.lab.scorers.learned import LearnedReliabilityScorer
from kinefilter.pipeline.lab.scorers.noise import NoiseReliabilityScorer

from .shum import ReliabilityScorer

SCORERS: dict[str, type[ReliabilityScorer]] = {
    "shum": ReliabilityScorer,
    "chiang": ChiangReliabilityScorer,
    "noise": NoiseReliabilityScorer,
    "learned": LearnedReliabilityScorer,
}
"""After Shum 2013, after Chiang 2017, by noise and segment lengths, and as learned."""
