"""Import of clips as armatures and transfer to others; this runs in Blender alone."""

# mypy: disable-error-code="no-any-return"

from __future__ import annotations

import base64
import json
import math
import struct
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix

_Y_UP = Matrix.Rotation(-math.pi / 2.0, 4, "X")  # from Blender's z up
_NEAR = 0.005  # frames; time stamps have single precision
_ROOT_LENGTH = 0.1  # m, of the root bone as it is drawn
_LIMBS = ("upper_arm", "forearm", "hand", "thigh", "shin", "foot", "toe")
_TORSO = "torso"
_CONTROLS = {
    _TORSO: "spine.001",
    "spine_fk": "spine",
    **{f"spine_fk.{k:03}": f"spine.{k:03}" for k in (1, 2, 3)},
    "neck": "spine.004",
    "head": "spine.006",
    **{f"shoulder.{side}": f"shoulder.{side}" for side in "LR"},
    **{f"{limb}_fk.{side}": f"{limb}.{side}" for side in "LR" for limb in _LIMBS},
}
"""Controls of a rig that Rigify generated, and the bones of its metarig they move."""


def extras(clip: Path) -> dict[str, Any]:
    """Return the ``extras`` that kinefilter stores in a GLB beside the animation."""
    data = clip.read_bytes()
    (size,) = struct.unpack_from("<I", data, 12)
    return json.loads(data[20 : 20 + size])["animations"][0]["extras"]["kinefilter"]


def rest_pose(armature: Any) -> str:
    """Return the rest pose of an armature's largest tree of bones as BVH, y up [m].

    That of a rig which Rigify generated is its metarig's.
    """
    if is_generated(armature):
        metarig = metarig_of(armature)
        text = rest_pose(metarig)
        bpy.data.armatures.remove(metarig.data)
        bpy.context.view_layer.objects.active = armature
        return text
    roots = [bone for bone in armature.data.bones if bone.parent is None]
    root = max(roots, key=lambda bone: len(bone.children_recursive))
    turn, numbers = (_Y_UP @ armature.matrix_world).to_3x3(), []

    def offset(vector: Any) -> str:
        return "OFFSET {:.9g} {:.9g} {:.9g}\n".format(*(turn @ vector))

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
    """Import a GLB on kinefilter's own skeleton or a rig, with its keys on frames."""
    if context.mode != "OBJECT":
        bpy.ops.object.mode_set(mode="OBJECT")
    before, render = set(bpy.data.objects), context.scene.render
    # The importer multiplies times by ``fps_base`` instead of dividing.
    base, render.fps_base = render.fps_base, fps / render.fps
    # The sensor's joints have no axes of their own; those of rigs are kept.
    axes = "TEMPERANCE" if own else "BLENDER"
    try:
        bpy.ops.import_scene.gltf(
            filepath=str(clip), bone_heuristic=axes, disable_bone_shape=True
        )
    finally:
        render.fps_base = base
    new = set(bpy.data.objects) - before
    (armature,) = [obj for obj in new if obj.type == "ARMATURE"]
    for obj in new:
        if obj.animation_data is None:
            continue
        for track in [*obj.animation_data.nla_tracks]:
            obj.animation_data.nla_tracks.remove(track)
        for curve in _curves(obj):
            keys = _points(curve)["co"]
            frames = np.rint(keys[:, 0])
            near = np.abs(keys[:, 0] - frames) < _NEAR
            keys[near, 0] = frames[near]
            curve.keyframe_points.foreach_set("co", keys.ravel())
            curve.update()
    if own:  # the children of the root are at its place, so Blender draws it long
        context.view_layer.objects.active = armature
        bpy.ops.object.mode_set(mode="EDIT")
        armature.data.edit_bones[0].length = _ROOT_LENGTH
        bpy.ops.object.mode_set(mode="OBJECT")
    return armature


def _curves(obj: Any) -> Any:
    action = obj.animation_data.action
    if hasattr(action, "fcurves"):  # up to Blender 4
        return action.fcurves
    return action.layers[0].strips[0].channelbags[0].fcurves


