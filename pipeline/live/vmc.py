"""Poses for engines: the VMC protocol, OSC messages in datagrams (protocol.vmc.info).

A pose is the person on VRM's skeleton (``retarget/rigs/vrm.toml``) in the person's own
size. Each bone has Unity's name, and position [m] and rotation (xyzw) relative to its
parent; the hips are relative to the root, which stays at the world origin. Unity's axes
are left-handed: x is mirrored.
"""

import numpy as np

from kinefilter.characters import Body, Motion
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import IDENTITY, inverse, multiply, rotate, slerp
from kinefilter.pipeline.avatar import Pose
from kinefilter.retarget.retargeting import segment_of, turned
from kinefilter.retarget.rig_map import SIDES, load_rig_map
from kinefilter.retarget.target_rig import built_rig

from .osc import MIRRORED, TURNED, Bundles, message

_AT_ORIGIN = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)  # x, y, z [m], then xyzw


class VmcFigure:
    """One person as VMC bones, each turned by its segment as in ``retarget``.

    Since arms and legs have the person's lengths and directions, hands and feet have
    the right positions relative to shoulders and hips.
    """

    def __init__(self, body: Body) -> None:
        self.body = body
        self.rig = built_rig(load_rig_map("vrm"), body)
        rest, skeleton = self.rig.rest, body.skeleton
        self._names = [name[0].upper() + name[1:] for name in rest.names]
        self._parents = np.maximum(rest.parents, 0)
        self._root = np.array(rest.parents) < 0
        self._local = rest.positions - rest.positions[self._parents]
        turns = np.tile(IDENTITY, (1, len(skeleton), 1))
        root = body.rest_positions[None, skeleton.root]
        still = Motion(time=np.zeros(1), body=body, root=root, rotations=turns)
        at_rest = turned(still, self.rig)
        self._rest_turns = np.array([at_rest[n][0] for n in range(len(rest))])
        self._segments = np.zeros(len(rest), dtype=np.intp)
        for part, joints in self.rig.parts.items():
            if part != "spine":
                self._segments[list(joints)] = segment_of(skeleton, part)
        self._spine = list(self.rig.parts["spine"])
        self._shares = np.linspace(0.0, 1.0, len(self._spine))
        self._trunk = [skeleton.parents[skeleton.girdle], skeleton.girdle]
        # The hips bone relative to the middle of the thighs [m], which turns with it,
        # and how much higher VRM's ankles are above flat soles than ours [m].
        positions, joint = rest.positions, self.rig.joint
        thighs = [joint(f"{side} thigh") for side in SIDES]
        feet = [joint(f"{side} foot") for side in SIDES]
        self._over = positions[joint("pelvis")] - positions[thighs].mean(axis=0)
        ours = body.rest_positions[skeleton.sides("Ankle"), 1].mean()
        self._higher = [0.0, positions[feet, 1].mean() - self.rig.floor - ours, 0.0]
        changes = (np.nan,) * len(_AT_ORIGIN)
        self._bundles = Bundles(
            [
                message("/VMC/Ext/OK", 1),
                message("/VMC/Ext/T", np.nan),
                message("/VMC/Ext/Root/Pos", "root", *changes),
                *(message("/VMC/Ext/Bone/Pos", n, *changes) for n in self._names),
            ]
        )

    def bones(self, pose: Pose) -> dict[str, tuple[Array, Array]]:
        """Return each bone's position [m] (3,) and rotation, wxyz (4,), by its name.

        They are relative to its parent, in Unity's axes.
        """
        segments = pose.rotations[self._segments]
        lower, upper = pose.rotations[self._trunk]
        segments[self._spine] = slerp(lower, upper, self._shares)
        turns = multiply(segments, self._rest_turns)
        above = np.where(self._root[:, None], IDENTITY, turns[self._parents])
        local = self._local.copy()
        hips = pose.positions[self.body.skeleton.hips].mean(axis=0) + self._higher
        local[self._root] = hips + rotate(turns[self._root], self._over)
        rotations = multiply(inverse(above), turns) * TURNED
        bones = zip(local * MIRRORED, rotations, strict=True)
        return dict(zip(self._names, bones, strict=True))

    def bundles(self, pose: Pose, seconds: float) -> list[bytes]:
        """Return a pose as bundles of messages, each of which fits into a packet.

        ``seconds`` is the time since the first pose [s].
        """
        bones = self.bones(pose).values()
        places = [[*position, *turn[1:], turn[0]] for position, turn in bones]
        return self._bundles.filled(np.array([seconds, *_AT_ORIGIN, *np.ravel(places)]))


def absence() -> bytes:
    """Return the message that there is no person."""
    return message("/VMC/Ext/OK", 0)
