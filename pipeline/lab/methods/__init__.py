"""Correction methods of the papers and in common use today, for comparison."""

from __future__ import annotations

__all__: list[str] = []
