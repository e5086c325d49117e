"""GLB, the binary form of glTF 2.0: skeleton, skin, animation and props; VRMA.

Axes and unit are glTF's own, which are the clip's: y up, facing +z, meters, seconds.
What no viewer needs is in the animation's ``extras`` (see CONVENTIONS.md). VRMA is GLB
on VRM's skeleton that says which node is which bone (VRMC_vrm_animation 1.0).
"""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Clip, Prop
from kinefilter.characters.arrays import Array, Indices, chunks
from kinefilter.characters.gaps import parts_of
from kinefilter.characters.rotations import continuous, matrix_from_wxyz
from kinefilter.characters.skin import skin_of

from .export import COLOR, LINEAR, ONCE, PER_FRAME, Export, name_tables
from .files import AnyPath, atomic_path
from .recording import FRAMES_AT_ONCE
from .rig import Rig, RigMotion

if TYPE_CHECKING:
    from .keys import Curve

MAGIC, JSON, BINARY = 0x46546C67, 0x4E4F534A, 0x004E4942
KINDS = {5121: "u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
"""Codes of numbers in accessors, and numpy's names."""
SIZES = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}
"""Numbers in each row of an accessor, by its type."""
UNITS = {
    **dict.fromkeys(("reliability", "external_force"), 100.0),
    **dict.fromkeys(("moved_by_correction", "moved_by_physics", "uncertainty"), 1000.0),
}
"""How many of the whole numbers in ``extras`` are one in a clip's fields."""
FRAMES = {**PER_FRAME, "state": "state", "externalForce": "external_force"}
"""What ``extras`` have a row of for each keyframe, and the clip's fields."""
SMOOTH = "CUBICSPLINE"
"""How samplers say that their keys are those of a curve."""
_POINTS, _CORNERS = 34962, 34963  # what a graphics card gets
_VRMA = "VRMC_vrm_animation"
_DECIMALS = 9  # of time stamps [s]
_MOST = 2.0**31  # of whole numbers: more than anything is


def write_glb(
    people: Sequence[tuple[Clip, RigMotion]], path: AnyPath, export: Export
) -> None:
    """Write the clips of one or more people as GLB or VRMA, whole or not at all.

    Of frames with the same time the last counts; one more ends a long gap, so that the
    character holds still until then. Time counts from the first frame of all; who is
    not there yet, or any more, stands still. Props are those of the first clip. On
    another rig there is neither skin nor prop. Raises InputError if the file cannot be
    written.
    """
    glb, known = _Document(), list[dict[str, Any]]()
    start = min(clip.time[0] for clip, _ in people)
    for clip, moved in people:
        rows, stamps, held = _keys(clip, start)
        _add_person(glb, clip, moved, rows, stamps, export)
        if not known and export.rig is None and clip.props:
            _add_props(glb, clip.props, rows)
        once = {"root": export.root, "turnedBy": dict(moved.turned_by)}
        known.append(_provenance(clip, rows, held) | once)
    for number, skin in enumerate(glb.skins if len(people) > 1 else (), start=1):
        skin["name"] = f"Person {number}"
    clip, moved = people[0]
    takes = clip.source.split(" + ")  # of a session, with their folders
    animation = {
        "name": " + ".join(Path(take).name.partition(".")[0] for take in takes),
        "samplers": glb.samplers,
        "channels": glb.channels,
        "extras": {"kinefilter": known[0] if len(people) == 1 else {"people": known}},
    }
    document = {
        "asset": {"version": "2.0", "generator": "kinefilter"},
        "scene": 0,
        "scenes": [{"nodes": glb.scene}],
        "nodes": glb.nodes,
        "skins": glb.skins,
        "animations": [animation],
        "meshes": glb.meshes,
        "materials": glb.materials,
        "accessors": glb.accessors,
        "bufferViews": glb.views,
        "buffers": [{"byteLength": len(glb.data)}],
    }
    if Path(path).suffix.lower() == ".vrma":
        bones = {name: {"node": n} for n, name in enumerate(moved.rig.names)}
        humanoid = {"specVersion": "1.0", "humanoid": {"humanBones": bones}}
        document |= {"extensions": {_VRMA: humanoid}, "extensionsUsed": [_VRMA]}
    document = {name: value for name, value in document.items() if value != []}
    text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    size = 12 + 8 + len(text) + 8 + len(glb.data)
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        file.write(struct.pack("<III", MAGIC, 2, size))
        file.write(struct.pack("<II", len(text), JSON) + text)
        file.write(struct.pack("<II", len(glb.data), BINARY) + glb.data)


