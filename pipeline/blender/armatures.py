"""Armatures in Blender: their rest pose, motions imported and brought onto others.

This runs in Blender, which knows no kinefilter.
"""

# mypy: disable-error-code="no-any-return"

from __future__ import annotations

import json
import math
import struct
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix

_Y_UP = Matrix.Rotation(-math.pi / 2.0, 4, "X")  # of Blender's z up
_NEAR = 0.005  # frames: stamps have single precision
_ROOT = 0.1  # m, drawn


def extras(clip: Path) -> dict[str, Any]:
    """Return what kinefilter keeps in a GLB beside the animation."""
    data = clip.read_bytes()
    (size,) = struct.unpack_from("<I", data, 12)
    return json.loads(data[20 : 20 + size])["animations"][0]["extras"]["kinefilter"]


def rest_pose(armature: Any) -> str:
    """Return the rest pose of an armature's largest tree of bones as BVH, y up [m]."""
    roots = [bone for bone in armature.data.bones if bone.parent is None]
    root = max(roots, key=lambda bone: len(bone.children_recursive))
    turned, numbers = (_Y_UP @ armature.matrix_world).to_3x3(), []

    def offset(vector: Any) -> str:
        return "OFFSET {:.9g} {:.9g} {:.9g}\n".format(*(turned @ vector))

    def joint(bone: Any, kind: str, place: Any) -> Iterator[str]:
        yield f"{kind} {bone.name}\n{{\n{offset(place)}"
        yield "CHANNELS 3 Zrotation Yrotation Xrotation\n"
        numbers.append("0 0 0")
        for child in bone.children:
            yield from joint(child, "JOINT", child.head_local - bone.head_local)
        if not bone.children:
            tip = bone.tail_local - bone.head_local
            yield f"End Site\n{{\n{offset(tip)}}}\n"
        yield "}\n"

    tree = "".join(joint(root, "ROOT", root.head_local))
    motion = f"MOTION\nFrames: 1\nFrame Time: 0.1\n{' '.join(numbers)}\n"
    return f"HIERARCHY\n{tree}{motion}"


def imported(context: Any, clip: Path, fps: float, *, own: bool) -> Any:
    """Return the armature of a GLB, which lies on whole frames of a rate [1/s]."""
    if context.mode != "OBJECT":
        bpy.ops.object.mode_set(mode="OBJECT")
    before, render = set(bpy.data.objects), context.scene.render
    base, render.fps_base = render.fps_base, fps / render.fps  # it multiplies by it
    try:
        bpy.ops.import_scene.gltf(
            filepath=str(clip),
            # The sensor's joints have no axes of their own, other rigs keep theirs.
            bone_heuristic="TEMPERANCE" if own else "BLENDER",
            disable_bone_shape=True,
        )
    finally:
        render.fps_base = base
    new = set(bpy.data.objects) - before
    (armature,) = [thing for thing in new if thing.type == "ARMATURE"]
    for thing in new:
        if thing.animation_data is not None:
            for track in [*thing.animation_data.nla_tracks]:
                thing.animation_data.nla_tracks.remove(track)
            for curve in _curves(thing):
                keys = _points(curve)["co"]
                near = np.rint(keys[:, 0])
                keys[:, 0] = np.where(
                    np.abs(keys[:, 0] - near) < _NEAR, near, keys[:, 0]
                )
                curve.keyframe_points.foreach_set("co", keys.ravel())
                curve.update()
    if own:  # its root, on which all hangs in its own place, would be long
        context.view_layer.objects.active = armature
        bpy.ops.object.mode_set(mode="EDIT")
        armature.data.edit_bones[0].length = _ROOT
        bpy.ops.object.mode_set(mode="OBJECT")
    return armature


def _curves(thing: Any) -> Any:
    """Return the curves of an object's action."""
    action = thing.animation_data.action
    if hasattr(action, "fcurves"):  # up to Blender 4
        return action.fcurves
    return action.layers[0].strips[0].channelbags[0].fcurves


