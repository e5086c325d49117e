"""What a performer is asked to look like: a pose, and poses in time."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import gaussian_filter1d

from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import continuous

_ARMS = (12, 20)  # where ``Pose.flat`` keeps the quaternions
_SMOOTHING = 0.05
"""Standard deviation [s] of the blur that rounds the joins between key poses."""


@dataclass(frozen=True, eq=False)
class Pose:
    """A posture, or with a leading axis of frames a motion. Angles in radians.

    Axes of sides are (left, right). World frame: y up, floor y = 0, facing +z.
    """

    root: Array
    """Wanted position of the root joint [m], (..., 3); height is cut to leg reach."""
    pelvis: Array
    """Yaw to the left, tilt forward, lean to the left, (..., 3)."""
    spine: Array
    """Flexion, bend to the left, axial rotation to the left, (..., 3)."""
    head: Array
    """The same three of head against thorax, (..., 3)."""
    arm: Array
    """Upper arm against thorax, wxyz, written for a left arm, (..., 2, 4)."""
    elbow: Array
    """Elbow flexion, (..., 2)."""
    hand: Array
    """Pronation of the hand about the forearm and wrist flexion, (..., 2, 2)."""
    ankle: Array
    """Ankle [m] of the foot if it stood flat, world frame, (..., 2, 3)."""
    foot: Array
    """Yaw in the world and heel rise (pitch about the toes), (..., 2, 2)."""
    lifted: Array
    """0: the foot stands on the floor; 1: it hangs from the shank, (..., 2)."""
    knee_out: Array
    """Rotation of the knee outward beyond the foot's direction, (..., 2)."""

    def flat(self) -> Array:
        """Return all channels side by side, (..., 40)."""
        lead = self.root.shape[:-1]
        return np.concatenate(
            [getattr(self, f.name).reshape(*lead, -1) for f in fields(self)], axis=-1
        )

    def unflat(self, channels: Array) -> Pose:
        """Return the pose whose ``flat`` is ``channels``, quaternions made unit."""
        values, start = {}, 0
        for f in fields(self):
            shape = getattr(self, f.name).shape[self.root.ndim - 1 :]
            stop = start + int(np.prod(shape))
            part = channels[..., start:stop]
            values[f.name] = part.reshape(*channels.shape[:-1], *shape)
            start = stop
        values["arm"] = values["arm"] / np.linalg.norm(
            values["arm"], axis=-1, keepdims=True
        )
        return Pose(**values)

    def with_arm(self, side: int, arm: tuple[Array, Array]) -> Pose:
        """Return the pose with another (upper arm, elbow) on one side."""
        arms, elbows = self.arm.copy(), self.elbow.copy()
        arms[..., side, :], elbows[..., side] = arm
        return replace(self, arm=arms, elbow=elbows)

    def leaning(
        self,
        *,
        drop: float = 0.0,
        back: float = 0.0,
        side: float = 0.0,
        pelvis: tuple[float, float, float] = (0.0, 0.0, 0.0),
        spine: tuple[float, float, float] = (0.0, 0.0, 0.0),
        head: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> Pose:
        """Return the pose with the root moved [m] and trunk angles [rad] added."""
        return replace(
            self,
            root=self.root + np.array([side, -drop, -back]),
            pelvis=self.pelvis + np.array(pelvis),
            spine=self.spine + np.array(spine),
            head=self.head + np.array(head),
        )

    def with_foot(
        self,
        side: int,
        *,
        ankle: Array | None = None,
        yaw: float | None = None,
        heel: float | None = None,
        knee_out: float | None = None,
    ) -> Pose:
        """Return the pose with one foot standing elsewhere; lengths [m], angles rad."""
        ankles, foot, out = self.ankle.copy(), self.foot.copy(), self.knee_out.copy()
        lifted = self.lifted.copy()
        lifted[side] = 0.0
        if ankle is not None:
            ankles[side] = ankle
        if yaw is not None:
            foot[side, 0] = yaw
        if heel is not None:
            foot[side, 1] = heel
        if knee_out is not None:
            out[side] = knee_out
        return replace(self, ankle=ankles, foot=foot, knee_out=out, lifted=lifted)

    def stepping(self, side: int, to: Array, lift: float) -> Pose:
        """Return the pose with one foot [m] in the air halfway to a place."""
        middle = (self.ankle[side] + to) / 2.0 + np.array([0.0, lift, 0.0])
        return self.with_foot(side, ankle=middle, heel=0.2)


class Score:
    """Key poses in time, joined by smooth movements."""

    def __init__(self, pose: Pose) -> None:
        self.duration = 0.0
        """Time of the last key [s]."""
        self._times = [0.0]
        self._poses = [pose]

    def to(self, seconds: float, pose: Pose) -> Score:
        """Move to a pose within some seconds; returns the score itself."""
        self.duration += seconds
        self._times.append(self.duration)
        self._poses.append(pose)
        return self

    def hold(self, seconds: float) -> Score:
        """Stay in the last pose."""
        return self.to(seconds, self._poses[-1])

    def append(self, other: Score) -> Score:
        """Play another score after this one, which ends where the other starts."""
        self._times += [self.duration + time for time in other._times[1:]]
        self._poses += other._poses[1:]
        self.duration += other.duration
        return self

    @property
    def last(self) -> Pose:
        """The last pose."""
        return self._poses[-1]

    def sample(self, fps: float) -> tuple[Array, Pose]:
        """Return time [s], shape (T,), and the motion at a constant frame rate."""
        time = np.arange(0.0, self.duration, 1.0 / fps)
        keys = np.stack([pose.flat() for pose in self._poses])
        arms = slice(*_ARMS)
        quats = continuous(keys[:, arms].reshape(len(keys), 2, 4))
        keys[:, arms] = quats.reshape(len(keys), -1)
        channels = PchipInterpolator(self._times, keys)(time)
        channels = gaussian_filter1d(channels, _SMOOTHING * fps, axis=0, mode="nearest")
        return time, self.last.unflat(channels)
