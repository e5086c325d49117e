"""The virtual Kinect: what the sensor would have said of a performance.

Rays tell what the sensor sees of each joint (``visibility``); from that follow where
the tracker puts it (``tracker_errors``) and what it says of it (``tracker_states``).
No depth image is made.

Positions of a take are in the sensor's frame, see ``sensor``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import mujoco
import numpy as np

from kinefilter.characters import KINECT_V1, Body, State, Take, standard_body
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import IDENTITY
from kinefilter.scenes.library.performers import Performance, perform_medley

from .geometry import SENSORS, Sensor, in_sensor_frame, in_world_frame
from .tracker_errors import TrackerErrors, misplaced
from .tracker_states import believed, guessed, swapped
from .visibility import look


def observe(
    performance: Performance,
    *,
    seed: int,
    sensor: Sensor | None = None,
    errors: TrackerErrors | None = None,
    scene: mujoco.MjSpec | None = None,
    prop_poses: Mapping[str, Array] | None = None,
    person: int | None = None,
) -> Take:
    """Return a take of a performance as a Kinect might have recorded it.

    Positions [m] are in the sensor's frame, NaN where the joint is not tracked.

    Args:
        performance: What happens in front of the sensor.
        seed: Draws every error; the same seed gives the same take.
        sensor: The sensor; by default a Kinect v2 at 1 m height, 2.7 m in front.
        errors: How far its tracker errs; by default as recorded ones do.
        scene: The room and its props, z up as MuJoCo has it; by default a bare floor.
        prop_poses: For bodies of the scene that move: position [m] and orientation
            wxyz in every frame, MuJoCo's world, shape (T, 7).
        person: Draws what stays the same in all takes of a person; by default the
            seed.

    Raises:
        InputError: A moving prop is no body of the scene, not a child of its world,
            or its poses do not fit the performance.
    """
    sensor, errors = sensor or Sensor(), errors or TrackerErrors()
    rng = np.random.default_rng([seed, 0])
    identity = np.random.default_rng([seed if person is None else person, 1])
    sight = look(performance, sensor, scene=scene, prop_poses=prop_poses)
    frames, skeleton = len(performance), performance.body.skeleton
    fps = performance.fps
    eye = in_world_frame(np.zeros(3), sensor)
    placed = misplaced(
        performance,
        sight,
        sensor,
        errors,
        eye=eye,
        rest_front=_rest_front(performance.body, sensor),
        rng=rng,
        person=identity,
    )
    inside = sensor.in_view(in_sensor_frame(performance.positions, sensor))
    inside &= inside[:, [skeleton.root]]
    state = believed(performance, sight, inside, errors, fps, rng)
    placed = guessed(placed, performance, sight, state, errors, fps, rng)
    toward = (eye - performance.positions[:, skeleton.root]) * np.array([1.0, 0.0, 1.0])
    toward /= np.linalg.norm(toward, axis=-1, keepdims=True)
    placed = swapped(placed, performance, sight, errors, fps, toward, rng)
    positions = in_sensor_frame(placed, sensor)
    positions[state == State.NOT_TRACKED] = np.nan
    arrived = rng.random(frames) >= sensor.dropped_share
    arrived[0] = True
    time = performance.time + rng.normal(0.0, sensor.stamp_jitter, frames)
    time = np.maximum.accumulate(time - time[0])
    return Take(
        time[arrived], positions[arrived], state[arrived], skeleton, performance.name
    )


def _rest_front(body: Body, sensor: Sensor) -> Array:
    """Return how much each part of a T-pose bulges towards the sensor [m], (J,)."""
    frontal = replace(sensor, azimuth=0.0, tilt=0.0)
    joints = len(body.skeleton)
    still = Performance(
        name="rest",
        time=np.zeros(1),
        positions=body.rest_positions[None],
        rotations=np.broadcast_to(IDENTITY, (1, joints, 4)),
        body=body,
    )
    return np.asarray(look(still, frontal).front[0])


def sample_take() -> Take:
    """Return the shipped sample, ``takes/wave_punch_bend.csv``, from scratch.

    A person half turned away waves, punches and bends before a Kinect v1; the hand
    leaves the picture while it waves.
    """
    parts = [("wave", 0.5), ("punch", 2.0), ("bend", 0.5)]
    body = standard_body(KINECT_V1)
    performance = perform_medley(parts, body, seed=17)
    sensor = replace(SENSORS["v1"], height=0.8, distance=2.5, azimuth=0.8)
    return observe(performance, seed=7, sensor=sensor)
