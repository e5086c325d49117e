"""The page of ``view``: a motion to play, look at from all sides, and edit."""

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
from kinefilter.pipeline.edits import FEET, LIMBS, Edit, EditHistory, EditsFile
from kinefilter.pipeline.progress import Progress

from .drawing import Drawing, Sensor
from .timelines import AXES, Curves, Playback, timeline_html
from .viewer_scene import ViewerScene
from .viewer_server import Action, ServedPage, table_html

CleanAgain = Callable[[Sequence[Edit], Progress], Drawing]  # cleans with other edits

_STEPS = ("-10", "-1", "+1", "+10")  # frames
_SPEEDS = ("0.1", "0.25", "0.5", "1", "2", "4")
_BESIDE = "raw alongside"  # checkbox: the raw take is beside the character
_SHADOWS = "shadows"  # checkbox: without a GPU, shadows are half of the work
_NO_EDITS = "none yet"
_ROWS = [name.replace("Left", " L").replace("Right", " R") for name in CONTACTS]
_HINT = (
    "distrust: ignore what the sensor reports for this limb or joint; swap sides: "
    "left is right and right is left; pin: drag a joint to its true position in this "
    "frame"
)
_PIN = 0.25  # m, size of the handle that a joint is dragged by
_PROGRESS_EVERY = 0.1  # s between two updates of the progress bar
_POLL = 1.0  # s between checks for Ctrl-C, which does not interrupt a wait on Windows


