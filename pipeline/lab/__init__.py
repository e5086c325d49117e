"""Evaluation, training and database building, which cleaning does not need."""
