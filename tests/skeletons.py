"""Tests of what is the same for every sensor."""

from __future__ import annotations

import pytest

from kinefilter.characters import KINECT_V1, KINECT_V2

__all__ = ["every_skeleton"]

every_skeleton = pytest.mark.parametrize(
    "skeleton", [KINECT_V1, KINECT_V2], ids=lambda s: s.name
)
