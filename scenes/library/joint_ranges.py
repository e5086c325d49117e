"""How far human joints go, and a pose kept within that.

Active ranges of healthy adults after the American Academy of Orthopaedic Surgeons, as
printed in Norkin & White 2016, Measurement of Joint Motion, 5th ed., appendix B.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .poses import Pose

JOINT_RANGES: dict[str, tuple[float, float]] = {
    "trunk flexion": (-30.0, 80.0),
    "trunk bend": (-35.0, 35.0),
    "trunk rotation": (-45.0, 45.0),
    "neck flexion": (-45.0, 45.0),
    "neck bend": (-45.0, 45.0),
    "neck rotation": (-60.0, 60.0),
    "shoulder elevation": (0.0, 180.0),
    "shoulder extension": (-180.0, 60.0),
    "elbow flexion": (0.0, 150.0),
    "hip flexion": (-30.0, 120.0),
    # 45 with a straight hip; bent and turned out it goes further, by how much is a
    # guess from side kicks and splits.
    "hip abduction": (-30.0, 65.0),
    "knee flexion": (0.0, 150.0),
}
"""Least and greatest angle [deg] by joint; thoracic and lumbar spine make the trunk."""

_PARTS = ("flexion", "bend", "rotation")


def within_ranges(pose: Pose) -> Pose:
    """Return the pose with trunk and neck held within their ranges.

    Elbows and knees cannot leave theirs, shoulders and hips go where scripts put them.
    """
    trunk = np.radians([JOINT_RANGES[f"trunk {part}"] for part in _PARTS])
    neck = np.radians([JOINT_RANGES[f"neck {part}"] for part in _PARTS])
    return replace(
        pose,
        spine=np.clip(pose.spine, *trunk.T),
        head=np.clip(pose.head, *neck.T),
    )
