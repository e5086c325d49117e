"""Foot contacts that are changed by hand, step by step."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import CONTACTS

Flags = NDArray[np.bool_]

PARTS: dict[str, tuple[int, ...]] = {
    "both feet": (0, 1, 2, 3),
    "left foot": (0, 1),
    "right foot": (2, 3),
    **{name: (k,) for k, name in enumerate(CONTACTS)},
}
"""What can be edited at once: columns of the contacts, by name."""

_STEPS = 200  # that can be undone; more than anybody remembers


class ContactEdits:
    """Contacts (CONTACTS), and what they were before each change.

    Args:
        contacts: Which parts of the feet stand, shape (T, 4).
    """

    def __init__(self, contacts: Flags) -> None:
        self._contacts = _frozen(contacts)
        self._saved = self._contacts
        self._before: deque[Flags] = deque(maxlen=_STEPS)

    @property
    def contacts(self) -> Flags:
        """The contacts as they are now, read-only, shape (T, 4)."""
        return self._contacts

    @property
    def unsaved(self) -> bool:
        """Whether they differ from those that were last saved."""
        return not np.array_equal(self._contacts, self._saved)

    def put(self, part: str, first: int, last: int, *, stands: bool) -> None:
        """Say whether a part (PARTS) stands in the frames from first to last."""
        edited = self._contacts.copy()
        edited[max(first, 0) : last + 1, list(PARTS[part])] = stands
        self.replace(edited)

    def replace(self, contacts: Flags) -> None:
        """Take other contacts, shape (T, 4), as one step that can be undone."""
        if not np.array_equal(contacts, self._contacts):
            self._before.append(self._contacts)
            self._contacts = _frozen(contacts)

    def undo(self) -> bool:
        """Take back the last change; return whether there was one."""
        if not self._before:
            return False
        self._contacts = self._before.pop()
        return True

    def mark_saved(self) -> None:
        """Note that the contacts were saved as they are."""
        self._saved = self._contacts


def _frozen(contacts: Flags) -> Flags:
    copy = np.array(contacts, dtype=np.bool_)
    copy.flags.writeable = False
    return copy
