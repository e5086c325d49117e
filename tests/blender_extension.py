"""Install the extension into Blender, use it, and save what it did.

    python tests/blender_extension.py FOLDER

This runs in a Python that has Blender's ``bpy``. In the folder are ``kinefilter.zip``,
``mixamo.glb``, somebody on that rig, and ``asked.json``: ``program``, the command line;
``take`` and ``short``, takes; ``giant``, how many times taller than people the armature
on Mixamo's rig is; ``slow``, a program that never ends and names its processes in
``pids.txt``. What Blender said is written to ``told.json``, and what it has of the
active armature, markers and texts to ``NAME.npz`` (see ``saved``), in meters, z up.
"""

from __future__ import annotations

import json
import math
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix

FOLDER = Path(sys.argv[1])
ASKED = json.loads((FOLDER / "asked.json").read_text())
MODULE = "bl_ext.user_default.kinefilter"
PATIENCE = 60.0  # s
told: dict[str, Any] = {}


def refused(name: str, **options: Any) -> None:
    try:
        told[name] = [*bpy.ops.kinefilter.clean(**options)]
    except RuntimeError as error:
        told[name] = str(error)


def empty() -> Any:
    """Return a scene without anything."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=False)
    return bpy.context.scene


def saved(name: str) -> None:
    """Save where the active armature's bones are in the scene's frames."""
    scene, armature = bpy.context.scene, bpy.context.active_object
    bones, action = armature.pose.bones, armature.animation_data.action
    heads, shares = [], []
    rest = [armature.matrix_world @ bone.bone.head_local for bone in bones]
    for frame in range(scene.frame_start, scene.frame_end + 1):
        scene.frame_set(frame)
        heads.append([armature.matrix_world @ bone.head for bone in bones])
        shares.append([bone.get("reliability", math.nan) for bone in bones])
    np.savez(
        FOLDER / f"{name}.npz",
        names=[bone.name for bone in bones],
        parents=[bones.find(b.parent.name) if b.parent else -1 for b in bones],
        rest=np.array(rest),
        heads=np.array(heads),
        shares=np.array(shares),
        colors=np.array([bone.color.custom.normal for bone in bones]),
        colored=[bone.color.palette == "CUSTOM" for bone in bones],
        frames=sorted({k.co[0] for c in curves(action) for k in c.keyframe_points}),
        rate=scene.render.fps / scene.render.fps_base,
        objects=[thing.type for thing in bpy.data.objects],
        markers=[marker.name for marker in scene.timeline_markers],
        marked=[marker.frame for marker in scene.timeline_markers],
        text=[text.as_string() for text in bpy.data.texts],
    )


def curves(action: Any) -> Any:
    if hasattr(action, "fcurves"):
        return action.fcurves
    return action.layers[0].strips[0].channelbags[0].fcurves


def somebody_of_mixamo() -> None:
    """Import them as Blender does Mixamo's FBX, in centimeters and turned: a giant."""
    bpy.ops.import_scene.gltf(
        filepath=str(FOLDER / "mixamo.glb"), disable_bone_shape=True
    )
    (armature,) = [o for o in bpy.data.objects if o.type == "ARMATURE"]
    armature.animation_data_clear()
    for bone in armature.pose.bones:
        bone.matrix_basis = Matrix()
    turn = Matrix.Rotation(math.pi / 2.0, 4, "X")
    armature.data.transform(turn.inverted() @ Matrix.Scale(100.0, 4))
    size = Matrix.Scale(0.01 * ASKED["giant"], 4)
    armature.matrix_world = Matrix.Translation((1, 2, 0)) @ turn @ size
    bpy.context.view_layer.objects.active = armature
    bpy.context.view_layer.update()


class Windows:
    """A context with what only windows have; Blender has none without a screen."""

    def __init__(self) -> None:
        self.shown: list[str | None] = []
        self.window_manager = self.workspace = self
        self.handlers, self.timers = [], []
        self.modal_handler_add = self.handlers.append
        self.event_timer_remove = self.timers.remove
        self.status_text_set = self.shown.append

    def event_timer_add(self, step: float, *, window: Any) -> float:
        del window
        self.timers.append(step)
        return step

    def __getattr__(self, name: str) -> Any:
        return getattr(bpy.context, name)


