"""Recordings, which are no part of kinefilter: tests that need them skip without."""

from __future__ import annotations

from pathlib import Path

import pytest

__all__ = ["CMU", "DATA", "PAIRS", "TAKES", "captured", "paired", "recorded"]

DATA = Path(__file__).parents[2] / "shared" / "data"
TAKES, PAIRS, CMU = DATA / "takes", DATA / "ui-prmd", DATA / "mocap" / "cmu"

recorded = pytest.mark.skipif(
    not TAKES.is_dir(), reason="no recorded takes in ../shared/data"
)
paired = pytest.mark.skipif(
    not PAIRS.is_dir(), reason="no pairs of Kinect and mocap in ../shared/data"
)
captured = pytest.mark.skipif(
    not CMU.is_dir(), reason="no motion capture in ../shared/data"
)