def _points(curve: Any) -> dict[str, Any]:
    """Return the keys and handles of a curve, each (K, 2): frame and value."""
    points = {}
    for name in ("co", "handle_left", "handle_right"):
        points[name] = np.empty((len(curve.keyframe_points), 2), dtype=np.float32)
        curve.keyframe_points.foreach_get(name, points[name].ravel())
    return points


def transferred(source: Any, target: Any) -> Any:
    """Move the action of an armature to one with the same bones; return that one.

    Their rest poses may differ in axes and scale. The source is deleted. A rig that
    Rigify generated gets the motion of its metarig on its controls.
    """
    if is_generated(target):
        return onto_controls(transferred(source, metarig_of(target)), target)
    scale = target.matrix_world.median_scale
    lengths = [_length(armature, source.data.bones) for armature in (target, source)]
    ratio = lengths[0] / lengths[1]
    curves = {(c.data_path, c.array_index): c for c in _curves(source)}
    for bone in source.pose.bones:
        moved = target.pose.bones[bone.name]
        moved.rotation_mode, moved.matrix_basis = "QUATERNION", Matrix()
        axes, wanted = (
            (a.matrix_world @ a.data.bones[bone.name].matrix_local).to_quaternion()
            for a in (source, target)
        )
        turn = np.array((wanted.inverted() @ axes).to_matrix())
        _turn(curves, bone.path_from_id("rotation_quaternion"), (1, 2, 3), turn)
        _turn(curves, bone.path_from_id("location"), (0, 1, 2), turn * ratio / scale)
    animated = target.animation_data or target.animation_data_create()
    if animated.action is not None:
        animated.action.use_fake_user = True  # so that saving the file keeps it
    animated.action = source.animation_data.action
    if hasattr(animated, "action_slot"):  # since Blender 4.4
        animated.action_slot = animated.action.slots[0]
    bpy.data.armatures.remove(source.data)
    return target


def _length(armature: Any, bones: Any) -> float:
    """Return the total length [m] of an armature's bones of these names."""
    named = [armature.data.bones[bone.name] for bone in bones if bone.parent]
    length = sum((bone.head_local - bone.parent.head_local).length for bone in named)
    return length * armature.matrix_world.median_scale


def _turn(curves: dict[Any, Any], path: str, axes: Any, matrix: Any) -> None:
    """Multiply the three curves of a vector by a matrix, and their handles."""
    three = [curves[path, axis] for axis in axes if (path, axis) in curves]
    if len(three) < 3:
        return
    points = [_points(curve) for curve in three]
    for name in points[0]:
        values = matrix @ np.stack([one[name][:, 1] for one in points])
        for curve, one, row in zip(three, points, values, strict=True):
            one[name][:, 1] = row
            curve.keyframe_points.foreach_set(name, one[name].ravel())
    for curve in three:
        curve.update()


def is_generated(armature: Any) -> bool:
    """Return True for a rig that Rigify generated from a metarig."""
    return "rig_id" in armature.data and "ORG-spine" in armature.data.bones


def metarig_of(rig: Any) -> Any:
    """Return a new armature with the bones of the metarig that a rig comes from.

    Raises ValueError if that is not the Human metarig.
    """
    names = [f"spine.{k:03}".removesuffix(".000") for k in range(7)]
    names += [name for name in _CONTROLS.values() if name not in names]
    lacks = [f"ORG-{name}" for name in names if f"ORG-{name}" not in rig.data.bones]
    lacks += [name for name in _CONTROLS if name not in rig.data.bones]
    if lacks:
        raise ValueError(f"{rig.name} lacks {lacks[0]}; generate it from Human metarig")
    armature = bpy.data.objects.new(rig.name, bpy.data.armatures.new(rig.name))
    bpy.context.scene.collection.objects.link(armature)
    armature.matrix_world = rig.matrix_world
    bones = _edited(armature)
    for before, name in zip([None, *names], names, strict=False):
        bone = original = rig.data.bones[f"ORG-{name}"]
        edited = _copied(bones, name, original)
        while (bone := bone.parent) and bone.name.removeprefix("ORG-") not in bones:
            pass
        parent = bone.name.removeprefix("ORG-") if bone else before
        edited.parent = bones[parent] if parent else None
    bpy.ops.object.mode_set(mode="OBJECT")
    return armature


