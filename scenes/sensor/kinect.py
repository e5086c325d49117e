"""The virtual Kinect, which records simulated takes of a motion.

Its tracker ``model`` adds errors fitted to recordings to the ground truth: ray casting
determines how much of each joint the sensor sees (``visibility``), and from that follow
the errors of position (``tracker_errors``), guesses, states and swapped limbs.
``depth`` finds joints in rendered depth images (``depth_tracker``).
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Literal, get_args

import mujoco
import numpy as np
from numpy.random import Generator

from kinefilter.characters import (
    KINECT_V1,
    Motion,
    Skeleton,
    State,
    Take,
    standard_body,
)
from kinefilter.characters.arrays import Array, Codes, Flags, as_numbers, check_choice
from kinefilter.characters.rotations import rotate, unit
from kinefilter.characters.skeleton import SIDES
from kinefilter.scenes.library.performers import perform_medley

from .depth_tracker import track_in_depth
from .geometry import SENSORS, Sensor, in_sensor_frame, in_world_frame
from .tracker_errors import TrackerErrors, slow_noise, velocities, with_position_errors
from .visibility import Sight, look

Tracker = Literal["model", "depth"]
_NEEDED = {"Head": 0.0, "Thumb": 0.0, "Shoulder": -0.2, "Hip": -0.3}
_NEEDED |= {"Elbow": 0.65, "Wrist": 0.82, "Hand": 0.81}
_NEEDED |= dict.fromkeys(("HandTip", "Knee", "Ankle", "Foot"), 0.2)
"""Minimum believed visible share of a part for its joint to be tracked, set by hand so
that each kind of joint is inferred as often as in recordings of free movement."""
_NEEDED_OF_TRUNK = -0.3  # the tracker always finds some of it
_ARM = ("Elbow", "Wrist", "Hand", "HandTip", "Thumb")
_LEG = ("Knee", "Ankle", "Foot")
_LIMB_SHARE = 0.5  # of the doubt's variance, common to a limb's joints; a guess
_FLICKER = 0.1  # of the doubt's variance, independent from frame to frame


def observe(
    motion: Motion,
    *,
    seed: int,
    sensor: Sensor | None = None,
    errors: TrackerErrors | None = None,
    scene: mujoco.MjSpec | None = None,
    prop_poses: Mapping[str, Array] | None = None,
    person: int | None = None,
    tracker: Tracker = "model",
) -> Take:
    """Return a take of a motion as a Kinect might have recorded it.

    Positions [m] are in the sensor frame, NaN for joints that are not tracked. The seed
    determines all errors. The sensor is by default a Kinect v2, 1 m high and 2.7 m
    away, and the scene, z up as in MuJoCo, a bare floor. ``prop_poses`` are the
    positions [m] and orientations (wxyz) of its moving bodies in every frame, in
    MuJoCo's world, (T, 7). Only for the tracker ``model``, ``errors`` are the sizes of
    errors, by default as in recordings, and ``person`` is the seed of those that all
    takes of a person share, by default ``seed``. Raises an InputError if the tracker is
    unknown, a moving prop is not a direct child of the scene's worldbody, or its poses
    do not fit the motion.
    """
    check_choice(tracker, get_args(Tracker), "tracker")
    sensor, errors = sensor or Sensor(), errors or TrackerErrors()
    shape, of = (len(motion), 7), ": position and quaternion (wxyz) in every frame"
    props = {
        name: as_numbers(poses, f"the pose of prop {name!r}", shape, of).astype(float)
        for name, poses in (prop_poses or {}).items()
    }
    rng = np.random.default_rng([seed, 0])
    if tracker == "depth":
        positions, state = track_in_depth(motion, sensor, rng, scene, props)
    else:
        identity = np.random.default_rng([seed if person is None else person, 1])
        sight = look(motion, sensor, scene=scene, prop_poses=props)
        placed = with_position_errors(motion, sight, sensor, errors, rng, identity)
        in_view = sensor.in_view(in_sensor_frame(motion.positions, sensor))
        in_view &= in_view[:, [motion.skeleton.root]]
        state = tracking_states(motion, sight, in_view, errors, rng)
        placed = with_guesses(placed, motion, sight, state, errors, rng)
        swap = swapped_joints(motion, sight, sensor, errors, rng)[..., None]
        placed = np.where(swap, placed[:, motion.skeleton.mirror], placed)
        positions = in_sensor_frame(placed, sensor)
        positions[state == State.NOT_TRACKED] = np.nan
    arrived = rng.random(len(motion)) >= sensor.dropped_share
    arrived[0] = True
    time = motion.time + rng.normal(0.0, sensor.stamp_jitter, len(motion))
    time = np.maximum.accumulate(time - time[0])[arrived]
    kept = positions[arrived], state[arrived]
    return Take(time, *kept, motion.skeleton, motion.source)


def sample_take() -> Take:
    """Simulate the shipped sample: someone aside waves out of view, punches, bends."""
    parts = [("wave", 0.5), ("punch", 2.0), ("bend", 0.5)]
    motion = perform_medley(parts, standard_body(KINECT_V1), seed=17)
    sensor = replace(SENSORS["v1"], height=0.8, distance=2.5, azimuth=0.8)
    return observe(motion, seed=7, sensor=sensor)


def _limbs(skeleton: Skeleton) -> list[list[int]]:
    return [
        [skeleton.index(s + side) for s in stems if s + side in skeleton.joints]
        for stems in (_ARM, _LEG)
        for side in SIDES
    ]


def tracking_states(
    motion: Motion, sight: Sight, in_view: Flags, errors: TrackerErrors, rng: Generator
) -> Codes:
    """Return states (T, J), tracked where enough of a part is believed visible."""
    skeleton, shape = motion.skeleton, sight.visible.shape
    steps = errors.doubt_time * motion.fps
    slow = slow_noise(shape, steps, rng)
    for limb in _limbs(skeleton):
        shared = slow_noise((shape[0], 1), steps, rng)
        slow[:, limb] *= np.sqrt(1.0 - _LIMB_SHARE)
        slow[:, limb] += np.sqrt(_LIMB_SHARE) * shared
    doubt = np.sqrt(1.0 - _FLICKER) * slow + np.sqrt(_FLICKER) * rng.normal(size=shape)
    from_root = motion.positions - motion.positions[:, [skeleton.root]]
    speed = np.linalg.norm(velocities(from_root, motion.fps), axis=-1)
    visible = sight.visible - errors.merging * sight.merged - errors.fast * speed
    needed = [_NEEDED.get(kind, _NEEDED_OF_TRUNK) for kind in skeleton.kinds]
    tracked = visible + errors.doubt * doubt > errors.trust + np.array(needed)
    state = np.where(tracked, State.TRACKED, State.INFERRED)
    return np.where(in_view, state, State.NOT_TRACKED).astype(np.uint8)


def with_guesses(
    placed: Array,
    motion: Motion,
    sight: Sight,
    state: Codes,
    errors: TrackerErrors,
    rng: Generator,
) -> Array:
    """Return positions [m] with inferred joints moved toward the tracker's guesses.

    A guess jumps from where the joint was last tracked, relative to its parent, and
    drifts to its usual position in a standing person. Its weight is the hidden share.
    """
    skeleton = motion.skeleton
    frame = np.arange(len(state))
    jumps = errors.jump * rng.normal(size=placed.shape)
    positions = placed.copy()
    arm, body = np.isin(skeleton.kinds, _ARM), motion.body
    usual = body.rest_offsets.copy()  # joints relative to their parents, arms down
    usual[arm] = body.lengths[arm, None] * [0.0, -1.0, 0.0]
    usual = rotate(motion.rotations[:, skeleton.root, None], usual)
    for j, parent in zip(skeleton.segments, skeleton.segment_parents, strict=True):
        tracked = state[:, j] == State.TRACKED
        last = np.maximum.accumulate(np.where(tracked, frame, -1))
        since = (frame - last) / motion.fps
        # A joint that was never tracked is at its usual position.
        kept = np.where(last >= 0, np.exp(-since / max(errors.guess_time, 1e-6)), 0.0)
        before = placed[last, j] - placed[last, parent] + jumps[last, j]
        guess = positions[:, parent] + _between(usual[:, j], before, kept)
        weight = errors.guess * np.where(tracked, 0.0, 1.0 - sight.visible[:, j])
        positions[:, j] += weight[:, None] * (guess - placed[:, j])
    return positions


def _between(start: Array, end: Array, share: Array) -> Array:
    share = share[:, None]
    lengths = [np.linalg.norm(v, axis=-1, keepdims=True) for v in (start, end)]
    length = lengths[0] + share * (lengths[1] - lengths[0])
    mixed = start + share * (end - start)
    norm = np.linalg.norm(mixed, axis=-1, keepdims=True)
    return np.asarray(mixed * length / np.maximum(norm, 1e-6))


def swapped_joints(
    motion: Motion, sight: Sight, sensor: Sensor, errors: TrackerErrors, rng: Generator
) -> Flags:
    """Return True for joints that are swapped with those of the other side, (T, J)."""
    fps, root = motion.fps, motion.skeleton.root
    swap = np.zeros(sight.rival.shape, dtype=bool)
    left_arm, right_arm, left_leg, right_leg = _limbs(motion.skeleton)
    for limbs in (left_arm + right_arm, left_leg + right_leg):
        rival = sight.rival[:, limbs].max(axis=1)
        starts = rng.random(len(rival)) < errors.swap_rate * rival / fps
        lengths = rng.exponential(errors.swap_time * fps, len(rival))
        for start in np.flatnonzero(starts):
            swap[start : start + max(1, round(lengths[start])), limbs] = True
    to_sensor = in_world_frame(np.zeros(3), sensor) - motion.positions[:, root]
    toward = unit(to_sensor * np.array([1.0, 0.0, 1.0]))
    forward = rotate(motion.rotations[:, root], np.array([0.0, 0.0, 1.0]))
    facing = np.sum(forward * toward, axis=-1)
    swap ^= (facing < np.cos(errors.mirrored_beyond))[:, None]
    return swap
