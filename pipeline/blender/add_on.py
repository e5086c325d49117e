"""Clean Kinect takes from within Blender; this runs there, without kinefilter.

The installed command line does the work in a process of its own; what it writes is
imported, or brought onto the active armature.
"""

# mypy: disable-error-code="misc, valid-type"
# ruff: noqa: N801 - Blender wants such names of classes

from __future__ import annotations

import json
import os
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import textwrap
import time
from collections.abc import Generator
from contextlib import suppress
from pathlib import Path
from typing import Any

import bpy
from bpy_extras.io_utils import ImportHelper

from . import armatures

_KNOWN = json.loads(Path(__file__).with_name("known.json").read_text(encoding="utf-8"))
_OWN = "OWN"
_TICK = 0.1  # s
_NEAR = 0.005  # a rate this near to a whole number is one
_LONGEST = 63  # letters of a marker's name


class _RefusedError(Exception):
    """What the user should know, in words."""


def _ran(
    program: str, arguments: list[str], folder: Path
) -> Generator[None, None, str]:
    """Run the command line, yield until it has ended, and return what it printed.

    It is killed, with all that it began, if nobody goes on. Its temporary files are in
    the folder.
    """
    found = shutil.which(program)
    if found is None:
        raise _RefusedError(
            f"{program}: no such program; install kinefilter into a Python of its own "
            "and name its program in the preferences of this add-on"
        )
    printed, complaint = folder / "printed.txt", folder / "complaint.txt"
    temporary = dict.fromkeys(("TMPDIR", "TEMP", "TMP"), str(folder))
    with printed.open("wb") as out, complaint.open("wb") as err:
        try:
            process = subprocess.Popen(
                [found, *arguments],
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=err,
                env=os.environ | temporary | {"PYTHONUTF8": "1"},
                start_new_session=True,  # a group to kill; on Windows nothing
                creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
            )
        except OSError as error:
            raise _RefusedError(f"{found}: cannot be run ({error})") from None
    try:
        while process.poll() is None:
            yield
    finally:
        if process.poll() is None:
            _kill(process)
    if process.returncode != 0:
        said = complaint.read_text("utf-8", "replace").strip().splitlines()
        told = said[-1] if said else f"{found}: ended with {process.returncode}"
        told = told.removeprefix("kinefilter: ").replace(f"{folder}{os.sep}", "")
        raise _RefusedError(told)
    return printed.read_text("utf-8")


def _kill(process: subprocess.Popen[bytes]) -> None:
    if sys.platform == "win32":
        tree = ["taskkill", "/T", "/F", "/PID", str(process.pid)]
        subprocess.run(tree, capture_output=True, check=False)
    else:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def _rate(info: dict[str, Any], body: int) -> float:
    """Return the frame rate [1/s] of a take, the whole one that its stamps mean."""
    people = info.get("bodies", ())
    (rate,) = [
        one["fps"]
        for one in people
        if (one["body"] == body if body else one["most_seen"])
    ] or [None]
    near = rate and abs(rate - round(rate)) <= _NEAR * rate
    return float(round(rate) if near else rate or 30.0)


class _Options:
    """What can be chosen for a take."""

    rig: bpy.props.EnumProperty(
        name="Rig",
        description="Whose bones a new armature has; of the active one, whose names",
        items=[(_OWN, "Sensor's joints", "With skin and props")]
        + [(name, name, "") for name in _KNOWN["rigs"]],
    )
    onto: bpy.props.BoolProperty(
        name="Onto Active Armature",
        description="Bring the motion onto the active armature, whose bones have the "
        "names of the rig",
    )
    rate: bpy.props.EnumProperty(
        name="Frame Rate",
        items=[
            ("TAKE", "Take's", "Set the scene's frame rate and range to the take's"),
            ("SCENE", "Scene's", "Leave the scene's frame rate and range as they are"),
        ],
    )
    physics: bpy.props.BoolProperty(
        name="Physics", default=True, description="Pull a simulated character along"
    )
    body: bpy.props.IntProperty(
        name="Body",
        min=0,
        description="Which person of the take, counted from 1; 0: who is seen in most "
        "frames",
    )
    options: bpy.props.StringProperty(
        name="Options",
        description="More options of 'kinefilter clean', such as --method local-pca "
        "--loop",
    )


