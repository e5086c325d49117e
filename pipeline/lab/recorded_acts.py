"""Recorded pairs of Kinect and marker mocap as performances before another sensor."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from kinefilter.characters import KINECT_V1, InputError, Motion, Skeleton, State, Take
from kinefilter.characters.arrays import Array, Flags
from kinefilter.pipeline.formats.mocap import RIGS, kinect_motion, read_mocap
from kinefilter.pipeline.pairs import PairedTake
from kinefilter.pipeline.target.floor import clearances
from kinefilter.retarget import (
    HeadingFrame,
    find_yaw,
    measured_body,
    rotations_from_positions,
)
from kinefilter.retarget.orientation import hang_missing
from kinefilter.scenes.sensor import (
    Sensor,
    Tracker,
    in_sensor_frame,
    in_world_frame,
    observe,
)

from .database_build import mocap_body, whole_frames

DISTANCE = 2.5
"""Distance [m] from the Kinect at which ui-prmd's people stand."""
_SENSOR = Sensor(distance=DISTANCE, dropped_share=0.0, stamp_jitter=0.0)
index = KINECT_V1.index
UNSEEN = [index(j) for j in ("Spine", "HandLeft", "HandRight")]
"""Joints that the recordings lack."""


@dataclass(frozen=True, eq=False)
class Pair:
    """A clip: what a Kinect said [m] and what happened, both in the world's frame."""

    clip: str
    kinect: Array
    mocap: Array
    act: Motion
    """The mocap on a body of constant segment lengths."""
    inferred: Flags | None = None
    """Joints that a simulated tracker does not call tracked, (T, 20)."""

    @property
    def error(self) -> Array:
        """Kinect minus mocap [m], (T, 20, 3), NaN where either lacks the joint."""
        error = self.kinect - self.mocap
        error[:, UNSEEN] = np.nan
        return error


def pairs_of(file: Path, every: int = 1) -> Iterator[Pair]:
    """Yield the clips of a person that have no long gaps in the mocap."""
    with np.load(file, allow_pickle=False) as arrays:
        data = {k: arrays[k] for k in ("clip", "kinect", "mocap", "start", "stop")}
    spans = zip(data["clip"], data["start"], data["stop"], strict=True)
    for clip, start, stop in list(spans)[::every]:
        mocap = _completed(data["mocap"][start:stop].astype(float))
        if np.isfinite(mocap).all():
            shift = np.array([0.0, 0.0, DISTANCE])
            kinect = data["kinect"][start:stop].astype(float) + shift
            truth = mocap + shift
            yield Pair(str(clip), kinect, truth, _act(truth, str(clip)))


def seen_by(pair: Pair, tracker: Tracker = "model") -> Pair:
    """Return the clip as the virtual Kinect sees it, by one of its trackers."""
    take = _observed(pair, tracker)
    kinect = in_world_frame(take.positions, _SENSOR)
    unsure = take.state != State.TRACKED
    return replace(pair, kinect=kinect, mocap=pair.act.positions, inferred=unsure)


def paired_by(pair: Pair, tracker: Tracker = "model") -> PairedTake:
    """Return the same as a pair of a take and its truth, in the sensor's frame."""
    truth = in_sensor_frame(pair.act.positions, _SENSOR)
    return PairedTake(_observed(pair, tracker), truth, pair.clip[4:7], pair.clip)


def _observed(pair: Pair, tracker: Tracker) -> Take:
    person = int(pair.clip[5:7])
    seed = sum(map(ord, pair.clip)) * 1000 + person
    return observe(pair.act, seed=seed, sensor=_SENSOR, person=person, tracker=tracker)


def mocap_act(path: Path, skeleton: Skeleton, fps: float) -> Motion:
    """Return the motion of a mocap file, in the middle of the world's floor.

    The body is that of the recording, on another skeleton. It faces +z to begin with.

    Args:
        path: A file that ``database build`` reads, such as one of CMU's.
        skeleton: The joints of the motion; those that the file has not hang at rest.
        fps: Frames a second, between which joints go straight.

    Raises:
        InputError: It is no mocap, of unknown joints, or has too few whole frames.
    """
    mocap = read_mocap(path)
    positions = kinect_motion(mocap, skeleton, RIGS).positions
    unit, body = mocap_body(positions, skeleton)
    whole = whole_frames(positions)
    stamps = mocap.frame_time * np.flatnonzero(whole)
    if len(stamps) < 2:
        raise InputError(f"{path}: no two frames have all joints; give whole bodies")
    flat = unit * positions[whole].reshape(len(stamps), -1)
    time = np.arange(stamps[0], stamps[-1], 1.0 / fps)
    even = np.stack([np.interp(time, stamps, column) for column in flat.T], axis=1)
    joints = even.reshape(len(time), len(skeleton), 3)
    joints = hang_missing(joints, body)
    yaw = find_yaw(joints[0], np.ones(len(skeleton)), skeleton)
    joints = HeadingFrame(np.zeros(3), np.nan_to_num(yaw)).remove(joints)
    joints -= 0.5 * (joints.min(axis=(0, 1)) + joints.max(axis=(0, 1)))
    joints[..., 1] -= (joints[..., 1] - clearances(body)).min()
    turns = rotations_from_positions(joints, body)
    return Motion(
        time=time - time[0],
        body=body,
        root=joints[:, skeleton.root],
        rotations=turns,
        source=path.name,
    )


def _completed(mocap: Array) -> Array:
    """Fill marker gaps linearly, the spine between its ends, and the hands."""
    flat = mocap.reshape(len(mocap), -1).copy()
    rows = np.arange(len(flat))
    for column in flat.T:
        known = np.isfinite(column)
        if known.any():
            column[:] = np.interp(rows, rows[known], column[known])
    filled = flat.reshape(mocap.shape)
    trunk = filled[:, index("HipCenter")], filled[:, index("ShoulderCenter")]
    filled[:, index("Spine")] = 0.45 * trunk[0] + 0.55 * trunk[1]
    for side in ("Left", "Right"):
        wrist = filled[:, index(f"Wrist{side}")]
        forearm = wrist - filled[:, index(f"Elbow{side}")]
        filled[:, index(f"Hand{side}")] = wrist + 0.3 * forearm
    return filled


def _act(positions: Array, name: str) -> Motion:
    seg, par = KINECT_V1.segments, KINECT_V1.segment_parents
    bones = np.linalg.norm(positions[:, seg] - positions[:, par], axis=-1)
    lengths = np.full(len(KINECT_V1), np.nan)
    lengths[seg] = np.median(bones, axis=0)
    body = measured_body(KINECT_V1, lengths)
    turn = rotations_from_positions(positions, body)
    return Motion(
        time=np.arange(len(positions)) / 30.0,
        body=body,
        root=positions[:, KINECT_V1.root],
        rotations=turn,
        source=name,
    )
