"""The command ``play``."""

from __future__ import annotations

import webbrowser
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from kinefilter.characters import Clip, TrackingName
from kinefilter.pipeline.config import CleanConfig, TakeFormat
from kinefilter.pipeline.extras import require
from kinefilter.pipeline.formats import read_recording
from kinefilter.pipeline.formats.clips import check_writable
from kinefilter.pipeline.formats.export import WHOLE_CLIPS
from kinefilter.pipeline.look.drawing import read_finite_clip

from .terminal import keep, out, progress_bars


@dataclass(frozen=True)
class Play:
    """Play with a character in the browser: push it, throw balls at it, let it fall.

    Prints the address of a page. The character performs a take again and again; the
    mouse drags it and throws balls, buttons and keys let it go and take hold of it,
    pause, slow down, begin again, and record a clip. Needs pip install
    "kinefilter[view]".
    """

    scene: Annotated[Positional[str], arg(metavar="SCENE")] = "basic"
    """What is around the character: a scene (an unknown name lists them), or an MJCF
    file (.xml)."""
    take: Path | None = None
    """What it performs: a take in any of the formats of --format, or a clip, .npz, USD
    or GLB; default: the take that comes with kinefilter."""
    format: TakeFormat | None = None
    """Layout of the take; default: detected from its content."""
    body: int | None = None
    """Which person of the take, counted from 1; default: who is seen in most
    frames."""
    tracking: TrackingName = "game"
    """How the character follows: faithful, as in clean, game: it gives way where it is
    hit, falls and gets up, or ragdoll: not at all."""
    save: Path = Path("play.npz")
    """Where the page records, and nothing else; the next ones to play.2.npz and so on.
    Any suffix of clips."""
    bind: str = "127.0.0.1"
    """Address to listen at; the default is reached from this machine alone. Whoever
    reaches it may play and record."""
    port: int = 0
    """Port to listen at; 0: any that is free."""
    open: bool = False
    """Open the page in this machine's browser."""

    def run(self) -> int:
        """Clean what is performed, serve, wait until it is ended."""
        require("viser", "playing", "view")
        from kinefilter.pipeline.look.player import Player
        from kinefilter.pipeline.look.viewer_server import check_address, opened_server
        from kinefilter.pipeline.physics.playground import Playground
        from kinefilter.scenes import SAMPLE  # loads mujoco

        check_address(self.bind, self.port)
        check_writable(self.save)
        keep(self.save, self.take)
        try:
            ground = Playground(
                self._motion(self.take or SAMPLE), self.scene, self.tracking
            )
            with opened_server(self.bind, self.port) as server:
                player = Player(server, ground, self.save)
                shown = self.take or SAMPLE.name
                out.print(f"{player.address} plays {shown}; Ctrl-C ends")
                if self.open:
                    webbrowser.open(player.address)
                player.run()
        except KeyboardInterrupt:
            pass  # that is how it ends
        return 0

    def _motion(self, path: Path) -> Clip:
        from kinefilter.pipeline.cleaner import clean

        if path.suffix.lower() in WHOLE_CLIPS:
            return read_finite_clip(path)
        take = read_recording(path, format=self.format).take(self.body)
        with progress_bars() as progress:
            return clean(take, CleanConfig(physics=False), progress=progress).clip
