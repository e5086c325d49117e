"""The ways to score reliability, by name."""

from __future__ import annotations

from .chiang_reliability import ChiangReliabilityScorer
from .reliability import ReliabilityScorer

__all__ = ["SCORERS"]

SCORERS: dict[str, type[ReliabilityScorer]] = {
    "shum": ReliabilityScorer,
    "chiang": ChiangReliabilityScorer,
}
"""After Shum 2013, and after Chiang 2017."""
