"""Convert ``clip.glb`` to ``clip.fbx``; this runs in Blender, without kinefilter.

    blender --background --python blender_fbx.py -- FOLDER FRAMES RATE IMPORTED

FBX has y up and centimeters, as most programs expect. The GLB has IMPORTED keyframes/s,
so that each is one of Blender's frames; the FBX gets RATE frames/s. When standard input
ends, the caller is gone: the folder is removed.
"""

import math
import os
import shutil
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

_CENTIMETERS = 100.0  # per meter
_AT_REST = -10  # frame, before all that are written, with the bones in rest pose


def _watch(folder: str) -> None:
    os.read(0, 1)
    shutil.rmtree(folder, ignore_errors=True)
    os._exit(1)


def _main(folder: str, frames: int, rate: float, imported: int) -> None:
    threading.Thread(target=_watch, args=(folder,), daemon=True).start()
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.fps = imported
    glb = str(Path(folder, "clip.glb"))
    bpy.ops.import_scene.gltf(filepath=glb, bone_heuristic="BLENDER")  # keeps axes
    _to_centimeters(bpy)
    scene.unit_settings.scale_length = 1.0 / _CENTIMETERS
    scene.frame_start, scene.frame_end = 0, frames - 1
    scene.frame_set(_AT_REST)  # the FBX takes its rest pose from here
    scene.render.fps = max(round(rate), 1)
    scene.render.fps_base = scene.render.fps / rate
    half = Path(folder, "half.fbx")
    bpy.ops.export_scene.fbx(
        filepath=str(half),
        object_types={"ARMATURE", "EMPTY", "MESH"},
        use_visible=True,  # without the hidden shapes of bones
        use_space_transform=False,
        add_leaf_bones=False,
        bake_anim_use_nla_strips=False,
        bake_anim_use_all_actions=False,
        bake_anim_simplify_factor=0.0,
    )
    half.rename(half.with_name("clip.fbx"))


def _to_centimeters(bpy: Any) -> None:
    """Turn and scale everything, so that the scene has the numbers of the FBX."""
    from mathutils import Matrix

    scale = Matrix.Scale(_CENTIMETERS, 4)
    turn = Matrix.Rotation(-math.pi / 2.0, 4, "X")
    for obj in bpy.data.objects:
        if obj.type == "ARMATURE":
            # Unreal treats an armature with any other name as a bone.
            obj.name = "Armature"
            # FBX names the animation after the scene.
            bpy.context.scene.name = obj.animation_data.nla_tracks[0].name
            obj.data.transform(turn @ scale)
            obj.data.update_tag()
        elif obj.type == "MESH":
            skinned = any(m.type == "ARMATURE" for m in obj.modifiers)
            obj.data.transform(turn @ scale if skinned else scale)
        elif obj.parent is None or obj.parent.type == "ARMATURE":
            obj.matrix_basis = turn @ obj.matrix_basis
        obj.location *= _CENTIMETERS
    for curve in _curves(bpy):
        if curve.data_path.endswith("location"):
            for key in curve.keyframe_points:
                for point in (key.co, key.handle_left, key.handle_right):
                    point[1] *= _CENTIMETERS
        if curve.data_path.startswith("pose.bones"):
            first = curve.array_index == 0 and curve.data_path.endswith("quaternion")
            still = float(first or curve.data_path.endswith("scale"))
            curve.keyframe_points.insert(_AT_REST, still)


def _curves(bpy: Any) -> Iterator[Any]:
    for action in bpy.data.actions:
        if hasattr(action, "fcurves"):  # up to Blender 4
            yield from action.fcurves
            continue
        for layer in action.layers:
            for strip in layer.strips:
                for bag in strip.channelbags:
                    yield from bag.fcurves


if __name__ == "__main__":
    folder, frames, rate, imported = sys.argv[sys.argv.index("--") + 1 :]
    _main(folder, int(frames), float(rate), int(imported))
