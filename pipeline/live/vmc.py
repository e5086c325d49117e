"""Poses for engines: the VMC protocol, OSC messages in datagrams (protocol.vmc.info).

A pose is the person on VRM's skeleton (``retarget/rigs/vrm.toml``), in the person's own
size: of each bone the name that Unity has for it, and position [m] and rotation (xyzw)
relative to its parent, of the hips relative to the root, which stays at the world's
origin. Unity's axes are left-handed: x is mirrored, so (x, y, z) becomes (-x, y, z) and
the quaternion (w, x, y, z) becomes (w, x, -y, -z).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Body, Clip, State
from kinefilter.pipeline.avatar import Pose
from kinefilter.retarget.retargeting import retarget
from kinefilter.retarget.rig_map import load_rig_map
from kinefilter.retarget.rotations import IDENTITY, inverse, multiply, rotate
from kinefilter.retarget.target_rig import built_rig

__all__ = ["VmcFigure", "absence"]

Array = NDArray[np.float64]

LARGEST_BUNDLE = 1400
"""Bytes: what an Ethernet packet holds, so that no datagram is split."""
_HEAD, _PREFIX = 16, 4  # bytes of a bundle's head, and before each message in it
_MIRRORED = np.array([-1.0, 1.0, 1.0])
_TURNED = np.array([1.0, 1.0, -1.0, -1.0])  # wxyz


class VmcFigure:
    """One person as VMC sends them.

    Args:
        body: The person's body.
    """

    def __init__(self, body: Body) -> None:
        self.body = body
        self.rig = built_rig(load_rig_map("vrm"), body)
        self._parents = np.array(self.rig.rest.parents)
        names = self.rig.rest.names
        self._names = [name[0].upper() + name[1:] for name in names]

    def bones(self, pose: Pose, time: float) -> dict[str, tuple[Array, Array]]:
        """Return where each bone is relative to its parent, in Unity's axes.

        Args:
            pose: The pose of the body.
            time: Its stamp [s].

        Returns:
            By bone: position [m], shape (3,), and rotation wxyz, shape (4,).
        """
        there = retarget(_clip(pose, self.body, time), self.rig)
        rotations, positions = there.rotations[0], there.positions[0]
        root = self._parents < 0
        above = np.where(root[:, None], IDENTITY, rotations[self._parents])
        start = np.where(root[:, None], 0.0, positions[self._parents])
        local = rotate(inverse(above), positions - start) * _MIRRORED
        turns = multiply(inverse(above), rotations) * _TURNED
        return dict(zip(self._names, zip(local, turns, strict=True), strict=True))

    def bundles(self, pose: Pose, time: float, since: float) -> list[bytes]:
        """Return a pose as bundles of messages, each of which fits into a datagram.

        Args:
            pose: The pose of the body.
            time: Its stamp [s].
            since: The stamp of the first pose [s]; VMC's times are short floats.
        """
        messages = [
            _message("/VMC/Ext/OK", 1),
            _message("/VMC/Ext/T", time - since),
            _place("/VMC/Ext/Root/Pos", "root", np.zeros(3), IDENTITY),
        ]
        for name, (position, turn) in self.bones(pose, time).items():
            messages.append(_place("/VMC/Ext/Bone/Pos", name, position, turn))
        return _bundled(messages)


def absence() -> bytes:
    """Return the message that nobody is there."""
    return _message("/VMC/Ext/OK", 0)


def _clip(pose: Pose, body: Body, time: float) -> Clip:
    """Return the one pose as a clip."""
    joints = len(body.skeleton)
    ones = np.ones((1, joints))
    ranks = np.full((1, joints), State.TRACKED, dtype=np.uint8)
    none = np.zeros((1, joints), dtype=np.uint8)
    return Clip(
        time=np.array([time]),
        positions=pose.positions[None],
        rotations=pose.rotations[None],
        skeleton=body.skeleton,
        body=body,
        state=ranks,
        reliability=ones,
        deciding_term=none,
        origin=none,
        moved_by_correction=0.0 * ones,
        moved_by_physics=0.0 * ones,
        contacts=np.repeat(pose.stands, 2)[None],
        external_force=np.array([pose.external_force]),
        source="live",
    )


def _place(address: str, name: str, position: Array, turn: Array) -> bytes:
    """Return a message of a place; the quaternion wxyz is sent as xyzw."""
    return _message(address, name, *position.tolist(), *np.roll(turn, -1).tolist())


def _message(address: str, *values: str | int | float) -> bytes:
    from pythonosc.osc_message_builder import OscMessageBuilder

    builder = OscMessageBuilder(address)
    for value in values:
        builder.add_arg(value)
    return bytes(builder.build().dgram)


def _bundled(messages: list[bytes]) -> list[bytes]:
    """Return as few bundles as hold the messages in their order."""
    bundles: list[list[bytes]] = []
    size = LARGEST_BUNDLE + 1
    for message in messages:
        size += _PREFIX + len(message)
        if size > LARGEST_BUNDLE:
            bundles.append([])
            size = _HEAD + _PREFIX + len(message)
        bundles[-1].append(message)
    return [_bundle(bundle) for bundle in bundles]


def _bundle(messages: list[bytes]) -> bytes:
    from pythonosc.osc_bundle_builder import IMMEDIATELY, OscBundleBuilder
    from pythonosc.osc_message import OscMessage

    builder = OscBundleBuilder(IMMEDIATELY)
    for message in messages:
        builder.add_content(OscMessage(message))
    return bytes(builder.build().dgram)
