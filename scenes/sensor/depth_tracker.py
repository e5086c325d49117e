"""A tracker that finds joints in depth images, and whose errors nobody wrote.

Shotton et al. 2011, Real-time human pose recognition in parts from single depth images,
CVPR: a forest tells body parts by pixel (``body_part_forest``), mean shift finds where
most of a part's skin is, and each joint lies a learned distance behind it. How much
skin was found around a joint decides its state; a joint that is not found stays where
it was, seen from its parent. Two rules keep left and right apart, the rest is what the
images show: of several places the one near to the last image's is preferred, and
segments do not stretch. They were chosen on s02, s03 and s04 of UI-PRMD.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import mujoco
import numpy as np

from kinefilter.characters import SKELETONS, Motion, Skeleton, State
from kinefilter.characters.arrays import Array, Codes

from .body_part_forest import BodyPartForest, parts_of_joints, shipped_forest
from .depth_image import DepthCamera, DepthImage, with_noise
from .geometry import Sensor
from .ray_casting import PosedBody, check_prop_poses

_DRAWN = 64  # points of skin that stand for a body part
_STARTS = 8  # of them from which mean shift starts
_STEPS = 10
_WIDTH = 0.06  # m: standard deviation of its kernel, about a hand's
_STEP, _LEAPS = 0.15, 0.1  # m: what a joint moves from image to image; share of leaps
_STRETCH = 1.4  # times its usual length that a segment may measure
_LEAST_PIXELS = 50  # that show somebody: less is nobody, a guess


class Proposals(NamedTuple):
    """Where joints are in one image, in the sensor's frame."""

    skin: Array
    """Where most of the skin around each joint is [m], NaN without any, (J, 3)."""
    area: Array
    """How much of it is there, by its probability [m^2], (J,)."""


