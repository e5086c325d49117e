"""Reliability scorers for comparison with the default one."""

from __future__ import annotations

__all__: list[str] = []
