"""Coded pictures into one video file, whole or not at all."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Any

from kinefilter.characters import InputError
from kinefilter.pipeline.formats import atomic_path

from .codec import Coded, rate_of, video_codec
from .palette import with_palette

FASTEST_GIF = 50.0
"""Frames a second that programs still play as they are."""

_HUNDREDTH = Fraction(1, 100)  # s: how finely a GIF tells time


def write_mp4(
    parts: Iterable[list[Coded]], path: Path, size: tuple[int, int], rate: float
) -> None:
    """Write the parts of a video one after another.

    Args:
        parts: Pictures of each part, as ``encode_video`` returns them.
        path: The file.
        size: Width and height in pixels.
        rate: Frames a second.

    Raises:
        InputError: The file cannot be written.
    """
    with _opened(path, {"movflags": "+faststart"}) as file:
        stream = file.add_stream("libx264", rate=rate_of(rate))
        video_codec(size, rate, context=stream.codec_context)
        first = 0
        for part in parts:
            for coded in part:
                file.mux(_packet(coded, stream, first, 1 / rate_of(rate)))
            first += len(part)


def write_gif(
    parts: Iterable[list[Coded]], path: Path, size: tuple[int, int], rate: float
) -> None:
    """Write an animation that plays for ever, with one palette for all pictures.

    Args:
        parts: Pictures of each part as PNG.
        path: The file.
        size: Width and height in pixels.
        rate: Frames a second.

    Raises:
        InputError: The file cannot be written.
    """
    pictures = [coded.data for part in parts for coded in part]
    with _opened(path, {"loop": "0"}) as file:
        stream = file.add_stream("gif", rate=rate_of(rate))
        stream.width, stream.height = size
        stream.pix_fmt = "pal8"
        stream.codec_context.time_base = _HUNDREDTH
        for number, frame in enumerate(with_palette(pictures, size)):
            frame.pts = round(number / (rate_of(rate) * _HUNDREDTH))
            frame.time_base = _HUNDREDTH
            file.mux(stream.encode(frame))
        file.mux(stream.encode(None))


def _packet(coded: Coded, stream: Any, first: int, step: Fraction) -> Any:
    import av

    packet: Any = av.Packet(coded.data)
    packet.stream, packet.time_base = stream, step
    packet.pts = packet.dts = first + coded.number
    packet.duration, packet.is_keyframe = 1, coded.whole
    return packet


@contextmanager
def _opened(path: Path, options: dict[str, str]) -> Iterator[Any]:
    """Yield a media file that takes the place of ``path`` once it is whole."""
    import av

    try:
        # What there is no room for may only show when the file is closed.
        with (
            atomic_path(path) as temporary,
            av.open(str(temporary), "w", options=options) as file,
        ):
            yield file
    except av.FFmpegError as error:
        raise InputError(
            f"{path}: cannot be written ({error}); write elsewhere or make room"
        ) from error
