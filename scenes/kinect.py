"""A small virtual Kinect: what the sensor would have said of a performance.

A model of the errors, not of the sensor: joints are displaced and their states drawn
at random, and a joint of a limb counts as hidden where the trunk, taken for rows of
balls, stands between it and the sensor. No depth image is made.

Sensor frame: origin at the sensor, y up, z from the sensor towards the person, x to
the sensor's left; a person who faces the sensor faces -z.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from kinefilter.characters import KINECT_V1, Skeleton, State, Take, standard_body
from kinefilter.retarget.rotations import about_y, rotate

from .performers import Performance, perform_medley

__all__ = ["Sensor", "observe", "sample_take"]

Array = NDArray[np.float64]

_LOOSE = {"Hand": 3.0, "Thumb": 3.0, "Wrist": 2.0, "Foot": 2.0, "Ankle": 1.5}
"""How much likelier than the other joints these are inferred."""
_UNSTEADY = {"Hand": 1.5, "Thumb": 1.5, "Wrist": 1.3, "Foot": 1.5, "Ankle": 1.2}
"""How much larger than the other joints' the errors of these are."""
_LIMBS = dict.fromkeys(
    ("Elbow", "Wrist", "Hand", "Thumb", "Knee", "Ankle", "Foot"), 1.0
)
_TRUNK_RADIUS = 0.06  # of stature
_LONGEST_RUN = 90  # frames
_DRIFT_FRAMES = 10.0  # until a drifting joint has gone most of its way


@dataclass(frozen=True)
class Sensor:
    """Where the virtual Kinect stands and how far it errs.

    Defaults whose field names no source are guesses that give the bone length
    variation of recorded takes, 4 to 8 %.
    """

    height: float = 1.0
    """Height of the sensor above the floor [m]."""
    distance: float = 2.7
    """Horizontal distance from the sensor to the origin of the performance [m]."""
    azimuth: float = 0.0
    """Angle by which the performer is turned to its left from facing the sensor
    [rad]."""
    depth_noise: float = 0.0012
    """Standard deviation of a joint's depth per frame at 1 m [m]; it grows with depth
    squared, as triangulation's does (Khoshelham & Elberink 2012, Sensors 12(2))."""
    wobble: float = 0.008
    """Standard deviation of a joint's slow error along each axis [m]."""
    wobble_time: float = 0.1
    """Standard deviation of the blur that makes the error slow [s]."""
    bias: float = 0.01
    """Standard deviation of a joint's constant misplacement along each axis [m]."""
    runs_per_second: float = 0.05
    """Rate at which a visible joint of the trunk falls into a run of inferred frames
    [1/s]."""
    hidden_factor: float = 30.0
    """How much likelier a run starts while the trunk hides the joint."""
    run_median: float = 2.0
    """Median length of these runs [frames], as in recorded takes."""
    run_p90: float = 19.0
    """90th percentile of the length of these runs [frames], as in recorded takes."""
    lost_share: float = 0.08
    """Share of runs in which the joint is not tracked at all, in [0, 1]."""
    astray: tuple[float, float] = (0.05, 0.4)
    """Least and largest displacement of an inferred joint [m]."""
    dropped_share: float = 0.01
    """Share of frames that never arrive, in [0, 1]."""
    stamp_jitter: float = 0.001
    """Standard deviation of the time stamps [s]."""


def observe(
    performance: Performance, *, seed: int, sensor: Sensor | None = None
) -> Take:
    """Return a take of a performance as a Kinect might have recorded it.

    Positions [m] are in the sensor's frame, NaN where the joint is not tracked. Half
    of the inferred joints jump to a wrong place at once, half drift there.

    Args:
        performance: What happens in front of the sensor.
        seed: Draws every error; the same seed gives the same take.
        sensor: The sensor; by default one at 1 m height, 2.7 m in front.
    """
    sensor = sensor or Sensor()
    rng = np.random.default_rng(seed)
    skeleton = performance.body.skeleton
    truth = _in_sensor_frame(performance.positions, sensor)
    hidden = _behind_trunk(truth, skeleton, _TRUNK_RADIUS * performance.body.height)
    fps = 1.0 / float(np.median(np.diff(performance.time)))
    positions = truth + _error(truth, skeleton, sensor, fps, rng)
    chance = sensor.runs_per_second / fps * _weights(skeleton, _LOOSE)
    chance = chance * np.where(hidden, sensor.hidden_factor, 1.0)
    state = np.full(hidden.shape, int(State.TRACKED), dtype=np.uint8)
    for frame, joint in np.argwhere(rng.random(chance.shape) < chance):
        run = slice(frame, frame + _run_length(sensor, rng))
        away = _astray(len(state[run]), sensor, rng)
        lost = rng.random() < sensor.lost_share
        for j in _with_tail(joint, skeleton):
            positions[run, j] = truth[run, j] + away
            state[run, j] = State.NOT_TRACKED if lost else State.INFERRED
    positions[state == State.NOT_TRACKED] = np.nan
    arrived = rng.random(len(state)) >= sensor.dropped_share
    arrived[0] = True
    time = performance.time + rng.normal(0.0, sensor.stamp_jitter, len(state))
    time = np.maximum.accumulate(time - time[0])
    return Take(
        time[arrived], positions[arrived], state[arrived], skeleton, performance.name
    )


