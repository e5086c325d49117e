"""The virtual Kinect, which records simulated takes of a motion.

Its tracker ``model`` adds errors fitted to recordings to the ground truth: ray casting
determines how much of each joint the sensor sees (``visibility``), and from that follow
the errors of position (``tracker_errors``) and the states (``tracker_states``).
``depth`` finds joints in rendered depth images (``depth_tracker``).
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Literal, get_args

import mujoco
import numpy as np

from kinefilter.characters import KINECT_V1, Motion, State, Take, standard_body
from kinefilter.characters.arrays import Array, as_numbers, check_choice
from kinefilter.scenes.library.performers import perform_medley

from .depth_tracker import track_in_depth
from .geometry import SENSORS, Sensor, in_sensor_frame
from .tracker_errors import TrackerErrors, with_position_errors
from .tracker_states import swapped_joints, tracking_states, with_guesses
from .visibility import look

Tracker = Literal["model", "depth"]


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
