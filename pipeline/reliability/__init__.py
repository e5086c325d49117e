"""How far each joint of each frame can be trusted, one way a file.

``shum`` is the default, and what ``chiang``, ``noise`` and ``learned`` are put in place
of by name (``scorers``). The last is a logistic regression learned from simulated
people.
"""

from .shum import Reference, Reliability, ReliabilityScorer, measure_reference

__all__ = [
    "Reference",
    "Reliability",
    "ReliabilityScorer",
    "measure_reference",
]
