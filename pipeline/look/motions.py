"""The motion that is drawn, whatever file it comes from."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from kinefilter.characters import (
    Clip,
    InputError,
    Motion,
    Take,
)
from kinefilter.pipeline.formats import read_clip, read_take
from kinefilter.pipeline.formats.files import check_file
from kinefilter.pipeline.reliability import measure_reference
from kinefilter.retarget import (
    hang_missing,
    measured_body,
    rotations_from_positions,
)

_READ = (".npz", ".csv", ".bvh")


def read_motion(path: Path) -> Clip:
    """Read a clip of which every joint is known.

    An npz is the whole clip. CSV and BVH hold joint positions alone: the body is then
    measured from them, and nothing is known about reliability and props.

    Raises:
        InputError: There is no such file, it is of another kind or malformed, or joints
            are missing in it.
    """
    check_file(path)
    name = path.name.lower().removesuffix(".gz")
    if not name.endswith(_READ):
        raise InputError(
            f"{path}: render reads {', '.join(_READ)}; write the clip as .npz too, "
            "which holds all of it"
        )
    clip = read_clip(path) if name.endswith(".npz") else _posed(read_take(path))
    if not len(clip):
        raise InputError(f"{path}: has no frames; nothing can be drawn")
    if not (np.isfinite(clip.positions).all() and np.isfinite(clip.rotations).all()):
        raise InputError(f"{path}: has numbers that are not finite; write it again")
    return clip


def _posed(take: Take) -> Clip:
    """Return a clip of the same postures, on a body as long as the median says.

    A joint that the file never has is where it is at rest.
    """
    skeleton, shape = take.skeleton, take.positions.shape[:2]
    lacks = np.asarray(~np.isfinite(take.positions).all(axis=-1))
    missing = np.argwhere(lacks & ~lacks.all(axis=0))
    if len(missing):
        frame, joint = missing[0]
        raise InputError(
            f"{take.source}: frame {frame + 1} has no {skeleton.joints[joint]}; "
            "it is a raw take: clean it, or draw it with --compare beside its clip"
        )
    measured = measure_reference(take)
    body = measured_body(
        skeleton, measured.lengths, measured.directions, source=take.source
    )
    rotations = rotations_from_positions(hang_missing(take.positions, body), body)
    root = take.positions[:, skeleton.root]
    motion = Motion(
        time=take.time, body=body, root=root, rotations=rotations, source=take.source
    )
    return Clip.of(motion, state=take.state, reliability=np.ones(shape))
