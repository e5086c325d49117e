"""The panel of the page: what one can press, pull and choose."""

from __future__ import annotations

from typing import Any

import viser

from .contact_edits import PARTS

STEPS = {"-10": -10, "-1": -1, "+1": 1, "+10": 10}
"""Frames that the buttons go on by, by what is written on them."""
BESIDE = "raw beside"
"""Checkbox that puts the raw take beside the character."""
SHADOWS = "shadows"
"""Checkbox of the shadows, half of the work where no GPU draws."""

_SPEEDS = ("0.1", "0.25", "0.5", "1", "2", "4")


class Panel:
    """Everything beside the scene. It shows, and does nothing by itself.

    Args:
        gui: Where it is built.
        frames: How many the motion has.
        layers: What can be shown, by name, and whether it is at first.
        cleans: Whether the take can be cleaned again.
    """

    def __init__(
        self, gui: viser.GuiApi, frames: int, layers: dict[str, bool], *, cleans: bool
    ) -> None:
        gui.configure_theme(
            control_width="large", show_logo=False, show_share_button=False
        )
        gui.set_panel_label("kinefilter")
        gui.main_panel.dock_right()
        last = max(frames, 2)  # a slider from 1 to 1 cannot be drawn
        self.status = gui.add_html("")
        self.frame = gui.add_slider("frame", 1, last, 1, 1)
        self.play = gui.add_button("Play", icon=viser.Icon.PLAYER_PLAY, hint="key K")
        self.step = gui.add_button_group("step", tuple(STEPS), hint="keys J and L")
        # As in editors of videos; space would press the button that was last used too.
        self.keys = {
            "play": gui.add_command("Play or pause", hotkey="K"),
            "back": gui.add_command("A frame back", hotkey="J"),
            "on": gui.add_command("A frame on", hotkey="L"),
        }
        self.speed = gui.add_dropdown("speed", _SPEEDS, initial_value="1")
        with gui.add_folder("Foot contacts"):
            self.timeline = gui.add_html("")
            self.span = gui.add_multi_slider("frames", 1, last, 1, (1, last))
            self.ends = gui.add_button_group("set", ("from here", "to here", "all"))
            self.part = gui.add_dropdown("part", tuple(PARTS))
            self.edit = gui.add_button_group("edit", ("stands", "lifts", "undo"))
            self.save = gui.add_button("Save contacts")
            self.again = gui.add_button("Save and clean again", visible=cleans)
            self.said = gui.add_html("")
            self.busy = gui.add_progress_bar(0.0, visible=False, animated=True)
        with gui.add_folder("Show"):
            self.layers = {
                name: gui.add_checkbox(name, shown) for name, shown in layers.items()
            }
            if "raw" in layers:
                self.layers[BESIDE] = gui.add_checkbox(BESIDE, True)
            self.layers[SHADOWS] = gui.add_checkbox(SHADOWS, True)

    @property
    def chosen(self) -> set[str]:
        """Names of what is to be seen."""
        return {name for name, box in self.layers.items() if box.value}

    @property
    def first_and_last(self) -> tuple[int, int]:
        """First and last of the frames to edit, counted from 0."""
        first, last = self.span.value
        return int(first) - 1, int(last) - 1

    def choose_frames(self, first: int, last: int) -> None:
        """Choose frames to edit, counted from 0."""
        _put(self.span, (first + 1, last + 1))

    def show_frame(self, frame: int) -> None:
        """Put the slider to a frame, counted from 0."""
        _put(self.frame, frame + 1)

    def show_work(self, share: float | None) -> None:
        """Show how far work is, 0 to 1; None: there is none."""
        self.busy.visible = share is not None
        _put(self.busy, 100.0 * (share or 0.0))

    def show_playing(self, playing: bool) -> None:
        """Let the button say what it does next."""
        self.play.label = "Pause" if playing else "Play"
        icon = viser.Icon.PLAYER_PAUSE if playing else viser.Icon.PLAYER_PLAY
        if self.play.icon != icon:
            self.play.icon = icon


def _put(handle: Any, value: object) -> None:
    """Set what an input shows: viser declares it so that mypy takes it for constant."""
    handle.value = value
