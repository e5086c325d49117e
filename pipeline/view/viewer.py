"""The page at work: what is asked for on it is done here, one thing after another."""

from __future__ import annotations

import html
import queue
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import viser

from kinefilter.characters import InputError
from kinefilter.pipeline.formats import write_contacts
from kinefilter.pipeline.progress import Progress

from .contact_edits import ContactEdits
from .layers import Layers, names_of, way_aside
from .panel import BESIDE, SHADOWS, STEPS, Panel
from .playback import Playback
from .server import address_of, opened_server
from .stage import set_stage
from .status import status_html
from .timeline import Timeline
from .viewed import Viewed

Again = Callable[[Path, Progress], Viewed]
"""Cleans the take once more, with the contacts of a file."""
Action = Callable[[Any], object]
"""What is to be done, given what the button or slider that asked for it then said."""

_TOLD_EVERY = 0.1  # s between two words on how far work is


class Viewer:
    """One motion on one page; every browser that opens it sees the same.

    What browsers ask for comes from threads of the server. It waits in a queue for
    ``run``, which alone changes anything, so there is nothing to lock.

    Args:
        server: The page.
        viewed: What is looked at.
        save: File that contacts are saved in.
        again: How the take is cleaned once more; None: it cannot be.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        viewed: Viewed,
        save: Path,
        again: Again | None = None,
    ) -> None:
        self._server, self._save, self._again = server, save, again
        self._asked: queue.Queue[tuple[Action, Any] | None] = queue.Queue()
        self._playback = Playback(viewed.clip.time)
        self._edits = ContactEdits(viewed.clip.contacts)
        self._panel = Panel(
            server.gui, len(viewed.clip), names_of(viewed), cleans=again is not None
        )
        self._look_at(viewed)
        self._listen()
        there = ", which is there and will be replaced" if save.exists() else ""
        self._say(f"to be saved as {save.name}{there}")

    @property
    def address(self) -> str:
        """What a browser opens."""
        return address_of(self._server)

    def run(self) -> None:
        """Do what the page asks for, until ``stop``."""
        while True:
            self._show()
            try:
                asked = self._asked.get(timeout=self._playback.until_next(_clock()))
                while asked is not None:
                    action, said = asked
                    action(said)
                    # What came meanwhile first: of many scrubs only the last is drawn.
                    asked = self._asked.get_nowait()
                return
            except queue.Empty:
                pass

    def stop(self) -> None:
        """Let ``run`` return; from any thread."""
        self._asked.put(None)

    def _look_at(self, viewed: Viewed) -> None:
        """Build the scene of what is looked at."""
        self._viewed, self._aside = viewed, way_aside(viewed)
        with self._server.atomic():
            self._server.scene.reset()
            self._sun = set_stage(self._server, viewed.clip, self._aside)
            self._layers = Layers(
                self._server.scene, viewed, np.asarray(self._edits.contacts)
            )
        self._timeline = Timeline(self._edits.contacts)
        self._choose()

    def _listen(self) -> None:
        """Tell every button and slider what it asks for."""
        panel = self._panel
        self._on(panel.frame.on_update, self._scrub)
        self._on(panel.play.on_click, self._play_or_pause)
        self._on(panel.step.on_click, self._step)
        self._on(panel.keys["play"].on_trigger, self._play_or_pause)
        self._on(panel.keys["back"].on_trigger, lambda _: self._step("-1"))
        self._on(panel.keys["on"].on_trigger, lambda _: self._step("+1"))
        self._on(panel.speed.on_update, self._change_speed)
        for box in panel.layers.values():
            self._on(box.on_update, self._choose)
        self._on(panel.span.on_update, lambda _: None)
        self._on(panel.ends.on_click, self._set_end)
        self._on(panel.edit.on_click, self._edit)
        self._on(panel.save.on_click, self._save_contacts)
        self._on(panel.again.on_click, self._clean_again)

    def _on(self, register: Callable[[Any], Any], action: Action) -> None:
        async def ask(event: Any) -> None:
            if event.client is not None:  # what this program itself changes is done
                self._asked.put((action, getattr(event.target, "value", None)))

        register(ask)

    def _show(self) -> None:
        """Draw the present frame."""
        frame = self._playback.frame(_clock())
        panel = self._panel
        with self._server.atomic():
            self._layers.show(frame)
            if self._asked.empty():  # or a slider that is pulled on would jump back
                panel.show_frame(frame)
            panel.status.content = status_html(self._viewed.clip, frame)
            panel.timeline.content = self._timeline.html(frame, panel.first_and_last)
            panel.show_playing(self._playback.playing)

    def _scrub(self, number: int) -> None:
        self._playback.seek(int(number) - 1)

    def _play_or_pause(self, _: object) -> None:
        if self._playback.playing:
            self._playback.pause(_clock())
        else:
            self._playback.play(_clock())

    def _step(self, way: str) -> None:
        self._playback.seek(self._playback.frame(_clock()) + STEPS[way])

    def _change_speed(self, times: str) -> None:
        self._playback.change_speed(float(times), _clock())

    def _choose(self, _: object = None) -> None:
        chosen = self._panel.chosen
        aside = self._aside if BESIDE in chosen else np.zeros(3)
        self._layers.choose(chosen, aside)
        self._sun.cast_shadow = SHADOWS in chosen

    def _set_end(self, which: str) -> None:
        """Let the frames to edit begin or end at the present one."""
        first, last = self._panel.first_and_last
        here = self._playback.frame(_clock())
        spans = {
            "from here": (here, max(here, last)),
            "to here": (min(first, here), here),
            "all": (0, len(self._viewed.clip) - 1),
        }
        self._panel.choose_frames(*spans[which])

    def _edit(self, asked: str) -> None:
        """Change the contacts, or take the last change back."""
        edits = self._edits
        if asked == "undo":
            edits.undo()
        else:
            first, last = self._panel.first_and_last
            edits.put(self._panel.part.value, first, last, stands=asked == "stands")
        self._layers.mark(edits.contacts)
        self._timeline = Timeline(edits.contacts)
        self._say("not saved" if edits.unsaved else "")

    def _save_contacts(self, _: object = None) -> bool:
        """Write the contacts; return whether they are there."""
        clip = replace(self._viewed.clip, contacts=self._edits.contacts)
        try:
            write_contacts(clip, self._save)
        except InputError as error:
            self._say(str(error), wrong=True)
            return False
        self._edits.mark_saved()
        self._say(f"saved {self._save}")
        return True

    def _clean_again(self, _: object) -> None:
        """Save, and clean as ``clean --contacts`` would with that file."""
        self._playback.pause(_clock())
        if self._again is None or not self._save_contacts():
            return
        try:
            viewed = self._again(self._save, self._told)
        except InputError as error:
            self._say(str(error), wrong=True)
            return
        finally:
            self._panel.show_work(None)
        self._edits.replace(viewed.clip.contacts)
        self._edits.mark_saved()
        self._look_at(viewed)
        self._say(f"cleaned with {self._save}")

    def _told(self, stage: str, count: int) -> Iterable[int]:
        """Show on the page how far a stage is."""
        self._say(f"{stage} ...")
        told = 0.0
        for step in range(count):
            if _clock() - told > _TOLD_EVERY:
                self._panel.show_work(step / count)
                told = _clock()
            yield step

    def _say(self, words: str, *, wrong: bool = False) -> None:
        color = "#c92a2a" if wrong else "inherit"
        self._panel.said.content = (
            f'<div id="said" style="font-size:12px;margin:0 8px;color:{color};'
            f'overflow-wrap:anywhere">{html.escape(words)}</div>'
        )


@contextmanager
def opened_viewer(
    viewed: Viewed,
    save: Path,
    *,
    again: Again | None = None,
    bind: str = "127.0.0.1",
    port: int = 0,
) -> Iterator[Viewer]:
    """Yield a page that waits for browsers, and works while its ``run`` does.

    Args:
        viewed: What is looked at.
        save: File that contacts are saved in, the only one that is written.
        again: How the take is cleaned once more; None: it cannot be.
        bind: Address to listen at; 127.0.0.1 is reached from this machine alone.
        port: Port, 0: any that is free.

    Raises:
        InputError: Nothing can listen there.
    """
    with opened_server(bind, port) as server:
        yield Viewer(server, viewed, save, again)


def _clock() -> float:
    return perf_counter()
