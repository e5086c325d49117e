"""A motion in the browser: played, turned, and its foot contacts edited."""

from __future__ import annotations

import html
import queue
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import viser

from kinefilter.characters import Clip, InputError, Term
from kinefilter.characters.arrays import Array
from kinefilter.characters.motion import nominal_step
from kinefilter.pipeline.formats import write_contacts
from kinefilter.pipeline.progress import Progress

from .contact_editing import PARTS, ContactEdits, timeline_html
from .drawing import Drawing
from .sensors import Sensor
from .viewer_scene import ViewerScene

CleanAgain = Callable[[Path, Progress], Drawing]
"""Cleans the take once more, with the contacts of a file."""
Action = Callable[[Any], object]
"""What is to be done, given the value of the widget that asked for it."""

_STEPS = {"-10": -10, "-1": -1, "+1": 1, "+10": 10}  # frames, by button
_SPEEDS = ("0.1", "0.25", "0.5", "1", "2", "4")
_BESIDE = "raw beside"  # checkbox: the raw take stands beside the character
_SHADOWS = "shadows"  # checkbox: they are half of the work where no GPU draws
_PROGRESS_EVERY = 0.1  # s between two reports of progress
_LOOK = 1.0  # s between looks for Ctrl-C, which on Windows wakes nobody who waits
_SHORTEST = 1.0 / 60.0  # s between two pictures: screens show no more


class Playback:
    """A place in a motion, at rest or ``playing`` with a clock; the end leads back."""

    def __init__(self, time: Array) -> None:
        last = np.nan_to_num(nominal_step(time), nan=1.0)
        self._starts = time - time[0]
        self._ends = np.append(self._starts[1:], self._starts[-1] + last)
        self._frame, self._speed, self.playing = 0, 1.0, False
        self._began = 0.0  # clock at which frame 0 was or would be, while it plays

    def frame(self, clock: float) -> int:
        """Return the frame that is shown at a time of the clock [s]."""
        if not self.playing:
            return self._frame
        return int(np.searchsorted(self._ends[:-1], self._now(clock), side="right"))

    def play(self, clock: float) -> None:
        """Go on from the present frame, or from the first if it is the last."""
        if not self.playing:
            last = self._frame == len(self._starts) - 1
            self._start(0 if last else self._frame, clock)

    def pause(self, clock: float) -> None:
        """Stay at the present frame."""
        self.seek(self.frame(clock))

    def seek(self, frame: int) -> None:
        """Stay at a frame, or at the nearest there is."""
        self._frame = min(max(frame, 0), len(self._starts) - 1)
        self.playing = False

    def change_speed(self, speed: float, clock: float) -> None:
        """Play ``speed`` times as fast from now on."""
        frame, self._speed = self.frame(clock), speed
        if self.playing:
            self._start(frame, clock)

    def until_next(self, clock: float) -> float | None:
        """Return how long [s] the present picture stays; None at rest."""
        if not self.playing:
            return None
        left = self._ends[self.frame(clock)] - self._now(clock)
        return max(float(left) / self._speed, _SHORTEST)

    def _now(self, clock: float) -> float:
        return (clock - self._began) * self._speed % float(self._ends[-1])

    def _start(self, frame: int, clock: float) -> None:
        self._began, self.playing = clock - self._starts[frame] / self._speed, True


