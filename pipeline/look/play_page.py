"""What the pages of ``play`` share: characters to shove, drag and throw balls at."""

from collections.abc import Callable, Sequence
from functools import partial
from time import perf_counter
from typing import Any

import numpy as np
import viser

from kinefilter.characters import (
    KINECT_V2,
    Body,
    Clip,
    InputError,
    Motion,
    standard_body,
)
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import IDENTITY
from kinefilter.pipeline.physics.playable import Playable
from kinefilter.pipeline.physics.pulled_character import PulledCharacter

from .drawing import Drawing, StickFigure
from .viewer_scene import add_batch, add_props, add_skin, cylinder, set_stage
from .viewer_server import Action, ServedPage, table_html

_STATUS_EVERY = 0.2  # s between two updates of the panel's text
_TO_GRAB = 1.3  # radius in which the pointer grabs a segment, relative to its own
_BALL_SPEED = 10.0  # m/s
_FROM_CAMERA = 0.4  # m in front of the camera, where balls start
_FAR = 100.0  # m: balls that wait there would be specks on the horizon
_AROUND = np.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])  # m: where people may come
_HELP = (
    ("drag a character", "pull and push it"),
    ("click", "throw a ball at this place"),
    ("Shift + click", "shove this part of the body"),
)
Button = tuple[Any, str, str, Action]
"""Key, label, hint, and what is done, given the click."""


