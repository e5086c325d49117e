"""What a performer is asked to look like: a pose, and poses in time.

Ranges of joints are active ones of healthy adults after the American Academy of
Orthopaedic Surgeons, in Norkin & White 2016, Measurement of Joint Motion, 5th ed.,
appendix B.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import gaussian_filter1d

from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import continuous

Rng = np.random.Generator
LEFT, RIGHT, BOTH = 0, 1, slice(None)
"""Sides of a pose."""

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

    def with_arm(self, side: int | slice, arm: tuple[Array, Array]) -> Pose:
        """Return the pose with another (upper arm, elbow) on one side, or on BOTH."""
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

    def over(self, side: int, share: float) -> Pose:
        """Return the pose with the root moved sideways towards one foot."""
        return self.leaning(side=float(share * (self.ankle[side, 0] - self.root[0])))

    def with_foot(
        self,
        side: int | slice,
        *,
        ankle: Array | None = None,
        yaw: float | None = None,
        heel: float | None = None,
        knee_out: float | None = None,
    ) -> Pose:
        """Return the pose with a foot standing elsewhere; lengths [m], angles [rad].

        With BOTH for a side, both feet do.
        """
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


JOINT_RANGES: dict[str, tuple[float, float]] = {
    "trunk flexion": (-30.0, 80.0),
    "trunk bend": (-35.0, 35.0),
    "trunk rotation": (-45.0, 45.0),
    "neck flexion": (-45.0, 45.0),
    "neck bend": (-45.0, 45.0),
    "neck rotation": (-60.0, 60.0),
    "shoulder elevation": (0.0, 180.0),
    "shoulder extension": (-180.0, 60.0),
    "elbow flexion": (0.0, 150.0),
    "hip flexion": (-30.0, 120.0),
    # 45 with a straight hip; bent and turned out it goes further, by how much is a
    # guess from side kicks and splits.
    "hip abduction": (-30.0, 65.0),
    "knee flexion": (0.0, 150.0),
}
"""Least and greatest angle [deg] by joint; thoracic and lumbar spine make the trunk."""

_PARTS = ("flexion", "bend", "rotation")


def within_ranges(pose: Pose) -> Pose:
    """Return the pose with trunk and neck held within their ranges.

    Elbows and knees cannot leave theirs, shoulders and hips go where scripts put them.
    """
    trunk = np.radians([JOINT_RANGES[f"trunk {part}"] for part in _PARTS])
    neck = np.radians([JOINT_RANGES[f"neck {part}"] for part in _PARTS])
    return replace(
        pose, spine=np.clip(pose.spine, *trunk.T), head=np.clip(pose.head, *neck.T)
    )
