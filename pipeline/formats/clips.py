"""Clips into files and back, and the skeletons of other people's rigs they are for.

The name's extension says which kind of file it is.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from kinefilter.characters import (
    KINECT_V2,
    Body,
    Clip,
    InputError,
    Motion,
    Take,
    standard_body,
)
from kinefilter.characters.arrays import Array, check_kind
from kinefilter.characters.rotations import IDENTITY, about_x, multiply, rotate
from kinefilter.pipeline.reliability import measure_body
from kinefilter.retarget.looping import repeated
from kinefilter.retarget.orientation import hang_missing, rotations_from_positions
from kinefilter.retarget.retargeting import Retargeted, retarget
from kinefilter.retarget.rig_map import RIGS, RigMap, load_rig_map, rig_map_of
from kinefilter.retarget.target_rig import RestPose, TargetRig, built_rig, matched_rig

from .bvh import Bvh, meters_by_leg, read_bvh, write_bvh
from .export import USD_SUFFIXES, Export, paced, with_y_up
from .fbx import blender_command, write_fbx
from .files import AnyPath, check_file, check_folder, parse_toml, read_limited
from .glb import write_glb
from .glb_reader import read_glb
from .guarded import read_usd
from .learning import write_joints
from .npz import clip_of_arrays, read_npz, write_npz
from .rig import RigMotion, motion_of_rig, own_motion, own_skeleton, retargeted_motion
from .shaping import shaped
from .sheets import write_take_csv
from .takes import read_take

_LARGEST_MAP = 2**20  # bytes: five thousand bones
_EXTENSIONS = (*USD_SUFFIXES, ".glb", ".vrma", ".fbx", ".bvh", ".csv", ".npz")


def check_writable(path: AnyPath, export: Export | None = None) -> None:
    """Raise, before any work is done, the InputError that write_clip would raise."""
    check_folder(path)
    suffix = Path(path).suffix
    if suffix.lower() not in _EXTENSIONS:
        known = ", ".join(_EXTENSIONS)
        raise InputError(f"{path}: unknown extension {suffix!r}; known: {known}")
    if export is None:
        return
    export.check(suffix.lower())
    if suffix.lower() == ".fbx":
        blender_command(export.blender)
    if layer := export.character:
        if layer.suffix.lower() not in USD_SUFFIXES[:3]:
            raise InputError(f"--character {layer}: expected .usda, .usdc or .usd")
        check_folder(layer)
    if export.rig is not None:
        target_rig(export.rig, export.target, standard_body(KINECT_V2))


def write_clip(clip: Clip, path: AnyPath, export: Export | None = None) -> None:
    """Write a clip as USD, GLB, VRMA, FBX, BVH, CSV or npz, whole or not at all.

    USD, GLB and FBX hold a skinned character in T-pose, rotations and props, BVH the
    skeleton and rotations, VRMA those of VRM; CSV joint positions and the sensor's
    states; npz the whole clip. On another rig, USD, GLB, FBX and BVH hold its
    skeleton and rotations, npz what ``write_joints`` writes. The extension decides:
    ``.usda``, ``.usdc``, ``.usd``, ``.usdz``, ``.glb``, ``.vrma``, ``.fbx``,
    ``.bvh``, ``.csv`` or ``.npz``. By default units are meters, y is up, and frames
    are the clip's. Raises InputError if the extension is unknown, an option does
    not go with it, nothing can be written, or as ``even_frames`` and ``write_fbx``.
    """
    check_kind(clip, Clip, "the clip")
    export = Export() if export is None else export
    check_kind(export, Export, "the export")
    check_writable(path, export)
    path = Path(path)
    suffix = path.suffix.lower()
    export = paced(export, suffix, clip.time, clip.source)
    if suffix == ".vrma":
        export = replace(export, rig="vrm")
    clip = shaped(clip, export)
    if suffix == ".csv":
        write_take_csv(clip, path)
    elif suffix == ".npz" and export.rig is None:
        write_npz(clip, path)
    else:
        moved = _moved(clip, export)
        if suffix == ".bvh":
            write_bvh(clip, moved, path, export)
        elif suffix in (".glb", ".vrma"):
            write_glb([(clip, moved)], path, export)
        elif suffix == ".fbx":
            write_fbx(clip, moved, path, export)
        elif suffix == ".npz":
            write_joints(clip, moved, path, export)
        else:
            # Loading pxr takes longer than most commands run.
            from .usd import write_usd

            write_usd(clip, moved, path, export)


def write_people(clips: Sequence[Clip], path: AnyPath, export: Export) -> None:
    """Write clips of people who were recorded together as one GLB.

    Raises InputError as ``write_clip``.
    """
    check_writable(path, export)
    people = []
    for clip in clips:
        own = paced(export, ".glb", clip.time, clip.source)
        part = shaped(clip, own)
        people.append((part, _moved(part, own)))
    write_glb(people, path, export)


def _moved(clip: Clip, export: Export) -> RigMotion:
    """Return how the skeleton that is asked for moves."""
    if export.rig is None:
        return own_motion(clip)
    rig = target_rig(export.rig, export.target, clip.body)
    axes = rig.rest.axes
    if export.up == "z" and axes is not None:
        # Turning the world must not rename the axes of bones.
        axes = multiply(axes, about_x(np.pi / 2.0))
        rig = replace(rig, rest=replace(rig.rest, axes=axes))
    acted, own = repeated(clip) if export.loop else (clip, slice(None))
    motion = Retargeted(*(values[own] for values in retarget(acted, rig)))
    return retargeted_motion(rig, motion, clip.skeleton, export.root)


def read_clip(path: AnyPath) -> Clip:
    """Read a clip from what write_clip writes, but VRMA and FBX.

    CSV and BVH may be gzipped. npz is the whole clip. USD on kinefilter's own skeleton
    is all but the sensor's states, the name of the take, stature and mass; its time
    starts at 0. GLB on it is all but the name of the take, in whole per cent and
    millimeters. BVH holds positions and rotations alone, CSV positions: the body is
    measured from them, contacts and props are unknown, and every joint counts as
    reliable. Raises InputError if the file is missing, damaged, of another kind or
    skeleton, or a raw take.
    """
    file = check_file(path)
    name = file.name.lower().removesuffix(".gz")
    if name.endswith(USD_SUFFIXES):
        return clip_of_arrays(read_usd("clip_arrays", path))
    with file.open("rb") as opened:
        if name.endswith(".npz") or opened.read(2) == b"PK":
            return read_npz(path)
    if name.endswith(".glb"):
        return read_glb(path)
    if name.endswith(".bvh"):
        return _of_own_bvh(read_bvh(path), os.fspath(path)) or _posed(read_take(path))
    if name.endswith(".csv"):
        return _posed(read_take(path))
    known = ", ".join(
        suffix for suffix in _EXTENSIONS if suffix not in (".vrma", ".fbx")
    )
    raise InputError(f"{path}: not a clip by its extension; expected one of {known}")


def _of_own_bvh(bvh: Bvh, source: str) -> Clip | None:
    """Return the clip in a BVH file of kinefilter's own skeleton, None of others."""
    skeleton = own_skeleton([bvh.names[n] for n in bvh.joints])
    if skeleton is None:
        return None
    offsets, rotations = bvh.offsets[bvh.joints], bvh.rotations[:, bvh.joints]
    root = bvh.positions[:, bvh.joints[0]]
    names = [bvh.names.index(j) for j in ("Head", "HipLeft", "KneeLeft", "AnkleLeft")]
    head, hip, knee, ankle = bvh.rest_positions[names]
    leg = np.linalg.norm(knee - hip) + np.linalg.norm(ankle - knee)
    meters = meters_by_leg(float(leg))
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
    motion = Motion(
        time=take.time,
        body=body,
        root=take.positions[:, skeleton.root],
        rotations=rotations_from_positions(hang_missing(take.positions, body), body),
        source=take.source,
    )
    return Clip.of(motion, state=take.state, reliability=np.ones(lacks.shape))


