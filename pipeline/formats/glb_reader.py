"""Reads clips that ``glb`` wrote."""

from __future__ import annotations

import json
import os
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Clip, InputError, Prop, Shape, standard_body
from kinefilter.characters.arrays import Array, Indices
from kinefilter.characters.rotations import normalize

from .export import ONCE, name_tables
from .files import AnyPath, check_file
from .glb import BINARY, FRAMES, JSON, KINDS, MAGIC, SIZES, SMOOTH, UNITS, key_times
from .rig import motion_of_rig, own_skeleton, rig_of

_LARGEST = 2**31  # bytes: hours of the largest skeleton
_UNFIT = "its skeleton and animation do not fit; export it again"


def read_glb(path: AnyPath) -> Clip:
    """Read a clip that ``write_glb`` wrote on kinefilter's own skeleton.

    Raises InputError if the file is missing, damaged, another's or on another rig.
    """
    with _refused(path) as source:
        return _clip(*_chunks(source), os.fspath(path))


def read_glb_times(path: AnyPath) -> tuple[list[list[str]], Array]:
    """Return the names of each skeleton's joints, and when there are keyframes [s].

    The keyframes are those of the first skeleton, which may be anybody's. Raises
    InputError as ``read_glb``.
    """
    with _refused(path) as source:
        document, data = _chunks(source)
        _, animation = _animated(document)
        names = [
            [str(document["nodes"][n]["name"]) for n in skin["joints"]]
            for skin in document["skins"]
        ]
        known = animation.get("extras", {}).get("kinefilter")
        if known and "people" not in known:
            time = np.array(known["time"], dtype=float)
            return names, key_times(time, time[0])
        index = animation["samplers"][0]["input"]
        return names, _values(document, data, index).astype(float).ravel()


@contextmanager
def _refused(path: AnyPath) -> Iterator[Path]:
    """Yield a file; what is wrong with it becomes an InputError that names it."""
    source = os.fspath(path)
    try:
        with np.errstate(all="ignore"):  # what is no number is refused with the rest
            yield check_file(path)
    except InputError as error:
        told = str(error)
        raise InputError(told if source in told else f"{source}: {told}") from None
    except (
        *(ValueError, TypeError, KeyError, IndexError, AttributeError, StopIteration),
        *(struct.error, RecursionError, OverflowError, MemoryError, ZeroDivisionError),
    ):
        raise InputError(f"{source}: {_UNFIT}") from None