def _points(curve: Any) -> dict[str, Any]:
    """Return keys and handles of a curve, each (K, 2): frame and value."""
    found = {}
    for what in ("co", "handle_left", "handle_right"):
        flat = np.empty(2 * len(curve.keyframe_points), dtype=np.float32)
        curve.keyframe_points.foreach_get(what, flat)
        found[what] = flat.reshape(-1, 2)
    return found


def brought(source: Any, target: Any) -> Any:
    """Bring the action of an armature onto another with the same bones; return that.

    Both rest alike, but for the axes of their bones and the unit.
    """
    scale = target.matrix_world.median_scale
    lengths = [_length(armature, source.data.bones) for armature in (target, source)]
    longer = lengths[0] / lengths[1]
    curves = {(c.data_path, c.array_index): c for c in _curves(source)}
    for bone in source.pose.bones:
        moved = target.pose.bones[bone.name]
        moved.rotation_mode, moved.matrix_basis = "QUATERNION", Matrix()
        axes, wanted = (
            (armature.matrix_world @ armature.data.bones[bone.name].matrix_local)
            for armature in (source, target)
        )
        change = wanted.to_quaternion().inverted() @ axes.to_quaternion()
        turn = np.array(change.to_matrix())
        _turn(curves, bone.path_from_id("rotation_quaternion"), (1, 2, 3), turn)
        _turn(curves, bone.path_from_id("location"), (0, 1, 2), turn * longer / scale)
    animated = target.animation_data or target.animation_data_create()
    if animated.action is not None:
        animated.action.use_fake_user = True  # it is not lost
    animated.action = source.animation_data.action
    if hasattr(animated, "action_slot"):  # from Blender 4.4 on
        animated.action_slot = animated.action.slots[0]
    bpy.data.armatures.remove(source.data)
    return target


def _length(armature: Any, named: Any) -> float:
    """Return how long some bones are together, from head to head."""
    bones = [armature.data.bones[bone.name] for bone in named if bone.parent]
    ways = [bone.head_local - bone.parent.head_local for bone in bones]
    return sum(way.length for way in ways) * armature.matrix_world.median_scale


def _turn(curves: dict[Any, Any], path: str, axes: Any, matrix: Any) -> None:
    """Multiply a vector's three curves by a matrix, handles too."""
    three = [curves[path, axis] for axis in axes if (path, axis) in curves]
    if len(three) < 3:
        return
    points = [_points(curve) for curve in three]
    for what in points[0]:
        values = matrix @ np.stack([one[what][:, 1] for one in points])
        for curve, one, row in zip(three, points, values, strict=True):
            one[what][:, 1] = row
            curve.keyframe_points.foreach_set(what, one[what].ravel())
    for curve in three:
        curve.update()


def show_reliability(
    armature: Any, known: dict[str, Any], fps: float, colors: Sequence[Sequence[float]]
) -> None:
    """Color bones by mean reliability, and animate it as a property of each.

    Where it is unknown, it counts as 0.
    """
    rows = np.delete(np.array(known["reliability"]), known["held"], axis=0)
    shares = np.maximum(rows, 0.0) / 100.0
    points = np.empty((len(shares), 2), dtype=np.float32)
    points[:, 0] = (np.array(known["time"]) - known["time"][0]) * fps
    linear = bpy.types.Keyframe.bl_rna.properties["interpolation"].enum_items["LINEAR"]
    for name, joint in known["turnedBy"].items():
        bone, seen = armature.pose.bones[name], shares[:, joint]
        mean = float(seen.mean())
        bone["reliability"] = mean
        bone.id_properties_ui("reliability").update(min=0.0, max=1.0)
        path = f'{bone.path_from_id()}["reliability"]'
        curve = _curves(armature).new(path)
        points[:, 1] = seen
        curve.keyframe_points.add(len(points))
        curve.keyframe_points.foreach_set("co", points.ravel())
        kinds = np.full(len(points), linear.value)
        curve.keyframe_points.foreach_set("interpolation", kinds)
        curve.update()
        color = colors[round(mean * (len(colors) - 1))]
        bone.color.palette = "CUSTOM"
        bone.color.custom.normal = color
        bone.color.custom.select = [0.5 + 0.5 * share for share in color]
        bone.color.custom.active = [0.3 + 0.7 * share for share in color]
