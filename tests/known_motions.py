"""Motions whose figures are known."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import (
    KINECT_V1,
    KINECT_V2,
    Body,
    Motion,
    Skeleton,
    State,
    Take,
    standard_body,
)
from kinefilter.pipeline.physics import PhysicsResult, Targets, pull_through
from kinefilter.pipeline.physics.pulled_character import PulledCharacter
from kinefilter.pipeline.target.foot_pitch import pitch_of
from kinefilter.pipeline.target.planting import plant_feet
from kinefilter.retarget import find_yaw
from kinefilter.scenes.library import perform, random_body

__all__ = [
    "BODY",
    "FEET",
    "Array",
    "noisy",
    "performed",
    "plant",
    "polynomial",
    "pulled_through",
    "stamps",
    "standing",
    "toes_rest",
    "yaw_of",
]

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
BODY = standard_body(KINECT_V1)
FEET = [KINECT_V1.index(f"Foot{side}") for side in ("Left", "Right")]


def stamps(count: int, fps: float = 30.0) -> Array:
    return np.arange(count) / fps


def standing(frames: int, skeleton: Skeleton = KINECT_V1) -> Array:
    return np.tile(standard_body(skeleton).rest_positions, (frames, 1, 1))


def noisy(act: Motion, sigma: float = 0.006, seed: int = 0) -> Array:
    """Return where a performance's joints are seen, every axis off by sigma [m]."""
    rng = np.random.default_rng(seed)
    return act.positions + rng.normal(0.0, sigma, act.positions.shape)


def toes_rest(time: Array, positions: Array, skeleton: Skeleton = KINECT_V1) -> Flags:
    """Return where toes are slow and low: what a foot that stands does, (T, 2)."""
    paths = positions[:, skeleton.sides("Foot")]
    speed = np.linalg.norm(np.gradient(paths, time, axis=0), axis=2)
    height = paths[..., 1]
    return np.asarray((speed < 0.15) & (height < np.nanmin(height, axis=0) + 0.05))


def polynomial(time: Array, *vectors: list[float]) -> Array:
    """Return a path with these vectors as coefficients of t^0, t^1, ..., (T, 20, 3)."""
    powers = time[:, None] ** np.arange(len(vectors))
    path = np.asarray(powers @ np.array(vectors, float))
    return np.asarray(standing(len(time)) + path[:, None])


def pulled_through(
    character: PulledCharacter, *targets: Array, stands: NDArray[np.bool_] | None = None
) -> PhysicsResult:
    """Pull a character through a motion: time stamps, positions and rotations."""
    return pull_through([character], [Targets(*targets, stands=stands)])[0]


def performed(motion: str, skeleton: Skeleton = KINECT_V2, seed: int = 0) -> Take:
    """Return a take of a scripted motion by a perfect sensor."""
    body = random_body(skeleton, np.random.default_rng(seed))
    act = perform(motion, body, seed=seed)
    state = np.full(act.positions.shape[:2], State.TRACKED, dtype=np.uint8)
    return Take(act.time, act.positions, state, skeleton, motion)


def yaw_of(take: Take) -> Array:
    """Return the heading of the trunk [rad], (T,)."""
    return find_yaw(take.positions, take.skeleton)


def plant(
    time: Array, path: Array, weights: Array, stands: Flags, body: Body
) -> tuple[Array, Flags]:
    """Return ``plant_feet`` and which heels are down, for feet that stand flat."""
    pitch = np.where(stands, 0.0, pitch_of(path, body))
    found, contacts = plant_feet(time, path, weights, stands, pitch, body)
    return found, contacts[:, ::2]
