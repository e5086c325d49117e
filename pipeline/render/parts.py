"""A clip's frames in parts, and parts in stretches for one process each."""

from __future__ import annotations

Parts = tuple[range, ...]

_PART = 60
"""Frames: in a video each part begins with a whole picture, and two seconds are about
how far players like to jump."""
_STRETCHES = 4
"""That each process gets, about: fewer, and one process is left with the last; more,
and every one of them has to get every clip ready."""
_LONGEST = 600  # frames: some seconds, after which a progress bar should move


def stretches(count: int, share: int) -> list[Parts]:
    """Return the parts of a clip in groups that one process draws in one go.

    The parts are the same whatever the groups, and so are the videos made of them.

    Args:
        count: Frames of the clip.
        share: Frames of all clips that fall to each process.
    """
    parts = [range(k, min(k + _PART, count)) for k in range(0, count, _PART)]
    size = max(1, min(share // _STRETCHES, _LONGEST) // _PART)
    return [tuple(parts[k : k + size]) for k in range(0, len(parts), size)]
