"""The page of ``play``: motions that repeat, in any scene, and recordings."""

from itertools import count
from pathlib import Path
from time import perf_counter
from typing import Any, get_args

import numpy as np
import viser

from kinefilter.characters import Clip, InputError, Motion, TrackingName
from kinefilter.pipeline.formats import write_clip
from kinefilter.pipeline.formats.files import numbered
from kinefilter.pipeline.physics.playground import RATE, Playground
from kinefilter.scenes import SCENES

from .play_page import Button, PlayPage

_SPEEDS = ("1", "0.5", "0.25", "0.1")
_MAX_DELAY = 0.25  # s: a longer delay is skipped, not caught up


class Player(PlayPage):
    """A playground on one page; every browser that opens it plays with the same.

    Only recordings are written: to ``save``, or if that exists to ``NAME.2`` and so on.
    """

    def __init__(
        self, server: viser.ViserServer, playground: Playground, save: Path
    ) -> None:
        self._playground, self._save = playground, save
        self._playing, self._speed = True, 1.0
        self._busy = 0.0
        super().__init__(server, playground)

    def run(self) -> None:
        """Play until ``stop`` is called, one step per frame of the motion."""
        due = perf_counter()
        while self._serve(max(due - perf_counter(), 0.0)):
            began = perf_counter()
            if began < due:  # a request arrived before the next step
                continue
            due = max(due + 1.0 / RATE, began - _MAX_DELAY)
            if self._playing:
                self._playground.step(self._speed / RATE)
            self._show()
            self._busy += 0.05 * (perf_counter() - began - self._busy)

    def _button_rows(self) -> list[Button]:
        playground = self._playground
        return [
            *super()._button_rows(),
            ("K", "Pause", "pause or resume", self._pause),
            ("R", "Restart", "put everything back", lambda _: playground.restart()),
            ("C", "Record", f"record a clip, {self._save}", self._record),
        ]

    def _add_choices(self, gui: viser.GuiApi) -> None:
        playground = self._playground
        speed = gui.add_dropdown("speed", _SPEEDS, initial_value="1")
        self._on(speed.on_update, self._set_speed)
        scenes = tuple(dict.fromkeys((str(playground.scene), *SCENES)))
        self._scenes: Any = gui.add_dropdown("scene", scenes, initial_value=scenes[0])
        self._on(self._scenes.on_update, lambda name: self._change(scene=name))
        names, now = get_args(TrackingName), playground.tracking
        tracking = gui.add_dropdown("tracking", names, initial_value=now)
        self._on(tracking.on_update, lambda name: self._change(tracking=name))
        if (count := len(playground.characters)) > 1:
            everyone = ("all", *map(str, range(1, count + 1)))
            chosen = gui.add_dropdown("character", everyone, initial_value="all")
            self._on(chosen.on_update, self._choose)

    @property
    def _framed(self) -> Clip:
        """The first motion, and its first posture wherever the others go."""
        first, *others = self._playground.motions
        root = np.concatenate([first.root, *(motion.root for motion in others)])
        there = np.repeat(first.rotations[:1], len(root) - len(first), axis=0)
        turns = np.concatenate([first.rotations, there])
        time = np.arange(len(root)) / RATE
        return Clip.of(Motion(time=time, body=first.body, root=root, rotations=turns))

    def _status_rows(self) -> list[tuple[str, str]]:
        rows = [
            ("time", f"{self._playground.time:.1f} s"),
            *super()._status_rows(),
            ("time per frame", f"{1e3 * self._busy:.0f} of {1e3 / RATE:.0f} ms"),
        ]
        if self._playground.recording is not None:
            rows.append(("recorded", f"{self._playground.recorded_time:.1f} s"))
        return rows

    def _labels(self) -> dict[str, str]:
        labels = super()._labels()
        if not self._playing:
            labels["Pause"] = "Resume"
        if self._playground.recording is not None:
            labels["Record"] = "Stop recording"
        return labels

    def _choose(self, name: str) -> None:
        self._number = None if name == "all" else int(name) - 1

    def _pause(self, _: object) -> None:
        self._playing = not self._playing

    def _set_speed(self, speed: str) -> None:
        self._speed = float(speed)

    def _change(self, **what: Any) -> None:
        try:
            if "scene" in what:  # the props are others
                self._report(self.save_recording())
            self._playground.change(**what)
        except InputError:
            self._scenes.value = str(self._playground.scene)
            raise
        self._draw_scene()

    def _record(self, _: object) -> None:
        if self._playground.recording is None:
            self._playground.record()
            self._report("")
        else:
            self._report(self.save_recording())

    def save_recording(self) -> str:
        """End a recording, if there is one; return what was written, in words."""
        if self._playground.recording is None:
            return ""
        try:
            clips = self._playground.recorded()
        except InputError:
            self._playground.stop_recording()
            raise
        bodies = range(1, len(clips) + 1) if len(clips) > 1 else (None,)
        names = (numbered(self._save, k if k > 1 else None) for k in count(1))
        recordings = ([numbered(name, body) for body in bodies] for name in names)
        paths = next(r for r in recordings if not any(path.exists() for path in r))
        for clip, to in zip(clips, paths, strict=True):
            write_clip(clip, to)
        self._playground.stop_recording()  # not before everything is written
        return f"wrote {', '.join(map(str, paths))}, {clips[0].time[-1]:.1f} s"
