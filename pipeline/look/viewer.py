"""A motion in the browser: played, turned and edited."""

from __future__ import annotations

import queue
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import viser

from kinefilter.characters import CONTACTS, Clip, InputError, Term
from kinefilter.characters.arrays import Flags, runs
from kinefilter.pipeline.edits import FEET, LIMBS, Edit, EditsFile
from kinefilter.pipeline.progress import Progress

from .doubts import doubtful
from .drawing import Drawing
from .edit_history import EditHistory, timeline_html
from .playback import Playback
from .sensors import Sensor
from .viewer_page import Action, ServedPage, table_html
from .viewer_scene import ViewerScene

CleanAgain = Callable[[Sequence[Edit], Progress], Drawing]
"""Cleans the take once more, with edits."""

_STEPS = {"-10": -10, "-1": -1, "+1": 1, "+10": 10}  # frames, by button
_SPEEDS = ("0.1", "0.25", "0.5", "1", "2", "4")
_BESIDE = "raw beside"  # checkbox: the raw take stands beside the character
_SHADOWS = "shadows"  # checkbox: they are half of the work where no GPU draws
_NONE = "none yet"
_ROWS = [name.replace("Left", " L").replace("Right", " R") for name in CONTACTS]
_EDIT = (
    "What the sensor says of a limb or joint counts for nothing; left is right; or "
    "drag a joint to where it is in this frame"
)
_PIN = 0.25  # m, size of what a joint is dragged by
_PROGRESS_EVERY = 0.1  # s between two reports of progress
_LOOK = 1.0  # s between looks for Ctrl-C, which on Windows wakes nobody who waits


