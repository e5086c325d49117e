"""Changes to a clip before it is written, whatever the format."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kinefilter.characters import Clip, Prop
from kinefilter.retarget.heading_frame import HeadingFrame, floor_frame
from kinefilter.retarget.looping import looped

from .export import Export, in_strict_t, resampled, span_of
from .rig import RootMotion


def shaped(clip: Clip, export: Export) -> Clip:
    """Return a clip with the span, frame rate, loop and rest pose of an export.

    The root motion is that of the export, too, unless a rig has its own. Raises
    InputError as ``span_of``, ``even_frames`` and ``looped``.
    """
    if (export.begin, export.end) != (None, None):
        clip = clip.at(span_of(export, clip.time, clip.source))
    if export.fps is not None:
        clip = resampled(clip, export.fps)
    if export.loop:
        clip = looped(clip)
    clip = in_strict_t(clip) if export.rest == "t" else clip
    return with_root_motion(clip, export.root) if export.rig is None else clip


def with_root_motion(clip: Clip, travel: RootMotion) -> Clip:
    """Return a clip with only the root motion of ``travel``; props follow the root."""
    if travel == "travel":
        return clip
    left = np.array([1.0, 0.0, 0.0])
    frame = floor_frame(clip.root, clip.rotations[:, clip.skeleton.root], left)
    if travel == "in-place":
        frame = frame.unturned
    return replace(
        clip,
        root=frame.remove(clip.root[:, None])[:, 0],
        rotations=frame.remove_rotations(clip.rotations),
        props=tuple(_in_frame(frame, prop) for prop in clip.props),
    )


def _in_frame(frame: HeadingFrame, prop: Prop) -> Prop:
    shape = len(frame.yaw), 1
    places = np.broadcast_to(prop.positions[:, None], (*shape, 3))
    turns = np.broadcast_to(prop.rotations[:, None], (*shape, 4))
    places, turns = frame.remove(places)[:, 0], frame.remove_rotations(turns)[:, 0]
    return replace(prop, positions=places, rotations=turns)