class _Document:
    """The lists of a glTF document; entries refer to each other by index."""

    def __init__(self) -> None:
        self.scene: list[int] = []
        self.skins: list[dict[str, Any]] = []
        self.nodes: list[dict[str, Any]] = []
        self.meshes: list[dict[str, Any]] = []
        self.materials: list[dict[str, Any]] = []
        self.samplers: list[dict[str, Any]] = []
        self.channels: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []
        self.views: list[dict[str, Any]] = []
        self.data = bytearray()

    def begin(self, stamps: Array) -> None:
        """Say when the keyframes are that ``move`` takes from now on [s]."""
        self._stamps, self._time = stamps, -1

    def add(
        self, values: NDArray[Any], target: int | None = None, *, bounds: bool = False
    ) -> int:
        """Return the index of a new accessor of rows (N,) or (N, C)."""
        width = values.shape[1] if values.ndim > 1 else 1
        view = {
            "buffer": 0,
            "byteOffset": len(self.data),
            "byteLength": values.nbytes,
        }
        self.views.append(view | ({"target": target} if target else {}))
        accessor = {
            "bufferView": len(self.views) - 1,
            "componentType": next(
                k for k, kind in KINDS.items() if values.dtype == kind
            ),
            "count": len(values),
            "type": next(name for name, size in SIZES.items() if size == width),
        }
        if bounds:
            rows = values.reshape(len(values), -1)
            accessor |= {"min": rows.min(0).tolist(), "max": rows.max(0).tolist()}
        self.accessors.append(accessor)
        self.data += values.tobytes()
        self.data += bytes(-len(self.data) % 4)
        return len(self.accessors) - 1

    def move(self, node: int, what: str, values: Array) -> None:
        """Animate a node's translation [m] or rotation (xyzw), a row a keyframe."""
        if self._time < 0:
            self._time = self.add(self._stamps.astype("<f4"), bounds=True)
        self._animate(node, what, {"input": self._time}, values)

    def _animate(
        self, node: int, what: str, sampler: dict[str, Any], values: Array
    ) -> None:
        target = {"node": node, "path": what}
        self.channels.append({"sampler": len(self.samplers), "target": target})
        self.samplers.append(sampler | {"output": self.add(values.astype("<f4"))})

    def bend(self, node: int, curve: Curve) -> None:
        """Animate a node's translation or rotation by a curve."""
        keys = np.stack([curve.slopes, curve.values, curve.slopes], axis=1)
        what = "translation"
        if keys.shape[-1] == 4:
            keys, what = _xyzw(keys), "rotation"
        times = self.add(curve.times.astype("<f4"), bounds=True)
        sampler = {"input": times, "interpolation": SMOOTH}
        self._animate(node, what, sampler, keys.reshape(-1, keys.shape[-1]))

    def mesh(self, name: str, primitive: dict[str, Any], color: Sequence[float]) -> int:
        """Return the index of a new mesh in a linear color with alpha."""
        looks = {"baseColorFactor": list(color), "metallicFactor": 0.0}
        primitive = primitive | {"material": len(self.materials)}
        self.materials.append({"name": name, "pbrMetallicRoughness": looks})
        self.meshes.append({"name": name, "primitives": [primitive]})
        return len(self.meshes) - 1


def _add_person(
    glb: _Document,
    clip: Clip,
    moved: RigMotion,
    rows: Indices,
    stamps: Array,
    export: Export,
) -> None:
    """Add the skeleton of a person, how it moves, and without a rig the skin."""
    first, rig = len(glb.nodes), moved.rig
    glb.begin(stamps)
    glb.scene.append(first)
    glb.nodes += _nodes(rig, first)
    turns = _turns(moved, rows)
    paths = {node: places[rows] for node, places in moved.places.items()}
    if export.keys is None or len(rows) < 2:
        for node, places in paths.items():
            glb.move(first + node, "translation", places)
        for node in range(len(rig)):
            glb.move(first + node, "rotation", _xyzw(turns[:, node]))
    else:
        from .keys import sparse_curves  # loads scipy

        step, error = 1.0 / clip.fps, export.keys / 1000.0
        for curve in sparse_curves(rig, stamps, step, paths, turns, error):
            glb.bend(first + curve.node, curve)
    if export.rig is None:
        mesh = glb.mesh("Skin", _skin(clip, rig, glb), (*COLOR, 1.0))
        glb.scene.append(len(glb.nodes))
        glb.nodes.append({"name": "Skin", "mesh": mesh, "skin": len(glb.skins)})
    skin = {
        "joints": list(range(first, first + len(rig))),
        "skeleton": first,
        "inverseBindMatrices": glb.add(_inverse_binds(rig)),
    }
    glb.skins.append(skin)


