"""OSC messages whose numbers alone change, in datagrams that no network splits."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

LARGEST_BUNDLE = 1400
"""Bytes: what an Ethernet packet holds."""
_HEAD, _PREFIX = 16, 4  # bytes of a bundle's head, and before each message in it
_WORD = 4  # bytes, of which everything in OSC is a multiple, and a float one

Value = str | int | float

Content = tuple[str, tuple[Value, ...]]
"""Address and arguments of a message."""


def message(address: str, *values: Value) -> bytes:
    """Return a message."""
    from pythonosc.osc_message_builder import OscMessageBuilder

    builder = OscMessageBuilder(address)
    for value in values:
        builder.add_arg(value)
    return bytes(builder.build().dgram)


class Packets:
    """Bundles that are built once, and whose floats are written anew each time.

    Building them takes half a millisecond, writing the floats a tenth of that.

    Args:
        contents: The messages; the floats among their arguments come last and change.
    """

    def __init__(self, contents: Sequence[Content]) -> None:
        bundles: list[list[Content]] = []
        size = LARGEST_BUNDLE + 1
        for content in contents:
            length = _PREFIX + len(message(content[0], *content[1]))
            size += length
            if size > LARGEST_BUNDLE:
                bundles.append([])
                size = _HEAD + length
            bundles[-1].append(content)
        self._bundles = [_bundle(bundle) for bundle in bundles]

    def filled(self, floats: Sequence[float]) -> list[bytes]:
        """Return the bundles with all their floats in order."""
        packets, values = [], np.array(floats, dtype=">f4")
        for words, places in self._bundles:
            now, values = values[: len(places)], values[len(places) :]
            packet = words.copy()
            packet[places] = now
            packets.append(packet.tobytes())
        return packets


def _bundle(contents: list[Content]) -> tuple[NDArray[np.float32], NDArray[np.intp]]:
    """Return a bundle as words of four bytes, and which of them are its floats."""
    from pythonosc.osc_bundle_builder import IMMEDIATELY, OscBundleBuilder
    from pythonosc.osc_message import OscMessage

    builder, end = OscBundleBuilder(IMMEDIATELY), _HEAD // _WORD
    places: list[int] = []
    for address, values in contents:
        built = message(address, *values)
        builder.add_content(OscMessage(built))
        end += (_PREFIX + len(built)) // _WORD
        count = sum(isinstance(value, float) for value in values)
        places += range(end - count, end)
    words = np.frombuffer(builder.build().dgram, dtype=">f4")
    return words, np.array(places, dtype=np.intp)
