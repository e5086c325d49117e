"""Pictures in the 256 colors that a GIF can have."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from fractions import Fraction
from typing import Any

from .codec import decode_png

_SIDE = 16  # pixels: a palette is a picture of its 256 colors
_STEP = Fraction(1, 1000)  # s; filters want a time base, and their order is all


def with_palette(pictures: Sequence[bytes], size: tuple[int, int]) -> Iterator[Any]:
    """Yield a frame of indices for each picture, all with one palette.

    One palette keeps a floor that does not change from flickering.

    Args:
        pictures: PNG files.
        size: Their width and height in pixels.
    """
    import av

    palette = _palette(pictures, size)
    graph = av.filter.Graph()
    source = _source(graph, size, "rgb24")
    colors = _source(graph, (_SIDE, _SIDE), "bgra")
    # Ordered dither: one that spreads errors would change the whole floor each frame.
    use = graph.add("paletteuse", "dither=bayer:bayer_scale=5")
    sink = graph.add("buffersink")
    source.link_to(use, 0, 0)
    colors.link_to(use, 0, 1)
    use.link_to(sink)
    graph.configure()
    colors.push(palette)
    colors.push(None)
    for number, data in enumerate(pictures):
        source.push(_frame(data, number))
        yield from _pulled(sink)
    source.push(None)
    yield from _pulled(sink)


def _palette(pictures: Sequence[bytes], size: tuple[int, int]) -> Any:
    """Return the frame of colors that serve all pictures best."""
    import av

    graph = av.filter.Graph()
    source = _source(graph, size, "rgb24")
    count = graph.add("palettegen", "reserve_transparent=0")
    sink = graph.add("buffersink")
    source.link_to(count)
    count.link_to(sink)
    graph.configure()
    for number, data in enumerate(pictures):
        source.push(_frame(data, number))
    source.push(None)
    (palette,) = _pulled(sink)
    palette.pts, palette.time_base = 0, _STEP
    return palette


def _source(graph: Any, size: tuple[int, int], layout: str) -> Any:
    import av

    return graph.add_buffer(
        width=size[0],
        height=size[1],
        format=av.VideoFormat(layout),
        time_base=_STEP,
    )


def _frame(data: bytes, number: int) -> Any:
    import av

    frame = av.VideoFrame.from_ndarray(decode_png(data))
    frame.pts, frame.time_base = number, _STEP
    return frame


def _pulled(sink: Any) -> Iterator[Any]:
    """Yield the frames that are ready."""
    import av

    while True:
        try:
            yield sink.pull()
        except (av.BlockingIOError, av.EOFError):
            return
