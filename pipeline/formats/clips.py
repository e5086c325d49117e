"""Writing and reading clips by file extension, on our own skeleton or another rig."""

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from kinefilter.characters import KINECT_V2, Body, InputError, standard_body
from kinefilter.characters.arrays import Array, check_kind
from kinefilter.characters.motion import Clip, Motion, Take
from kinefilter.characters.rotations import IDENTITY, about_x, multiply, rotate
from kinefilter.pipeline.reliability import measure_body
from kinefilter.retarget import fill_missing_joints, rotations_from_positions
from kinefilter.retarget.looping import repeated
from kinefilter.retarget.retargeting import Retargeted, retarget
from kinefilter.retarget.rig_map import RIGS, RigMap, load_rig_map, rig_map_of
from kinefilter.retarget.target_rig import RestPose, TargetRig, built_rig, matched_rig

from .bvh import Bvh, meters_by_leg, read_bvh, write_bvh
from .export import USD_SUFFIXES, Export, from_z_up, shaped, with_frame_rate
from .fbx import blender_command, write_fbx
from .files import AnyPath, check_file, check_folder, parse_toml, read_limited
from .glb import write_glb
from .glb_reader import read_glb
from .guarded import read_usd
from .learning import write_joints
from .npz import clip_as_arrays, clip_of_arrays, read_npz, write_arrays
from .rig import RigMotion, motion_of_rig, own_motion, own_skeleton, retargeted_motion
from .sheets import write_take_csv
from .takes import read_take

_LARGEST_MAP = 2**20  # bytes: five thousand bones
_READABLE = (*USD_SUFFIXES, ".glb", ".bvh", ".csv", ".npz")
_WRITABLE = (*USD_SUFFIXES, ".glb", ".vrma", ".fbx", ".bvh", ".csv", ".npz")


def check_writable(path: AnyPath, export: Export | None = None) -> None:
    """Raise, before any work is done, the InputError that write_clip would raise."""
    check_folder(path)
    suffix = Path(path).suffix
    if suffix.lower() not in _WRITABLE:
        known = ", ".join(_WRITABLE)
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
    """Write a clip in the format of the path's extension, whole or not at all.

    USD (``.usda``, ``.usdc``, ``.usd``, ``.usdz``), ``.glb`` and ``.fbx`` hold a
    skinned character in T-pose, its animation and props; ``.bvh`` the skeleton and
    rotations; ``.vrma`` the rotations of VRM's skeleton; ``.csv`` joint positions and
    the sensor's states; ``.npz`` the whole clip. With a rig, USD, GLB, FBX and BVH hold
    its skeleton and animation, and npz the arrays of ``write_joints``. By default units
    are meters, y is up, and the frames are the clip's. Raises InputError if the
    extension is unknown, an option does not apply to it, or the file cannot be written,
    and as ``even_frames`` and ``write_fbx``.
    """
    check_kind(clip, Clip, "the clip")
    export = Export() if export is None else export
    check_kind(export, Export, "the export")
    check_writable(path, export)
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix == ".vrma":
        export = replace(export, rig="vrm")
    export = with_frame_rate(export, suffix, clip.time, clip.source)
    clip = shaped(clip, export)
    if suffix == ".csv":
        write_take_csv(clip, path)
    elif suffix == ".npz" and export.rig is None:
        write_arrays(path, clip_as_arrays(clip))
    elif suffix in (".glb", ".vrma"):
        write_glb([(clip, _rig_motion(clip, export))], path, export)
    elif suffix in USD_SUFFIXES:
        from .usd import write_usd  # loads pxr, which is slow

        write_usd(clip, _rig_motion(clip, export), path, export)
    else:
        write = {".bvh": write_bvh, ".fbx": write_fbx, ".npz": write_joints}[suffix]
        write(clip, _rig_motion(clip, export), path, export)


def write_people(clips: Sequence[Clip], path: AnyPath, export: Export) -> None:
    """Write clips of people recorded together as one GLB; raises as ``write_clip``."""
    check_writable(path, export)
    paces = [with_frame_rate(export, ".glb", clip.time, clip.source) for clip in clips]
    clips = [shaped(clip, own) for clip, own in zip(clips, paces, strict=True)]
    write_glb([*zip(clips, map(_rig_motion, clips, paces), strict=True)], path, export)


def _rig_motion(clip: Clip, export: Export) -> RigMotion:
    """Return a clip's motion on its own skeleton or on the rig of an export."""
    if export.rig is None:
        return own_motion(clip)
    rig = target_rig(export.rig, export.target, clip.body)
    if export.up == "z" and rig.rest.axes is not None:
        # Turning the world must not rename the axes of bones.
        axes = multiply(rig.rest.axes, about_x(np.pi / 2.0))
        rig = replace(rig, rest=replace(rig.rest, axes=axes))
    repetitions, own = repeated(clip) if export.loop else (clip, slice(None))
    motion = Retargeted(*(values[own] for values in retarget(repetitions, rig)))
    return retargeted_motion(rig, motion, clip.skeleton, export.root)