def target_rig(rig: str, target: Path | None, body: Body) -> TargetRig:
    """Return the skeleton that a clip is written on.

    ``rig`` is the name of a map, or its file; ``target`` a file with the skeleton at
    rest, None for the map's own in the person's size. Raises InputError if either
    cannot be read, or the file's joints do not have the map's names.
    """
    rig_map = read_rig_map(rig)
    if target is None:
        return built_rig(rig_map, body)
    suffix = target.suffix.lower()
    if suffix == ".bvh":
        return matched_rig(rig_map, _bvh_rest(target, rig_map, body), body)
    if suffix in USD_SUFFIXES:
        return matched_rig(rig_map, _usd_rest(target), body)
    raise InputError(f"--target {target}: expected .bvh, {', '.join(USD_SUFFIXES)}")


def read_rig_map(rig: str) -> RigMap:
    """Return one of RIGS, or the map in a TOML file, or raise InputError."""
    if rig in RIGS:
        return load_rig_map(rig)
    if Path(rig).suffix.lower() != ".toml":
        known = ", ".join(RIGS)
        raise InputError(f"unknown rig {rig!r}; expected {known} or a map (.toml)")
    text = read_limited(rig, _LARGEST_MAP)
    return rig_map_of(parse_toml(text, rig, "expected a map of bones"), rig)


