"""The edits of a motion, with undo and redo, and their picture over time."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from kinefilter.characters import Clip
from kinefilter.characters.arrays import Flags, runs
from kinefilter.pipeline.edits import Edit, with_contacts

_WIDTH = 600  # units of the picture, roughly the pixels across a panel
_ROW = 16  # px from one row to the next
_BAR = 10  # px, height of a bar
_CLOSE = 300  # frames of a close-up: ten seconds, at least a pixel each
_COLORS = {"L": "#2f7fd6", "R": "#e08a2e", "edited": "#777", "doubtful": "#d9342b"}


class EditHistory:
    """Edits of a clip, with undo and redo."""

    def __init__(self, edits: Iterable[Edit], clip: Clip) -> None:
        self._states, self._current = [tuple(edits)], 0
        self.mark_saved()
        self.look_at(clip)

    def look_at(self, clip: Clip) -> None:
        """Use the contacts and times of a clip."""
        self._clip, self.since = clip, clip.time - clip.time[0]
        self._go_to(self._current)

    @property
    def edits(self) -> tuple[Edit, ...]:
        """The edits as they are now."""
        return self._states[self._current]

    @property
    def unsaved(self) -> bool:
        """Whether the edits differ from those last saved."""
        return self.edits != self._saved

    def replace(self, edits: Iterable[Edit]) -> None:
        """Replace all edits, as one step that can be undone."""
        if (changed := tuple(edits)) != self.edits:
            self._states[self._current + 1 :] = [changed]
            self._go_to(self._current + 1)

    def undo(self) -> None:
        """Undo the last change, if there is one."""
        self._go_to(max(self._current - 1, 0))

    def redo(self) -> None:
        """Redo the change undone last, if there is one."""
        self._go_to(min(self._current + 1, len(self._states) - 1))

    def mark_saved(self) -> None:
        """Record that the current edits are saved."""
        self._saved = self.edits

    def _go_to(self, state: int) -> None:
        self._current = state
        self.contacts = with_contacts(self._clip.contacts, self.edits, self.since)
        """Planted parts of the feet (CONTACTS), shape (T, 4)."""
        self.edited = np.zeros(len(self.since), dtype=np.bool_)
        """Frames that an edit covers, shape (T,)."""
        for edit in self.edits:
            self.edited |= edit.frames(self.since)


def timeline_html(
    rows: Mapping[str, Flags], frame: int, chosen: tuple[int, int]
) -> str:
    """Return HTML that shows when flags (T,) are true, as rows of bars over time.

    ``frame`` is marked, and the frames from the first to the last ``chosen`` are
    shaded. Long motions also get a close-up of the frames around ``frame``.
    """
    flags = np.column_stack(list(rows.values()))
    count, height = len(flags), _ROW * len(rows)

    def strip(name: str, flags: Flags, frames: range) -> str:
        step, scale, bars = _WIDTH / len(flags), _WIDTH / len(frames), ""
        for k, row in enumerate(rows):
            path = "".join(
                f"M{run.start * step:.1f} {_ROW * k + _ROW // 2}"
                f"h{(run.stop - run.start) * step:.1f}"
                for run in runs(flags[:, k])
            )
            bars += (
                f'<path class="row" d="{path}" stroke="{_COLORS[row.split()[-1]]}" '
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
            f'{bars}<path d="M{mark:.1f} 0V{height}" stroke="#d9342b" '
            'stroke-width="2" vector-effect="non-scaling-stroke"/></svg></div>'
        )

    # However long the motion, send no more steps than can be seen.
    columns = min(count, _WIDTH)
    starts = np.arange(columns) * count // columns
    coarse = np.logical_or.reduceat(flags, starts, axis=0)
    strips = strip("timeline", coarse, range(count))
    if count > 2 * _CLOSE:
        first = min(max(frame - _CLOSE // 2, 0), count - _CLOSE)
        near = range(first, first + _CLOSE)
        strips += strip("close-up", flags[near], near)
    return strips
