"""Draw the bones of an FBX in one frame as Blender shows them; run by ``tools.py``.

    python tests/pictures/blender_bones.py clip.fbx FRAME OUT.png WIDTH HEIGHT

This runs in a Python that has Blender's ``bpy``. Without a screen Blender draws no
bones, so that each becomes a mesh of the same shape.
"""

from __future__ import annotations

import sys

import bpy
from mathutils import Matrix, Vector

BONE = [(0, 0, 0), (1, 1, 1), (1, 1, -1), (-1, 1, -1), (-1, 1, 1), (0, 8, 0)]
SIDES = [(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 1), (5, 2, 1), (5, 3, 2), (5, 4, 3)]
SIDES += [(5, 1, 4)]


def material(name: str, color: tuple[float, float, float]) -> bpy.types.Material:
    found = bpy.data.materials.new(name)
    found.use_nodes = True
    found.node_tree.nodes["Principled BSDF"].inputs[0].default_value = (*color, 1.0)
    return found


def thing(name: str, data: object) -> bpy.types.Object:
    found = bpy.data.objects.new(name, data)
    bpy.context.scene.collection.objects.link(found)
    return found


def main(fbx: str, frame: str, out: str, width: str, height: str) -> None:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.fbx(filepath=fbx)
    scene = bpy.context.scene
    scene.frame_set(int(frame))
    (armature,) = [o for o in bpy.data.objects if o.type == "ARMATURE"]
    mesh = bpy.data.meshes.new("bone")
    mesh.from_pydata([Vector(point) / 8.0 for point in BONE], [], SIDES)
    mesh.materials.append(material("bone", (0.7, 0.16, 0.01)))
    for bone in armature.pose.bones:
        place = armature.matrix_world @ bone.matrix
        thing(bone.name, mesh).matrix_world = place @ Matrix.Scale(bone.length, 4)
    bpy.ops.mesh.primitive_plane_add(size=40)
    bpy.context.object.data.materials.append(material("floor", (0.6, 0.62, 0.65)))
    camera, sun = bpy.data.cameras.new("camera"), bpy.data.lights.new("sun", "SUN")
    camera.lens, sun.energy = 50, 3
    hips = armature.matrix_world @ armature.pose.bones[0].head
    scene.camera = thing("camera", camera)
    scene.camera.location = (hips.x - 1.5, hips.y + 3.6, 1.5)
    away = Vector((hips.x, hips.y, 0.95)) - scene.camera.location
    scene.camera.rotation_euler = away.to_track_quat("-Z", "Y").to_euler()
    thing("sun", sun).rotation_euler = (-0.7, 0.3, 0.4)
    scene.world = bpy.data.worlds.new("world")
    scene.world.use_nodes = True
    sky = scene.world.node_tree.nodes["Background"].inputs[0]
    sky.default_value = (0.5, 0.52, 0.55, 1.0)
    scene.render.engine, scene.cycles.samples = "CYCLES", 64
    scene.render.resolution_x, scene.render.resolution_y = int(width), int(height)
    scene.render.filepath = out
    bpy.ops.render.render(write_still=True)


main(*sys.argv[1:])