def begun(take: str, **options: Any) -> tuple[Any, Windows]:
    """Return the operator as Blender begins it for people, and its windows."""
    operator, windows = sys.modules[MODULE].KINEFILTER_OT_clean, Windows()
    methods = {n: v for n, v in vars(operator).items() if callable(v)}
    made = type("Operator", (), methods)()
    known = {"rig": "OWN", "onto": False, "rate": "TAKE", "physics": True, "body": 0}
    vars(made).update(known | {"options": "", "filepath": take} | options)
    made.report = lambda _, words: windows.shown.append(words)
    assert made.invoke(windows, None) == {"RUNNING_MODAL"}
    assert windows.handlers == [made]
    return made, windows


def event(kind: str) -> SimpleNamespace:
    return SimpleNamespace(type=kind)


def preferences() -> Any:
    return bpy.context.preferences.addons[MODULE].preferences


package = str(FOLDER / "kinefilter.zip")
bpy.ops.extensions.package_install_files(
    filepath=package, repo="user_default", enable_on_install=True
)
told["installed"] = MODULE in bpy.context.preferences.addons
for _ in range(2):
    bpy.ops.preferences.addon_disable(module=MODULE)
    told["left"] = hasattr(bpy.types, "KINEFILTER_OT_clean")
    bpy.ops.preferences.addon_enable(module=MODULE)
told["again"] = hasattr(bpy.types, "KINEFILTER_OT_clean")
preferences().program = str(FOLDER / "absent")
refused("no program", filepath=ASKED["take"])
preferences().program = ASKED["program"]
empty()
refused("no take", filepath=str(FOLDER / "absent.csv"))
refused("no armature", filepath=ASKED["short"], onto=True, rig="mixamo")
refused("wrong option", filepath=ASKED["short"], options="--cutoff -3")
refused("wrong quotes", filepath=ASKED["short"], options="--cutoff '3")
elsewhere = f"-o '{FOLDER / 'elsewhere.glb'}'"
refused("elsewhere", filepath=ASKED["short"], options=elsewhere)
told["objects"] = len(bpy.data.objects)
refused("own", filepath=ASKED["take"])
saved("own")

scene = empty()
scene.render.fps, scene.render.fps_base = 24, 1.001
bpy.ops.kinefilter.choose(filepath=ASKED["short"], rig="rigify", rate="SCENE")
scene.frame_start, scene.frame_end = 0, 45
saved("slower")

empty()
somebody_of_mixamo()
refused("no rig", filepath=ASKED["short"], onto=True)
refused("other rig", filepath=ASKED["short"], onto=True, rig="rigify")
refused("mixamo", filepath=ASKED["short"], onto=True, rig="mixamo")
saved("mixamo")

empty()
bpy.ops.preferences.addon_enable(module="rigify")
bpy.ops.object.armature_human_metarig_add()
operator, windows = begun(ASKED["short"], onto=True, rig="rigify")
end, state = time.monotonic() + PATIENCE, {"RUNNING_MODAL"}
while state == {"RUNNING_MODAL"} and time.monotonic() < end:
    time.sleep(0.05)
    told["meanwhile"] = [*operator.modal(windows, event("MOUSEMOVE"))]
    state = operator.modal(windows, event("TIMER"))
told["rigify"] = [*state]
told["shown"] = windows.shown, windows.timers
saved("rigify")

metarig = bpy.context.active_object
metarig.animation_data_clear()
for bone in metarig.pose.bones:  # Rigify keeps the pose of some
    bone.matrix_basis = Matrix()
bpy.ops.pose.rigify_generate()
(rig,) = {o for o in bpy.data.objects if o.type == "ARMATURE"} - {metarig}
bpy.ops.object.select_all(action="DESELECT")
bpy.context.view_layer.objects.active = rig
refused("controls", filepath=ASKED["short"], onto=True, rig="rigify")
bpy.data.armatures.remove(metarig.data)
saved("controls")
bpy.context.active_object.data.bones["ORG-hand.L"].name = "lost"
refused("no metarig", filepath=ASKED["short"], onto=True, rig="rigify")

preferences().program = ASKED["slow"]
operator, windows = begun(ASKED["short"])
end = time.monotonic() + PATIENCE
pids = FOLDER / "pids.txt"
while time.monotonic() < end and not (pids.is_file() and "\n" in pids.read_text()):
    assert operator.modal(windows, event("TIMER")) == {"RUNNING_MODAL"}
    time.sleep(0.02)
told["cancelled"] = [*operator.modal(windows, event("ESC"))], windows.timers
(FOLDER / "told.json").write_text(json.dumps(told))