class Viewer(ServedPage):
    """One motion on one page; every browser that opens it sees the same.

    Edits are read from the file ``save`` and saved there; nothing else is written,
    except a copy of that file if another program has changed it. ``again`` cleans the
    take again; clips have none. ``listed`` names all motions of a list, of which this
    is number ``shown``, to choose from.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        drawing: Drawing,
        save: Path,
        again: CleanAgain | None = None,
        listed: Sequence[str] = (),
        shown: int = 0,
    ) -> None:
        super().__init__(server)
        self._listed, self._shown, self._chosen = tuple(listed), shown, shown
        self._file, self._again = EditsFile(save), again
        self._playback = Playback(drawing.clip.time)
        self._edits = EditHistory(self._file.read(), drawing.clip)
        self._pin: Any = None
        self._add_panel(server.gui, drawing)
        self._look_at(drawing)
        self._report(f"{len(self._edits.edits) or 'no'} edits in {save.name}")

    def run(self) -> int | None:
        """Play and serve the requests of the page until ``stop`` is called.

        Returns the number of the motion that was chosen from the list, if any was.
        """
        serving = True
        while serving and self._chosen == self._shown:
            self._show()
            wait = self._playback.until_next(perf_counter())
            if sys.platform == "win32":
                wait = min(wait or _POLL, _POLL)
            serving = self._serve(wait)
        return self._chosen if serving else None

    def _add_panel(self, gui: viser.GuiApi, drawing: Drawing) -> None:
        def add_buttons(
            label: str, names: Iterable[str], action: Action, hint: str | None = None
        ) -> None:
            group = gui.add_button_group(label, tuple(names), hint=hint)
            self._on(group.on_click, action)

        if self._listed:
            now = self._listed[self._chosen]
            self._take: Any = gui.add_dropdown("take", self._listed, initial_value=now)
            self._on(self._take.on_update, self._choose_take)
        last = max(len(drawing.clip), 2)  # a slider from 1 to 1 cannot be drawn
        self._status = gui.add_html("")
        self._frame: Any = gui.add_slider("frame", 1, last, 1, 1)
        self._on(self._frame.on_update, lambda k: self._playback.seek(int(k) - 1))
        self._play = gui.add_button("Play", icon=viser.Icon.PLAYER_PLAY, hint="key K")
        self._on(self._play.on_click, self._play_or_pause)
        add_buttons("step", _STEPS, self._step, "keys J and L")
        # As in video editors; the space bar would also press the last button used.
        keys: dict[Any, tuple[str, Action]] = {
            "K": ("Play or pause", self._play_or_pause),
            "J": ("One frame back", lambda _: self._step("-1")),
            "L": ("One frame forward", lambda _: self._step("+1")),
            "N": ("Go to the next doubtful stretch", self._go_to_doubt),
            "U": ("Undo an edit", lambda _: self._change("undo")),
            "R": ("Redo an edit", lambda _: self._change("redo")),
        }
        for key, (label, action) in keys.items():
            self._on(gui.add_command(label, hotkey=key).on_trigger, action)
        speed = gui.add_dropdown("speed", _SPEEDS, initial_value="1")
        faster = self._playback.change_speed
        self._on(speed.on_update, lambda x: faster(float(x), perf_counter()))
        doubt = gui.add_button("Next doubtful stretch", hint="key N")
        self._on(doubt.on_click, self._go_to_doubt)
        with gui.add_folder("Edits"):
            self._timeline = gui.add_html("")
            self._span: Any = gui.add_multi_slider("frames", 1, last, 1, (1, last))
            self._on(self._span.on_update, lambda _: None)  # redraws the timeline
            add_buttons("range", ("start here", "end here", "all"), self._set_span)
            joints = drawing.clip.skeleton.joints
            self._joint = gui.add_dropdown("limb or joint", (*LIMBS, *joints))
            add_buttons("edit", ("distrust", "swap sides", "pin"), self._edit, _HINT)
            self._part = gui.add_dropdown("foot", tuple(FEET))
            add_buttons("contact", ("planted", "lifted"), self._edit)
            self._list: Any = gui.add_dropdown("edits", (_NO_EDITS,))
            names = ("remove", "undo", "redo")
            add_buttons("change", names, self._change, "keys U and R")
            self._on(gui.add_button("Save edits").on_click, self._save)
            again = gui.add_button("Save and clean again", visible=bool(self._again))
            self._on(again.on_click, self._clean_again)
            self._message = gui.add_html("")
            self._busy: Any = gui.add_progress_bar(0.0, visible=False, animated=True)
        with gui.add_folder("Curves", expand_by_default=False):
            self._curve = gui.add_dropdown("joint", joints)
            self._axis = gui.add_dropdown("coordinate", AXES, initial_value=AXES[1])
            self._plot = gui.add_html("")
        for choice in (self._curve, self._axis):
            self._on(choice.on_update, self._choose_curves)
        shown = dict(drawing.layers)
        if "raw" in shown:  # several sensors stay where they are in the room
            shown[_BESIDE] = not drawing.sensors
        shown[_SHADOWS] = True
        with gui.add_folder("Show"):
            self._boxes = {n: gui.add_checkbox(n, on) for n, on in shown.items()}
        for box in self._boxes.values():
            self._on(box.on_update, self._choose_layers)

    def _choose_take(self, name: str) -> None:
        """Leave this motion for another one of the list, unless edits would be lost."""
        if self._edits.unsaved:
            self._take.value = self._listed[self._shown]
            raise InputError("save or undo your edits before you open another take")
        self._chosen = self._listed.index(name)

    def _look_at(self, drawing: Drawing) -> None:
        self._drawing, self._clip = drawing, drawing.clip
        self._choose_curves()
        with self._server.atomic():
            self._scene = ViewerScene(self._server, drawing, self._edits)
        self._pin = None  # removed with the old scene
        self._edits.look_at(drawing.clip)
        self._show_edits()
        self._choose_layers()

    def _show(self) -> None:
        frame, playing = self._playback.frame(perf_counter()), self._playback.playing
        with self._server.atomic():
            self._scene.show(frame)
            if self._requests.empty():  # a slider being dragged would jump back
                self._frame.value = frame + 1
            self._status.content = status_html(self._clip, frame, self._drawing.sensors)
            rows = dict(zip(_ROWS, self._edits.contacts.T, strict=True))
            rows |= {"edited": self._edits.edited, "doubtful": self._doubts}
            self._timeline.content = timeline_html(rows, frame, self._first_and_last)
            self._plot.content = self._curves.html(frame)
            if self._pin is not None:
                self._pin.visible = frame == self._pinned
            self._play.label = "Pause" if playing else "Play"
            icons = viser.Icon.PLAYER_PLAY, viser.Icon.PLAYER_PAUSE
            self._play.icon = icons[playing]

    @property
    def _doubts(self) -> Flags:
        """Doubtful frames that no edit covers yet, shape (T,)."""
        return np.asarray(self._drawing.doubtful & ~self._edits.edited)

    @property
    def _first_and_last(self) -> tuple[int, int]:
        """First and last of the frames to edit, counted from 0."""
        first, last = self._span.value
        return int(first) - 1, int(last) - 1

    def _play_or_pause(self, _: object) -> None:
        playback = self._playback
        (playback.pause if playback.playing else playback.play)(perf_counter())

    def _step(self, button: str) -> None:
        self._playback.seek(self._playback.frame(perf_counter()) + int(button))

    def _choose_curves(self, _: object = None) -> None:
        self._curves = Curves(self._drawing, self._curve.value, self._axis.value)

    def _choose_layers(self, _: object = None) -> None:
        chosen = {name for name, box in self._boxes.items() if box.value}
        self._scene.choose(chosen, beside=_BESIDE in chosen, shadows=_SHADOWS in chosen)

    def _set_span(self, button: str) -> None:
        first, last = self._span.value
        here = self._playback.frame(perf_counter()) + 1
        self._span.value = {
            "start here": (here, max(here, last)),
            "end here": (min(first, here), here),
            "all": (1, len(self._clip)),
        }[button]

    def _go_to_doubt(self, _: object = None) -> None:
        here, spans = self._playback.frame(perf_counter()), runs(self._doubts)
        if not spans:
            self._report("no doubtful frames are left")
            return
        span = next((span for span in spans if span.start > here), spans[0])
        self._playback.seek(span.start)
        self._span.value = (span.start + 1, span.stop)

    def _edit(self, button: str) -> None:
        """Add an edit of the selected frames, or offer to pin a joint."""
        joint, part = self._joint.value, self._part.value
        begin, end = (self._seconds(frame) for frame in self._first_and_last)
        if button == "pin":
            self._offer_pin(joint)
            return
        edit = {
            "distrust": Edit("distrust", begin, end, (joint,)),
            "swap sides": Edit("exchange", begin, end),
            "planted": Edit("contact", begin, end, part=part, stands=True),
            "lifted": Edit("contact", begin, end, part=part, stands=False),
        }[button]
        self._edits.replace(dict.fromkeys((*self._edits.edits, edit)))
        self._show_edits()

    def _seconds(self, frame: int) -> float:
        return round(float(self._edits.since[frame]), 4)

    def _offer_pin(self, name: str) -> None:
        """Add a handle to drag a joint to its true position in the current frame."""
        joints = self._clip.skeleton.joints
        if name not in joints:
            raise InputError("a limb cannot be pinned; choose a joint")
        self._playback.pause(perf_counter())
        self._pinned = frame = self._playback.frame(perf_counter())
        place = self._clip.positions[frame, joints.index(name)]
        self._pin = self._server.scene.add_transform_controls(
            "/pin", _PIN, position=place, disable_rotations=True, depth_test=False
        )

        def dropped(_: object) -> None:
            time = self._seconds(frame)
            there = tuple(round(float(x), 4) for x in self._pin.position)
            pin = Edit("pin", time, time, (name,), position=there)
            same = [e for e in self._edits.edits if replace(e, position=there) == pin]
            others = [e for e in self._edits.edits if e not in same]
            self._edits.replace([*others, pin])
            self._show_edits()

        self._on(self._pin.on_update, dropped)
        self._report(f"drag {name} to its true position")

    def _change(self, button: str) -> None:
        """Remove the edit selected in the list, or undo or redo a change."""
        edits, selected = self._edits, self._list.options.index(self._list.value)
        if button == "remove":
            edits.replace(edit for k, edit in enumerate(edits.edits) if k != selected)
        else:
            (edits.undo if button == "undo" else edits.redo)()
        self._show_edits()

    def _show_edits(self) -> None:
        lines = [f"{k}. {edit.summary}" for k, edit in enumerate(self._edits.edits, 1)]
        self._list.options = lines or [_NO_EDITS]
        self._list.value = self._list.options[-1]  # the latest
        self._report("unsaved changes" if self._edits.unsaved else "")

    def _save(self, _: object = None) -> None:
        kept = self._file.write(self._edits.edits)
        self._edits.mark_saved()
        also = f"; the version edited elsewhere is now {kept.name}" if kept else ""
        self._report(f"saved {self._file.path}{also}")

    def _clean_again(self, _: object) -> None:
        """Save, and clean as ``clean --edits`` would with the saved file."""
        self._playback.pause(perf_counter())
        self._save()
        assert self._again is not None  # or the button is hidden
        try:
            drawing = self._again(self._edits.edits, self._progress)
        finally:
            self._busy.visible = False
        self._look_at(drawing)
        self._report(f"cleaned with {self._file.path}")

    def _progress(self, stage: str, count: int) -> Iterable[int]:
        self._report(f"{stage} ...")
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
    rows = [("time", f"{seconds:.2f} s, frame {frame + 1} of {len(clip)}")]
    rates = clip.reliability[frame]
    if np.isfinite(rates).any():
        worst = int(np.nanargmin(rates))
        term = Term(int(clip.deciding_term[frame, worst])).words
        joint = clip.skeleton.joints[worst]
        rows.append(("least reliable", f"{joint}, {rates[worst]:.2f} ({term})"))
    force = float(clip.external_force[frame])
    if np.isfinite(force):
        rows.append(("external force", f"{force:.2f} body weights"))
    styled = [("opacity:0.6", *row) for row in rows]
    for sensor in sensors:
        distances, text = sensor.residuals[frame], "sees no one"
        if np.isfinite(distances).any():
            text = f"share {sensor.shares[frame].mean():.0%}, "
            text += f"{np.nanmedian(distances) * 100.0:.1f} cm from merged"
        style = f"font-weight:600;color:rgb{sensor.color};overflow-wrap:anywhere"
        styled.append((style, sensor.name, text))
    return table_html(styled)
