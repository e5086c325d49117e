"""What a skeleton tracker says when it does not see: states, guesses, swapped limbs."""

from __future__ import annotations

import numpy as np

from kinefilter.characters import Motion, Skeleton, State
from kinefilter.characters.arrays import Array, Codes, Flags
from kinefilter.characters.rotations import rotate

from .geometry import Sensor, in_world_frame
from .tracker_errors import TrackerErrors, slow_noise
from .visibility import Sight

_NEEDED = {
    "Head": 0.0,
    "Shoulder": -0.2,
    "Hip": -0.3,
    "Elbow": 0.65,
    "Wrist": 0.82,
    "Hand": 0.81,
    "HandTip": 0.2,
    "Thumb": 0.0,
    "Knee": 0.2,
    "Ankle": 0.2,
    "Foot": 0.2,
}
"""Share of a part that must be believed seen for it to be tracked, set by hand so that
as many joints of each kind are inferred as in recordings of free movement."""
_NEEDED_OF_TRUNK = -0.3  # the tracker always finds some of it
_ARM = ("Elbow", "Wrist", "Hand", "HandTip", "Thumb")
_LEG = ("Knee", "Ankle", "Foot")
_SIDES = ("Left", "Right")
_LIMB_SHARE = 0.5  # of the doubt's variance that all joints of a limb share, a guess
_FLICKER = 0.1  # of the doubt's variance that is new in each frame


def _stem(joint: str) -> str:
    return joint.removesuffix("Left").removesuffix("Right")


def _limbs(skeleton: Skeleton) -> list[list[int]]:
    """Joints of left arm, right arm, left leg, right leg that may be swapped."""
    return [
        [skeleton.index(s + side) for s in stems if s + side in skeleton.joints]
        for stems in (_ARM, _LEG)
        for side in _SIDES
    ]


def believed(
    motion: Motion,
    sight: Sight,
    in_view: Flags,
    errors: TrackerErrors,
    rng: np.random.Generator,
) -> Codes:
    """Return the tracking states (T, J).

    A joint is tracked while the share of its part that is seen, as the tracker
    believes, is over a threshold; what lies out of view is not tracked.
    """
    skeleton, shape = motion.skeleton, sight.visible.shape
    steps = errors.doubt_time * motion.fps
    slow = slow_noise(shape, steps, rng)
    for limb in _limbs(skeleton):
        shared = slow_noise((shape[0], 1), steps, rng)
        slow[:, limb] *= np.sqrt(1.0 - _LIMB_SHARE)
        slow[:, limb] += np.sqrt(_LIMB_SHARE) * shared
    doubt = np.sqrt(1.0 - _FLICKER) * slow + np.sqrt(_FLICKER) * rng.normal(size=shape)
    seen = sight.visible - errors.merging * sight.merged
    if shape[0] > 1:
        seen = seen - errors.fast * _speed(motion)
    needed = [_NEEDED.get(_stem(j), _NEEDED_OF_TRUNK) for j in skeleton.joints]
    tracked = seen + errors.doubt * doubt > errors.trust + np.array(needed)
    state = np.where(tracked, State.TRACKED, State.INFERRED)
    return np.where(in_view, state, State.NOT_TRACKED).astype(np.uint8)


def _speed(motion: Motion) -> Array:
    """Speed of each joint against the root [m/s], (T, J)."""
    root = motion.positions[:, [motion.skeleton.root]]
    velocity = np.gradient(motion.positions - root, 1.0 / motion.fps, axis=0)
    return np.asarray(np.linalg.norm(velocity, axis=-1))


def guessed(
    placed: Array,
    motion: Motion,
    sight: Sight,
    state: Codes,
    errors: TrackerErrors,
    rng: np.random.Generator,
) -> Array:
    """Return positions [m] with inferred joints where the tracker guesses them.

    A guess starts where the joint was last seen, relative to its parent, jumps
    somewhat, and goes to where such joints mostly are: hanging. It counts as much as
    the part is hidden.
    """
    skeleton = motion.skeleton
    row = np.arange(len(state))
    jumps = errors.jump * rng.normal(size=placed.shape)
    positions = placed.copy()
    hanging = _hanging(motion)
    for j, parent in zip(skeleton.segments, skeleton.segment_parents, strict=True):
        seen = state[:, j] == State.TRACKED
        last = np.maximum.accumulate(np.where(seen, row, -1))
        since = (row - last) / motion.fps
        # What was never seen is where such joints mostly are.
        drift = np.where(last >= 0, np.exp(-since / max(errors.guess_time, 1e-6)), 0.0)
        kept = placed[last, j] - placed[last, parent] + jumps[last, j]
        guess = positions[:, parent] + _between(hanging[:, j], kept, drift)
        weight = errors.guess * np.where(seen, 0.0, 1.0 - sight.visible[:, j])
        positions[:, j] += weight[:, None] * (guess - placed[:, j])
    return positions


def _between(usual: Array, kept: Array, share: Array) -> Array:
    """Return vectors a share of the way to ``kept``, their lengths so as well."""
    share = share[:, None]
    sizes = [np.linalg.norm(v, axis=-1, keepdims=True) for v in (usual, kept)]
    size = sizes[0] + share * (sizes[1] - sizes[0])
    mixed = usual + share * (kept - usual)
    return np.asarray(
        mixed * size / np.maximum(np.linalg.norm(mixed, axis=-1, keepdims=True), 1e-6)
    )


def _hanging(motion: Motion) -> Array:
    """Vectors [m] from each joint's parent of a person who stands, (T, J, 3)."""
    body = motion.body
    skeleton = body.skeleton
    usual = body.rest_offsets.copy()
    for j, joint in enumerate(skeleton.joints):
        if _stem(joint) in _ARM:
            usual[j] = [0.0, -body.lengths[j], 0.0]
    pelvis = motion.rotations[:, skeleton.root, None]
    return rotate(pelvis, usual)


def swapped(
    positions: Array,
    motion: Motion,
    sight: Sight,
    sensor: Sensor,
    errors: TrackerErrors,
    rng: np.random.Generator,
) -> Array:
    """Return positions [m] with limbs taken for the other side's, world, (T, J, 3)."""
    fps = motion.fps
    skeleton = motion.skeleton
    swap = np.zeros(positions.shape[:2], dtype=bool)
    left_arm, right_arm, left_leg, right_leg = _limbs(skeleton)
    for limb in (left_arm + right_arm, left_leg + right_leg):
        rival = sight.rival[:, limb].max(axis=1)
        starts = rng.random(len(rival)) < errors.swap_rate * rival / fps
        lengths = rng.exponential(errors.swap_time * fps, len(rival))
        for start in np.flatnonzero(starts):
            stop = start + max(1, round(lengths[start]))
            swap[start:stop, limb] = True
    eye = in_world_frame(np.zeros(3), sensor)
    toward = (eye - motion.positions[:, skeleton.root]) * np.array([1.0, 0.0, 1.0])
    toward /= np.linalg.norm(toward, axis=-1, keepdims=True)
    forward = rotate(motion.rotations[:, skeleton.root], np.array([0.0, 0.0, 1.0]))
    facing = np.sum(forward * toward, axis=-1)
    swap ^= (facing < np.cos(errors.mirrored_beyond))[:, None]
    return np.where(swap[..., None], positions[:, skeleton.mirror], positions)
