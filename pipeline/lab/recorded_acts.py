"""Recordings for the lab: pairs, takes, and mocap that virtual sensors see."""

import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple, Self

import numpy as np

from kinefilter.characters import KINECT_V1, Body, InputError, Skeleton
from kinefilter.characters.arrays import Array, Flags
from kinefilter.characters.motion import Motion, State, Take
from kinefilter.pipeline.formats.mocap import RIGS, kinect_motion, read_mocap
from kinefilter.pipeline.formats.takes import read_take
from kinefilter.pipeline.pairs import PairedTake, read_pairs
from kinefilter.pipeline.reliability import segment_lengths
from kinefilter.pipeline.target.floor import clearances
from kinefilter.retarget import (
    fill_missing_joints,
    measured_body,
    rotations_from_positions,
)
from kinefilter.retarget.standardize import HeadingFrame, find_yaw
from kinefilter.scenes.sensor import Tracker, observe
from kinefilter.scenes.sensor.geometry import Sensor, in_sensor_frame, in_world_frame

from .database_build import mocap_body, whole_frames
from .methods.filters import bridge_gaps

DISTANCE = 2.5  # m: of the people in UI-PRMD from the Kinect
_SENSOR = Sensor(distance=DISTANCE, dropped_share=0.0, stamp_jitter=0.0)
index = KINECT_V1.index
NOT_IN_MOCAP = [index(j) for j in ("Spine", "HandLeft", "HandRight")]
"""Joints that the mocap lacks."""


@dataclass(frozen=True, eq=False)
class Pair:
    """A clip: joint positions by Kinect and mocap [m], both in the world frame."""

    clip: str
    kinect: Array
    mocap: Array
    act: Motion  # the mocap on a body of constant segment lengths
    inferred: Flags | None = None  # by a simulated tracker, (T, 20)

    @property
    def error(self) -> Array:
        """Kinect minus mocap [m], (T, 20, 3), NaN where either lacks the joint."""
        error = self.kinect - self.mocap
        error[:, NOT_IN_MOCAP] = np.nan
        return error


def pairs_of(file: Path, every: int = 1) -> Iterator[Pair]:
    """Yield a person's clips whose mocap has every joint, after gaps are filled."""
    shift = np.array([0.0, 0.0, DISTANCE])
    for pair in read_pairs(file)[::every]:
        mocap = _completed(pair.truth) + shift
        if np.isfinite(mocap).all():
            lengths = np.median(segment_lengths(mocap, KINECT_V1), axis=0)
            body = measured_body(KINECT_V1, lengths)
            act = _motion(pair.take.time, mocap, body, pair.clip)
            yield Pair(pair.clip, pair.take.positions + shift, mocap, act)


def seen_by(pair: Pair, tracker: Tracker = "model") -> Pair:
    """Return the clip as a tracker of the virtual Kinect sees it."""
    take = _observed(pair, tracker)
    kinect = in_world_frame(take.positions, _SENSOR)
    inferred = take.state != State.TRACKED
    return replace(pair, kinect=kinect, mocap=pair.act.positions, inferred=inferred)


def simulated_pair_of(pair: Pair, tracker: Tracker = "model") -> PairedTake:
    """Return the same as a take and its ground truth, in the sensor frame."""
    truth = in_sensor_frame(pair.act.positions, _SENSOR)
    return PairedTake(_observed(pair, tracker), truth, pair.clip[4:7], pair.clip)


def _observed(pair: Pair, tracker: Tracker) -> Take:
    person = int(pair.clip[5:7])
    seed = sum(map(ord, pair.clip)) * 1000 + person
    return observe(pair.act, seed=seed, sensor=_SENSOR, person=person, tracker=tracker)


