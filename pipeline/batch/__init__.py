"""Folders of takes into folders of clips, on all cores or on a cluster.

A million takes of 300 frames cost 0.7 s of a core each: 195 core hours, or 3 hours on
64 cores. A take has 0.23 MB and its clip in USD 0.8 MB, so that 64 cores read 21 and
write 72 MB a second, 0.23 and 0.8 TB in all. Memory is 0.3 to 0.4 GB a worker, whatever
the number of takes. ``tests/batch_figures.py`` measures this;
``tests/batch_faults.py`` kills runs and workers. What more cores do not make faster is
the store, and the one process that plans the takes and writes the manifest.
"""

from .manifest import ClipRow, Row
from .run import JobProgress, Outcome, clean_files
from .summary import as_tables

__all__ = ["ClipRow", "JobProgress", "Outcome", "Row", "as_tables", "clean_files"]
