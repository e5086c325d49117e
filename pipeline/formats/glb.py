"""GLB, the binary form of glTF 2.0: skeleton, skin, animation and props.

Axes and unit are glTF's own, which are the clip's: y up, facing +z, meters, seconds.
What no viewer needs is in the animation's ``extras``, as whole numbers a row a frame:
reliability in per cent, how far joints were moved and may be off in mm, the external
force in per cent of the body's weight, contacts and codes.
"""

from __future__ import annotations

import json
import os
import struct
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Clip, InputError, Prop, Shape, standard_body
from kinefilter.characters.arrays import Array, Indices, chunks
from kinefilter.characters.gaps import parts_of
from kinefilter.characters.rotations import continuous, matrix_from_wxyz, normalize
from kinefilter.characters.skin import skin_of

from .export import LINEAR, ONCE, PER_FRAME, Export, name_tables
from .files import AnyPath, atomic_path, check_file
from .recording import FRAMES_AT_ONCE
from .rig import Rig, RigMotion, motion_of_rig, own_skeleton, rig_of

_MAGIC, _JSON, _BINARY = 0x46546C67, 0x4E4F534A, 0x004E4942
_LARGEST = 2**31  # bytes: hours of the largest skeleton
_FLOAT, _POINTS, _CORNERS = 5126, 34962, 34963
_KINDS: dict[int, Any] = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2"}
_KINDS |= {5125: "<u4", _FLOAT: "<f4"}
_SIZES = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_COLOR = (0.11, 0.24, 0.32, 1.0)  # linear; a quiet color that no prop has
_UNITS = {"reliability": 100.0, "external_force": 100.0}
_UNITS |= dict.fromkeys(("moved_by_correction", "moved_by_physics"), 1000.0)
_UNITS["uncertainty"] = 1000.0
_FRAMES = {**PER_FRAME, "state": "state", "externalForce": "external_force"}
_UNFIT = "its skeleton and animation do not fit; export it again"


