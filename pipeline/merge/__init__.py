"""Makes one take of what several sensors recorded of a person at the same time.

Their clocks and frames are found from the motion itself (``alignment``); then every
joint is fused of what each sensor saw of it (``fusion``).
"""

from .alignment import Alignment, align
from .calibration import read_calibration, write_calibration
from .cleaning import Corrected, clean_session
from .fusion import Fused, Fusion, Sight
from .session import Merged, merge

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