def _animated(document: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the first skin and the first animation."""
    if not document.get("skins") or not document.get("animations"):
        raise InputError("has no animated skeleton; expected a clip of kinefilter")
    return document["skins"][0], document["animations"][0]


def _chunks(path: Path) -> tuple[dict[str, Any], bytes]:
    """Return the document and the binary part of a file."""
    if path.stat().st_size > _LARGEST:
        raise InputError("is larger than any clip that kinefilter writes")
    with path.open("rb") as file:
        magic, version, _ = struct.unpack("<III", file.read(12))
        if (magic, version) != (MAGIC, 2):
            raise InputError("not a GLB file of glTF 2.0; give a clip")
        found = []
        for kind in (JSON, BINARY):
            size, which = struct.unpack("<II", file.read(8))
            part = file.read(size)
            if which != kind or len(part) != size:
                raise InputError("ends before its data does; export it again")
            found.append(part)
    return json.loads(found[0]), found[1]


def _clip(document: dict[str, Any], data: bytes, path: str) -> Clip:
    nodes, (skin, animation) = document["nodes"], _animated(document)
    known = animation.get("extras", {}).get("kinefilter")
    joints = skin["joints"]
    skeleton = own_skeleton([nodes[n]["name"] for n in joints])
    if skeleton is None:
        raise InputError(
            "is on another skeleton than the sensor's, as of --rig; give a clip that "
            "was written without"
        )
    if known is None or joints != list(range(len(joints))):
        raise InputError(
            "lacks what kinefilter keeps in extras; give the clip as it was written"
        )
    if "people" in known:
        raise InputError(
            f"holds {len(known['people'])} people; give a clip of one, as --body all "
            "writes without --one-file"
        )
    for name, table in name_tables(skeleton).items():
        if known[name] != table:
            raise InputError(f"its {name} are not kinefilter's; export it again")
    values = partial(_values, document, data)
    samplers = {
        (channel["target"]["node"], channel["target"]["path"]): sampler
        for channel in animation["channels"]
        for sampler in [animation["samplers"][channel["sampler"]]]
    }
    time = np.array(known["time"], dtype=float)
    keys = len(known["state"])
    kept = np.delete(np.arange(keys), np.array(known["held"], dtype=int))
    stamps = key_times(time, time[0])
    # Frames with the same stamp share a keyframe.
    kept = kept[np.cumsum(np.diff(stamps, prepend=stamps[:1]) > 0.0)]

    def moved(node: int, what: str) -> Array:
        rows = np.array([nodes[node][what]], dtype=float)
        if sampler := samplers.get((node, what)):
            rows = values(sampler["output"]).astype(float)
            if sampler.get("interpolation") == SMOOTH:
                from scipy.interpolate import CubicHermiteSpline  # slow to load

                keys = values(sampler["input"]).astype(float)
                _, places, slopes = np.moveaxis(rows.reshape(len(keys), 3, -1), 1, 0)
                rows = CubicHermiteSpline(keys, places, slopes)(stamps)
            else:
                rows = rows[kept]
        return _wxyz(rows) if what == "rotation" else rows

    turns = np.stack([moved(n, "rotation") for n in joints], axis=1)
    motion = motion_of_rig(
        skeleton,
        np.array([nodes[n]["translation"] for n in joints], dtype=float),
        rig_of(standard_body(skeleton)).world_rotations(turns),
        moved(0, "translation"),
        time,
        path,
    )
    height, mass = float(known["height"]), float(known["mass"])
    motion = replace(motion, body=replace(motion.body, height=height, mass=mass))
    props = []
    (*_, last) = document["scenes"][0]["nodes"]
    for n in nodes[last].get("children", ()) if nodes[last]["name"] == "Props" else ():
        parts = [nodes[part] for part in nodes[n].get("children", ())]
        shapes = tuple(_shape(part, document, values) for part in parts)
        place = moved(n, "translation"), moved(n, "rotation")
        props.append(Prop(nodes[n]["name"], shapes, *place))
    return Clip.of(motion, **_known(known, kept), props=tuple(props))


def _values(document: dict[str, Any], data: bytes, index: int) -> NDArray[Any]:
    """Return the rows of an accessor, (N,) or (N, C)."""
    accessor = document["accessors"][index]
    begin = document["bufferViews"][accessor["bufferView"]]["byteOffset"]
    kind, width = KINDS[accessor["componentType"]], SIZES[accessor["type"]]
    if min(accessor["count"], begin) < 0:
        raise InputError(_UNFIT)
    rows = np.frombuffer(data, kind, accessor["count"] * width, begin)
    return rows.reshape(-1, width) if width > 1 else rows


def _known(known: dict[str, Any], kept: Indices) -> dict[str, Any]:
    """Return a clip's fields as ``_provenance`` put them down."""
    found: dict[str, Any] = {
        field: float(known[name]) for name, field in ONCE.items() if name in known
    }
    for name, field in FRAMES.items():
        rows = np.array(known[name], dtype=float)[kept]
        unit = UNITS.get(field)
        if unit is None:
            if not np.isin(rows, np.arange(256)).all():
                raise InputError(f"its {name} are no codes; export it again")
            found[field] = rows.astype(np.uint8)
        else:
            found[field] = np.where(rows < 0.0, np.nan, rows / unit)
    return found


def _wxyz(xyzw: Array) -> Array:
    return normalize(np.roll(xyzw, 1, axis=-1))


def _shape(
    node: dict[str, Any],
    document: dict[str, Any],
    values: Callable[[int], NDArray[Any]],
) -> Shape:
    known = node["extras"]
    points, triangles = np.empty((0, 3)), np.empty((0, 3), dtype=np.intp)
    if known["kind"] == "mesh":
        (primitive,) = document["meshes"][node["mesh"]]["primitives"]
        points = values(primitive["attributes"]["POSITION"]).astype(float)
        triangles = values(primitive["indices"]).reshape(-1, 3).astype(np.intp)
    size, color, place, turn = (
        np.array(numbers, dtype=float)
        for numbers in (
            *(known["size"], known["color"]),
            *(node["translation"], node["rotation"]),
        )
    )
    return Shape(known["kind"], size, place, _wxyz(turn), color, points, triangles)
