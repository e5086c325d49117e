"""Evaluation, training and database building, which cleaning does not need."""

from __future__ import annotations

__all__: list[str] = []
