"""The studies of the papers, on simulated takes: a table and a plot each."""

from .catalog import STUDIES, check_names, reproduce
from .drawing import check_drawing
from .files import check_studies_folder, write_study
from .study import Bar, Study, as_table

__all__ = [
    "STUDIES",
    "Bar",
    "Study",
    "as_table",
    "check_drawing",
    "check_names",
    "check_studies_folder",
    "reproduce",
    "write_study",
]
