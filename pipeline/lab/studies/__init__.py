"""The figures of README and of the papers, measured: one table and plot per study.

A study is a function of ``Options`` and sizes that returns a ``Study``; ``catalog``
lists them by name. Studies of the papers use simulated people. Studies of README's
figures use recordings where there are any, and simulated people otherwise;
``claims.toml`` lists the figures as README states them, and ``claims`` compares them
with the measured ones.
"""

from . import claims
from .catalog import (
    STUDIES,
    check_names,
    fingerprint,
    is_up_to_date,
    record_fingerprint,
    reproduce,
)
from .output import check_drawing, check_studies_folder, make_pictures, write_study
from .study import Options, Study, as_table
from .study_takes import recordings_folder

__all__ = [
    "STUDIES",
    "Options",
    "Study",
    "as_table",
    "check_drawing",
    "check_names",
    "check_studies_folder",
    "claims",
    "fingerprint",
    "is_up_to_date",
    "make_pictures",
    "record_fingerprint",
    "recordings_folder",
    "reproduce",
    "write_study",
]
