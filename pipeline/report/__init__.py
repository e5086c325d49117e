"""What cleaning did to a take, as one page that a browser opens without a network."""

from .compared import Compared, compare
from .limits import Limit, parse_limit, read_limits
from .page import write_report

__all__ = [
    "Compared",
    "Limit",
    "compare",
    "parse_limit",
    "read_limits",
    "write_report",
]
