"""Blender add-on that cleans Kinect takes; it runs in Blender, without kinefilter.

The installed command line does the work in a separate process. The add-on imports the
clip as a new armature, or transfers its motion to the active armature.
"""

# mypy: disable-error-code="misc, valid-type"
# ruff: noqa: N801 - Blender requires such class names

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

_DATA = json.loads(Path(__file__).with_name("known.json").read_text(encoding="utf-8"))
_OWN = "OWN"
_TICK = 0.1  # s
_RATE_TOLERANCE = 0.005  # relative; time stamps jitter
_LONGEST_NAME = 63  # characters of a marker's name


class _UserError(Exception):
    """An error whose message is shown to the user."""


def _run(program: str, args: list[str], folder: Path) -> Generator[None, None, str]:
    """Run the command line, yield until it has ended, and return what it printed.

    Closing the generator kills the process and its children. Temporary files are in
    ``folder``.
    """
    executable = shutil.which(program)
    if executable is None:
        raise _UserError(
            f"{program}: no such program; install kinefilter in a Python environment "
            "of its own, and enter its program in the preferences of this add-on"
        )
    output, errors = folder / "output.txt", folder / "errors.txt"
    temporary = dict.fromkeys(("TMPDIR", "TEMP", "TMP"), str(folder))
    with output.open("wb") as out, errors.open("wb") as err:
        try:
            process = subprocess.Popen(
                [executable, *args],
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=err,
                env=os.environ | temporary | {"PYTHONUTF8": "1"},
                start_new_session=True,  # a group to kill; no effect on Windows
                creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
            )
        except OSError as error:
            raise _UserError(f"{executable}: cannot be run ({error})") from None
    try:
        while process.poll() is None:
            yield
    finally:
        if process.poll() is None:
            _kill(process)
    if process.returncode != 0:
        lines = errors.read_text("utf-8", "replace").strip().splitlines()
        message = (lines or [f"{executable}: exit code {process.returncode}"])[-1]
        message = message.removeprefix("kinefilter: ").replace(f"{folder}{os.sep}", "")
        raise _UserError(message)
    return output.read_text("utf-8")


def _kill(process: subprocess.Popen[bytes]) -> None:
    if sys.platform == "win32":
        tree = ["taskkill", "/T", "/F", "/PID", str(process.pid)]
        subprocess.run(tree, capture_output=True, check=False)
    else:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def _rate(info: dict[str, Any], body: int) -> float:
    """Return the frame rate [1/s] of a take, rounded if it is nearly a whole number."""
    for person in info.get("bodies", ()):
        if (person["body"] == body if body else person["most_seen"]) and person["fps"]:
            rate = float(person["fps"])
            near = abs(rate - round(rate)) <= _RATE_TOLERANCE * rate
            return float(round(rate)) if near else rate
    return 30.0


class _Options:
    rig: bpy.props.EnumProperty(
        name="Rig",
        description="Skeleton of the new armature, or the rig whose bone names the "
        "active armature has",
        items=[(_OWN, "Sensor's joints", "With skin and props")]
        + [(name, name, "") for name in _DATA["rigs"]],
    )
    onto: bpy.props.BoolProperty(
        name="Onto Active Armature",
        description="Retarget the motion to the active armature instead of creating a "
        "new one. Its bones must have the names of the rig, or it is a rig that Rigify "
        "generated, whose limbs are switched to FK",
    )
    rate: bpy.props.EnumProperty(
        name="Frame Rate",
        items=[
            ("TAKE", "Take's", "Set the scene's frame rate and range to the take's"),
            ("SCENE", "Scene's", "Keep the scene's frame rate and range"),
        ],
    )
    physics: bpy.props.BoolProperty(
        name="Physics",
        default=True,
        description="Have a physically simulated character follow the motion",
    )
    body: bpy.props.IntProperty(
        name="Body",
        min=0,
        description="Number of the person, from 1; 0 is the person seen in most frames",
    )
    options: bpy.props.StringProperty(
        name="Options",
        description="More options of 'kinefilter clean', such as --method local-pca "
        "--loop",
    )