def read_clip(path: AnyPath) -> Clip:
    """Read a clip from any file that write_clip writes, except VRMA and FBX.

    npz is the whole clip. USD on kinefilter's own skeleton is all but the sensor's
    states, the name of the take, stature and mass; its time starts at 0. GLB on it is
    all but the name of the take, in whole percent and millimeters. BVH has positions
    and rotations, CSV only positions: the body is measured from them, contacts and
    props are unknown, and every joint counts as reliable; both may be gzipped. Raises
    InputError if the file is missing, damaged, of another skeleton, or no clip.
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
        clip = _own_bvh_clip(read_bvh(path), os.fspath(path))
        if clip is not None:
            return clip
    elif not name.endswith(".csv"):
        known = ", ".join(_READABLE)
        wrong = "unknown extension for a clip"
        if name.endswith((".vrma", ".fbx")):
            wrong = "VRMA and FBX are for other tools and cannot be read back"
        raise InputError(f"{path}: {wrong}; give {known}")
    return _clip_of_take(read_take(path))


def _own_bvh_clip(bvh: Bvh, source: str) -> Clip | None:
    """Return the clip of a BVH file, or None if it is on another skeleton than ours."""
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
        offsets, rotations, root = map(from_z_up, (offsets, rotations, root))
    motion = motion_of_rig(
        skeleton, meters * offsets, rotations, meters * root, bvh.time, source
    )
    return Clip.of(motion, reliability=np.ones((len(bvh), len(skeleton))))


def _clip_of_take(take: Take) -> Clip:
    """Return the postures on a body of median lengths, with absent joints at rest."""
    missing = np.asarray(~np.isfinite(take.positions).all(axis=-1))
    gaps = np.argwhere(missing & ~missing.all(axis=0))
    if len(gaps):
        frame, joint = gaps[0]
        raise InputError(
            f"{take.source}: frame {frame + 1} has no {take.skeleton.joints[joint]}; "
            "this is a raw take: clean it, or draw it beside its clip with --compare"
        )
    body = measure_body(take)
    filled = fill_missing_joints(take.positions, body)
    rotations = rotations_from_positions(filled, body)
    root = take.positions[:, take.skeleton.root]
    motion = Motion(
        time=take.time, body=body, root=root, rotations=rotations, source=take.source
    )
    return Clip.of(motion, state=take.state, reliability=np.ones(missing.shape))


def target_rig(rig: str, target: Path | None, body: Body) -> TargetRig:
    """Return the skeleton that a clip is written on.

    ``rig`` is the name or the file of a map; ``target`` is a file with the skeleton at
    rest, or None for the map's own in the person's size. Raises InputError if either
    cannot be read, or the file's joints do not have the map's names.
    """
    rig_map = read_rig_map(rig)
    if target is None:
        return built_rig(rig_map, body)
    suffix = target.suffix.lower()
    if suffix == ".bvh":
        return matched_rig(rig_map, _bvh_rest(target, rig_map, body), body)
    if suffix in USD_SUFFIXES:
        arrays = read_usd("rest_arrays", target)
        names, parents = (tuple(arrays[k].tolist()) for k in ("names", "parents"))
        places, axes = arrays["places"], arrays["axes"]
        rest = RestPose(names, parents, places, axes, source=str(target))
        return matched_rig(rig_map, rest, body)
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
    """Return a BVH file's skeleton in meters, y up; the legs show its unit and axes."""
    bvh = read_bvh(path)
    joints, meters = bvh.joints, 1.0
    names = tuple(bvh.names[n] for n in joints)
    above = [bvh.parents[n] for n in joints]
    parents = tuple(joints.index(n) if n in joints else -1 for n in above)
    plain = [rig_map.plain(name) for name in names]
    leg = [rig_map.plain(rig_map.of(f"left {p}")[0].name) for p in ("thigh", "foot")]
    places, offsets = bvh.rest_positions, bvh.offsets[joints]
    if set(leg) <= set(plain):
        thigh, foot = (places[joints[plain.index(name)]] for name in leg)
        meters = meters_by_leg(float(np.linalg.norm(foot - thigh)))
        if abs(foot[2] - thigh[2]) > abs(foot[1] - thigh[1]):
            places, offsets = from_z_up(places), from_z_up(offsets)
    rest = RestPose(names, parents, places[joints], None, places[:, 1].min(), str(path))
    if rig_map.axes_in_bvh:
        rest = _with_axes(rest, offsets, rig_map, body)
    lowest = None if rest.lowest is None else meters * rest.lowest
    return replace(rest, positions=meters * rest.positions, lowest=lowest)


def _with_axes(rest: RestPose, offsets: Array, rig_map: RigMap, body: Body) -> RestPose:
    """Pose a skeleton by a map's axes, which its BVH has in the motion."""
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
