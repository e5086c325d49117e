from __future__ import annotations

from collections.abc import Callable
from itertools import product

import numpy as np
import pytest
from numpy.typing import NDArray

from kinefilter.characters import (
    KINECT_V1,
    SKELETONS,
    Body,
    Clip,
    Skeleton,
    standard_body,
)
from kinefilter.retarget.kinematics import positions_from_rotations

MakeClip = Callable[..., Clip]

BODIES = {skeleton.name: standard_body(skeleton) for skeleton in SKELETONS.values()}


def _smooth_rotations(
    time: NDArray[np.float64], joints: int, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Swing every joint through up to a full turn, shape (T, J, 4)."""
    pace = rng.uniform(0.1, 2.0, (joints, 3))
    phase = rng.uniform(0.0, 6.0, (joints, 3))
    vectors = 3.0 * np.sin(time[:, None, None] * pace + phase)
    angles = np.linalg.norm(vectors, axis=-1, keepdims=True)
    axes = vectors / np.maximum(angles, 1e-12)
    return np.concatenate([np.cos(angles / 2), np.sin(angles / 2) * axes], axis=-1)


def _wild_rotations(
    frames: int, joints: int, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Mix random turns with quarter and half turns about the axes, (T, J, 4)."""
    corners = np.array([q for q in product((-1.0, 0.0, 1.0), repeat=4) if any(q)])
    quaternions = rng.normal(size=(frames, joints, 4))
    special = corners[rng.integers(len(corners), size=(frames, joints))]
    quaternions = np.where(rng.random((frames, joints, 1)) < 0.5, special, quaternions)
    return quaternions / np.linalg.norm(quaternions, axis=-1, keepdims=True)


@pytest.fixture(scope="session")
def make_clip() -> MakeClip:
    """Return a maker of clips whose positions follow from random rotations."""

    def make(
        frames: int = 40,
        skeleton: Skeleton = KINECT_V1,
        *,
        seed: int = 0,
        wild: bool = False,
        time: NDArray[np.float64] | None = None,
        body: Body | None = None,
    ) -> Clip:
        rng = np.random.default_rng(seed)
        if time is None:
            time = np.arange(frames) / 30.0
        joints, body = len(skeleton), body or BODIES[skeleton.name]
        if wild:
            rotations = _wild_rotations(len(time), joints, rng)
        else:
            rotations = _smooth_rotations(time, joints, rng)
        root = np.stack(
            [np.sin(time), 0.9 + 0.1 * np.cos(time), 2.0 + np.cos(time / 3)], axis=-1
        )
        shape = (len(time), joints)
        moved = rng.random(shape)
        moved[0, 0] = np.nan
        return Clip(
            time=time,
            positions=positions_from_rotations(rotations, root, body),
            rotations=rotations,
            skeleton=skeleton,
            body=body,
            state=rng.integers(1, 3, shape).astype(np.uint8),
            reliability=rng.random(shape),
            deciding_term=rng.integers(0, 5, shape).astype(np.uint8),
            origin=rng.integers(0, 3, shape).astype(np.uint8),
            moved_by_correction=moved,
            moved_by_physics=rng.random(shape),
            contacts=rng.random((len(time), 4)) < 0.5,
            external_force=rng.random(len(time)),
            source="made up",
        )

    return make
