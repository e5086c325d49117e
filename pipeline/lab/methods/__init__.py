"""Correction methods of the papers and of today, to compare with."""

__all__: list[str] = []
