"""Writing pictures to files: H.264 in MP4, animated GIF, numbered PNG.

Videos are drawn in parts. Each is encoded separately and starts with a keyframe, so
that parts from several processes can be joined in one file.
"""

import io
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from fractions import Fraction
from itertools import chain
from pathlib import Path
from typing import Any

import av
import numpy as np
from av.codec.context import Flags
from numpy.typing import NDArray

from kinefilter.characters import InputError
from kinefilter.pipeline.formats import atomic_path

Pixels = NDArray[np.uint8]  # a picture, shape (height, width, 3)
Size = tuple[int, int]  # width and height in pixels
Coded = tuple[bytes, bool]  # an encoded picture, and whether it is a keyframe
Parts = Iterable[list[Coded]]

# x264's quality 18 is said to look lossless; above 18, lines on the floor suffer.
_X264 = {"preset": "veryfast", "crf": "18", "bf": "0", "threads": "1"}
# Otherwise its vector code for small pictures depends on what was in memory before.
_X264["x264-params"] = "cpu-independent=1"
_LARGEST_RATE = 100_000  # denominator of a frame rate
_HUNDREDTH = Fraction(1, 100)  # s, the time unit of a GIF


def encode_video(pictures: Iterable[Pixels], size: Size, rate: float) -> list[Coded]:
    """Encode the pictures of one part."""
    codec = _x264(av.CodecContext.create("libx264", "w"), size, rate)
    packets = []
    for number, picture in enumerate(pictures):
        packets += codec.encode(_frame(picture, number, codec))
    packets += codec.encode(None)
    return [(bytes(packet), packet.is_keyframe) for packet in packets]


def write_mp4(parts: Parts, path: Path, size: Size, rate: float) -> None:
    """Write the parts of a video (``encode_video``), or raise an InputError."""
    with _media_file(path, {"movflags": "+faststart"}) as file:
        stream = file.add_stream("libx264", rate=_fraction(rate))
        _x264(stream.codec_context, size, rate)
        for number, (data, keyframe) in enumerate(chain.from_iterable(parts)):
            packet: Any = av.Packet(data)
            packet.stream, packet.time_base = stream, 1 / _fraction(rate)
            packet.pts = packet.dts = number
            packet.duration, packet.is_keyframe = 1, keyframe
            file.mux(packet)


def write_gif(parts: Parts, path: Path, size: Size, rate: float) -> None:
    """Write an endless animation of PNG pictures, or raise an InputError."""
    pictures = [data for part in parts for data, _ in part]
    # One palette for all pictures keeps the floor from flickering, and so does ordered
    # dither: error diffusion would change the whole floor in every frame.
    (palette,) = _filtered(pictures, "palettegen", "reserve_transparent=0")
    dither = "dither=bayer:bayer_scale=5"
    frames = _filtered(pictures, "paletteuse", dither, palette)
    with _media_file(path, {"loop": "0"}) as file:
        stream = file.add_stream("gif", rate=_fraction(rate))
        stream.width, stream.height = size
        stream.pix_fmt = "pal8"
        stream.codec_context.time_base = _HUNDREDTH
        for number, frame in enumerate(frames):
            frame.pts = round(number / (_fraction(rate) * _HUNDREDTH))
            frame.time_base = _HUNDREDTH
            file.mux(stream.encode(frame))
        file.mux(stream.encode(None))


def encode_png(picture: Pixels) -> bytes:
    """Encode a picture as PNG."""
    codec: Any = av.CodecContext.create("png", "w")
    codec.height, codec.width = picture.shape[:2]
    codec.pix_fmt, codec.time_base = "rgb24", Fraction(1, 30)
    codec.options = {"compression_level": "4", "pred": "up"}
    packets = codec.encode(_frame(picture, 0, codec)) + codec.encode(None)
    return b"".join(bytes(packet) for packet in packets)


def _fraction(rate: float) -> Fraction:
    return Fraction(rate).limit_denominator(_LARGEST_RATE)


def _x264(codec: Any, size: Size, rate: float) -> Any:
    codec.width, codec.height = size
    codec.pix_fmt = "yuv420p"
    codec.framerate, codec.time_base = _fraction(rate), 1 / _fraction(rate)
    codec.options = dict(_X264)
    codec.flags |= Flags.global_header
    return codec


def _frame(picture: Pixels, number: int, codec: Any) -> Any:
    frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture))
    frame.pts, frame.time_base = number, codec.time_base
    return frame


@contextmanager
def _media_file(path: Path, options: dict[str, str]) -> Iterator[Any]:
    """Yield a media file that replaces ``path`` once it is complete."""
    try:
        # A full disk may go unnoticed until the file is closed.
        with (
            atomic_path(path) as temporary,
            av.open(str(temporary), "w", options=options) as file,
        ):
            yield file
    except av.FFmpegError as error:
        raise InputError(
            f"{path}: cannot be written ({error}); write elsewhere or free some space"
        ) from error


def _filtered(
    pictures: Sequence[bytes], name: str, options: str, palette: Any = None
) -> Iterator[Any]:
    """Yield the frames a filter makes from PNG pictures and, for some, a palette."""
    graph: Any = av.filter.Graph()
    node, sink = graph.add(name, options), graph.add("buffersink")
    with av.open(io.BytesIO(b"".join(pictures)), "r", format="png_pipe") as file:
        source = graph.add_buffer(file.streams.video[0])
        graph.link_nodes(source, node, sink)
        if palette is not None:
            palette.pts = 0
            colors = graph.add_buffer(palette, time_base=palette.time_base)
            colors.link_to(node, 0, 1)
        graph.configure()
        if palette is not None:
            colors.push(palette)
            colors.push(None)
        for frame in chain(file.decode(video=0), [None]):
            source.push(frame)
            with suppress(av.BlockingIOError, av.EOFError):
                while True:
                    yield sink.pull()