class _Buffer:
    """The binary part of a file, and the accessors of its arrays."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []

    def add(
        self, values: NDArray[Any], target: int | None = None, *, bounds: bool = False
    ) -> int:
        """Return the index of a new accessor of rows (N,) or (N, C)."""
        values = np.ascontiguousarray(values)
        kind = next(k for k, name in _KINDS.items() if values.dtype == np.dtype(name))
        width = values.shape[1] if values.ndim > 1 else 1
        view = {
            "buffer": 0,
            "byteOffset": len(self.data),
            "byteLength": values.nbytes,
        }
        self.views.append(view | ({"target": target} if target else {}))
        accessor = {
            "bufferView": len(self.views) - 1,
            "componentType": kind,
            "count": len(values),
            "type": next(name for name, size in _SIZES.items() if size == width),
        }
        if bounds:
            rows = values.reshape(len(values), -1)
            accessor |= {"min": rows.min(0).tolist(), "max": rows.max(0).tolist()}
        self.accessors.append(accessor)
        self.data += values.tobytes()
        self.data += bytes(-len(self.data) % 4)
        return len(self.accessors) - 1


def write_glb(clip: Clip, moved: RigMotion, path: AnyPath, export: Export) -> None:
    """Write a clip as GLB, whole or not at all.

    Of frames with the same time the last counts; one more ends a long gap, so that the
    character holds still until then. On another rig there is neither skin nor prop.
    Raises InputError if the file cannot be written.
    """
    rows, stamps, held = _keys(clip)
    buffer, rig, own = _Buffer(), moved.rig, export.rig is None
    meshes: list[dict[str, Any]] = []
    materials: list[dict[str, Any]] = []
    nodes = _nodes(rig)
    scene = [0]
    skin = {
        "joints": list(range(len(rig))),
        "skeleton": 0,
        "inverseBindMatrices": buffer.add(_inverse_binds(rig)),
    }
    if own:
        scene.append(len(nodes))
        nodes.append({"name": "Skin", "mesh": 0, "skin": 0})
        meshes.append({"name": "Skin", "primitives": [_skin(clip, rig, buffer)]})
        materials.append(_material("Skin", _COLOR))
    time = buffer.add(stamps.astype("<f4"), bounds=True)
    samplers: list[dict[str, Any]] = []
    channels: list[dict[str, Any]] = []

    def move(node: int, what: str, values: Array) -> None:
        output = buffer.add(values.astype("<f4"))
        channels.append(
            {"sampler": len(samplers), "target": {"node": node, "path": what}}
        )
        samplers.append({"input": time, "output": output})

    move(rig.mover, "translation", moved.path[rows])
    for node, turns in enumerate(_turns(moved, rows)):
        move(node, "rotation", turns)
    props = clip.props if own else ()
    if props:
        scene.append(len(nodes))
        nodes.append({"name": "Props", "children": []})
    for prop in props:
        here = len(nodes)
        nodes[scene[-1]]["children"].append(here)
        nodes.append(_placed(prop.name, prop.positions[0], prop.rotations[0]))
        if prop.moves:
            move(here, "translation", prop.positions[rows])
            move(here, "rotation", _xyzw(continuous(prop.rotations[rows])))
        parts = range(here + 1, here + 1 + len(prop.shapes))
        nodes[here]["children"] = list(parts)
        for shape in prop.shapes:
            part = _placed(f"{prop.name} {shape.kind}", shape.position, shape.rotation)
            nodes.append(part | {"mesh": len(meshes), "extras": _as_extras(shape)})
            primitive = _surface(shape, buffer) | {"material": len(materials)}
            meshes.append({"name": part["name"], "primitives": [primitive]})
            color = (*(shape.color**LINEAR).tolist(), 1.0)
            materials.append(_material(part["name"], color))
    document = {
        "asset": {"version": "2.0", "generator": "kinefilter"},
        "scene": 0,
        "scenes": [{"nodes": scene}],
        "nodes": nodes,
        "skins": [skin],
        "animations": [
            {
                "name": clip.source,
                "samplers": samplers,
                "channels": channels,
                "extras": {"kinefilter": _provenance(clip, rows, held)},
            }
        ],
        "meshes": meshes,
        "materials": materials,
        "accessors": buffer.accessors,
        "bufferViews": buffer.views,
        "buffers": [{"byteLength": len(buffer.data)}],
    }
    document = {name: value for name, value in document.items() if value != []}
    text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    size = 12 + 8 + len(text) + 8 + len(buffer.data)
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        file.write(struct.pack("<III", _MAGIC, 2, size))
        file.write(struct.pack("<II", len(text), _JSON) + text)
        file.write(struct.pack("<II", len(buffer.data), _BINARY) + buffer.data)


def _keys(clip: Clip) -> tuple[Indices, Array, list[int]]:
    """Return the frame of each key, its time [s], and which keys end a long gap."""
    rows = np.flatnonzero(np.append(np.diff(clip.time) > 0.0, True))
    stamps = clip.time[rows] - clip.time[0]
    starts = np.array([part.start for part in parts_of(stamps)[1:]], dtype=int)
    held = (starts + np.arange(len(starts))).tolist()
    stamps = np.insert(stamps, starts, stamps[starts] - 1.0 / clip.fps)
    return np.insert(rows, starts, rows[starts - 1]), stamps, held


def _xyzw(wxyz: Array) -> Array:
    return np.roll(wxyz, -1, axis=-1)


def _placed(name: str, place: Array, turn: Array) -> dict[str, Any]:
    return {
        "name": name,
        "translation": place.tolist(),
        "rotation": _xyzw(turn).tolist(),
    }


def _nodes(rig: Rig) -> list[dict[str, Any]]:
    nodes = [_placed(*node) for node in zip(rig.names, *rig.at_rest, strict=True)]
    for n, parent in enumerate(rig.parents[1:], start=1):
        nodes[parent].setdefault("children", []).append(n)
    return nodes


def _inverse_binds(rig: Rig) -> NDArray[Any]:
    """Return what takes points at rest into each node's frame, column by column."""
    binds = np.tile(np.eye(4), (len(rig), 1, 1))
    if rig.axes is not None:
        binds[:, :3, :3] = matrix_from_wxyz(rig.axes)
    binds[:, :3, 3] = rig.rest_positions
    inverse = np.linalg.inv(binds)
    inverse[:, 3] = (0.0, 0.0, 0.0, 1.0)
    return np.swapaxes(inverse, 1, 2).reshape(len(rig), 16).astype("<f4")


def _skin(clip: Clip, rig: Rig, buffer: _Buffer) -> dict[str, Any]:
    skin = skin_of(clip.body)
    weights = skin.weights.astype("<f4")
    joints = np.where(weights > 0.0, rig.starts[skin.segments], 0)
    attributes = {
        "POSITION": buffer.add(skin.points.astype("<f4"), _POINTS, bounds=True),
        "NORMAL": buffer.add(skin.normals.astype("<f4"), _POINTS),
        "JOINTS_0": buffer.add(joints.astype("u1"), _POINTS),
        "WEIGHTS_0": buffer.add(weights, _POINTS),
    }
    corners = buffer.add(skin.triangles.astype("<u4").ravel(), _CORNERS)
    return {"attributes": attributes, "indices": corners, "material": 0}


def _surface(shape: Shape, buffer: _Buffer) -> dict[str, Any]:
    surface = shape.surface()
    points = buffer.add(surface.vertices.astype("<f4"), _POINTS, bounds=True)
    corners = buffer.add(surface.faces.astype("<u4").ravel(), _CORNERS)
    return {"attributes": {"POSITION": points}, "indices": corners}


def _material(name: str, color: Sequence[float]) -> dict[str, Any]:
    looks = {"baseColorFactor": list(color), "metallicFactor": 0.0}
    return {"name": name, "pbrMetallicRoughness": looks}


def _turns(moved: RigMotion, rows: Indices) -> NDArray[Any]:
    """Return every node's rotation in its parent, xyzw, (N, K, 4)."""
    found = np.empty((len(rows), len(moved.rig), 4))
    for some in chunks(len(rows), FRAMES_AT_ONCE):
        found[some] = moved.rig.local_rotations(moved.rotations[rows[some]])
    return np.swapaxes(_xyzw(continuous(found)), 0, 1)