def _in_sensor_frame(positions: Array, sensor: Sensor) -> Array:
    turned = rotate(about_y(np.pi + sensor.azimuth), positions)
    return np.asarray(turned + np.array([0.0, -sensor.height, sensor.distance]))


def _weights(
    skeleton: Skeleton, table: dict[str, float], *, other: float = 1.0
) -> Array:
    stems = [j.removesuffix("Left").removesuffix("Right") for j in skeleton.joints]
    return np.array([table.get(stem.removesuffix("Tip"), other) for stem in stems])


def _behind_trunk(
    positions: Array, skeleton: Skeleton, radius: float
) -> NDArray[np.bool_]:
    """Whether the trunk stands between the sensor and a joint of a limb, (T, J)."""
    root = positions[:, skeleton.root]
    v2 = "SpineShoulder" in skeleton.joints
    neck = positions[:, skeleton.index("SpineShoulder" if v2 else "ShoulderCenter")]
    far = np.linalg.norm(positions, axis=-1)
    ray = positions / far[..., None]
    hidden = np.zeros(far.shape, dtype=bool)
    width = positions[:, skeleton.index("HipLeft")] - root
    for share, side in product(np.linspace(0.0, 1.0, 8), (-0.6, 0.0, 0.6)):
        spot = (root + share * (neck - root) + side * width)[:, None, :]
        along = np.sum(spot * ray, axis=-1)
        off = np.linalg.norm(spot - along[..., None] * ray, axis=-1)
        hidden |= (off < radius) & (along + 0.5 * radius < far)
    return hidden & (_weights(skeleton, _LIMBS, other=0.0) > 0.0)


def _error(
    truth: Array,
    skeleton: Skeleton,
    sensor: Sensor,
    fps: float,
    rng: np.random.Generator,
) -> Array:
    """Noise along the line of sight, slow wobble and constant bias [m], (T, J, 3)."""
    depth = np.linalg.norm(truth, axis=-1, keepdims=True)
    noise = sensor.depth_noise * depth**2 * rng.normal(size=depth.shape)
    blur = sensor.wobble_time * fps
    slow = gaussian_filter1d(rng.normal(size=truth.shape), blur, axis=0, mode="wrap")
    slow *= np.sqrt(2.0 * blur * np.sqrt(np.pi))  # unit variance again
    fixed = rng.normal(size=truth.shape[1:])
    error = noise * truth / depth + sensor.wobble * slow + sensor.bias * fixed
    return np.asarray(error * _weights(skeleton, _UNSTEADY)[:, None])


def _with_tail(joint: int, skeleton: Skeleton) -> list[int]:
    """Return a joint and, on a limb, what hangs on it: a lost elbow takes the hand."""
    if _weights(skeleton, _LIMBS, other=0.0)[joint] == 0.0:
        return [joint]
    tail = [joint]
    for j in tail:
        tail.extend(skeleton.children[j])
    return tail


def _run_length(sensor: Sensor, rng: np.random.Generator) -> int:
    # A log-normal law through the two percentiles; 1.2816 is the normal's 90th.
    spread = np.log(sensor.run_p90 / sensor.run_median) / 1.2816
    length = sensor.run_median * float(np.exp(spread * rng.normal()))
    return int(np.clip(round(length), 1, _LONGEST_RUN))


def _astray(frames: int, sensor: Sensor, rng: np.random.Generator) -> Array:
    """Displacement [m] of a joint that jumps or drifts away, shape (frames, 3)."""
    way = rng.normal(size=3)
    way *= rng.uniform(*sensor.astray) / np.linalg.norm(way)
    gone = np.ones(frames)
    if rng.random() < 0.5:
        gone = 1.0 - np.exp(-2.0 * np.arange(1, frames + 1) / _DRIFT_FRAMES)
    return gone[:, None] * way + sensor.wobble * rng.normal(size=(frames, 3))


def sample_take() -> Take:
    """Return the shipped sample, ``takes/wave_punch_bend.csv``, from scratch.

    A person half turned away waves, punches and bends (Kinect v1).
    """
    parts = [("wave", 0.5), ("punch", 2.0), ("bend", 0.5)]
    body = standard_body(KINECT_V1)
    performance = perform_medley(parts, body, seed=11)
    return observe(performance, seed=7, sensor=Sensor(azimuth=1.0))
