"""Correction methods of the papers and in common use today, for comparison."""
