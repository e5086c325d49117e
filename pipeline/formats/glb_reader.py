"""Reading clips that ``glb`` wrote."""

import base64
import json
import os
import struct
import zlib
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import CONTACTS, Clip, InputError, Prop, Shape, standard_body
from kinefilter.characters.arrays import Array, Indices
from kinefilter.characters.rotations import normalize

from . import glb
from .export import DAMAGED, PER_CLIP, name_tables
from .files import AnyPath, check_file, refused
from .rig import motion_of_rig, own_skeleton, rig_of

_LARGEST = 2**31  # bytes: hours of the largest skeleton
_Values = Callable[[int], NDArray[Any]]


def read_glb(path: AnyPath) -> Clip:
    """Read a clip of ``write_glb`` on kinefilter's skeleton, or raise InputError."""
    source = os.fspath(path)
    with refused(source, DAMAGED), np.errstate(all="ignore"):
        return _clip(*_chunks(check_file(path)), source)


def read_glb_times(path: AnyPath) -> tuple[list[list[str]], Array, str | None]:
    """Return the joint names of each skeleton, times [s] of keyframes, and root motion.

    Keyframes are those of the first skeleton, which may come from any program; its root
    motion is then unknown. Raises InputError if the file has no animated skeleton.
    """
    with refused(path, DAMAGED), np.errstate(all="ignore"):
        document, data = _chunks(check_file(path))
        nodes, skins = document["nodes"], document["skins"]
        names = [[str(nodes[n]["name"]) for n in skin["joints"]] for skin in skins]
        animation = document["animations"][0]
        extras = animation.get("extras", {}).get("kinefilter")
        if extras and "people" not in extras:
            time = np.array(extras["time"], dtype=float)
            return names, glb.key_times(time, time[0]), extras.get("root")
        index = animation["samplers"][0]["input"]
        times = _values(document, data, index).astype(float).ravel()
        return names, times, extras and extras["people"][0].get("root")


def _chunks(path: Path) -> tuple[dict[str, Any], bytes]:
    """Return the document of an animated skeleton, and its binary data."""
    if path.stat().st_size > _LARGEST:
        raise InputError("is larger than any clip that kinefilter writes")
    with path.open("rb") as file:
        magic, version, _ = struct.unpack("<III", file.read(12))
        if (magic, version) != (glb.MAGIC, 2):
            raise InputError("not a GLB file of glTF 2.0; give a clip")
        parts = []
        for kind in (glb.JSON, glb.BINARY):
            size, found = struct.unpack("<II", file.read(8))
            parts.append(file.read(size))
            if found != kind or len(parts[-1]) != size:
                raise InputError("ends before its data does; export it again")
    document = json.loads(parts[0])
    if not document.get("skins") or not document.get("animations"):
        raise InputError("has no animated skeleton; expected a clip of kinefilter")
    return document, parts[1]