class KINEFILTER_OT_clean(bpy.types.Operator, _Options):
    """Clean a Kinect take and import it as an animated armature; Esc cancels."""

    bl_idname = "kinefilter.clean"
    bl_label = "Clean Kinect Take"
    bl_options = {"UNDO"}  # noqa: RUF012 - Blender reads it

    filepath: bpy.props.StringProperty(name="Take", subtype="FILE_PATH")

    def execute(self, context: Any) -> set[str]:
        """Clean the take and wait until it is done."""
        work = self._work(context)
        while (done := self._advance(work)) is None:
            time.sleep(_TICK / 4.0)
        return done

    def invoke(self, context: Any, _event: Any) -> set[str]:
        """Start cleaning in the background."""
        manager = context.window_manager
        self._running, self._start = self._work(context), time.monotonic()
        self._timer = manager.event_timer_add(_TICK, window=context.window)
        manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: Any, event: Any) -> set[str]:
        """Show the progress, and finish once cleaning is done."""
        if event.type == "ESC":
            self.cancel(context)
            self.report({"INFO"}, "kinefilter: canceled")
            return {"CANCELLED"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        name, seconds = Path(self.filepath).name, time.monotonic() - self._start
        status = f"kinefilter: cleaning {name}, {seconds:.0f} s (Esc to cancel)"
        context.workspace.status_text_set(status)
        done = self._advance(self._running)
        if done is not None:
            self.cancel(context)
        return done or {"RUNNING_MODAL"}

    def cancel(self, context: Any) -> None:
        """Stop the process, and remove the timer, status and temporary files."""
        self._running.close()
        context.window_manager.event_timer_remove(self._timer)
        context.workspace.status_text_set(None)

    def _advance(self, work: Generator[None, None, None]) -> set[str] | None:
        """Return how the work ended, or None while it is running."""
        try:
            next(work)
        except StopIteration:
            return {"FINISHED"}
        except (_UserError, OSError, RuntimeError, ValueError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return None

    def _work(self, context: Any) -> Generator[None, None, None]:
        """Clean the take and import the clip; yield while the command line runs."""
        target = context.active_object if self.onto else None
        if self.onto and (target is None or target.type != "ARMATURE"):
            raise _UserError("no armature is active; select one")
        if target is not None and not target.data.bones:
            raise _UserError(f"{target.name}: this armature has no bones")
        if self.onto and self.rig not in _DATA["targets"]:
            rigs = ", ".join(_DATA["targets"])
            raise _UserError(f"choose the rig whose names the bones have: {rigs}")
        program = context.preferences.addons[__package__].preferences.program
        take = Path(bpy.path.abspath(self.filepath))
        with tempfile.TemporaryDirectory(prefix="kinefilter-") as name:
            folder = Path(name)
            clip, summary = folder / "clip.glb", folder / "figures.json"
            fps = context.scene.render.fps / context.scene.render.fps_base
            if self.rate == "TAKE":
                info = yield from _run(program, ["info", "--json", str(take)], folder)
                fps = _rate(json.loads(info), self.body)
            command = ["clean", str(take), "-o", str(clip), "--json", str(summary)]
            command += ["--fps", repr(fps)]
            command += [] if self.physics else ["--no-physics"]
            command += ["--body", str(self.body)] if self.body else []
            command += [] if self.rig == _OWN else ["--rig", self.rig]
            if target is not None:
                target_name, rest = target.name, folder / "armature.bvh"
                text = armatures.rest_pose(target)
                rest.write_text(text, encoding="utf-8", newline="\n")
                command += ["--target", str(rest)]
            command += shlex.split(self.options)
            printed = yield from _run(program, command, folder)
            extras = armatures.extras(clip) if clip.is_file() else {}
            if "turnedBy" not in extras:
                raise _UserError(
                    f"{self.options}: this does not write one clip of one person; "
                    "leave out -o, --body all, --one-file and --gaps split"
                )
            if target is not None and target_name not in bpy.data.objects:
                raise _UserError(f"{target_name}: this armature was removed meanwhile")
            figures = json.loads(summary.read_text("utf-8"))
            armature = armatures.imported(context, clip, fps, own=self.rig == _OWN)
        if target is None:
            armature.name = take.stem
        else:  # by name, as undo in the meantime may have replaced the object
            target = bpy.data.objects[target_name]
            armature = armatures.transferred(armature, target)
        scene, first, last = context.scene, extras["time"][0], extras["time"][-1]
        if self.rate == "TAKE":
            scene.render.fps = max(round(fps), 1)
            scene.render.fps_base = scene.render.fps / fps
            scene.frame_start, scene.frame_end = 0, round((last - first) * fps)
        armatures.show_reliability(armature, extras, fps, _DATA["colors"])
        for time_stamp, label in _events(figures):
            if first <= time_stamp <= last:
                frame = round((time_stamp - first) * fps)
                scene.timeline_markers.new(label, frame=frame)
        bpy.data.texts.new(take.name).from_string(printed)  # all failures and figures
        bpy.ops.object.select_all(action="DESELECT")
        armature.select_set(True)
        context.view_layer.objects.active = armature
        failures = len(figures["failures"])
        summary_line = f"{take.name}: {figures['frames']} frames, {failures} failures"
        self.report({"INFO"}, "; ".join([summary_line, *figures["notes"]]))


def _events(figures: dict[str, Any]) -> list[tuple[float, str]]:
    """Return the times [s] at which failures and gaps begin and end, with labels."""
    spans = [(gap, "no frames", "") for gap in figures["gaps"]]
    for failure in figures["failures"]:
        label = f"{failure['part']} {failure['kind'].replace('_', ' ')}"
        spans.append((failure, label, f": {failure['done']}"))
    return [
        (span[key], textwrap.shorten(label + more, _LONGEST_NAME, placeholder="..."))
        for span, label, done in spans
        for key, more in (("start_s", done), ("end_s", " ends"))
    ]


class KINEFILTER_OT_choose(bpy.types.Operator, ImportHelper, _Options):
    """Choose a Kinect take, clean it, and import it as an animated armature."""

    bl_idname = "kinefilter.choose"
    bl_label = "Clean Kinect Take"

    def execute(self, _context: Any) -> set[str]:
        """Start cleaning the chosen take."""
        bpy.ops.kinefilter.clean("INVOKE_DEFAULT", **self.as_keywords())
        return {"FINISHED"}


class KINEFILTER_PT_panel(bpy.types.Panel):
    """Panel in the sidebar of the 3D view."""

    bl_label = "kinefilter"
    bl_category = "kinefilter"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"

    def draw(self, context: Any) -> None:
        """Draw the buttons."""
        name, active = KINEFILTER_OT_choose.bl_idname, context.active_object
        self.layout.operator(name, text="Clean a Take").onto = False
        if active is not None and active.type == "ARMATURE":
            self.layout.operator(name, text=f"Clean onto {active.name}").onto = True
        self.layout.label(text="Bone colors: red is unreliable, blue is reliable")


class KINEFILTER_preferences(bpy.types.AddonPreferences):
    """Preferences: where the command line is installed."""

    bl_idname = __package__

    program: bpy.props.StringProperty(
        name="Program",
        description="Path of the kinefilter command, or its name if it is on the PATH",
        subtype="FILE_PATH",
        default="kinefilter",
    )

    def draw(self, _context: Any) -> None:
        """Draw the preferences."""
        self.layout.prop(self, "program")


def _draw_menu(menu: Any, _context: Any) -> None:
    name = KINEFILTER_OT_choose.bl_idname
    menu.layout.operator(name, text="Kinect take (kinefilter)").onto = False


_register_classes, _unregister_classes = bpy.utils.register_classes_factory(
    (
        KINEFILTER_preferences,
        KINEFILTER_OT_clean,
        KINEFILTER_OT_choose,
        KINEFILTER_PT_panel,
    )
)


def register() -> None:
    """Register the add-on's classes and its menu entry with Blender."""
    _register_classes()
    bpy.types.TOPBAR_MT_file_import.append(_draw_menu)


def unregister() -> None:
    """Remove the menu entry and the classes."""
    bpy.types.TOPBAR_MT_file_import.remove(_draw_menu)
    _unregister_classes()
