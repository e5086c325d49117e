"""Foot contacts that are edited by hand, and their picture over time."""

from __future__ import annotations

from collections import deque

import numpy as np

from kinefilter.characters import CONTACTS
from kinefilter.characters.arrays import Flags, read_only, runs

PARTS: dict[str, tuple[int, ...]] = {
    "both feet": (0, 1, 2, 3),
    "left foot": (0, 1),
    "right foot": (2, 3),
    **{name: (k,) for k, name in enumerate(CONTACTS)},
}
"""What can be edited at once: columns of the contacts, by name."""

_STEPS = 200  # that can be undone
_WIDTH = 600  # steps of the picture: about the pixels that a panel has
_ROW = 16  # pixels from one row to the next
_BAR = 10  # pixels that a bar is high
_CLOSE = 300  # frames of a close-up: ten seconds, a pixel or more for each
_COLORS = ("#2f7fd6", "#2f7fd6", "#e08a2e", "#e08a2e")  # left, right
_LABELS = tuple(name.replace("Left", " L").replace("Right", " R") for name in CONTACTS)


class ContactEdits:
    """Contacts (CONTACTS), read-only, shape (T, 4), and what they were before."""

    def __init__(self, contacts: Flags) -> None:
        self._before: deque[Flags] = deque(maxlen=_STEPS)
        self.contacts = self._saved = read_only(contacts.copy())

    @property
    def unsaved(self) -> bool:
        """Whether they differ from those that were last saved."""
        return not np.array_equal(self.contacts, self._saved)

    def put(self, part: str, first: int, last: int, *, stands: bool) -> None:
        """Set whether a part (PARTS) stands from the first to the last frame."""
        edited = self.contacts.copy()
        edited[max(first, 0) : last + 1, list(PARTS[part])] = stands
        self.replace(edited)

    def replace(self, contacts: Flags) -> None:
        """Take other contacts, shape (T, 4), as one step that can be undone."""
        if not np.array_equal(contacts, self.contacts):
            self._before.append(self.contacts)
            self.contacts = read_only(contacts.copy())

    def undo(self) -> None:
        """Take back the last change, if there was one."""
        if self._before:
            self.contacts = self._before.pop()

    def mark_saved(self) -> None:
        """Note that the contacts were saved as they are."""
        self._saved = self.contacts


def timeline_html(contacts: Flags, frame: int, chosen: tuple[int, int]) -> str:
    """Return HTML of when each part of the feet stands, as four rows of bars over time.

    One frame is marked, and the first to last chosen are shaded. Long motions have a
    close-up of the frames around the marked one.
    """
    count = len(contacts)
    # However long the motion, no more steps are sent than can be seen.
    columns = min(count, _WIDTH)
    starts = np.arange(columns) * count // columns
    seen = np.logical_or.reduceat(contacts, starts, axis=0)
    strips = _strip("timeline", seen, range(count), frame, chosen)
    if count > 2 * _CLOSE:
        first = min(max(frame - _CLOSE // 2, 0), count - _CLOSE)
        near = range(first, first + _CLOSE)
        strips += _strip("close-up", contacts[near], near, frame, chosen)
    return strips


def _strip(
    name: str, contacts: Flags, frames: range, frame: int, chosen: tuple[int, int]
) -> str:
    height, scale = _ROW * len(CONTACTS), _WIDTH / len(frames)
    bars = ""
    for row, color in enumerate(_COLORS):
        y, step = _ROW * row + _ROW // 2, _WIDTH / len(contacts)
        parts = "".join(
            f"M{run.start * step:.1f} {y}h{(run.stop - run.start) * step:.1f}"
            for run in runs(contacts[:, row])
        )
        bars += (
            f'<path class="stands" d="{parts}" stroke="{color}" '
            f'stroke-width="{_BAR}" fill="none"/>'
        )
    ends = np.array([chosen[0], chosen[1] + 1]) - frames.start
    first, end = np.clip(ends, 0, len(frames)).tolist()
    mark = (frame - frames.start + 0.5) * scale
    return (
        '<div style="display:flex;gap:6px;font-size:11px;margin:4px 8px">'
        f'<div style="flex:none;line-height:{_ROW}px">{"<br>".join(_LABELS)}</div>'
        f'<svg id="{name}" viewBox="0 0 {_WIDTH} {height}" width="100%" '
        f'height="{height}" preserveAspectRatio="none" '
        'style="background:rgba(128,128,128,0.12)">'
        f'<rect x="{first * scale:.1f}" width="{(end - first) * scale:.1f}" '
        f'height="{height}" fill="rgba(128,128,128,0.25)"/>'
        f"{bars}"
        f'<path d="M{mark:.1f} 0V{height}" stroke="#d9342b" stroke-width="2" '
        'vector-effect="non-scaling-stroke"/></svg></div>'
    )
