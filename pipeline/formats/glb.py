"""Writing GLB, the binary form of glTF 2.0, and VRMA.

Clips and glTF have the same axes and units: y up, facing +z, meters, seconds. Data that
viewers do not need is in the animation's ``extras`` (see CONVENTIONS.md). VRMA is GLB
on VRM's skeleton, with a table of its bones (VRMC_vrm_animation 1.0).
"""

import base64
import json
import struct
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Clip, Prop
from kinefilter.characters.arrays import Array, Indices, chunks
from kinefilter.characters.gaps import parts_of
from kinefilter.characters.rotations import continuous, matrix_from_wxyz
from kinefilter.characters.skin import skin_of

from .export import GAMMA, LENGTHS, PER_CLIP, PER_FRAME, SKIN_COLOR, Export, name_tables
from .files import AnyPath, atomic_path
from .keys import Curve, sparse_curves
from .rig import Rig, RigMotion

MAGIC, JSON, BINARY = 0x46546C67, 0x4E4F534A, 0x004E4942
COMPONENT_TYPES = {5121: "u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
"""Number types of accessors, with numpy's names."""
WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}
"""Numbers in a row of an accessor, by its type."""
SCALES = {"reliability": 1e2, "external_force": 1e2, **dict.fromkeys(LENGTHS, 1e3)}
"""Factors by which fields of a clip are multiplied before ``extras`` rounds them."""
PER_KEYFRAME = {**PER_FRAME, "state": "state", "externalForce": "external_force"}
"""Data in ``extras`` with a row for each keyframe, and the fields of a clip."""
PACKED = np.dtype("<i4")  # type of the numbers in packed data
SMOOTH = "CUBICSPLINE"  # interpolation of samplers whose keyframes have tangents
_POINTS, _CORNERS = 34962, 34963  # ARRAY_BUFFER and ELEMENT_ARRAY_BUFFER
_VRMA = "VRMC_vrm_animation"
_DECIMALS = 9  # of time stamps [s]
_ONE = 2**16 - 1  # of the skin's weights; with bytes, skin would be off by over 1 mm
_LARGEST_INTEGER = 2**31 - 1  # of PACKED; no measured value comes near


def write_glb(
    people: Sequence[tuple[Clip, RigMotion]], path: AnyPath, export: Export
) -> None:
    """Write the clips of one or more people as GLB or VRMA, whole or not at all.

    Time counts from the first frame of anyone. Of frames with the same time the last
    one counts. An additional keyframe ends each long gap, so that the character holds
    still until then. People stand still before they appear and after they leave. Props
    are those of the first clip; with a rig, skin and props are left out. Raises
    InputError if the file cannot be written.
    """
    glb, extras = _Document(), list[dict[str, Any]]()
    start = min(clip.time[0] for clip, _ in people)
    for clip, motion in people:
        rows, stamps, held = _keys(clip, start)
        glb.begin(stamps)
        _add_person(glb, clip, motion, rows, export)
        if not extras and export.rig is None and clip.props:
            _add_props(glb, clip.props, rows)
        once = {"root": export.root, "turnedBy": dict(motion.turned_by)}
        extras.append(_provenance(clip, rows, held) | once)
    if len(people) > 1:
        for number, skin in enumerate(glb.lists["skins"], start=1):
            skin["name"] = f"Person {number}"
    clip, motion = people[0]
    takes = clip.source.split(" + ")  # of a session, with their folders
    animation = {
        "name": " + ".join(Path(take).name.partition(".")[0] for take in takes),
        "samplers": glb.samplers,
        "channels": glb.channels,
        "extras": {"kinefilter": extras[0] if len(people) == 1 else {"people": extras}},
    }
    glb.lists["animations"].append(animation)
    document = {
        "asset": {"version": "2.0", "generator": "kinefilter"},
        "scene": 0,
        "scenes": [{"nodes": glb.scene}],
        **{name: entries for name, entries in glb.lists.items() if entries},
        "buffers": [{"byteLength": len(glb.data)}],
    }
    if Path(path).suffix.lower() == ".vrma":
        bones = {name: {"node": n} for n, name in enumerate(motion.rig.names)}
        humanoid = {"specVersion": "1.0", "humanoid": {"humanBones": bones}}
        document |= {"extensions": {_VRMA: humanoid}, "extensionsUsed": [_VRMA]}
    text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    size = 12 + 8 + len(text) + 8 + len(glb.data)
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        file.write(struct.pack("<III", MAGIC, 2, size))
        file.write(struct.pack("<II", len(text), JSON) + text)
        file.write(struct.pack("<II", len(glb.data), BINARY) + glb.data)


