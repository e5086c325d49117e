"""Poses for VRChat: its OSC trackers (docs.vrchat.com/docs/osc-trackers).

Each is at a joint [m] and turned with a segment [degrees], as Unity's left-handed axes
and its Euler angles have it, in the order z, x, y. By them VRChat moves the avatar of
the one person who plays; further people go to other ports.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from kinefilter.characters import Body
from kinefilter.pipeline.avatar import Pose

from .osc import MIRRORED, TURNED, Bundles, message


class VrchatFigure:
    """One person as hips, chest, feet, knees, upper arms (1 to 8), and the head."""

    def __init__(self, body: Body) -> None:
        self.body, skeleton = body, body.skeleton
        middle, head = [skeleton.root, skeleton.girdle], skeleton.index("Head")
        knees, elbows = skeleton.sides("Knee"), skeleton.sides("Elbow")
        self._joints = [*middle, *skeleton.sides("Ankle"), *knees, *elbows, head]
        self._segments = [*middle, *skeleton.sides("Foot"), *knees, *elbows, head]
        names, changes = [*map(str, range(1, 9)), "head"], (np.nan,) * 3
        self._bundles = Bundles(
            [
                message(f"/tracking/trackers/{name}/{what}", *changes)
                for name in names
                for what in ("position", "rotation")
            ]
        )

    def bundles(self, pose: Pose, _seconds: float) -> list[bytes]:
        """Return a pose as bundles of messages, each of which fits into a packet."""
        turns = pose.rotations[self._segments] * TURNED
        rotations = Rotation.from_quat(turns, scalar_first=True)
        turned = rotations.as_euler("YXZ", degrees=True)
        places = pose.positions[self._joints] * MIRRORED
        return self._bundles.filled(np.hstack([places, turned[:, [1, 0, 2]]]).ravel())
