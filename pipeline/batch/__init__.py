"""Folders of takes into folders of clips, on all cores or on a cluster.

A million takes of 300 frames cost 0.7 s of a core each (0.5 s cleaning, 0.2 s writing
0.7 MB of USD): 195 core hours, or 3 hours on 64 cores, which then read 25 and write 65
MB a second. Up to some hundred cores they are the limit. After them it is the store
(0.25 TB in, 0.7 TB out), and near a thousand takes a second the one process that writes
the manifest: it spends 0.1 ms on planning a take and 1 ms on its row, and keeps 3 kB of
it, 3 GB in all. Memory is 0.3 to 0.4 GB a worker, whatever the number of takes
(``tests/batch_figures.py``; ``tests/batch_faults.py`` kills runs and workers).
"""

from .row import ClipRow, Row
from .run import Outcome, Standing, clean_files
from .summary import as_tables

__all__ = ["ClipRow", "Outcome", "Row", "Standing", "as_tables", "clean_files"]