def _bvh_rest(path: Path, rig_map: RigMap, body: Body) -> RestPose:
    """Return a BVH file's skeleton, in the unit in which it has a person's legs."""
    bvh = read_bvh(path)
    joints, meters = bvh.joints, 1.0
    names = tuple(bvh.names[n] for n in joints)
    above = [bvh.parents[n] for n in joints]
    parents = tuple(joints.index(n) if n in joints else -1 for n in above)
    plain = [rig_map.plain(name) for name in names]
    chain = [rig_map.plain(rig_map.of(f"left {p}")[0].name) for p in ("thigh", "foot")]
    places = bvh.rest_positions
    rest = RestPose(names, parents, places[joints], None, places[:, 1].min(), str(path))
    if rig_map.axes_in_bvh:
        rest = _posed_by_map(rest, bvh.offsets[joints], rig_map, body)
    if set(chain) <= set(plain):
        thigh, foot = (rest.positions[plain.index(name)] for name in chain)
        meters = meters_by_leg(float(np.linalg.norm(foot - thigh)))
    lowest = None if rest.lowest is None else meters * rest.lowest
    return replace(rest, positions=meters * rest.positions, lowest=lowest)


def _posed_by_map(
    rest: RestPose, offsets: Array, rig_map: RigMap, body: Body
) -> RestPose:
    """Return how bones rest that have no rest pose without rotations, by a map."""
    built = built_rig(rig_map, body).rest
    if built.axes is None:
        return rest
    known = dict(zip(map(rig_map.plain, built.names), built.axes, strict=True))
    axes, places = np.tile(IDENTITY, (len(rest), 1)), rest.positions.copy()
    for n, parent in enumerate(rest.parents):
        axes[n] = known.get(rig_map.plain(rest.names[n]), axes[parent])
        if parent >= 0:
            places[n] = places[parent] + rotate(axes[parent], offsets[n])
    return replace(rest, positions=places, axes=axes, lowest=None, axes_in_bvh=True)


def _usd_rest(path: Path) -> RestPose:
    """Return the first skeleton of a USD file at rest, y up, in meters."""
    found = read_usd("rest_arrays", path)
    names, parents = tuple(found["names"].tolist()), tuple(found["parents"].tolist())
    return RestPose(names, parents, found["places"], found["axes"], source=str(path))
