"""Folders of takes into folders of clips, on all cores or on a cluster."""

from .row import ClipRow, Row
from .run import Outcome, Standing, clean_files
from .summary import as_tables

__all__ = ["ClipRow", "Outcome", "Row", "Standing", "as_tables", "clean_files"]