class _Document:
    """The lists of a glTF document, whose entries refer to each other by index."""

    def __init__(self) -> None:
        names = ("nodes", "skins", "animations", "meshes", "materials", "accessors")
        self.lists = {name: list[dict[str, Any]]() for name in (*names, "bufferViews")}
        self.scene: list[int] = []
        self.samplers: list[dict[str, Any]] = []
        self.channels: list[dict[str, Any]] = []
        self.data = bytearray()

    def append(self, name: str, entry: dict[str, Any]) -> int:
        """Add an entry to a list, and return its index."""
        self.lists[name].append(entry)
        return len(self.lists[name]) - 1

    def begin(self, stamps: Array) -> None:
        """Set the times [s] of the keyframes that ``move`` takes from now on."""
        self.stamps, self._time = stamps, -1

    def add(
        self, values: NDArray[Any], target: int | None = None, *, bounds: bool = False
    ) -> int:
        """Return the index of a new accessor of rows (N,) or (N, C)."""
        width = values.shape[1] if values.ndim > 1 else 1
        view = {"buffer": 0, "byteOffset": len(self.data), "byteLength": values.nbytes}
        if target is not None:
            view["target"] = target
        kinds = (k for k, kind in COMPONENT_TYPES.items() if values.dtype == kind)
        accessor = {
            "bufferView": self.append("bufferViews", view),
            "componentType": next(kinds),
            "count": len(values),
            "type": next(name for name, size in WIDTHS.items() if size == width),
        }
        if bounds:
            rows = values.reshape(len(values), -1)
            accessor |= {"min": rows.min(0).tolist(), "max": rows.max(0).tolist()}
        self.data += values.tobytes()
        self.data += bytes(-len(self.data) % 4)
        return self.append("accessors", accessor)

    def move(self, node: int, path: str, values: Array) -> None:
        """Animate a node's translation [m] or rotation (wxyz), a row per keyframe."""
        if self._time < 0:
            self._time = self.add(self.stamps.astype("<f4"), bounds=True)
        self._animate(node, path, {"input": self._time}, values)

    def bend(self, node: int, curve: Curve) -> None:
        """Animate a node's translation or rotation by a curve."""
        keys, width = [curve.slopes, curve.values, curve.slopes], curve.values.shape[1]
        times = self.add(curve.times.astype("<f4"), bounds=True)
        sampler = {"input": times, "interpolation": SMOOTH}
        path = "rotation" if width == 4 else "translation"
        self._animate(node, path, sampler, np.stack(keys, axis=1).reshape(-1, width))

    def _animate(
        self, node: int, path: str, sampler: dict[str, Any], values: Array
    ) -> None:
        target = {"node": node, "path": path}
        self.channels.append({"sampler": len(self.samplers), "target": target})
        values = _xyzw(values) if path == "rotation" else values
        self.samplers.append(sampler | {"output": self.add(values.astype("<f4"))})

    def mesh(self, name: str, primitive: dict[str, Any], color: Sequence[float]) -> int:
        """Return the index of a new mesh in an opaque linear color."""
        looks = {"baseColorFactor": [*color, 1.0], "metallicFactor": 0.0}
        material = {"name": name, "pbrMetallicRoughness": looks}
        primitive = primitive | {"material": self.append("materials", material)}
        return self.append("meshes", {"name": name, "primitives": [primitive]})


def _add_person(
    glb: _Document, clip: Clip, motion: RigMotion, rows: Indices, export: Export
) -> None:
    nodes, rig = glb.lists["nodes"], motion.rig
    first = len(nodes)
    glb.scene.append(first)
    nodes += [_placed(*node) for node in zip(rig.names, *rig.at_rest, strict=True)]
    for n, parent in enumerate(rig.parents[1:], start=1):
        nodes[first + parent].setdefault("children", []).append(first + n)
    some = chunks(len(rows))
    local = [rig.local_rotations(motion.rotations[rows[part]]) for part in some]
    turns = continuous(np.concatenate(local))
    paths = {node: places[rows] for node, places in motion.places.items()}
    if export.keys is None or len(rows) < 2:
        for node, places in paths.items():
            glb.move(first + node, "translation", places)
        for node in range(len(rig)):
            glb.move(first + node, "rotation", turns[:, node])
    else:
        step, error = 1.0 / clip.fps, export.keys / 1000.0
        for curve in sparse_curves(rig, glb.stamps, step, paths, turns, error):
            glb.bend(first + curve.node, curve)
    if export.rig is None:
        mesh = glb.mesh("Skin", _skin(clip, rig, glb), SKIN_COLOR)
        skinned = {"name": "Skin", "mesh": mesh, "skin": len(glb.lists["skins"])}
        glb.scene.append(glb.append("nodes", skinned))
    skin = {
        "joints": list(range(first, first + len(rig))),
        "skeleton": first,
        "inverseBindMatrices": glb.add(_inverse_binds(rig)),
    }
    glb.append("skins", skin)


