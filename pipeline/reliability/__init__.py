"""How far each joint of each frame can be trusted, and what the person measures.

``shum`` has the default scorer; others stand in ``pipeline.methods``.
"""

from .shum import (
    Reference,
    Reliability,
    ReliabilityScorer,
    measure_body,
    measure_reference,
    rest_reference,
)

__all__ = [
    "Reference",
    "Reliability",
    "ReliabilityScorer",
    "measure_body",
    "measure_reference",
    "rest_reference",
]