def mocap_act(path: Path, skeleton: Skeleton, fps: float) -> Motion:
    """Return the motion of a mocap file, resampled and centered on the world's floor.

    It is performed by the body in the file and starts facing +z. Joints that the file
    lacks keep their rest posture; positions are interpolated linearly. Raises an
    InputError for other files, unknown joints or too few frames.
    """
    mocap = read_mocap(path)
    positions = kinect_motion(mocap, skeleton, RIGS).positions
    unit, body = mocap_body(positions, skeleton)
    whole = whole_frames(positions)
    stamps = mocap.stamps[whole]
    if len(stamps) < 2:
        raise InputError(
            f"{path}: fewer than two frames have all joints; give mocap of whole bodies"
        )
    flat = unit * positions[whole].reshape(len(stamps), -1)
    time = np.arange(stamps[0], stamps[-1], 1.0 / fps)
    even = np.stack([np.interp(time, stamps, column) for column in flat.T], axis=1)
    joints = fill_missing_joints(even.reshape(len(time), len(skeleton), 3), body)
    yaw = find_yaw(joints[0], skeleton)
    joints = HeadingFrame(np.zeros(3), np.nan_to_num(yaw)).remove(joints)
    joints -= 0.5 * (joints.min(axis=(0, 1)) + joints.max(axis=(0, 1)))
    joints[..., 1] -= (joints[..., 1] - clearances(body)).min()
    return _motion(time - time[0], joints, body, path.name)


def _completed(mocap: Array) -> Array:
    """Fill gaps linearly, and add the spine and the hands by fixed proportions."""
    filled = bridge_gaps(np.arange(len(mocap), dtype=float), mocap)
    trunk = filled[:, index("HipCenter")], filled[:, index("ShoulderCenter")]
    filled[:, index("Spine")] = 0.45 * trunk[0] + 0.55 * trunk[1]
    sides = KINECT_V1.sides
    wrists = filled[:, sides("Wrist")]
    filled[:, sides("Hand")] = wrists + 0.3 * (wrists - filled[:, sides("Elbow")])
    return filled


def _motion(time: Array, positions: Array, body: Body, source: str) -> Motion:
    root = positions[:, body.skeleton.root]
    rotations = rotations_from_positions(positions, body)
    return Motion(time=time, body=body, root=root, rotations=rotations, source=source)


_JITTER = 0.008  # m, added to mocap, which jitters less than a sensor. A guess.
_MOCAP_RATE = 30.0  # Hz
# Share of the frames of pairs that unseen arms are learned from: with all of them, the
# unseen arms of any take do the few exercises of the pairs.
_SHARE_OF_PAIRS = 0.15


class NamedTake(NamedTuple):
    """A take with the names of the person, movement and clip."""

    person: str
    movement: str
    name: str
    take: Take
    share: float = 1.0  # of its frames, to learn unseen arms from

    @classmethod
    def of(cls, pair: PairedTake) -> Self:
        """Return the Kinect take of a pair."""
        names = pair.subject, pair.movement, pair.clip
        return cls(*names, pair.take, _SHARE_OF_PAIRS)


def recordings_in(file: Path) -> Iterator[NamedTake]:
    """Yield the recordings in a pairs file (.npz), mocap (.bvh) or a take."""
    name = file.name.partition(".")[0]
    if file.suffix == ".npz":
        yield from map(NamedTake.of, read_pairs(file))
    else:
        is_mocap = ".bvh" in file.suffixes
        take = _take_of_mocap(file, name) if is_mocap else read_take(file)
        yield NamedTake(name, name, name, take)


def _take_of_mocap(file: Path, name: str) -> Take:
    mocap = read_mocap(file, [])
    positions = kinect_motion(mocap, KINECT_V1, RIGS).positions
    meters, _ = mocap_body(positions, KINECT_V1)
    step = max(1, round(1.0 / (_MOCAP_RATE * mocap.frame_time)))
    frames = np.flatnonzero(whole_frames(positions))[::step]
    positions = meters * positions[frames]
    rng = np.random.default_rng(zlib.crc32(name.encode()))
    positions += rng.normal(scale=_JITTER, size=positions.shape)
    time = np.arange(float(len(positions))) * step * mocap.frame_time
    state = np.full(positions.shape[:2], State.TRACKED, dtype=np.uint8)
    return Take(time, positions, state, KINECT_V1, str(file))
