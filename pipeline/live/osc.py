"""OSC messages in datagrams, and Unity's axes, in which engines take poses.

Packing messages takes half a millisecond, so they are packed once; overwriting their
floats for each pose takes a tenth of that.
"""

import struct
from collections.abc import Sequence

import numpy as np

from kinefilter.characters.arrays import Array, Indices, Singles

LARGEST_BUNDLE = 1400  # bytes that fit into an Ethernet packet, so that none is split
MIRRORED = np.array([-1.0, 1.0, 1.0])  # of a position, in left-handed axes
TURNED = np.array([1.0, 1.0, -1.0, -1.0])  # of a quaternion, wxyz
_HEAD = b"#bundle\0" + bytes(7) + b"\1"  # of a bundle to be shown immediately


def message(address: str, *values: str | int | float) -> bytes:
    """Return an OSC message."""
    from pythonosc.osc_message_builder import OscMessageBuilder

    builder = OscMessageBuilder(address)
    for value in values:
        builder.add_arg(value)
    return bytes(builder.build().dgram)


class Bundles:
    """Messages in bundles, each of which fits into a packet; NaN are filled in."""

    def __init__(self, messages: Sequence[bytes]) -> None:
        bundles = [_HEAD]
        for one in messages:
            sized = struct.pack(">i", len(one)) + one
            if len(bundles[-1]) + len(sized) > LARGEST_BUNDLE:
                bundles.append(_HEAD)
            bundles[-1] += sized
        # OSC's words have four bytes; no other word than a NaN is NaN.
        self._bundles: list[tuple[Singles, Indices]] = []
        for bundle in bundles:
            words = np.frombuffer(bundle, dtype=">f4")
            self._bundles.append((words, np.flatnonzero(np.isnan(words))))

    def filled(self, values: Array) -> list[bytes]:
        """Return the bundles with the values in place of the NaN, in order."""
        packets, rest = [], values.astype(">f4")
        for words, changed in self._bundles:
            packet = words.copy()
            packet[changed], rest = rest[: len(changed)], rest[len(changed) :]
            packets.append(packet.tobytes())
        return packets