class KINEFILTER_OT_clean(bpy.types.Operator, _Options):
    """Clean a Kinect take and bring it onto an armature; Esc cancels."""

    bl_idname = "kinefilter.clean"
    bl_label = "Clean Kinect Take"
    bl_options = {"UNDO"}  # noqa: RUF012 - Blender reads it

    filepath: bpy.props.StringProperty(name="Take", subtype="FILE_PATH")

    def execute(self, context: Any) -> set[str]:
        """Clean, and wait for it."""
        work = self._work(context)
        while (done := self._advance(work)) is None:
            time.sleep(_TICK / 4.0)
        return done

    def invoke(self, context: Any, event: Any) -> set[str]:
        """Clean while Blender goes on."""
        del event
        manager = context.window_manager
        self._running, self._begun = self._work(context), time.monotonic()
        self._timer = manager.event_timer_add(_TICK, window=context.window)
        manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: Any, event: Any) -> set[str]:
        """Look whether it is done."""
        if event.type == "ESC":
            self.cancel(context)
            self.report({"INFO"}, "kinefilter: cancelled")
            return {"CANCELLED"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        name, seconds = Path(self.filepath).name, time.monotonic() - self._begun
        told = f"kinefilter cleans {name}: {seconds:.0f} s (Esc cancels)"
        context.workspace.status_text_set(told)
        done = self._advance(self._running)
        if done is not None:
            self.cancel(context)
        return done or {"RUNNING_MODAL"}

    def cancel(self, context: Any) -> None:
        """End the process and leave nothing behind."""
        self._running.close()
        context.window_manager.event_timer_remove(self._timer)
        context.workspace.status_text_set(None)

    def _advance(self, work: Generator[None, None, None]) -> set[str] | None:
        """Return how the work ended, None if it goes on."""
        try:
            next(work)
        except StopIteration:
            return {"FINISHED"}
        except (_RefusedError, OSError, RuntimeError, ValueError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return None

    def _work(self, context: Any) -> Generator[None, None, None]:
        """Clean and import; yield while the command line runs."""
        target = context.active_object if self.onto else None
        if self.onto and (target is None or target.type != "ARMATURE"):
            raise _RefusedError("no armature is active; select one")
        if target is not None and not target.data.bones:
            raise _RefusedError(f"{target.name}: this armature has no bones")
        if self.onto and self.rig not in _KNOWN["targets"]:
            rigs = ", ".join(_KNOWN["targets"])
            raise _RefusedError(f"choose the rig whose names the bones have: {rigs}")
        program = context.preferences.addons[__package__].preferences.program
        take = Path(bpy.path.abspath(self.filepath))
        with tempfile.TemporaryDirectory(prefix="kinefilter-") as name:
            folder = Path(name)
            clip, figures, rest = (
                folder / file for file in ("clip.glb", "figures.json", "armature.bvh")
            )
            fps = context.scene.render.fps / context.scene.render.fps_base
            if self.rate == "TAKE":
                info = yield from _ran(program, ["info", "--json", str(take)], folder)
                fps = _rate(json.loads(info), self.body)
            command = ["clean", str(take), "-o", str(clip), "--fps", repr(fps)]
            command += ["--json", str(figures)]
            command += [] if self.physics else ["--no-physics"]
            command += ["--body", str(self.body)] if self.body else []
            command += [] if self.rig == _OWN else ["--rig", self.rig]
            if target is not None:
                called = target.name
                text = armatures.rest_pose(target)
                rest.write_text(text, encoding="utf-8", newline="\n")
                command += ["--target", str(rest)]
            command += shlex.split(self.options)
            said = yield from _ran(program, command, folder)
            known = armatures.extras(clip) if clip.is_file() else {}
            if "turnedBy" not in known:
                raise _RefusedError(
                    f"{self.options}: the clip is not one of one person; leave out "
                    "-o, --body all, --one-file and --gaps split"
                )
            if target is not None and (target := bpy.data.objects.get(called)) is None:
                raise _RefusedError(f"{called}: this armature is gone")
            found = json.loads(figures.read_text("utf-8"))
            armature = armatures.imported(context, clip, fps, own=self.rig == _OWN)
        if target is not None:
            armature = armatures.brought(armature, target)
        else:
            armature.name = take.stem
        scene, first, last = context.scene, known["time"][0], known["time"][-1]
        if self.rate == "TAKE":
            scene.render.fps = max(round(fps), 1)
            scene.render.fps_base = scene.render.fps / fps
            scene.frame_start, scene.frame_end = 0, round((last - first) * fps)
        armatures.show_reliability(armature, known, fps, _KNOWN["colors"])
        for time_stamp, words in _events(found):
            if first <= time_stamp <= last:
                frame = round((time_stamp - first) * fps)
                scene.timeline_markers.new(words, frame=frame)
        bpy.data.texts.new(take.name).from_string(said)  # failures in full, figures
        bpy.ops.object.select_all(action="DESELECT")
        armature.select_set(True)
        context.view_layer.objects.active = armature
        failures = len(found["failures"])
        told = f"{take.name}: {found['frames']} frames, {failures} failures"
        self.report({"INFO"}, "; ".join([told, *found["notes"]]))


def _events(figures: dict[str, Any]) -> list[tuple[float, str]]:
    """Return when [s] failures and gaps begin and end, and words for markers."""
    told = [(gap, "no frames", "") for gap in figures["gaps"]]
    for one in figures["failures"]:
        what = f"{one['part']} {one['kind'].replace('_', ' ')}"
        told.append((one, what, f": {one['done']}"))
    return [
        (one[key], textwrap.shorten(what + more, _LONGEST, placeholder="..."))
        for one, what, done in told
        for key, more in (("start_s", done), ("end_s", " ends"))
    ]


class KINEFILTER_OT_choose(bpy.types.Operator, ImportHelper, _Options):
    """Choose a Kinect take, clean it, and bring it onto an armature."""

    bl_idname = "kinefilter.choose"
    bl_label = "Clean Kinect Take"

    def execute(self, context: Any) -> set[str]:
        """Begin to clean."""
        del context
        bpy.ops.kinefilter.clean("INVOKE_DEFAULT", **self.as_keywords())
        return {"FINISHED"}


class KINEFILTER_PT_panel(bpy.types.Panel):
    """Buttons in the 3D view's sidebar."""

    bl_label = "kinefilter"
    bl_category = "kinefilter"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"

    def draw(self, context: Any) -> None:
        """Draw them."""
        name, active = KINEFILTER_OT_choose.bl_idname, context.active_object
        self.layout.operator(name, text="Clean a Take").onto = False
        if active is not None and active.type == "ARMATURE":
            self.layout.operator(name, text=f"Clean onto {active.name}").onto = True
        self.layout.label(text="Bones: from red, doubtful, to blue, reliable")


class KINEFILTER_preferences(bpy.types.AddonPreferences):
    """Where the command line is."""

    bl_idname = __package__

    program: bpy.props.StringProperty(
        name="Program",
        description="The command line: its path, or its name if the shell finds it",
        subtype="FILE_PATH",
        default="kinefilter",
    )

    def draw(self, context: Any) -> None:
        """Draw it."""
        del context
        self.layout.prop(self, "program")


def _draw_menu(menu: Any, context: Any) -> None:
    del context
    name = KINEFILTER_OT_choose.bl_idname
    menu.layout.operator(name, text="Kinect take (kinefilter)").onto = False


_CLASSES = (
    KINEFILTER_preferences,
    KINEFILTER_OT_clean,
    KINEFILTER_OT_choose,
    KINEFILTER_PT_panel,
)


def register() -> None:
    """Add everything to Blender."""
    for kind in _CLASSES:
        bpy.utils.register_class(kind)
    bpy.types.TOPBAR_MT_file_import.append(_draw_menu)


def unregister() -> None:
    """Take it away again."""
    bpy.types.TOPBAR_MT_file_import.remove(_draw_menu)
    for kind in reversed(_CLASSES):
        bpy.utils.unregister_class(kind)
