"""Poses of a performer, and sequences of poses in time.

Joint ranges are the active ranges of healthy adults (American Academy of Orthopaedic
Surgeons, in Norkin & White 2016, Measurement of Joint Motion, 5th ed., appendix B).
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import gaussian_filter1d

from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import continuous

Rng = np.random.Generator
Angles = float | tuple[float, float, float]
Arm = tuple[Array, Array]  # upper arm (..., 4) and elbow (...) of a pose
LEFT, RIGHT, BOTH = 0, 1, slice(None)  # sides of a pose

_SMOOTHING = 0.05  # s, standard deviation of the blur of the motion at the key poses


@dataclass(frozen=True, eq=False)
class Pose:
    """A posture, or with a leading axis of frames a motion. Angles in radians.

    Axes of sides are (left, right). World frame: y up, floor y = 0, facing +z.
    """

    root: Array  # desired root joint [m], (..., 3); the legs' reach limits its height
    pelvis: Array  # yaw to the left, tilt forward, lean to the left, (..., 3)
    spine: Array  # flexion, bend and axial rotation to the left, (..., 3)
    head: Array  # the same angles of the head relative to the thorax, (..., 3)
    arm: Array  # upper arm relative to the thorax, wxyz, as for a left arm, (..., 2, 4)
    elbow: Array  # flexion, (..., 2)
    hand: Array  # pronation about the forearm, wrist flexion, (..., 2, 2)
    ankle: Array  # place [m] while the foot is flat, world frame, (..., 2, 3)
    foot: Array  # yaw in the world, heel rise (pitch about the toes), (..., 2, 2)
    lifted: Array  # 0: the foot is planted; 1: it hangs from the shank, (..., 2)
    knee_out: Array  # outward rotation of the knee relative to the foot, (..., 2)

    def with_arm(self, side: int | slice, arm: Arm) -> Pose:
        """Return the pose with a new (upper arm, elbow) on one side or on BOTH."""
        arms, elbows = self.arm.copy(), self.elbow.copy()
        arms[..., side, :], elbows[..., side] = arm
        return replace(self, arm=arms, elbow=elbows)

    def leaning(
        self,
        *,
        drop: float = 0.0,
        back: float = 0.0,
        side: float = 0.0,
        pelvis: Angles = 0.0,
        spine: Angles = 0.0,
        head: Angles = 0.0,
    ) -> Pose:
        """Return the pose with the root moved [m] and trunk angles [rad] added.

        A single number is a forward tilt or flexion.
        """
        tilt = pelvis if isinstance(pelvis, tuple) else (0.0, pelvis, 0.0)
        bend, nod = (a if isinstance(a, tuple) else (a, 0, 0) for a in (spine, head))
        return replace(
            self,
            root=self.root + np.array([side, -drop, -back]),
            pelvis=self.pelvis + np.array(tilt),
            spine=self.spine + np.array(bend),
            head=self.head + np.array(nod),
        )

    def over(self, side: int, share: float) -> Pose:
        """Return the pose with the root moved sideways toward one foot."""
        return self.leaning(side=float(share * (self.ankle[side, 0] - self.root[0])))

    def with_foot(
        self,
        side: int | slice,
        *,
        ankle: Array | None = None,
        yaw: float | None = None,
        heel: float | Array | None = None,
        knee_out: float | Array | None = None,
    ) -> Pose:
        """Return the pose with a foot, or with BOTH, planted as given [m, rad]."""
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
        """Return the pose with one foot in the air halfway to its next place [m]."""
        middle = (self.ankle[side] + to) / 2.0 + np.array([0.0, lift, 0.0])
        return self.with_foot(side, ankle=middle, heel=0.2)


class Score:
    """Key poses in time, joined by smooth movements."""

    def __init__(self, pose: Pose) -> None:
        self.duration = 0.0  # time of the last key pose [s]
        self._times = [0.0]
        self._poses = [pose]

    def to(self, seconds: float, pose: Pose) -> Score:
        """Move to a pose in the given time and return the score itself."""
        self.duration += seconds
        self._times.append(self.duration)
        self._poses.append(pose)
        return self

    def hold(self, seconds: float) -> Score:
        """Hold the last pose and return the score itself."""
        return self.to(seconds, self._poses[-1])

    def append(self, other: Score) -> None:
        """Append another score, which starts in the pose where this one ends."""
        self._times += [self.duration + time for time in other._times[1:]]
        self._poses += other._poses[1:]
        self.duration += other.duration

    def sample(self, fps: float) -> tuple[Array, Pose]:
        """Return time [s], shape (T,), and the motion at a constant frame rate."""
        time = np.arange(0.0, self.duration, 1.0 / fps)
        channels, width = {}, _SMOOTHING * fps
        for field in fields(Pose):
            keys = np.stack([getattr(pose, field.name) for pose in self._poses])
            if field.name == "arm":
                keys = continuous(keys)
            path = PchipInterpolator(self._times, keys)(time)
            soft = gaussian_filter1d(path, width, axis=0, mode="nearest")
            channels[field.name] = soft
        arm = channels["arm"]
        channels["arm"] = arm / np.linalg.norm(arm, axis=-1, keepdims=True)
        return time, Pose(**channels)


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
    # 45 with a straight hip; flexed and rotated outward it goes further. How much
    # further is a guess from side kicks and splits.
    "hip abduction": (-30.0, 65.0),
    "knee flexion": (0.0, 150.0),
}
"""Smallest and largest angle [deg]; the trunk is the thoracic and the lumbar spine."""


def within_ranges(pose: Pose) -> Pose:
    """Return the pose with trunk and neck angles clipped to their ranges."""
    angles = ("flexion", "bend", "rotation")
    trunk, neck = (
        np.radians([JOINT_RANGES[f"{part} {angle}"] for angle in angles])
        for part in ("trunk", "neck")
    )
    spine, head = np.clip(pose.spine, *trunk.T), np.clip(pose.head, *neck.T)
    return replace(pose, spine=spine, head=head)