def _clip(document: dict[str, Any], data: bytes, path: str) -> Clip:
    nodes, animation = document["nodes"], document["animations"][0]
    extras = animation.get("extras", {}).get("kinefilter")
    joints = document["skins"][0]["joints"]
    skeleton = own_skeleton([nodes[n]["name"] for n in joints])
    if skeleton is None:
        raise InputError("is on another skeleton; give a clip written without --rig")
    if extras is None or joints != list(range(len(joints))):
        raise InputError("lacks kinefilter's extras; give the file as it was written")
    if "people" in extras:
        count = len(extras["people"])
        raise InputError(f"holds {count} people; write one each, without --one-file")
    for name, table in name_tables(skeleton).items():
        if extras[name] != table:
            raise InputError(f"its {name} are not kinefilter's; export it again")
    values = partial(_values, document, data)
    samplers = {}
    for channel in animation["channels"]:
        node, what = channel["target"]["node"], channel["target"]["path"]
        samplers[node, what] = animation["samplers"][channel["sampler"]]
    time = np.array(extras["time"], dtype=float)
    held = np.array(extras["held"], dtype=int)
    stamps = glb.key_times(time, time[0])
    # Frames with the same stamp share a keyframe.
    keyframes = np.cumsum(np.diff(stamps, prepend=stamps[:1]) > 0.0)
    count = int(keyframes[-1]) + 1 + len(held)
    kept = np.delete(np.arange(count), held)[keyframes]

    def animated(node: int, what: str) -> Array:
        rows = np.array([nodes[node][what]], dtype=float)
        if sampler := samplers.get((node, what)):
            rows = values(sampler["output"]).astype(float)
            if sampler.get("interpolation") == glb.SMOOTH:
                from scipy.interpolate import CubicHermiteSpline  # slow to load

                keys = values(sampler["input"]).astype(float)
                _, places, slopes = np.moveaxis(rows.reshape(len(keys), 3, -1), 1, 0)
                rows = CubicHermiteSpline(keys, places, slopes)(stamps)
            else:
                rows = rows[kept]
        return _wxyz(rows) if what == "rotation" else rows

    turns = np.stack([animated(n, "rotation") for n in joints], axis=1)
    world = rig_of(standard_body(skeleton)).world_rotations(turns)
    offsets = np.array([nodes[n]["translation"] for n in joints], dtype=float)
    root = animated(0, "translation")
    motion = motion_of_rig(skeleton, offsets, world, root, time, path)
    height, mass = float(extras["height"]), float(extras["mass"])
    motion = replace(motion, body=replace(motion.body, height=height, mass=mass))
    props = []
    (*_, last) = document["scenes"][0]["nodes"]
    for n in nodes[last].get("children", ()) if nodes[last]["name"] == "Props" else ():
        parts = [nodes[part] for part in nodes[n].get("children", ())]
        shapes = tuple(_shape(part, document, values) for part in parts)
        place = animated(n, "translation"), animated(n, "rotation")
        props.append(Prop(nodes[n]["name"], shapes, *place))
    return Clip.of(motion, **_provenance(extras, count, kept), props=tuple(props))


def _values(document: dict[str, Any], data: bytes, index: int) -> NDArray[Any]:
    """Return the rows of an accessor, (N,) or (N, C)."""
    accessor = document["accessors"][index]
    begin = document["bufferViews"][accessor["bufferView"]]["byteOffset"]
    kind = glb.COMPONENT_TYPES[accessor["componentType"]]
    width = glb.WIDTHS[accessor["type"]]
    if min(accessor["count"], begin) < 0:
        raise InputError(DAMAGED)
    rows = np.frombuffer(data, kind, accessor["count"] * width, begin)
    return rows.reshape(-1, width) if width > 1 else rows


def _provenance(extras: dict[str, Any], count: int, kept: Indices) -> dict[str, Any]:
    """Return the fields of a clip in extras of ``count`` keyframes, at those kept."""
    joints = len(extras["joints"])
    once = PER_CLIP.items()
    values: dict[str, Any] = {f: float(extras[k]) for k, f in once if k in extras}
    for name, field in glb.PER_KEYFRAME.items():
        width = {"contacts": len(CONTACTS), "external_force": 1}.get(field, joints)
        size = count * width * glb.PACKED.itemsize
        data = zlib.decompressobj().decompress(base64.b64decode(extras[name]), size + 1)
        rows = np.frombuffer(data, glb.PACKED).reshape(width, count).T[kept]
        rows = rows.astype(float)
        if field == "external_force":
            rows = rows[:, 0]
        if field in glb.SCALES:
            values[field] = np.where(rows < 0.0, np.nan, rows / glb.SCALES[field])
        elif np.isin(rows, np.arange(256)).all():
            values[field] = rows.astype(np.uint8)
        else:
            raise InputError(f"its {name} are not codes; export it again")
    return values


def _wxyz(xyzw: Array) -> Array:
    return normalize(np.roll(xyzw, 1, axis=-1))


def _shape(node: dict[str, Any], document: dict[str, Any], values: _Values) -> Shape:
    extras = node["extras"]
    points, triangles = np.empty((0, 3)), np.empty((0, 3), dtype=np.intp)
    if extras["kind"] == "mesh":
        (primitive,) = document["meshes"][node["mesh"]]["primitives"]
        points = values(primitive["attributes"]["POSITION"]).astype(float)
        triangles = values(primitive["indices"]).reshape(-1, 3).astype(np.intp)
    size, color = (np.array(extras[k], dtype=float) for k in ("size", "color"))
    place, turn = (np.array(node[k], dtype=float) for k in ("translation", "rotation"))
    return Shape(extras["kind"], size, place, _wxyz(turn), color, points, triangles)
