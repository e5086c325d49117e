"""Cleaning folders of takes into folders of clips, on all cores or on a cluster.

``pipeline/lab/RESULTS.md`` has what a million takes need, ``tests/batch_figures.py``
measures it, and ``tests/batch_faults.py`` kills runs and workers.
"""
