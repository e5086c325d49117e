"""Merges the takes of one person by several sensors into a single take."""

from .alignment import Alignment, align
from .fusion import Fused, Fusion, Sight
from .session import (
    Corrected,
    Merged,
    clean_session,
    merge,
    read_calibration,
    write_calibration,
)

__all__ = [
    "Alignment",
    "Corrected",
    "Fused",
    "Fusion",
    "Merged",
    "Sight",
    "align",
    "clean_session",
    "merge",
    "read_calibration",
    "write_calibration",
]
