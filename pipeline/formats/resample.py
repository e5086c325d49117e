"""Clips at another frame rate, and in another rest pose."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Clip, Prop, standard_body
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import between, multiply, slerp

_CHUNK = 4096  # frames at a time, to bound the memory
_END = 1e-6  # of a frame: the last one is not lost to rounding


def resampled(clip: Clip, fps: float) -> Clip:
    """Return a clip with frames a constant time apart, from its first to its last.

    Positions between frames lie on a line, rotations on the shortest arc, joints where
    the bones then put them. Numbers are interpolated too; what has no middle, such as
    contacts, is that of the nearest frame.

    Args:
        clip: The motion; of frames with the same time, the last counts.
        fps: Frames a second.
    """
    known = np.flatnonzero(np.append(np.diff(clip.time) > 0.0, True))
    stamps = clip.time[known]
    count = int((stamps[-1] - stamps[0]) * fps + _END) + 1
    time = stamps[0] + np.arange(count) / fps
    after = np.clip(np.searchsorted(stamps, time, "right"), 1, max(len(known) - 1, 1))
    after = np.minimum(after, len(known) - 1)
    before = np.maximum(after - 1, 0)
    step = np.maximum(stamps[after] - stamps[before], 1e-12)
    between_frames = _Between(
        known[before],
        known[after],
        np.clip((time - stamps[before]) / step, 0.0, 1.0),
    )
    line, nearest = between_frames.line, between_frames.nearest
    return replace(
        clip,
        time=time,
        root=line(clip.root),
        rotations=between_frames.turned(clip.rotations),
        state=clip.state[nearest],
        reliability=line(clip.reliability),
        deciding_term=clip.deciding_term[nearest],
        origin=clip.origin[nearest],
        moved_by_correction=line(clip.moved_by_correction),
        moved_by_physics=line(clip.moved_by_physics),
        contacts=clip.contacts[nearest],
        external_force=line(clip.external_force),
        props=tuple(between_frames.prop(prop) for prop in clip.props),
    )


class _Between:
    """Where new frames lie between those of a clip."""

    def __init__(
        self, before: NDArray[np.intp], after: NDArray[np.intp], share: Array
    ) -> None:
        self.before, self.after, self.share = before, after, share

    @property
    def nearest(self) -> NDArray[np.intp]:
        return np.where(self.share < 0.5, self.before, self.after)

    def line(self, values: Array) -> Array:
        share = self.share.reshape(-1, *[1] * (values.ndim - 1))
        start = values[self.before]
        moved = start + share * (values[self.after] - start)
        # A frame that is there already is kept as it is, also beside a missing one.
        return np.where(share == 0.0, start, moved)

    def arc(self, rotations: Array, frames: slice) -> Array:
        share = self.share[frames].reshape(-1, *[1] * (rotations.ndim - 2))
        return slerp(
            rotations[self.before[frames]], rotations[self.after[frames]], share
        )

    def turned(self, rotations: Array) -> Array:
        """Return rotations (T, J, 4) of the new frames."""
        found = np.empty((len(self.share), *rotations.shape[1:]))
        for start in range(0, len(found), _CHUNK):
            some = slice(start, start + _CHUNK)
            found[some] = self.arc(rotations, some)
        return found

    def prop(self, prop: Prop) -> Prop:
        if not prop.moves:
            return prop
        rotations = self.arc(prop.rotations, slice(None))
        return replace(prop, positions=self.line(prop.positions), rotations=rotations)


def in_strict_t(clip: Clip) -> Clip:
    """Return the same motion with a rest posture in which every bone is square.

    Every joint stays where it is: rotations that turned the person's own rest posture
    turn the strict one.
    """
    body = clip.body
    square = standard_body(body.skeleton).directions
    turns = between(square, body.directions)
    return replace(
        clip,
        rotations=multiply(clip.rotations, turns),
        body=replace(body, directions=square),
    )