class Viewer(ServedPage):
    """One motion on one page; every browser that opens it sees the same.

    Edits are read from the file ``save`` and saved there, and nothing else is written
    but what was there before, where somebody else wrote it; ``again`` cleans the take
    once more, if it can be.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        drawing: Drawing,
        save: Path,
        again: CleanAgain | None = None,
    ) -> None:
        super().__init__(server)
        self._file, self._again = EditsFile(save), again
        self._playback = Playback(drawing.clip.time)
        self._edits = EditHistory(self._file.read(), drawing.clip)
        self._pin: Any = None
        self._add_panel(server.gui, drawing)
        self._look_at(drawing)
        count = len(self._edits.edits)
        self._say(f"{count} edits of {save.name}" if count else f"no {save.name} yet")

    def run(self) -> None:
        """Do what the page asks for, until ``stop``."""
        while True:
            self._show()
            try:
                wait = self._playback.until_next(perf_counter())
                if sys.platform == "win32":
                    wait = min(wait or _LOOK, _LOOK)
                asked = self._asked.get(timeout=wait)
                while asked is not None:
                    action, value = asked
                    action(value)
                    # What came meanwhile first: of many scrubs only the last is drawn.
                    asked = self._asked.get_nowait()
                return
            except queue.Empty:
                pass

    def _add_panel(self, gui: viser.GuiApi, drawing: Drawing) -> None:
        last = max(len(drawing.clip), 2)  # a slider from 1 to 1 cannot be drawn
        self._status = gui.add_html("")
        self._frame: Any = gui.add_slider("frame", 1, last, 1, 1)
        self._on(self._frame.on_update, lambda k: self._playback.seek(int(k) - 1))
        self._play = gui.add_button("Play", icon=viser.Icon.PLAYER_PLAY, hint="key K")
        self._on(self._play.on_click, self._play_or_pause)
        steps = gui.add_button_group("step", tuple(_STEPS), hint="keys J and L")
        self._on(steps.on_click, self._step)
        # As in video editors; the space bar would press the last button as well.
        keys: dict[Any, tuple[str, Action]] = {
            "K": ("Play or pause", self._play_or_pause),
            "J": ("A frame back", lambda _: self._step("-1")),
            "L": ("A frame on", lambda _: self._step("+1")),
            "N": ("To the next doubtful second", self._go_to_doubt),
            "U": ("Undo an edit", lambda _: self._change("undo")),
            "R": ("Redo an edit", lambda _: self._change("redo")),
        }
        for key, (label, action) in keys.items():
            self._on(gui.add_command(label, hotkey=key).on_trigger, action)
        speed = gui.add_dropdown("speed", _SPEEDS, initial_value="1")
        self._on(
            speed.on_update,
            lambda s: self._playback.change_speed(float(s), perf_counter()),
        )
        doubt = gui.add_button("Next doubtful second", hint="key N")
        self._on(doubt.on_click, self._go_to_doubt)
        with gui.add_folder("Edits"):
            self._picture = gui.add_html("")
            self._span: Any = gui.add_multi_slider("frames", 1, last, 1, (1, last))
            self._on(self._span.on_update, lambda _: None)  # draws the timeline again
            ends = gui.add_button_group("set", ("from here", "to here", "all"))
            self._on(ends.on_click, self._set_end)
            known = drawing.clip.skeleton.joints
            self._joint = gui.add_dropdown("limb or joint", (*LIMBS, *known))
            edit = gui.add_button_group(
                "edit", ("distrust", "exchange", "pin"), hint=_EDIT
            )
            self._on(edit.on_click, self._edit)
            self._part = gui.add_dropdown("foot", tuple(FEET))
            contact = gui.add_button_group("contact", ("stands", "lifts"))
            self._on(contact.on_click, self._edit)
            self._list: Any = gui.add_dropdown("edits", (_NONE,))
            change = gui.add_button_group(
                "change", ("remove", "undo", "redo"), hint="keys U and R"
            )
            self._on(change.on_click, self._change)
            self._on(gui.add_button("Save edits").on_click, self._save)
            possible = self._again is not None
            again = gui.add_button("Save and clean again", visible=possible)
            self._on(again.on_click, self._clean_again)
            self._said = gui.add_html("")
            self._busy: Any = gui.add_progress_bar(0.0, visible=False, animated=True)
        shown = dict(drawing.layers)
        if "raw" in shown:
            shown[_BESIDE] = not drawing.sensors  # they are where the room has them
        shown[_SHADOWS] = True
        with gui.add_folder("Show"):
            self._boxes = {n: gui.add_checkbox(n, on) for n, on in shown.items()}
        for box in self._boxes.values():
            self._on(box.on_update, self._choose)

    def _look_at(self, drawing: Drawing) -> None:
        self._clip, self._sensors = drawing.clip, drawing.sensors
        with self._server.atomic():
            self._scene = ViewerScene(self._server, drawing, self._edits)
        self._pin = None  # is gone with the scene
        self._edits.look_at(drawing.clip)
        self._doubtful = doubtful(drawing.clip, drawing.failures)
        self._show_edits()
        self._choose()

    def _show(self) -> None:
        frame = self._playback.frame(perf_counter())
        playing = self._playback.playing
        with self._server.atomic():
            self._scene.show(frame)
            if self._asked.empty():  # or a slider that is being pulled would jump back
                self._frame.value = frame + 1
            self._status.content = status_html(self._clip, frame, self._sensors)
            chosen = self._first_and_last
            rows = dict(zip(_ROWS, self._edits.contacts.T, strict=True))
            rows |= {"edited": self._edits.edited, "doubtful": self._doubts}
            self._picture.content = timeline_html(rows, frame, chosen)
            if self._pin is not None:
                self._pin.visible = frame == self._pinned
            self._play.label = "Pause" if playing else "Play"
            icon = viser.Icon.PLAYER_PAUSE if playing else viser.Icon.PLAYER_PLAY
            if self._play.icon != icon:
                self._play.icon = icon

    @property
    def _doubts(self) -> Flags:
        """Frames that are doubtful, and of which nothing is said yet, shape (T,)."""
        return np.asarray(self._doubtful & ~self._edits.edited)

    @property
    def _first_and_last(self) -> tuple[int, int]:
        """First and last of the frames to edit, counted from 0."""
        first, last = self._span.value
        return int(first) - 1, int(last) - 1

    def _play_or_pause(self, _: object) -> None:
        playback = self._playback
        (playback.pause if playback.playing else playback.play)(perf_counter())

    def _step(self, button: str) -> None:
        self._playback.seek(self._playback.frame(perf_counter()) + _STEPS[button])

    def _choose(self, _: object = None) -> None:
        chosen = {name for name, box in self._boxes.items() if box.value}
        self._scene.choose(chosen, beside=_BESIDE in chosen, shadows=_SHADOWS in chosen)

    def _set_end(self, which: str) -> None:
        """Let the frames to edit begin or end at the present one."""
        first, last = self._span.value
        here = self._playback.frame(perf_counter()) + 1
        self._span.value = {
            "from here": (here, max(here, last)),
            "to here": (min(first, here), here),
            "all": (1, len(self._clip)),
        }[which]

    def _go_to_doubt(self, _: object = None) -> None:
        """Show the next second that is to be doubted, and choose its frames."""
        here, found = self._playback.frame(perf_counter()), runs(self._doubts)
        if not found:
            self._say("nothing here is doubtful")
            return
        span = next((span for span in found if span.start > here), found[0])
        self._playback.seek(span.start)
        self._span.value = (span.start + 1, span.stop)

    def _edit(self, button: str) -> None:
        """Say something of the chosen frames."""
        first, last = self._first_and_last
        begin, end = (round(float(self._edits.since[k]), 4) for k in (first, last))
        if button == "pin":
            self._offer_pin(self._joint.value)
        elif button in ("stands", "lifts"):
            stands = button == "stands"
            self._add(Edit("contact", begin, end, part=self._part.value, stands=stands))
        else:
            joints = (self._joint.value,) if button == "distrust" else ()
            self._add(Edit(button, begin, end, joints))

    def _add(self, *edits: Edit) -> None:
        self._edits.replace(dict.fromkeys((*self._edits.edits, *edits)))
        self._show_edits()

    def _offer_pin(self, name: str) -> None:
        """Let a joint be dragged to where it is in the present frame."""
        joints = self._clip.skeleton.joints
        if name not in joints:
            self._say("choose a joint to pin, not a limb", wrong=True)
            return
        self._playback.pause(perf_counter())
        self._pinned = frame = self._playback.frame(perf_counter())
        place = self._clip.positions[frame, joints.index(name)]
        self._pin = self._server.scene.add_transform_controls(
            "/pin", _PIN, position=place, disable_rotations=True, depth_test=False
        )

        def dropped(_: object) -> None:
            time = round(float(self._edits.since[frame]), 4)
            there = tuple(round(float(x), 4) for x in self._pin.position)
            pin = Edit("pin", time, time, (name,), position=there)
            same = [e for e in self._edits.edits if replace(e, position=there) == pin]
            self._edits.replace([e for e in (*self._edits.edits, pin) if e not in same])
            self._show_edits()

        self._on(self._pin.on_update, dropped)
        self._say(f"drag {name} to where it is")

    def _change(self, button: str) -> None:
        """Remove the edit that the list shows, or undo or redo a change."""
        edits, shown = self._edits, self._list.options.index(self._list.value)
        if button == "remove":
            edits.replace(edit for k, edit in enumerate(edits.edits) if k != shown)
        else:
            (edits.undo if button == "undo" else edits.redo)()
        self._show_edits()

    def _show_edits(self) -> None:
        told = [f"{k}. {edit.told}" for k, edit in enumerate(self._edits.edits, 1)]
        self._list.options = told or [_NONE]
        self._list.value = self._list.options[-1]  # the last one made
        self._say("not saved" if self._edits.unsaved else "")

    def _save(self, _: object = None) -> bool:
        """Write the edits; return whether that worked."""
        try:
            kept = self._file.write(self._edits.edits)
        except InputError as error:
            self._say(str(error), wrong=True)
            return False
        self._edits.mark_saved()
        also = f"; what was there is now {kept.name}" if kept else ""
        self._say(f"saved {self._file.path}{also}")
        return True

    def _clean_again(self, _: object) -> None:
        """Save, and clean as ``clean --edits`` would with that file."""
        self._playback.pause(perf_counter())
        if self._again is None or not self._save():
            return
        try:
            drawing = self._again(self._edits.edits, self._progress)
        except InputError as error:
            self._say(str(error), wrong=True)
            return
        finally:
            self._busy.visible = False
        self._look_at(drawing)
        self._say(f"cleaned with {self._file.path}")

    def _progress(self, stage: str, count: int) -> Iterable[int]:
        """Show on the page how far a stage is."""
        self._say(f"{stage} ...")
        shown = 0.0
        for step in range(count):
            if perf_counter() - shown > _PROGRESS_EVERY:
                self._busy.visible = True
                self._busy.value = 100.0 * step / count
                shown = perf_counter()
            yield step


def status_html(clip: Clip, frame: int, sensors: Sequence[Sensor] = ()) -> str:
    """Return time, least reliable joint, force and sensors of a frame as HTML."""
    seconds = clip.time[frame] - clip.time[0]
    quiet, rows = "opacity:0.6", list[tuple[str, str, str]]()
    rows.append((quiet, "time", f"{seconds:.2f} s, frame {frame + 1} of {len(clip)}"))
    rates = clip.reliability[frame]
    if np.isfinite(rates).any():
        worst = int(np.nanargmin(rates))
        term = Term(int(clip.deciding_term[frame, worst])).words
        joint = clip.skeleton.joints[worst]
        rows.append((quiet, "least reliable", f"{joint}, {rates[worst]:.2f} ({term})"))
    force = float(clip.external_force[frame])
    if np.isfinite(force):
        rows.append((quiet, "external force", f"{force:.2f} body weights"))
    for sensor in sensors:
        apart = sensor.residuals[frame]
        seen = np.isfinite(apart)
        text = "sees nobody"
        if seen.any():
            text = f"share {sensor.shares[frame].mean():.0%}, "
            text += f"{np.median(apart[seen]) * 100.0:.1f} cm apart"
        style = f"font-weight:600;color:rgb{sensor.color};overflow-wrap:anywhere"
        rows.append((style, sensor.name, text))
    return table_html(rows)