def _add_props(glb: _Document, props: Sequence[Prop], rows: Indices) -> None:
    """Add a node with the props below it, moving at the times given last."""
    node: dict[str, Any] = {"name": "Props", "children": []}
    glb.scene.append(len(glb.nodes))
    glb.nodes.append(node)
    for prop in props:
        node["children"].append(len(glb.nodes))
        _add_prop(glb, prop, rows)


def _add_prop(glb: _Document, prop: Prop, rows: Indices) -> None:
    """Add the node of a prop, and below it a node for each of its shapes."""
    here = len(glb.nodes)
    node = _placed(prop.name, prop.positions[0], prop.rotations[0])
    children = list(range(here + 1, here + 1 + len(prop.shapes)))
    glb.nodes.append(node | ({"children": children} if children else {}))
    if prop.moves:
        glb.move(here, "translation", prop.positions[rows])
        glb.move(here, "rotation", _xyzw(continuous(prop.rotations[rows])))
    for shape in prop.shapes:
        part = _placed(f"{prop.name} {shape.kind}", shape.position, shape.rotation)
        surface = shape.surface()
        points = glb.add(surface.vertices.astype("<f4"), _POINTS, bounds=True)
        corners = glb.add(surface.faces.astype("<u4").ravel(), _CORNERS)
        primitive = {"attributes": {"POSITION": points}, "indices": corners}
        color = (*(shape.color**LINEAR).tolist(), 1.0)
        part["mesh"] = glb.mesh(part["name"], primitive, color)
        known = {"size": shape.size.tolist(), "color": shape.color.tolist()}
        glb.nodes.append(part | {"extras": {"kind": shape.kind, **known}})


def _keys(clip: Clip, start: float) -> tuple[Indices, Array, list[int]]:
    """Return each keyframe's frame, its time since the start [s], and ends of gaps."""
    stamps = key_times(clip.time.round(_DECIMALS), round(start, _DECIMALS))
    rows = np.flatnonzero(np.append(np.diff(stamps) > 0.0, True))
    stamps = stamps[rows]
    starts = np.array([part.start for part in parts_of(stamps)[1:]], dtype=int)
    ends = np.asarray((stamps[starts] - 1.0 / clip.fps).astype(np.float32))
    # Days from the beginning single precision leaves no room for one.
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
    return {
        "name": name,
        "translation": place.tolist(),
        "rotation": _xyzw(turn).clip(-1.0, 1.0).tolist(),  # rounding goes beyond
    }


def _nodes(rig: Rig, first: int) -> list[dict[str, Any]]:
    nodes = [_placed(*node) for node in zip(rig.names, *rig.at_rest, strict=True)]
    for n, parent in enumerate(rig.parents[1:], start=1):
        nodes[parent].setdefault("children", []).append(first + n)
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


def _skin(clip: Clip, rig: Rig, glb: _Document) -> dict[str, Any]:
    skin = skin_of(clip.body)
    weights = skin.weights.astype("<f4")
    joints = np.where(weights > 0.0, rig.starts[skin.segments], 0)
    attributes = {
        "POSITION": glb.add(skin.points.astype("<f4"), _POINTS, bounds=True),
        "NORMAL": glb.add(skin.normals.astype("<f4"), _POINTS),
        "JOINTS_0": glb.add(joints.astype("u1"), _POINTS),
        "WEIGHTS_0": glb.add(weights, _POINTS),
    }
    corners = glb.add(skin.triangles.astype("<u2").ravel(), _CORNERS)  # of some 9,000
    return {"attributes": attributes, "indices": corners}


def _turns(moved: RigMotion, rows: Indices) -> NDArray[Any]:
    """Return every node's rotation in its parent, wxyz, (K, N, 4)."""
    found = np.empty((len(rows), len(moved.rig), 4))
    for some in chunks(len(rows), FRAMES_AT_ONCE):
        found[some] = moved.rig.local_rotations(moved.rotations[rows[some]])
    return continuous(found)


def _provenance(clip: Clip, rows: Indices, held: list[int]) -> dict[str, Any]:
    once = {name: getattr(clip, field) for name, field in ONCE.items()}
    once |= {"height": clip.body.height, "mass": clip.body.mass}
    found: dict[str, Any] = {
        k: value for k, value in once.items() if np.isfinite(value)
    }
    found["time"] = clip.time.round(_DECIMALS).tolist()
    for name, field in FRAMES.items():
        values = getattr(clip, field)[rows] * UNITS.get(field, 1.0)
        whole = np.where(np.isfinite(values), np.rint(values), -1.0)
        whole = np.minimum(whole, _MOST).astype(int)
        found[name] = whole.tolist()
    return {**name_tables(clip.skeleton), **found, "held": held}
