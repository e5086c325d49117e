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
from kinefilter.pipeline.reliability import measure_body
from kinefilter.retarget.orientation import hang_missing, rotations_from_positions
from kinefilter.retarget.retargeting import retarget

from .bvh import Bvh, meters_by_leg, read_bvh
from .bvh_writer import write_bvh
from .export import USD_SUFFIXES, Export, in_strict_t, resampled, with_y_up
from .files import check_file, check_folder
from .npz import read_npz, write_npz
from .rig import RigMotion, motion_of_rig, own_skeleton, retargeted_motion, rig_of
from .sheets import write_take_csv
from .takes import read_take
from .targets import target_rig
from .usd import write_usd
from .usd_reader import read_usd_clip

_EXTENSIONS = (*USD_SUFFIXES, ".bvh", ".csv", ".npz")


def check_writable(path: str | os.PathLike[str], export: Export | None = None) -> None:
    """Raise, before any work is done, the InputError that write_clip would raise."""
    suffix = Path(path).suffix
    if suffix.lower() not in _EXTENSIONS:
        raise InputError(
            f"{os.fspath(path)}: unknown extension {suffix!r}; "
            f"known: {', '.join(_EXTENSIONS)}"
        )
    check_folder(path)
    if export is None:
        return
    export.check(suffix.lower())
    if export.character is not None:
        if export.character.suffix.lower() not in USD_SUFFIXES[:3]:
            known = "expected .usda, .usdc or .usd"
            raise InputError(f"--character {export.character}: {known}")
        check_folder(export.character)
    if export.rig is not None:
        target_rig(export.rig, export.target, standard_body(KINECT_V2))


def write_clip(
    clip: Clip, path: str | os.PathLike[str], export: Export | None = None
) -> None:
    """Write a clip as USD, BVH, CSV or npz, whole or not at all.

    USD holds a skinned character in T-pose, rotations and props, BVH the skeleton and
    rotations; CSV joint positions and the sensor's states; npz the whole clip. On
    another rig, USD and BVH hold its skeleton and rotations. The extension decides:
    ``.usda``, ``.usdc``, ``.usd``, ``.usdz``, ``.bvh``, ``.csv`` or ``.npz``. By
    default units are meters, y is up, and frames are the clip's. Raises InputError if
    the extension is unknown, an option does not go with it, or nothing can be written.
    """
    export = export or Export()
    check_writable(path, export)
    if export.fps is not None:
        clip = resampled(clip, export.fps)
    if export.rest == "t":
        clip = in_strict_t(clip)
    suffix, path = Path(path).suffix.lower(), Path(path)
    if suffix == ".csv":
        write_take_csv(clip, path)
    elif suffix == ".npz":
        write_npz(clip, path)
    else:
        root = clip.positions[:, clip.skeleton.root]
        moved = RigMotion(rig_of(clip.body), clip.rotations, root, clip.positions)
        if export.rig is not None:
            rig = target_rig(export.rig, export.target, clip.body)
            moved = retargeted_motion(rig, retarget(clip, rig))
        write = write_bvh if suffix == ".bvh" else write_usd
        write(clip, moved, path, export)


def read_clip(path: str | os.PathLike[str]) -> Clip:
    """Read a clip from any file that write_clip writes; CSV and BVH may be gzipped.

    npz is the whole clip. USD on kinefilter's own skeleton is all but the sensor's
    states, the name of the take, stature and mass; its time starts at 0. BVH holds
    positions and rotations alone, CSV positions: the body is measured from them,
    contacts and props are unknown, and every joint counts as reliable. Raises
    InputError if the file is missing, damaged, of another kind or skeleton, or a raw
    take.
    """
    file = check_file(path)
    name = file.name.lower().removesuffix(".gz")
    if name.endswith(USD_SUFFIXES):
        return read_usd_clip(path)
    with file.open("rb") as opened:
        if name.endswith(".npz") or opened.read(2) == b"PK":
            return read_npz(path)
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
    """Return the same postures on a body of median lengths, absent joints at rest."""
    skeleton = take.skeleton
    lacks = np.asarray(~np.isfinite(take.positions).all(axis=-1))
    missing = np.argwhere(lacks & ~lacks.all(axis=0))
    if len(missing):
        frame, joint = missing[0]
        raise InputError(
            f"{take.source}: frame {frame + 1} has no {skeleton.joints[joint]}; "
            "it is a raw take: clean it, or draw it with --compare beside its clip"
        )
    body = measure_body(take)
    rotations = rotations_from_positions(hang_missing(take.positions, body), body)
    root = take.positions[:, skeleton.root]
    motion = Motion(
        time=take.time, body=body, root=root, rotations=rotations, source=take.source
    )
    return Clip.of(motion, state=take.state, reliability=np.ones(lacks.shape))