def _add_props(glb: _Document, props: Sequence[Prop], rows: Indices) -> None:
    """Add a node for all props, one for each below it, and one for each shape."""
    folder: dict[str, Any] = {"name": "Props", "children": []}
    glb.scene.append(glb.append("nodes", folder))
    for prop in props:
        node = _placed(prop.name, prop.positions[0], prop.rotations[0])
        here = glb.append("nodes", node)
        folder["children"].append(here)
        if prop.moves:
            glb.move(here, "translation", prop.positions[rows])
            glb.move(here, "rotation", continuous(prop.rotations[rows]))
        for shape in prop.shapes:
            part = _placed(f"{prop.name} {shape.kind}", shape.position, shape.rotation)
            surface = shape.surface()
            points = glb.add(surface.vertices.astype("<f4"), _POINTS, bounds=True)
            corners = glb.add(surface.faces.astype("<u4").ravel(), _CORNERS)
            primitive = {"attributes": {"POSITION": points}, "indices": corners}
            color = (shape.color**GAMMA).tolist()
            part["mesh"] = glb.mesh(part["name"], primitive, color)
            sizes = {"size": shape.size.tolist(), "color": shape.color.tolist()}
            part["extras"] = {"kind": shape.kind, **sizes}
            node.setdefault("children", []).append(glb.append("nodes", part))


def _keys(clip: Clip, start: float) -> tuple[Indices, Array, list[int]]:
    """Return each keyframe's frame and time since the start [s], and those held."""
    stamps = key_times(clip.time.round(_DECIMALS), round(start, _DECIMALS))
    rows = np.flatnonzero(np.append(np.diff(stamps) > 0.0, True))
    stamps = stamps[rows]
    # Each long gap ends with a keyframe that holds the frame before it.
    starts = np.array([part.start for part in parts_of(stamps)[1:]], dtype=int)
    ends = np.asarray((stamps[starts] - 1.0 / clip.fps).astype(np.float32))
    # Days after the start, single precision may have no number between two frames.
    room = (stamps[starts - 1] < ends) & (ends < stamps[starts])
    starts, ends = starts[room], ends[room]
    held = (starts + np.arange(len(starts))).tolist()
    stamps = np.insert(stamps, starts, ends)
    return np.insert(rows, starts, rows[starts - 1]), stamps, held


def key_times(time: Array, start: float) -> Array:
    """Return time stamps [s] (T,) since the start, rounded to single precision."""
    return np.asarray((time - start).astype(np.float32), dtype=np.float64)


def _xyzw(wxyz: Array) -> Array:
    return np.roll(wxyz, -1, axis=-1)


def _placed(name: str, place: Array, turn: Array) -> dict[str, Any]:
    rotation = _xyzw(turn).clip(-1.0, 1.0).tolist()  # rounding may exceed the range
    return {"name": name, "translation": place.tolist(), "rotation": rotation}


def _inverse_binds(rig: Rig) -> NDArray[Any]:
    """Return the inverse bind matrix of each node, column by column, (N, 16)."""
    binds = np.tile(np.eye(4), (len(rig), 1, 1))
    if rig.axes is not None:
        binds[:, :3, :3] = matrix_from_wxyz(rig.axes)
    binds[:, :3, 3] = rig.positions
    inverse = np.linalg.inv(binds)
    inverse[:, 3] = (0.0, 0.0, 0.0, 1.0)
    return np.swapaxes(inverse, 1, 2).reshape(len(rig), 16).astype("<f4")


def _skin(clip: Clip, rig: Rig, glb: _Document) -> dict[str, Any]:
    skin = skin_of(clip.body)
    weights = np.rint(_ONE * skin.weights)
    weights[:, 0] = _ONE - weights[:, 1:].sum(axis=1)  # the largest: the sum is 1
    joints = np.where(weights > 0.0, rig.segment_nodes[skin.segments], 0)
    attributes = {
        "POSITION": glb.add(skin.points.astype("<f4"), _POINTS, bounds=True),
        "NORMAL": glb.add(skin.normals.astype("<f4"), _POINTS),
        "JOINTS_0": glb.add(joints.astype("u1"), _POINTS),
        "WEIGHTS_0": glb.add(weights.astype("<u2"), _POINTS),
    }
    glb.lists["accessors"][attributes["WEIGHTS_0"]]["normalized"] = True
    corners = glb.add(skin.triangles.astype("<u2").ravel(), _CORNERS)  # about 9,000
    return {"attributes": attributes, "indices": corners}


def _provenance(clip: Clip, rows: Indices, held: list[int]) -> dict[str, Any]:
    once = {name: getattr(clip, field) for name, field in PER_CLIP.items()}
    once |= {"height": clip.body.height, "mass": clip.body.mass}
    extras: dict[str, Any] = {**name_tables(clip.skeleton)}
    extras |= {name: number for name, number in once.items() if np.isfinite(number)}
    extras["time"] = clip.time.round(_DECIMALS).tolist()
    for name, field in PER_KEYFRAME.items():
        values = getattr(clip, field)[rows] * SCALES.get(field, 1.0)
        whole = np.where(np.isfinite(values), np.rint(values), -1.0)
        extras[name] = _packed(np.minimum(whole, _LARGEST_INTEGER))
    return extras | {"held": held}


def _packed(whole: Array) -> str:
    """Return whole numbers (K, ...), a column after the other, compressed, as text."""
    return base64.b64encode(zlib.compress(whole.T.astype(PACKED).tobytes())).decode()