class Viewer:
    """One motion on one page; every browser that opens it sees the same.

    Contacts are saved in the file ``save``, the only one that is written; ``again``
    cleans the take once more, if it can be.

    What browsers ask for comes from threads of the server. It waits in a queue for
    ``run``, which alone changes anything, so that no locks are needed.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        drawing: Drawing,
        save: Path,
        again: CleanAgain | None = None,
    ) -> None:
        self._server, self._save, self._again = server, save, again
        self._asked: queue.Queue[tuple[Action, Any] | None] = queue.Queue()
        self._playback = Playback(drawing.clip.time)
        self._edits = ContactEdits(drawing.clip.contacts)
        self._add_panel(server.gui, drawing)
        self._look_at(drawing)
        exists = ", which is there and will be replaced" if save.exists() else ""
        self._say(f"to be saved as {save.name}{exists}")

    @property
    def address(self) -> str:
        """What a browser opens."""
        host = self._server.get_host()
        host = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(host, host)
        name = f"[{host}]" if ":" in host else host
        return f"http://{name}:{self._server.get_port()}"

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

    def stop(self) -> None:
        """Let ``run`` return; from any thread."""
        self._asked.put(None)

    def _add_panel(self, gui: viser.GuiApi, drawing: Drawing) -> None:
        plain: Any = {"show_logo": False, "show_share_button": False}
        gui.configure_theme(control_width="large", **plain)
        gui.set_panel_label("kinefilter")
        gui.main_panel.dock_right()
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
        }
        for key, (label, action) in keys.items():
            self._on(gui.add_command(label, hotkey=key).on_trigger, action)
        speed = gui.add_dropdown("speed", _SPEEDS, initial_value="1")
        self._on(
            speed.on_update,
            lambda s: self._playback.change_speed(float(s), perf_counter()),
        )
        with gui.add_folder("Foot contacts"):
            self._picture = gui.add_html("")
            self._span: Any = gui.add_multi_slider("frames", 1, last, 1, (1, last))
            self._on(self._span.on_update, lambda _: None)  # draws the timeline again
            ends = gui.add_button_group("set", ("from here", "to here", "all"))
            self._on(ends.on_click, self._set_end)
            self._part = gui.add_dropdown("part", tuple(PARTS))
            edit = gui.add_button_group("edit", ("stands", "lifts", "undo"))
            self._on(edit.on_click, self._edit)
            self._on(gui.add_button("Save contacts").on_click, self._save_contacts)
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

    def _on(self, register: Callable[[Any], Any], action: Action) -> None:
        async def ask(event: Any) -> None:
            if event.client is not None:  # not where this program changed a widget
                self._asked.put((action, getattr(event.target, "value", None)))

        register(ask)

    def _look_at(self, drawing: Drawing) -> None:
        self._clip, self._sensors = drawing.clip, drawing.sensors
        with self._server.atomic():
            self._scene = ViewerScene(self._server, drawing, self._edits)
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
            self._picture.content = timeline_html(self._edits.contacts, frame, chosen)
            self._play.label = "Pause" if playing else "Play"
            icon = viser.Icon.PLAYER_PAUSE if playing else viser.Icon.PLAYER_PLAY
            if self._play.icon != icon:
                self._play.icon = icon

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

    def _edit(self, button: str) -> None:
        """Change the contacts, or take the last change back."""
        edits = self._edits
        if button == "undo":
            edits.undo()
        else:
            first, last = self._first_and_last
            edits.put(self._part.value, first, last, stands=button == "stands")
        self._say("not saved" if edits.unsaved else "")

    def _save_contacts(self, _: object = None) -> bool:
        """Write the contacts; return whether that worked."""
        try:
            clip = replace(self._clip, contacts=self._edits.contacts)
            write_contacts(clip, self._save)
        except InputError as error:
            self._say(str(error), wrong=True)
            return False
        self._edits.mark_saved()
        self._say(f"saved {self._save}")
        return True

    def _clean_again(self, _: object) -> None:
        """Save, and clean as ``clean --contacts`` would with that file."""
        self._playback.pause(perf_counter())
        if self._again is None or not self._save_contacts():
            return
        try:
            drawing = self._again(self._save, self._progress)
        except InputError as error:
            self._say(str(error), wrong=True)
            return
        finally:
            self._busy.visible = False
        self._edits.replace(drawing.clip.contacts)
        self._edits.mark_saved()
        self._look_at(drawing)
        self._say(f"cleaned with {self._save}")

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

    def _say(self, words: str, *, wrong: bool = False) -> None:
        color = "#c92a2a" if wrong else "inherit"
        self._said.content = (
            f'<div id="said" style="font-size:12px;margin:0 8px;color:{color};'
            f'overflow-wrap:anywhere">{html.escape(words)}</div>'
        )


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
    cells = "".join(
        f'<div style="{style}">{html.escape(name)}</div><div>{html.escape(text)}</div>'
        for style, name, text in rows
    )
    return (
        '<div id="status" style="display:grid;grid-template-columns:auto 1fr;'
        f'gap:1px 8px;font-size:12px;margin:2px 8px">{cells}</div>'
    )
