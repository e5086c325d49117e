"""A character in the browser: pushed, hit with balls, let go and taken hold of."""

from __future__ import annotations

import queue
from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import Any, get_args

import numpy as np
import viser

from kinefilter.characters import InputError, TrackingName
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.formats import write_clip
from kinefilter.pipeline.formats.recording import numbered
from kinefilter.pipeline.physics.playground import RATE, Playground
from kinefilter.scenes import SCENES

from .drawing import Drawing, StickFigure
from .viewer_page import Action, ServedPage, table_html
from .viewer_scene import add_batch, add_props, add_skin, cylinder, set_stage

_SPEEDS = ("1", "0.5", "0.25", "0.1")
_BEHIND = 0.25  # s: what is later than that is not made up for
_BETWEEN = 0.2  # s between two changes of the words in the panel
_TO_GRAB = 1.3  # of a part's radius, within which a pointer grabs it
_FROM_CAMERA = 0.4  # m before the camera, where balls come from
_HELP = (
    ("drag the character", "pull and push it"),
    ("click", "throw a ball there"),
    ("Shift + click", "shove what is there"),
)


class Player(ServedPage):
    """A playground on one page; every browser that opens it plays with the same.

    Recordings are written to ``save``, or where that exists to ``NAME.2`` and so on;
    nothing else is.
    """

    def __init__(
        self, server: viser.ViserServer, playground: Playground, save: Path
    ) -> None:
        super().__init__(server)
        self._ground, self._save = playground, save
        self._playing, self._speed = True, 1.0
        self._told = self._busy = 0.0
        self._add_panel(server.gui)
        self._on(server.scene.on_click(), self._throw_at, whole=True)
        shove = server.scene.on_click(modifier="shift")
        self._on(shove, self._shove_at, whole=True)
        self._draw_anew()

    def run(self) -> None:
        """Play until ``stop``, one step a frame of the motion."""
        due = perf_counter()
        while True:
            try:
                while True:
                    asked = self._asked.get(timeout=max(due - perf_counter(), 0.0))
                    if asked is None:
                        return
                    action, value = asked
                    try:
                        action(value)
                    except InputError as error:
                        self._say(str(error), wrong=True)
            except queue.Empty:
                pass
            began = perf_counter()
            due = max(due + 1.0 / RATE, began - _BEHIND)
            if self._playing:
                self._ground.step(self._speed / RATE)
            self._show()
            self._busy += 0.05 * (perf_counter() - began - self._busy)

    def _add_panel(self, gui: viser.GuiApi) -> None:
        self._status = gui.add_html("")
        keys: dict[str, tuple[Any, str, Action]] = {
            "Shove": ("P", "key P: shove the chest, away from you", self._shove),
            "Throw a ball": (
                "B",
                "key B: at the chest, from where you are",
                self._throw,
            ),
            "Let go": ("G", "key G: nothing pulls the character", self._let_go),
            "Pause": ("K", "key K", self._pause),
            "Begin again": ("R", "key R: everything where it was", self._restart),
            "Record": ("C", f"key C: a clip, {self._save}", self._record),
        }
        self._buttons = {}
        for label, (key, hint, action) in keys.items():
            button = gui.add_button(label, hint=hint)
            self._buttons[label] = button
            self._on(button.on_click, action, whole=True)
            command = gui.add_command(label, hotkey=key)
            self._on(command.on_trigger, action, whole=True)
        speed = gui.add_dropdown("speed", _SPEEDS, initial_value="1")
        self._on(speed.on_update, self._set_speed)
        ground = self._ground
        scenes = tuple(dict.fromkeys((str(ground.scene), *SCENES)))
        scene = gui.add_dropdown("scene", scenes, initial_value=str(ground.scene))
        self._on(scene.on_update, lambda name: self._change(scene=name))
        names = get_args(TrackingName)
        follows = gui.add_dropdown("tracking", names, initial_value=ground.tracking)
        self._on(follows.on_update, lambda name: self._change(tracking=name))
        self._said = gui.add_html("")
        gui.add_html(table_html(("opacity:0.6", *row) for row in _HELP))

    def _draw_anew(self) -> None:
        """Draw what is in the scene of the playground, each where it is."""
        server, ground = self._server, self._ground
        with server.atomic():
            server.scene.reset()
            set_stage(server, Drawing(ground.motion))
            _, self._pose = add_skin(server.scene, ground.motion.body)
            self._grips, self._place = _add_grips(server.scene, ground)
            self._on(self._grips.on_drag("left"), self._drag, whole=True)
            _, frames = add_props(server.scene, ground.props)
            named = {p.name: f for p, f in zip(ground.props, frames, strict=True)}
            self._moving = [named[name] for name in ground.things.moving]

    def _show(self) -> None:
        ground = self._ground
        character = ground.character
        with self._server.atomic():
            positions, rotations = character.positions, character.rotations
            self._pose(positions, rotations)
            self._place(positions)
            for frame, (place, turn) in zip(
                self._moving, zip(*ground.things.now, strict=True), strict=True
            ):
                frame.position, frame.wxyz = place, turn
            if perf_counter() - self._told > _BETWEEN:
                self._told = perf_counter()
                self._tell()

    def _tell(self) -> None:
        ground, quiet = self._ground, "opacity:0.6"
        rows = [
            (quiet, "time", f"{ground.time:.1f} s"),
            (quiet, "it does", ground.doing),
            (quiet, "a frame takes", f"{1e3 * self._busy:.0f} of {1e3 / RATE:.0f} ms"),
        ]
        if ground.recording is not None:
            rows.append((quiet, "recorded", f"{ground.recording / RATE:.1f} s"))
        self._status.content = table_html(rows)
        labels = {
            "Let go": "Take hold" if ground.limp else "Let go",
            "Pause": "Pause" if self._playing else "Play",
            "Record": "Record" if ground.recording is None else "End the recording",
        }
        for name, label in labels.items():
            if self._buttons[name].label != label:
                self._buttons[name].label = label

    def _throw_at(self, event: viser.SceneClickEvent) -> None:
        way = np.array(event.ray_direction)
        self._ground.throw(event.ray_origin + _FROM_CAMERA * way, way)

    def _throw(self, event: Any) -> None:
        way = self._from(event)
        way = way / np.linalg.norm(way)
        self._ground.throw(event.client.camera.position + _FROM_CAMERA * way, way)

    def _shove_at(self, event: viser.SceneClickEvent) -> None:
        joint = self._ground.hit_by(event.ray_origin, event.ray_direction)
        if joint is not None:
            self._ground.shove(joint, event.ray_direction)

    def _shove(self, event: Any) -> None:
        chest = self._ground.motion.skeleton.girdle
        self._ground.shove(chest, self._from(event) * [1.0, 0.0, 1.0])

    def _from(self, event: Any) -> Any:
        """Return the way from who asks to the chest [m], shape (3,)."""
        chest = self._ground.motion.skeleton.girdle
        away = self._ground.character.positions[chest] - event.client.camera.position
        return away if np.linalg.norm(away[[0, 2]]) > 0.01 else np.array([0.0, 0, -1])

    def _drag(self, event: Any) -> None:
        if event.phase == "end" or event.instance_index is None:
            self._ground.release()
            return
        joint = self._ground.motion.skeleton.segments[event.instance_index]
        self._ground.drag(joint, event.start_position, event.end_position)

    def _let_go(self, _: object) -> None:
        self._ground.limp = not self._ground.limp

    def _pause(self, _: object) -> None:
        self._playing = not self._playing

    def _restart(self, _: object) -> None:
        self._ground.restart()

    def _set_speed(self, speed: str) -> None:
        self._speed = float(speed)

    def _change(self, **what: Any) -> None:
        self._ground.change(**what)
        self._draw_anew()

    def _record(self, _: object) -> None:
        """Begin to record, or end and write."""
        if self._ground.recording is None:
            self._ground.record()
            self._say("")
            return
        clip, path, number = self._ground.recorded(), self._save, 1
        while path.exists():
            path, number = numbered(self._save, number + 1), number + 1
        write_clip(clip, path)
        self._say(f"wrote {path}, {clip.time[-1]:.1f} s")


def _add_grips(
    scene: viser.SceneApi, ground: Playground
) -> tuple[Any, Callable[[Array], None]]:
    """Add what a pointer grabs: unseen cylinders around all segments."""
    body = ground.motion.body
    ends = body.skeleton.segments
    radii = _TO_GRAB * body.radii[ends]
    rod = cylinder(1.0, 1.0, sections=10)
    grips = add_batch(scene, "/grips", rod, len(ends), (0, 0, 0), shadow=False)
    grips.opacity = 0.0

    def place(positions: Array) -> None:
        now = StickFigure(body.skeleton, positions[None]).at(0)
        grips.batched_positions, grips.batched_wxyzs = now.centers, now.rotations
        grips.batched_scales = np.stack([radii, now.lengths, radii], axis=1)

    return grips, place
