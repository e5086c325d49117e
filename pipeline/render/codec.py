"""Pictures into bytes: H.264 for videos, PNG for single pictures.

A part of a video is encoded by itself and begins with a whole picture, so that parts
made in several processes follow one another in one file.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

Pixels = NDArray[np.uint8]

# Quality 18 of x264 is said to look lossless; lines on a floor show below that.
_OPTIONS = {"preset": "veryfast", "crf": "18", "bf": "0", "threads": "1"}
_LARGEST_RATE = 100_000  # denominator of a frame rate


@dataclass(frozen=True)
class Coded:
    """One coded picture."""

    data: bytes
    """What the codec made of it."""
    number: int
    """The picture's number in its part, from 0."""
    whole: bool
    """Whether it can be seen without those before it."""


def rate_of(rate: float) -> Fraction:
    """Return a frame rate as files have it."""
    return Fraction(rate).limit_denominator(_LARGEST_RATE)


def video_codec(size: tuple[int, int], rate: float, *, context: Any = None) -> Any:
    """Return x264 for videos of a size; the same settings for every part and file.

    Args:
        size: Width and height in pixels, both even.
        rate: Frames a second.
        context: The codec of a stream to set; by default a new one.
    """
    import av
    from av.codec.context import Flags

    codec = context or av.CodecContext.create("libx264", "w")
    codec.width, codec.height = size
    codec.pix_fmt = "yuv420p"
    codec.framerate, codec.time_base = rate_of(rate), 1 / rate_of(rate)
    codec.options = dict(_OPTIONS)
    codec.flags |= Flags.global_header
    return codec


def encode_video(
    pictures: Iterable[Pixels], size: tuple[int, int], rate: float
) -> list[Coded]:
    """Return the pictures of one part, coded."""
    import av

    codec = video_codec(size, rate)
    packets = []
    for number, picture in enumerate(pictures):
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture))
        frame.pts, frame.time_base = number, codec.time_base
        packets += codec.encode(frame)
    packets += codec.encode(None)
    return [Coded(bytes(p), n, p.is_keyframe) for n, p in enumerate(packets)]


def encode_png(picture: Pixels) -> bytes:
    """Return a picture as PNG."""
    import av

    codec: Any = av.CodecContext.create("png", "w")
    codec.height, codec.width = picture.shape[:2]
    codec.pix_fmt, codec.time_base = "rgb24", Fraction(1, 30)
    codec.options = {"compression_level": "4", "pred": "up"}
    frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture))
    packets = codec.encode(frame) + codec.encode(None)
    return b"".join(bytes(packet) for packet in packets)


def decode_png(data: bytes) -> Pixels:
    """Return the picture of a PNG, shape (height, width, 3)."""
    import av

    codec: Any = av.CodecContext.create("png", "r")
    frames = codec.decode(av.Packet(data)) + codec.decode(None)
    return np.asarray(frames[0].to_ndarray(format="rgb24"), dtype=np.uint8)
