"""What cleaning did to a take, as one page that a browser opens without a network."""

from .compared import Compared, compare, read_compared
from .limits import Limit, parse_limit, read_limits
from .page import check_report, write_report

__all__ = [
    "Compared",
    "Limit",
    "check_report",
    "compare",
    "parse_limit",
    "read_compared",
    "read_limits",
    "write_report",
]
