"""Addresses that only this machine reaches."""

from __future__ import annotations

import ipaddress
import re

OWN_PAGES = re.compile(r"https?://(localhost|127\.0\.0\.1|\[::1\])(:\d+)?")
"""Origins of pages that a server of this machine gave its browser."""


def is_loopback(host: str) -> bool:
    """Tell whether a host is this machine, and cannot be reached by others."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