def _edited(armature: Any) -> Any:
    """Return the bones of an armature in edit mode."""
    if bpy.context.mode != "OBJECT":
        bpy.ops.object.mode_set(mode="OBJECT")
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="EDIT")
    return armature.data.edit_bones


def _copied(bones: Any, name: str, bone: Any) -> Any:
    edited = bones.new(name)
    edited.head, edited.tail = bone.head_local, bone.tail_local
    edited.matrix = bone.matrix_local
    return edited


def onto_controls(metarig: Any, rig: Any) -> Any:
    """Move the action of a metarig to the controls of its rig; return the rig.

    The limbs are switched from IK to FK. The metarig is deleted.
    """
    bones = _edited(metarig)
    for control, name in _CONTROLS.items():
        axes = _copied(bones, f"to {control}", rig.data.bones[control])
        axes.parent = bones[name]
    bpy.ops.object.mode_set(mode="OBJECT")
    first, last = metarig.animation_data.action.frame_range
    if rig.animation_data is not None and rig.animation_data.action is not None:
        rig.animation_data.action.use_fake_user = True
        rig.animation_data.action = None
    bpy.ops.object.select_all(action="DESELECT")
    rig.select_set(True)
    bpy.context.view_layer.objects.active = rig
    bpy.ops.object.mode_set(mode="POSE")
    bpy.ops.pose.select_all(action="DESELECT")
    for side in "LR":
        for limb in ("upper_arm", "thigh"):
            rig.pose.bones[f"{limb}_parent.{side}"]["IK_FK"] = 1.0
    following = []
    for control in _CONTROLS:
        bone = rig.pose.bones[control]
        kind = "COPY_TRANSFORMS" if control == _TORSO else "COPY_ROTATION"
        follows = bone.constraints.new(kind)
        follows.target, follows.subtarget = metarig, f"to {control}"
        following.append((bone, follows))
        selects = bone if hasattr(bone, "select") else bone.bone  # before Blender 5
        selects.select = True
    bpy.ops.nla.bake(
        frame_start=round(first),
        frame_end=round(last),
        only_selected=True,
        visual_keying=True,
        use_current_action=True,
        bake_types={"POSE"},
        channel_types={"LOCATION", "ROTATION"},
    )
    bpy.ops.object.mode_set(mode="OBJECT")
    for bone, follows in following:
        bone.constraints.remove(follows)
    bpy.data.actions.remove(metarig.animation_data.action)
    bpy.data.armatures.remove(metarig.data)
    return rig


def show_reliability(
    armature: Any, extras: dict[str, Any], fps: float, colors: Sequence[Sequence[float]]
) -> None:
    """Color bones by mean reliability, and animate it as a property; unknown is 0."""
    packed = zlib.decompress(base64.b64decode(extras["reliability"]))
    columns = np.frombuffer(packed, "<i4").reshape(len(extras["joints"]), -1)
    shares = np.maximum(np.delete(columns.T, extras["held"], axis=0), 0.0) / 100.0
    points = np.empty((len(shares), 2), dtype=np.float32)
    points[:, 0] = (np.array(extras["time"]) - extras["time"][0]) * fps
    linear = bpy.types.Keyframe.bl_rna.properties["interpolation"].enum_items["LINEAR"]
    turned = extras["turnedBy"]
    if is_generated(armature):
        turned = {c: turned[name] for c, name in _CONTROLS.items() if name in turned}
    for name, joint in turned.items():
        bone, points[:, 1] = armature.pose.bones[name], shares[:, joint]
        mean = float(shares[:, joint].mean())
        bone["reliability"] = mean
        bone.id_properties_ui("reliability").update(min=0.0, max=1.0)
        curve = _curves(armature).new(f'{bone.path_from_id()}["reliability"]')
        curve.keyframe_points.add(len(points))
        curve.keyframe_points.foreach_set("co", points.ravel())
        kinds = np.full(len(points), linear.value)
        curve.keyframe_points.foreach_set("interpolation", kinds)
        curve.update()
        color = colors[round(mean * (len(colors) - 1))]
        bone.color.palette, bone.color.custom.normal = "CUSTOM", color
        bone.color.custom.select = [0.5 + 0.5 * share for share in color]
        bone.color.custom.active = [0.3 + 0.7 * share for share in color]
