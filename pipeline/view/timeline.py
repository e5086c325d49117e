"""When each part of the feet stands, as four rows over time with a mark at a frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import CONTACTS
from kinefilter.pipeline.contacts import runs

__all__ = ["Timeline"]

_WIDTH = 600  # steps of the picture: about the pixels that a panel has
_ROW = 16  # pixels from one row to the next
_BAR = 10  # pixels that a bar is high
_COLORS = ("#2f7fd6", "#2f7fd6", "#e08a2e", "#e08a2e")  # left, right
_LABELS = tuple(name.replace("Left", " L").replace("Right", " R") for name in CONTACTS)


class Timeline:
    """The rows of some contacts; drawn once, as only the mark moves.

    Args:
        contacts: Which parts of the feet stand (CONTACTS), shape (T, 4).
    """

    def __init__(self, contacts: NDArray[np.bool_]) -> None:
        self._frames = len(contacts)
        rows = [_bars(contacts[:, row], row) for row in range(len(CONTACTS))]
        self._bars = "".join(rows)

    def html(self, frame: int, chosen: tuple[int, int]) -> str:
        """Return the picture as HTML.

        Args:
            frame: The frame that is marked.
            chosen: First and last of the frames that are to be edited.
        """
        height = _ROW * len(CONTACTS)
        scale = _WIDTH / self._frames
        first, last = chosen
        band, wide = first * scale, (last + 1 - first) * scale
        mark = (frame + 0.5) * scale
        labels = "".join(
            f'<div style="height:{_ROW}px;line-height:{_ROW}px">{label}</div>'
            for label in _LABELS
        )
        return (
            '<div style="display:flex;gap:6px;font-size:11px;margin:4px 8px">'
            f'<div style="flex:none">{labels}</div>'
            f'<svg id="timeline" viewBox="0 0 {_WIDTH} {height}" width="100%" '
            f'height="{height}" preserveAspectRatio="none" '
            'style="background:rgba(128,128,128,0.12)">'
            f'<rect x="{band:.1f}" width="{wide:.1f}" height="{height}" '
            'fill="rgba(128,128,128,0.25)"/>'
            f"{self._bars}"
            f'<path d="M{mark:.1f} 0V{height}" stroke="#d9342b" stroke-width="2" '
            'vector-effect="non-scaling-stroke"/></svg></div>'
        )


def _bars(stands: NDArray[np.bool_], row: int) -> str:
    """Return the path of one row, a bar for each run of frames that stand."""
    scale, y = _WIDTH / len(stands), _ROW * row + _ROW // 2
    parts = "".join(
        f"M{run.start * scale:.1f} {y}h{(run.stop - run.start) * scale:.1f}"
        for run in runs(stands)
    )
    return (
        f'<path class="stands" d="{parts}" stroke="{_COLORS[row]}" '
        f'stroke-width="{_BAR}" fill="none"/>'
    )
