"""The page of ``play``: characters to shove, throw balls at, drag and let go."""

from collections.abc import Callable, Sequence
from functools import partial
from itertools import count
from pathlib import Path
from time import perf_counter
from typing import Any, get_args

import numpy as np
import viser

from kinefilter.characters import Body, TrackingName
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.formats import write_clip
from kinefilter.pipeline.formats.files import numbered
from kinefilter.pipeline.physics.playground import RATE, Playground
from kinefilter.pipeline.physics.pulled_character import PulledCharacter
from kinefilter.scenes import SCENES

from .drawing import Drawing, StickFigure
from .viewer_scene import add_batch, add_props, add_skin, cylinder, set_stage
from .viewer_server import Action, ServedPage, table_html

_SPEEDS = ("1", "0.5", "0.25", "0.1")
_MAX_DELAY = 0.25  # s: a longer delay is skipped, not caught up
_STATUS_EVERY = 0.2  # s between two updates of the panel's text
_TO_GRAB = 1.3  # radius in which the pointer grabs a segment, relative to its own
_FROM_CAMERA = 0.4  # m in front of the camera, where balls start
_HELP = (
    ("drag a character", "pull and push it"),
    ("click", "throw a ball at this place"),
    ("Shift + click", "shove this part of the body"),
)


class Player(ServedPage):
    """A playground on one page; every browser that opens it plays with the same.

    Only recordings are written: to ``save``, or if that exists to ``NAME.2`` and so on.
    """

    def __init__(
        self, server: viser.ViserServer, playground: Playground, save: Path
    ) -> None:
        super().__init__(server)
        self._playground, self._save = playground, save
        self._playing, self._speed = True, 1.0
        self._status_shown = self._busy = 0.0
        self._add_panel(server.gui)
        self._on(server.scene.on_click(), self._throw_at, whole=True)
        self._on(server.scene.on_click(modifier="shift"), self._shove_at, whole=True)
        self._draw_scene()

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

    def _add_panel(self, gui: viser.GuiApi) -> None:
        playground, path = self._playground, self._save
        self._status = gui.add_html("")
        buttons: tuple[tuple[Any, str, str, Action], ...] = (
            ("P", "Shove", "shove the chest, away from you", self._shove),
            ("B", "Throw a ball", "throw a ball at the chest", self._throw),
            ("G", "Let go", "stop or resume pulling the character", self._let_go),
            ("K", "Pause", "pause or resume", self._pause),
            ("R", "Restart", "put everything back", lambda _: playground.restart()),
            ("C", "Record", f"record a clip, {path}", self._record),
        )
        self._buttons = {}
        for key, label, hint, action in buttons:
            button = gui.add_button(label, hint=f"key {key}: {hint}")
            self._buttons[label] = button
            self._on(button.on_click, action, whole=True)
            command = gui.add_command(label, hotkey=key)
            self._on(command.on_trigger, action, whole=True)
        speed = gui.add_dropdown("speed", _SPEEDS, initial_value="1")
        self._on(speed.on_update, self._set_speed)
        scenes = tuple(dict.fromkeys((str(playground.scene), *SCENES)))
        scene = gui.add_dropdown("scene", scenes, initial_value=scenes[0])
        self._on(scene.on_update, lambda name: self._change(scene=name))
        names, now = get_args(TrackingName), playground.tracking
        tracking = gui.add_dropdown("tracking", names, initial_value=now)
        self._on(tracking.on_update, lambda name: self._change(tracking=name))
        self._number: int | None = None  # of the character that buttons act on
        if (count := len(playground.characters)) > 1:
            everyone = ("all", *map(str, range(1, count + 1)))
            chosen = gui.add_dropdown("character", everyone, initial_value="all")
            self._on(chosen.on_update, self._choose)
        self._message = gui.add_html("")
        gui.add_html(table_html(("opacity:0.6", *row) for row in _HELP))

    def _draw_scene(self) -> None:
        server, playground = self._server, self._playground
        with server.atomic():
            server.scene.reset()
            set_stage(server, Drawing(playground.motion))
            self._figures: list[tuple[Any, Any]] = []  # what poses skin and grips
            for number, motion in enumerate(playground.motions):
                end = str(number + 1) if number else ""
                _, pose = add_skin(server.scene, motion.body, f"/mesh{end}")
                grips, place = _add_grips(server.scene, motion.body, f"/grips{end}")
                drag = partial(self._drag, number=number)
                self._on(grips.on_drag("left"), drag, whole=True)
                self._figures.append((pose, place))
            _, frames = add_props(server.scene, playground.props)
            names = [prop.name for prop in playground.props]
            by_name = dict(zip(names, frames, strict=True))
            self._moving = [by_name[name] for name in playground.scene_props.moving]

    def _show(self) -> None:
        characters, things = self._playground.characters, self._playground.scene_props
        with self._server.atomic():
            drawn = zip(characters, self._figures, strict=True)
            for character, (pose, place_grips) in drawn:
                positions = character.positions
                pose(positions, character.rotations)
                place_grips(positions)
            for frame, place, turn in zip(self._moving, *things.now, strict=True):
                frame.position, frame.wxyz = place, turn
            if perf_counter() - self._status_shown > _STATUS_EVERY:
                self._status_shown = perf_counter()
                self._show_status()

    def _show_status(self) -> None:
        playground, recorded = self._playground, self._playground.recording
        rows = [
            ("time", f"{playground.time:.1f} s"),
            ("character", playground.doing),
            ("time per frame", f"{1e3 * self._busy:.0f} of {1e3 / RATE:.0f} ms"),
        ]
        if recorded is not None:
            rows.append(("recorded", f"{recorded / RATE:.1f} s"))
        self._status.content = table_html(("opacity:0.6", *row) for row in rows)
        limp = all(character.limp for character in self._acted_on)
        label = {
            "Let go": "Take hold" if limp else "Let go",
            "Pause": "Pause" if self._playing else "Resume",
            "Record": "Record" if recorded is None else "Stop recording",
        }
        for name, button in self._buttons.items():
            button.label = label.get(name, name)

    def _throw_at(self, event: viser.SceneClickEvent) -> None:
        way = np.array(event.ray_direction)
        self._playground.throw(event.ray_origin + _FROM_CAMERA * way, way)

    def _throw(self, event: Any) -> None:
        *_, way = self._way_to_chest(event)
        way /= np.linalg.norm(way)
        self._playground.throw(event.client.camera.position + _FROM_CAMERA * way, way)

    def _shove_at(self, event: viser.SceneClickEvent) -> None:
        hit = self._playground.hit_by(event.ray_origin, event.ray_direction)
        if hit is not None:
            self._playground.shove(hit[1], event.ray_direction, hit[0])

    def _shove(self, event: Any) -> None:
        number, chest, way = self._way_to_chest(event)
        self._playground.shove(chest, way * [1.0, 0.0, 1.0], number)

    def _way_to_chest(self, event: Any) -> tuple[int, int, Array]:
        """Return who is acted on, the chest, and the way there from the camera [m]."""
        number = self._number or 0
        chest = self._playground.motions[number].skeleton.girdle
        camera = event.client.camera.position
        way = self._playground.characters[number].positions[chest] - camera
        level = np.linalg.norm(way[[0, 2]])
        return number, chest, way if level > 0.01 else np.array([0.0, 0.0, -1.0])

    def _drag(self, event: Any, number: int = 0) -> None:
        if event.phase == "end" or event.instance_index is None:
            self._playground.release()
            return
        segments = self._playground.motions[number].skeleton.segments
        joint = segments[event.instance_index]
        self._playground.drag(joint, event.start_position, event.end_position, number)

    @property
    def _acted_on(self) -> Sequence[PulledCharacter]:
        """The characters that the buttons act on."""
        characters, number = self._playground.characters, self._number
        return characters if number is None else characters[number : number + 1]

    def _let_go(self, _: object) -> None:
        limp = all(character.limp for character in self._acted_on)
        for character in self._acted_on:
            character.limp = not limp

    def _choose(self, name: str) -> None:
        self._number = None if name == "all" else int(name) - 1

    def _pause(self, _: object) -> None:
        self._playing = not self._playing

    def _set_speed(self, speed: str) -> None:
        self._speed = float(speed)

    def _change(self, **what: Any) -> None:
        if "scene" in what:  # the props are others
            self._report(self.save_recording())
        self._playground.change(**what)
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
        clips = self._playground.recorded()
        bodies = range(1, len(clips) + 1) if len(clips) > 1 else (None,)
        names = (numbered(self._save, k if k > 1 else None) for k in count(1))
        recordings = ([numbered(name, body) for body in bodies] for name in names)
        paths = next(r for r in recordings if not any(path.exists() for path in r))
        for clip, to in zip(clips, paths, strict=True):
            write_clip(clip, to)
        return f"wrote {', '.join(map(str, paths))}, {clips[0].time[-1]:.1f} s"


def _add_grips(
    scene: viser.SceneApi, body: Body, name: str
) -> tuple[Any, Callable[[Array], None]]:
    """Add invisible cylinders to grab segments by; also return what places them."""
    ends = body.skeleton.segments
    radii = _TO_GRAB * body.radii[ends]
    rod = cylinder(1.0, 1.0, sections=10)
    grips = add_batch(scene, name, rod, len(ends), (0, 0, 0))
    grips.opacity, grips.cast_shadow = 0.0, False

    def place(positions: Array) -> None:
        now = StickFigure(body.skeleton, positions[None]).at(0)
        grips.batched_positions, grips.batched_wxyzs = now.centers, now.rotations
        grips.batched_scales = np.stack([radii, now.lengths, radii], axis=1)

    return grips, place
