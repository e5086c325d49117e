"""Evaluation, training and database building, which cleaning does not need."""

__all__: list[str] = []
