"""Clips into files and back: the name's extension says which kind."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from kinefilter.characters import (
    KINECT_V2,
    Clip,
    InputError,
    Motion,
    Take,
    standard_body,
)
from kinefilter.pipeline.reliability import measure_reference
from kinefilter.retarget.body_size import measured_body
from kinefilter.retarget.orientation import hang_missing, rotations_from_positions
from kinefilter.retarget.retargeting import retarget

from .archive import read_npz, write_npz
from .bvh import Bvh, meters_by_leg
from .bvh_reader import read_bvh
from .bvh_writer import write_bvh
from .export import Export, with_y_up
from .files import check_file, check_folder
from .resample import in_strict_t, resampled
from .rig import RigMotion, motion_of, motion_of_rig, own_skeleton, retargeted_motion
from .tables import write_take_csv
from .takes import read_take
from .targets import target_rig
from .usd import write_usd
from .usd_reader import read_usd_clip

_USD = (".usda", ".usdc", ".usd", ".usdz")
_EXTENSIONS = (*_USD, ".bvh", ".csv", ".npz")


def check_writable(path: str | os.PathLike[str], export: Export | None = None) -> None:
    """Raise, before any work is done, what write_clip would raise after it.

    Raises:
        InputError: The extension is unknown, what was chosen does not go with it, or
            nothing can be written there.
    """
    suffix = Path(path).suffix
    if suffix.lower() not in _EXTENSIONS:
        raise InputError(
            f"{os.fspath(path)}: unknown extension {suffix!r}; "
            f"known: {', '.join(_EXTENSIONS)}"
        )
    check_folder(path)
    if export is not None:
        export.check(suffix.lower())
        if export.character is not None:
            _check_character(export.character)
        if export.rig is not None:
            target_rig(export.rig, export.target, standard_body(KINECT_V2))


def _check_character(path: Path) -> None:
    if path.suffix.lower() not in (".usda", ".usdc", ".usd"):
        raise InputError(f"--character {path}: expected .usda, .usdc or .usd")
    check_folder(path)


def write_clip(
    clip: Clip, path: str | os.PathLike[str], export: Export | None = None
) -> None:
    """Write a clip as USD, BVH, CSV or npz.

    USD holds a skinned character in T-pose, rotations and props, BVH the skeleton and
    rotations; CSV joint positions and the sensor's states; npz the whole clip. On a
    rig of somebody else's, USD and BVH hold its skeleton and rotations.

    Args:
        clip: The motion.
        path: The file; its extension is one of ``.usda``, ``.usdc``, ``.usd``,
            ``.usdz``, ``.bvh``, ``.csv`` and ``.npz``. It appears whole or not at all.
        export: Axes, unit, frame rate and so on; by default meters, y up, and the
            frames of the clip.

    Raises:
        InputError: The extension is unknown, what was chosen does not go with it, or
            nothing can be written there.
    """
    export = export or Export()
    check_writable(path, export)
    if export.fps is not None:
        clip = resampled(clip, export.fps)
    if export.rest == "t":
        clip = in_strict_t(clip)
    suffix, path = Path(path).suffix.lower(), Path(path)
    if suffix == ".bvh":
        write_bvh(clip, _moved(clip, export), path, export)
    elif suffix == ".csv":
        write_take_csv(clip, path)
    elif suffix == ".npz":
        write_npz(clip, path)
    else:
        write_usd(clip, _moved(clip, export), path, export)


def read_clip(path: str | os.PathLike[str]) -> Clip:
    """Read a clip from any file that write_clip writes.

    npz is the whole clip. USD on kinefilter's own skeleton is all but the sensor's
    states, the name of the take, stature and mass; its time starts at 0. BVH holds
    places and rotations alone, CSV places: the body is measured from them, nothing is
    known of contacts and props, and every joint counts as reliable.

    Args:
        path: The file; CSV and BVH may be gzipped.

    Raises:
        InputError: The file is missing, of another kind or damaged, of somebody else's
            skeleton, or a raw take in which joints are missing.
    """
    name = check_file(path).name.lower()
    if name.endswith(".npz"):
        return read_npz(path)
    if name.endswith(_USD):
        return read_usd_clip(path)
    name = name.removesuffix(".gz")
    if name.endswith(".bvh"):
        return _of_own_bvh(read_bvh(path), os.fspath(path)) or _posed(read_take(path))
    if name.endswith(".csv"):
        return _posed(read_take(path))
    raise InputError(
        f"{os.fspath(path)}: not a clip by its extension; expected one of "
        + ", ".join(_EXTENSIONS)
    )


def _of_own_bvh(bvh: Bvh, source: str) -> Clip | None:
    """Return the clip in a BVH file of kinefilter's own skeleton, None of others."""
    skeleton = own_skeleton([bvh.names[n] for n in bvh.joints])
    if skeleton is None:
        return None
    offsets, rotations = bvh.offsets[bvh.joints], bvh.rotations[:, bvh.joints]
    root = bvh.positions[:, bvh.joints[0]]
    head, hip, knee, ankle = (
        bvh.rest_positions[bvh.names.index(joint)]
        for joint in ("Head", "HipLeft", "KneeLeft", "AnkleLeft")
    )
    meters = meters_by_leg(
        float(np.linalg.norm(knee - hip) + np.linalg.norm(ankle - knee))
    )
    if abs((head - ankle)[2]) > abs((head - ankle)[1]):
        offsets, rotations, root = map(with_y_up, (offsets, rotations, root))
    motion = motion_of_rig(
        skeleton, meters * offsets, rotations, meters * root, bvh.time, source
    )
    return Clip.of(motion, reliability=np.ones((len(bvh), len(skeleton))))


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


def _moved(clip: Clip, export: Export) -> RigMotion:
    """Return the motion on the rig that was chosen."""
    if export.rig is None:
        return motion_of(clip)
    rig = target_rig(export.rig, export.target, clip.body)
    return retargeted_motion(rig, retarget(clip, rig))
