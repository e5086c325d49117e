"""The edits of a motion, with undo and redo."""

from collections.abc import Iterable

import numpy as np

from kinefilter.characters import Clip
from kinefilter.pipeline.edits import Edit, with_contacts


class EditHistory:
    """Edits, and with them contacts (T, 4) and edited frames (T,) of a clip."""

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
        self.edited = np.zeros(len(self.since), dtype=np.bool_)
        for edit in self.edits:
            self.edited |= edit.frames(self.since)
