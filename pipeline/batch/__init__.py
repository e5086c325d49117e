"""Cleaning folders of takes into folders of clips, on all cores or on a cluster.

A take of 300 frames needs 0.8 s of one core, so a million takes need 220 core hours, or
3 hours on 64 cores. A take has 0.23 MB and its USD clip 0.8 MB; 64 cores read 21 MB/s
and write 72 MB/s, 0.23 TB and 0.8 TB in all. Each worker needs 0.3 to 0.4 GB of memory,
whatever the number of takes. The limits to scaling are the store, and the one process
that plans the jobs and writes the manifest. ``tests/batch_figures.py`` measures this;
``tests/batch_faults.py`` kills runs and workers.
"""

from .again import clean_again, find_takes
from .manifest import ClipRow, Row, read_rows
from .outcome_tables import as_tables, figures_of, worst_first
from .run import JobProgress, Outcome, clean_files

__all__ = [
    "ClipRow",
    "JobProgress",
    "Outcome",
    "Row",
    "as_tables",
    "clean_again",
    "clean_files",
    "figures_of",
    "find_takes",
    "read_rows",
    "worst_first",
]