def _provenance(clip: Clip, rows: Indices, held: list[int]) -> dict[str, Any]:
    once = {name: getattr(clip, field) for name, field in ONCE.items()}
    found = {name: value for name, value in once.items() if np.isfinite(value)}
    for name, field in _FRAMES.items():
        values = getattr(clip, field)[rows] * _UNITS.get(field, 1.0)
        whole = np.where(np.isfinite(values), np.rint(values), -1.0).astype(int)
        found[name] = whole.tolist()
    return {**name_tables(clip.skeleton), **found, "held": held}


def _as_extras(shape: Shape) -> dict[str, Any]:
    known = {"size": shape.size.tolist(), "color": shape.color.tolist()}
    return {"kind": shape.kind, **known}


def read_glb(path: AnyPath) -> Clip:
    """Read a clip that ``write_glb`` wrote on kinefilter's own skeleton.

    Its time starts at 0. Raises InputError if the file is missing, damaged, another's
    or on another rig.
    """
    file = check_file(path)
    source = os.fspath(path)
    try:
        return _clip(*_chunks(file), source)
    except InputError as error:
        told = str(error)
        raise InputError(told if source in told else f"{source}: {told}") from None
    except (
        *(ValueError, TypeError, KeyError, IndexError, AttributeError, StopIteration),
        *(struct.error, RecursionError, OverflowError, MemoryError, ZeroDivisionError),
    ):
        raise InputError(f"{source}: {_UNFIT}") from None


def _chunks(path: Path) -> tuple[dict[str, Any], bytes]:
    """Return the document and the binary part of a file."""
    if path.stat().st_size > _LARGEST:
        raise InputError("is larger than any clip that kinefilter writes")
    with path.open("rb") as file:
        magic, version, _ = struct.unpack("<III", file.read(12))
        if (magic, version) != (_MAGIC, 2):
            raise InputError("not a GLB file of glTF 2.0; give a clip")
        found = []
        for kind in (_JSON, _BINARY):
            size, which = struct.unpack("<II", file.read(8))
            part = file.read(size)
            if which != kind or len(part) != size:
                raise InputError("ends before its data does; export it again")
            found.append(part)
    return json.loads(found[0]), found[1]


def _clip(document: dict[str, Any], data: bytes, path: str) -> Clip:
    nodes, (animation, *_) = document["nodes"], document["animations"]
    known = animation.get("extras", {}).get("kinefilter")
    joints = document["skins"][0]["joints"]
    skeleton = own_skeleton([nodes[n]["name"] for n in joints])
    if skeleton is None or known is None or joints != list(range(len(joints))):
        raise InputError(
            "not a clip on kinefilter's own skeleton; only those can be read back"
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
    stamps = values(samplers[0, "rotation"]["input"]).astype(float)
    kept = np.delete(np.arange(len(stamps)), np.array(known["held"], dtype=int))

    def moved(node: int, what: str) -> Array:
        rows = np.array([nodes[node][what]], dtype=float)
        if (node, what) in samplers:
            rows = values(samplers[node, what]["output"])[kept].astype(float)
        return _wxyz(rows) if what == "rotation" else rows

    turns = np.stack([moved(n, "rotation") for n in joints], axis=1)
    motion = motion_of_rig(
        skeleton,
        np.array([nodes[n]["translation"] for n in joints], dtype=float),
        rig_of(standard_body(skeleton)).world_rotations(turns),
        moved(0, "translation"),
        stamps[kept],
        path,
    )
    props = []
    (*_, last) = document["scenes"][0]["nodes"]
    for n in nodes[last].get("children", ()) if nodes[last]["name"] == "Props" else ():
        parts = [nodes[part] for part in nodes[n]["children"]]
        shapes = tuple(_shape(part, document, values) for part in parts)
        place = moved(n, "translation"), moved(n, "rotation")
        props.append(Prop(nodes[n]["name"], shapes, *place))
    return Clip.of(motion, **_known(known, kept), props=tuple(props))


def _values(document: dict[str, Any], data: bytes, index: int) -> NDArray[Any]:
    """Return the rows of an accessor, (N,) or (N, C)."""
    accessor = document["accessors"][index]
    begin = document["bufferViews"][accessor["bufferView"]]["byteOffset"]
    kind, width = _KINDS[accessor["componentType"]], _SIZES[accessor["type"]]
    if min(accessor["count"], begin) < 0:
        raise InputError(_UNFIT)
    rows = np.frombuffer(data, kind, accessor["count"] * width, begin)
    return rows.reshape(-1, width) if width > 1 else rows


def _known(known: dict[str, Any], kept: Indices) -> dict[str, Any]:
    """Return a clip's fields as ``_provenance`` put them down."""
    found: dict[str, Any] = {
        field: float(known[name]) for name, field in ONCE.items() if name in known
    }
    for name, field in _FRAMES.items():
        rows = np.array(known[name], dtype=float)[kept]
        unit = _UNITS.get(field)
        if unit is None:
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
