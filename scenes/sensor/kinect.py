"""The virtual Kinect: what the sensor would have said of a motion.

Two trackers look through it. Of one, the errors are a model that was fitted to
recordings: rays tell what the sensor sees of each joint (``visibility``), and from that
follow where the tracker puts it (``tracker_errors``) and what it says of it
(``tracker_states``). The other finds joints in depth images (``depth_tracker``), and
errs as it happens to.

Positions of a take are in the sensor's frame, see ``sensor``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Literal, get_args

import mujoco
import numpy as np

from kinefilter.characters import KINECT_V1, Motion, State, Take, standard_body
from kinefilter.characters.arrays import Array, Codes, check_word
from kinefilter.scenes.library.performers import perform_medley

from .depth_tracker import found_in_depth
from .geometry import SENSORS, Sensor, in_sensor_frame
from .tracker_errors import TrackerErrors, misplaced
from .tracker_states import believed, guessed, swapped
from .visibility import look

Tracker = Literal["model", "depth"]
"""How joints are found: put beside the truth by a model of a tracker's errors, or
looked for in depth images."""


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

    Positions [m] are in the sensor's frame, NaN where the joint is not tracked.

    Args:
        motion: What happens in front of the sensor.
        seed: Draws every error; the same seed gives the same take.
        sensor: The sensor; by default a Kinect v2 at 1 m height, 2.7 m in front.
        errors: How far its tracker errs; by default as recorded ones do. Of the
            tracker ``model`` alone.
        scene: The room and its props, z up as MuJoCo has it; by default a bare floor.
        prop_poses: For bodies of the scene that move: position [m] and orientation
            wxyz in every frame, MuJoCo's world, shape (T, 7).
        person: Draws what stays the same in all takes of a person; by default the
            seed. Of the tracker ``model`` alone: the other knows nobody.
        tracker: How joints are found.

    Raises:
        InputError: An unknown tracker; a moving prop is no body of the scene, not a
            child of its world, or its poses do not fit the motion.
    """
    check_word(tracker, get_args(Tracker), "tracker")
    sensor = sensor or Sensor()
    rng = np.random.default_rng([seed, 0])
    if tracker == "depth":
        positions, state = found_in_depth(
            motion, sensor, rng, scene=scene, prop_poses=prop_poses
        )
        return _recorded(motion, positions, state, sensor, rng)
    errors = errors or TrackerErrors()
    identity = np.random.default_rng([seed if person is None else person, 1])
    sight = look(motion, sensor, scene=scene, prop_poses=prop_poses)
    skeleton = motion.skeleton
    placed = misplaced(motion, sight, sensor, errors, rng=rng, person=identity)
    inside = sensor.in_view(in_sensor_frame(motion.positions, sensor))
    inside &= inside[:, [skeleton.root]]
    state = believed(motion, sight, inside, errors, rng)
    placed = guessed(placed, motion, sight, state, errors, rng)
    placed = swapped(placed, motion, sight, sensor, errors, rng)
    positions = in_sensor_frame(placed, sensor)
    positions[state == State.NOT_TRACKED] = np.nan
    return _recorded(motion, positions, state, sensor, rng)


def _recorded(
    motion: Motion,
    positions: Array,
    state: Codes,
    sensor: Sensor,
    rng: np.random.Generator,
) -> Take:
    """Return the frames that arrive, with stamps that tremble."""
    frames = len(motion)
    arrived = rng.random(frames) >= sensor.dropped_share
    arrived[0] = True
    time = motion.time + rng.normal(0.0, sensor.stamp_jitter, frames)
    time = np.maximum.accumulate(time - time[0])
    return Take(
        time[arrived],
        positions[arrived],
        state[arrived],
        motion.skeleton,
        motion.source,
    )


def sample_take() -> Take:
    """Return the shipped sample, ``takes/wave_punch_bend.csv``, from scratch.

    A person half turned away waves, punches and bends before a Kinect v1; the hand
    leaves the picture while it waves.
    """
    parts = [("wave", 0.5), ("punch", 2.0), ("bend", 0.5)]
    body = standard_body(KINECT_V1)
    motion = perform_medley(parts, body, seed=17)
    sensor = replace(SENSORS["v1"], height=0.8, distance=2.5, azimuth=0.8)
    return observe(motion, seed=7, sensor=sensor)
