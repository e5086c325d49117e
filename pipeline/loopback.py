"""Addresses that are only reachable from this machine."""

import ipaddress
import re

OWN_PAGES = re.compile(r"https?://(localhost|127\.0\.0\.1|\[::1\])(:\d+)?")
"""Origins of web pages served by this machine."""


def is_loopback(host: str) -> bool:
    """Return True if a host is this machine, and unreachable for others."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
