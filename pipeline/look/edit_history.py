"""What is said of a motion on a page, undone and redone, and its picture over time."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from kinefilter.characters import Clip
from kinefilter.characters.arrays import Flags, runs
from kinefilter.pipeline.edits import Edit, with_contacts

_WIDTH = 600  # steps of the picture: about the pixels that a panel has
_ROW = 16  # pixels from one row to the next
_BAR = 10  # pixels that a bar is high
_CLOSE = 300  # frames of a close-up: ten seconds, a pixel or more for each
_COLORS = {"L": "#2f7fd6", "R": "#e08a2e", "edited": "#777", "doubtful": "#d9342b"}


class EditHistory:
    """Edits of a clip, and what they were before."""

    def __init__(self, edits: Iterable[Edit], clip: Clip) -> None:
        self.edits = self._saved = tuple(edits)
        self._before: list[tuple[Edit, ...]] = []
        self._undone: list[tuple[Edit, ...]] = []
        self.look_at(clip)

    def look_at(self, clip: Clip) -> None:
        """Show contacts and times of a clip."""
        self._clip, self.since = clip, clip.time - clip.time[0]
        self._show()

    def _show(self) -> None:
        self.contacts = with_contacts(self._clip.contacts, self.edits, self.since)
        """Which parts of the feet stand (CONTACTS), shape (T, 4)."""
        self.edited = np.zeros(len(self.since), dtype=np.bool_)
        """Which frames something is said of, shape (T,)."""
        for edit in self.edits:
            self.edited |= edit.frames(self.since)

    @property
    def unsaved(self) -> bool:
        """Whether they differ from those that were last saved."""
        return self.edits != self._saved

    def replace(self, edits: Iterable[Edit]) -> None:
        """Take other edits, as one step that can be undone."""
        if (changed := tuple(edits)) != self.edits:
            self._before.append(self.edits)
            self._undone.clear()
            self.edits = changed
            self._show()

    def undo(self) -> None:
        """Take back the last change, if there was one."""
        self._move(self._before, self._undone)

    def redo(self) -> None:
        """Make the change again that was taken back last, if there was one."""
        self._move(self._undone, self._before)

    def _move(self, one: list[tuple[Edit, ...]], other: list[tuple[Edit, ...]]) -> None:
        if one:
            other.append(self.edits)
            self.edits = one.pop()
            self._show()

    def mark_saved(self) -> None:
        """Note that the edits were saved as they are."""
        self._saved = self.edits


def timeline_html(
    rows: Mapping[str, Flags], frame: int, chosen: tuple[int, int]
) -> str:
    """Return HTML of when flags (T,) are true, as rows of bars over time.

    One frame is marked, and the first to last chosen are shaded. Long motions have a
    close-up of the frames around the marked one.
    """
    flags = np.column_stack(list(rows.values()))
    count, names = len(flags), list(rows)
    # However long the motion, no more steps are sent than can be seen.
    columns = min(count, _WIDTH)
    starts = np.arange(columns) * count // columns
    seen = np.logical_or.reduceat(flags, starts, axis=0)
    strips = _strip("timeline", names, seen, range(count), frame, chosen)
    if count > 2 * _CLOSE:
        first = min(max(frame - _CLOSE // 2, 0), count - _CLOSE)
        near = range(first, first + _CLOSE)
        strips += _strip("close-up", names, flags[near], near, frame, chosen)
    return strips


def _strip(
    name: str,
    rows: list[str],
    flags: Flags,
    frames: range,
    frame: int,
    chosen: tuple[int, int],
) -> str:
    height, scale = _ROW * len(rows), _WIDTH / len(frames)
    bars = ""
    for k, row in enumerate(rows):
        y, step = _ROW * k + _ROW // 2, _WIDTH / len(flags)
        parts = "".join(
            f"M{run.start * step:.1f} {y}h{(run.stop - run.start) * step:.1f}"
            for run in runs(flags[:, k])
        )
        bars += (
            f'<path class="row" d="{parts}" stroke="{_COLORS[row.split()[-1]]}" '
            f'stroke-width="{_BAR}" fill="none"/>'
        )
    ends = np.array([chosen[0], chosen[1] + 1]) - frames.start
    first, end = np.clip(ends, 0, len(frames)).tolist()
    mark = (frame - frames.start + 0.5) * scale
    return (
        '<div style="display:flex;gap:6px;font-size:11px;margin:4px 8px">'
        f'<div style="flex:none;line-height:{_ROW}px">{"<br>".join(rows)}</div>'
        f'<svg id="{name}" viewBox="0 0 {_WIDTH} {height}" width="100%" '
        f'height="{height}" preserveAspectRatio="none" '
        'style="background:rgba(128,128,128,0.12)">'
        f'<rect x="{first * scale:.1f}" width="{(end - first) * scale:.1f}" '
        f'height="{height}" fill="rgba(128,128,128,0.25)"/>'
        f"{bars}"
        f'<path d="M{mark:.1f} 0V{height}" stroke="#d9342b" stroke-width="2" '
        'vector-effect="non-scaling-stroke"/></svg></div>'
    )