class PlayPage(ServedPage):
    """Characters in a scene on one page; all browsers that open it play together."""

    _number: int | None = None  # of the character that buttons act on, None for all

    def __init__(self, server: viser.ViserServer, ground: Playable) -> None:
        super().__init__(server)
        self._ground, self._status_shown = ground, 0.0
        self._skins: set[str] = set()  # names that skins have had so far
        self._add_panel(server.gui)
        self._on(server.scene.on_click(), self._throw_at, whole=True)
        self._on(server.scene.on_click(modifier="shift"), self._shove_at, whole=True)
        self._draw_scene()

    def _add_panel(self, gui: viser.GuiApi) -> None:
        self._status = gui.add_html("")
        self._buttons = {}
        for key, label, hint, action in self._button_rows():
            button = gui.add_button(label, hint=f"key {key}: {hint}")
            self._buttons[label] = button
            self._on(button.on_click, action, whole=True)
            command = gui.add_command(label, hotkey=key)
            self._on(command.on_trigger, action, whole=True)
        self._add_choices(gui)
        self._message = gui.add_html("")
        gui.add_html(table_html(("opacity:0.6", *row) for row in _HELP))

    def _button_rows(self) -> list[Button]:
        return [
            ("P", "Shove", "shove the chest, away from you", self._shove),
            ("B", "Throw a ball", "throw a ball at the chest", self._throw),
            ("G", "Let go", "stop or resume pulling the character", self._let_go),
        ]

    def _add_choices(self, gui: viser.GuiApi) -> None:
        """Add what is chosen from lists."""

    def _status_rows(self) -> list[tuple[str, str]]:
        """Return what the panel tells, with its labels."""
        return [("character", self._ground.doing)]

    def _labels(self) -> dict[str, str]:
        """Return the labels of buttons that now do something else."""
        limp = bool(self._acted_on) and all(c.limp for c in self._acted_on)
        return {"Let go": "Take hold"} if limp else {}

    @property
    def _framed(self) -> Clip:
        """What the camera shows at first."""
        return _still(self._ground.characters)

    def _draw_scene(self) -> None:
        server, ground = self._server, self._ground
        with server.atomic():
            server.scene.reset()
            set_stage(server, Drawing(self._framed))
            self._figures: list[tuple[Any, Any]] = []  # what poses skin and grips
            drawn = set[str]()
            for number, character in enumerate(ground.characters):
                end = str(number + 1) if number else ""
                _, pose = add_skin(server.scene, character.body, f"/mesh{end}")
                drawn.add(f"/mesh{end}")
                grips, place = _add_grips(server.scene, character.body, f"/grips{end}")
                drag = partial(self._drag, number=number)
                self._on(grips.on_drag("left"), drag, whole=True)
                self._figures.append((pose, place))
            # viser's page breaks down where a skin is removed and nothing replaces it.
            for name in self._skins - drawn:
                server.scene.add_frame(name, show_axes=False)
            self._skins |= drawn
            self._moving: list[Any] = []
            if ground.characters:
                props = ground.props
                _, frames = add_props(server.scene, props)
                by_name = {p.name: f for p, f in zip(props, frames, strict=True)}
                self._moving = [by_name[name] for name in ground.scene_props.moving]

    def _show(self) -> None:
        characters = self._ground.characters
        with self._server.atomic():
            drawn = zip(characters, self._figures, strict=True)
            for character, (pose, place_grips) in drawn:
                positions = character.positions
                pose(positions, character.rotations)
                place_grips(positions)
            places = self._ground.scene_props.now if characters else ((), ())
            for frame, place, turn in zip(self._moving, *places, strict=True):
                frame.position, frame.wxyz = place, turn
                if frame.visible != (near := bool(np.abs(place).max() < _FAR)):
                    frame.visible = near
            if perf_counter() - self._status_shown > _STATUS_EVERY:
                self._status_shown, labels = perf_counter(), self._labels()
                rows = self._status_rows()
                self._status.content = table_html(("opacity:0.6", *r) for r in rows)
                for name, button in self._buttons.items():
                    button.label = labels.get(name, name)

    def _throw_at(self, event: viser.SceneClickEvent) -> None:
        self._check_somebody()
        way = np.array(event.ray_direction)
        self._ground.throw(event.ray_origin + _FROM_CAMERA * way, _BALL_SPEED * way)

    def _throw(self, event: Any) -> None:
        *_, way = self._way_to_chest(event)
        way /= np.linalg.norm(way)
        origin = event.client.camera.position + _FROM_CAMERA * way
        self._ground.throw(origin, _BALL_SPEED * way)

    def _shove_at(self, event: viser.SceneClickEvent) -> None:
        self._check_somebody()
        hit = self._ground.hit_by(event.ray_origin, event.ray_direction)
        if hit is not None:
            self._ground.shove(hit[1], event.ray_direction, hit[0])

    def _shove(self, event: Any) -> None:
        number, chest, way = self._way_to_chest(event)
        self._ground.shove(chest, way * [1.0, 0.0, 1.0], number)

    def _way_to_chest(self, event: Any) -> tuple[int, int, Array]:
        """Return who is acted on, the chest, and the way there from the camera [m]."""
        self._check_somebody()
        number = self._number or 0
        chest = self._ground.characters[number].body.skeleton.girdle
        camera = event.client.camera.position
        way = self._ground.characters[number].positions[chest] - camera
        level = np.linalg.norm(way[[0, 2]])
        return number, chest, way if level > 0.01 else np.array([0.0, 0.0, -1.0])

    def _drag(self, event: Any, number: int = 0) -> None:
        gone = number >= len(self._ground.characters)
        if gone or event.phase == "end" or event.instance_index is None:
            self._ground.release()
            return
        segments = self._ground.characters[number].body.skeleton.segments
        joint = segments[event.instance_index]
        self._ground.drag(joint, event.start_position, event.end_position, number)

    def _check_somebody(self) -> None:
        if not self._ground.characters:
            raise InputError("nobody is here yet; stand in front of the sensor")

    @property
    def _acted_on(self) -> Sequence[PulledCharacter]:
        """The characters that the buttons act on."""
        characters, number = self._ground.characters, self._number
        return characters if number is None else characters[number : number + 1]

    def _let_go(self, _: object) -> None:
        limp = all(character.limp for character in self._acted_on)
        for character in self._acted_on:
            character.limp = not limp


def _still(characters: Sequence[PulledCharacter]) -> Clip:
    """Return a clip of where the first character stands, or may, for the camera."""
    if characters:
        body, turns = characters[0].body, np.tile(characters[0].rotations, (2, 1, 1))
        roots = np.tile(characters[0].root, (2, 1))
    else:
        body = standard_body(KINECT_V2)
        turns = np.tile(IDENTITY, (2, len(body.skeleton), 1))
        roots = body.rest_positions[body.skeleton.root] + _AROUND
    time = np.array([0.0, 1.0])
    return Clip.of(Motion(time=time, body=body, root=roots, rotations=turns))


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
