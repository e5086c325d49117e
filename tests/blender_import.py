"""Import every USD, GLB, FBX and BVH file of a folder; save where Blender has things.

    python tests/blender_import.py FOLDER

This runs in a Python that has Blender's ``bpy``, which needs another numpy than
kinefilter. Frames to look at are in ``NAME.frames.npy``: time codes of USD, frames of
BVH and FBX counted from 0, 24 a second of GLB. Beside each file a ``NAME.npz`` is
written, in Blender's unit (meters) and axes (z up): ``names`` and ``heads`` (F, N, 3)
of the joints, armature by armature, their own axes in each frame, ``turns``
(F, N, 3, 3), and at rest, ``axes`` (N, 3, 3); of the first skinned mesh, if any,
``modifiers`` (their types), ``groups`` (vertex groups that move something), ``rest``
(P, 3) and ``moved`` (F, P, 3); and ``props`` (names) and ``places`` (F, K, 3) of
everything in ``Props``.
"""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

Array = np.ndarray


def load(path: Path) -> float:
    """Import a file and return which frame of Blender its first is."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    if path.suffix == ".bvh":
        z_up = "z_up" in path.stem
        bpy.ops.import_anim.bvh(
            filepath=str(path),
            axis_forward="Y" if z_up else "-Z",
            axis_up="Z" if z_up else "Y",
            global_scale=0.01 if "_cm" in path.stem else 1.0,
            frame_start=1,
        )
        return 1.0
    if path.suffix == ".glb":
        bpy.ops.import_scene.gltf(filepath=str(path))
    elif path.suffix == ".fbx":
        bpy.ops.import_scene.fbx(filepath=str(path))
        return 1.0
    else:
        bpy.ops.wm.usd_import(filepath=str(path))
    return 0.0


def look(path: Path) -> None:
    first = load(path)
    armatures = [o for o in bpy.data.objects if o.type == "ARMATURE"]
    armatures.sort(key=lambda armature: armature.name)
    skins = [
        o
        for o in bpy.data.objects
        if o.type == "MESH" and any(m.type == "ARMATURE" for m in o.modifiers)
    ][:1]
    props = [o for o in bpy.data.objects if o.parent and o.parent.name == "Props"]
    bones = [(a, bone) for a in armatures for bone in a.pose.bones]
    heads, turns, moved, places = [], [], [], []
    for frame in first + np.load(path.with_name(path.name + ".frames.npy")):
        whole = int(np.floor(frame))
        bpy.context.scene.frame_set(whole, subframe=float(frame - whole))
        heads.append([a.matrix_world @ b.head for a, b in bones])
        turns.append([axes_of(a, b.matrix) for a, b in bones])
        moved.extend(points_of(skin, deformed=True) for skin in skins)
        places.append([prop.matrix_world.translation.copy() for prop in props])
    np.savez(
        path.with_name(path.name + ".npz"),
        names=np.array([bone.name for _, bone in bones]),
        heads=np.array(heads),
        turns=np.array(turns),
        axes=np.array([axes_of(a, b.bone.matrix_local) for a, b in bones]),
        modifiers=np.array([m.type for s in skins for m in s.modifiers]),
        groups=len({g.group for s in skins for v in s.data.vertices for g in v.groups}),
        rest=np.array([points_of(skin, deformed=False) for skin in skins]),
        moved=np.array(moved),
        props=np.array([prop.name for prop in props]),
        places=np.array(places),
    )


def axes_of(armature: bpy.types.Object, matrix: Matrix) -> Array:
    """Return the rotation (3, 3) of a bone's axes, column by column, in the world."""
    return np.array((armature.matrix_world @ matrix).to_quaternion().to_matrix())


def points_of(skin: bpy.types.Object, *, deformed: bool) -> Array:
    shown = skin
    if deformed:
        shown = skin.evaluated_get(bpy.context.evaluated_depsgraph_get())
    flat = np.empty(3 * len(shown.data.vertices))
    shown.data.vertices.foreach_get("co", flat)
    matrix = np.array(shown.matrix_world)
    return flat.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3]


for file in sorted(Path(sys.argv[1]).glob("*.frames.npy")):
    look(file.with_name(file.name.removesuffix(".frames.npy")))
