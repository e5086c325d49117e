"""Cleaning folders of takes into folders of clips, on all cores or on a cluster.

A take of 300 frames needs 0.8 s of one core, so a million takes need 220 core hours, or
3 hours on 64 cores. A take has 0.23 MB and its USD clip 0.8 MB; 64 cores read 21 MB/s
and write 72 MB/s, 0.23 TB and 0.8 TB in all. Each worker needs 0.3 to 0.4 GB of memory,
whatever the number of takes. The limits to scaling are the store, and the one process
that plans the jobs and writes the manifest. ``tests/batch_figures.py`` measures this;
``tests/batch_faults.py`` kills runs and workers.
"""
