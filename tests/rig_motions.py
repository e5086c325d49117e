"""Performances as clips, for the tests of other people's rigs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import KINECT_V2, Clip, Motion, Skeleton
from kinefilter.scenes.library import perform, random_body

Array = NDArray[np.float64]

ARM = ("upper arm", "lower arm", "hand"), ("Shoulder", "Elbow", "Wrist")
LEG = ("thigh", "shin", "foot"), ("Hip", "Knee", "Ankle")
SIDES = ("left", "right")
_STILL = 1e-3  # m between frames: a part of the foot that moves less stands


def performed(name: str, *, seed: int = 3, skeleton: Skeleton = KINECT_V2) -> Clip:
    """Return a scripted motion as a clip; what rests near the floor stands."""
    body = random_body(skeleton, np.random.default_rng(seed))
    motion = perform(name, body, seed=seed)
    shape = motion.positions.shape[:2]
    parts = [
        skeleton.index(f"{part}{side}")
        for side in ("Left", "Right")
        for part in ("Ankle", "Foot")
    ]
    path, rest = motion.positions[:, parts], body.rest_positions[parts, 1]
    step = np.linalg.norm(np.diff(path, axis=0), axis=-1)
    low = path[..., 1] < rest + 0.01
    known = {
        "reliability": np.ones(shape),
        "moved_by_correction": np.zeros(shape),
        "moved_by_physics": np.zeros(shape),
        "uncertainty": np.zeros(shape),
        "contacts": low & (np.concatenate([step[:1], step]) < _STILL),
        "source": name,
    }
    root = motion.positions[:, skeleton.root]
    posed = Motion(time=motion.time, body=body, root=root, rotations=motion.rotations)
    return Clip.of(posed, **known)


def bent_to(limb: Array) -> Array:
    """Return from the line between a limb's ends to its middle (T, 3, 3), (T, 3)."""
    line, bone = limb[:, 2] - limb[:, 0], limb[:, 1] - limb[:, 0]
    share = np.sum(bone * line, axis=-1) / np.sum(line * line, axis=-1)
    return np.asarray(bone - share[:, None] * line)
