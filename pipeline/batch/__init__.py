"""Folders of takes into folders of clips, on all cores or on a cluster.

A million takes of 300 frames cost 0.7 s of a core each: 195 core hours, or 3 hours on
64 cores. A take has 0.25 MB and its clip in USD 0.7 MB, so that 64 cores read 25 and
write 65 MB a second, 0.25 and 0.7 TB in all. Memory is 0.3 to 0.4 GB a worker, whatever
the number of takes. ``tests/batch_figures.py`` measures this;
``tests/batch_faults.py`` kills runs and workers. What more cores do not make faster is
the store, and the one process that plans the takes and writes the manifest.
"""

from .row import ClipRow, Row
from .run import Outcome, Standing, clean_files
from .summary import as_tables

__all__ = ["ClipRow", "Outcome", "Row", "Standing", "as_tables", "clean_files"]