def propose(
    image: DepthImage,
    forest: BodyPartForest,
    skeleton: Skeleton,
    before: Array | None = None,
) -> Proposals:
    """Return where the skin around each joint is, by mean shift (Shotton, eq. 7).

    Pixels count by their probability and by the area of skin that they show. Every
    second one is looked at. For each joint, points that are drawn by that weight stand
    for all. Of several places, the one with the most skin is taken, or with less if it
    is near to where the skin was in the image before [m], (J, 3).
    """
    rows, columns = np.nonzero(image.segments >= 0)
    kept = (rows + columns) % 2 == 0
    rows, columns = rows[kept], columns[kept]
    if len(rows) < _LEAST_PIXELS:
        nowhere = np.full((len(skeleton), 3), np.nan)
        return Proposals(nowhere, np.zeros(len(skeleton)))
    points = image.points(rows, columns)
    shares = forest.shares(image, rows, columns) @ parts_of_joints(skeleton)
    weights = 2.0 * shares * (points[:, 2] / image.focal)[:, None] ** 2
    whole = weights.sum(axis=0)
    # As many points of the same weight, at even steps of the sum of weights.
    ends = np.cumsum(weights, axis=0) / np.maximum(whole, 1e-12)
    steps = (np.arange(_DRAWN) + 0.5) / _DRAWN
    drawn = np.array([np.searchsorted(end, steps) for end in ends.T])
    cloud = points[np.minimum(drawn, len(points) - 1)]  # (J, drawn, 3)
    modes = cloud[:, :: _DRAWN // _STARTS]
    for _ in range(_STEPS):
        near = _kernel(modes, cloud)
        modes = near @ cloud / near.sum(axis=-1, keepdims=True)
    density = _kernel(modes, cloud).mean(axis=-1)
    likely = density
    if before is not None:
        away = np.linalg.norm(modes - before[:, None], axis=-1)
        stayed = np.exp(-0.5 * np.square(np.nan_to_num(away, nan=np.inf) / _STEP))
        likely = density * (_LEAPS + stayed)
    best = np.argmax(likely, axis=1)
    row = np.arange(len(skeleton))
    found = np.where(whole[:, None] > 0.0, modes[row, best], np.nan)
    return Proposals(found, whole * density[row, best])


def _kernel(modes: Array, cloud: Array) -> Array:
    """Return how near points (J, N, 3) are to modes (J, M, 3), (J, M, N)."""
    away = np.square(modes).sum(-1)[..., None] + np.square(cloud).sum(-1)[:, None]
    away -= 2.0 * modes @ cloud.swapaxes(1, 2)
    return np.asarray(np.exp(-0.5 * np.maximum(away, 0.0) / _WIDTH**2))


def found_in_depth(
    motion: Motion,
    sensor: Sensor,
    rng: np.random.Generator,
    *,
    scene: mujoco.MjSpec | None = None,
    prop_poses: Mapping[str, Array] | None = None,
    forest: BodyPartForest | None = None,
) -> tuple[Array, Codes]:
    """Return where joints are found [m], in the sensor's frame, and their states.

    Args:
        motion: What happens in front of the sensor.
        sensor: Where it stands, and what its lens and range allow.
        rng: Draws the noise of the images.
        scene: The room and its props, z up as MuJoCo has it; by default a bare floor.
        prop_poses: For bodies of the scene that move: position [m] and orientation
            wxyz in every frame, MuJoCo's world, shape (T, 7).
        forest: What tells the body parts; by default the one that ships.

    Raises:
        InputError: A moving prop is no body of the scene, not a child of its world,
            or its poses do not fit the motion.
    """
    forest, skeleton = forest or shipped_forest(), motion.skeleton
    prop_poses = prop_poses or {}
    check_prop_poses(motion, prop_poses)
    camera = DepthCamera(PosedBody(motion.body, scene, tuple(prop_poses)), sensor)
    push, least = constants_of(forest, skeleton)
    positions = np.full(motion.positions.shape, np.nan)
    state = np.full(positions.shape[:2], State.NOT_TRACKED, dtype=np.uint8)
    before = None
    for t, joints in enumerate(motion.positions):
        props = [np.asarray(poses[t], float) for poses in prop_poses.values()]
        image = with_noise(camera.take(joints, motion.rotations[t], props), sensor, rng)
        skin, area = propose(image, forest, skeleton, before)
        before = skin
        if not area.any():
            continue
        positions[t] = behind(skin, push)
        state[t] = np.where(area >= least, State.TRACKED, State.INFERRED)
    return steadied(positions, state, skeleton, sensor), state


def constants_of(forest: BodyPartForest, skeleton: Skeleton) -> tuple[Array, Array]:
    """Return how far joints lie behind the skin [m], and the least area [m^2], (J,)."""
    row = list(SKELETONS).index(skeleton.name)
    of_joint = np.argmax(parts_of_joints(skeleton), axis=0)
    return forest.push[row, of_joint], forest.least[row, of_joint]


def behind(skin: Array, push: Array) -> Array:
    """Return points [m] that lie some way [m] behind others, seen from the origin."""
    return np.asarray(skin * (1.0 + push / np.linalg.norm(skin, axis=-1))[..., None])


def steadied(
    positions: Array, state: Codes, skeleton: Skeleton, sensor: Sensor
) -> Array:
    """Return joints as they are told: inferred ones stay where they were.

    That is, seen from their parent. A joint too far from its parent, for what the
    segment measures in the take, is taken for another's and becomes inferred; what is
    out of view becomes not tracked, and is NaN.

    Args:
        positions: Where joints were found [m], in the sensor's frame, (T, J, 3).
        state: Their states, which change, (T, J).
        skeleton: The joints.
        sensor: What its lens and range allow.
    """
    held = positions.copy()
    parents = np.maximum(skeleton.parents, 0)
    bones = np.linalg.norm(positions - positions[:, parents], axis=-1)
    seen = (state == State.TRACKED) & (state[:, parents] == State.TRACKED)
    usual = [
        float(np.median(bones[some, j])) if some.any() else np.inf
        for j, some in enumerate(seen.T)
    ]
    for t in range(1, len(held)):
        for j in skeleton.order:
            before, parent = held[t - 1, j], skeleton.parents[j]
            if parent >= 0:
                before = before + held[t, parent] - held[t - 1, parent]
                if np.linalg.norm(held[t, j] - held[t, parent]) > _STRETCH * usual[j]:
                    state[t, j] = min(state[t, j], State.INFERRED)
            if state[t, j] == State.INFERRED and np.isfinite(before).all():
                held[t, j] = before
    lost = ~sensor.in_view(np.nan_to_num(held)) | np.isnan(held[..., 0])
    state[lost] = State.NOT_TRACKED
    held[lost] = np.nan
    return held
