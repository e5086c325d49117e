"""The command ``play``."""

from __future__ import annotations

import webbrowser
from contextlib import suppress
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
    """Interact with a character in the browser: push it, throw balls, let it fall.

    Prints the address of a page. The character performs a take in a loop; drag it or
    throw balls with the mouse, and use buttons and keys to release and reattach it,
    pause, slow down, restart, and record a clip. Needs pip install "kinefilter[view]".
    """

    scene: Annotated[Positional[str], arg(metavar="SCENE")] = "basic"
    """Surroundings: a scene (an unknown name lists the scenes), or an MJCF file
    (.xml)."""
    take: Path | None = None
    """The motion to perform: a take in any of the formats of --format, or a clip (.npz,
    USD or GLB); default: the sample take."""
    format: TakeFormat | None = None
    """Format of the take; default: detected from its content."""
    body: int | None = None
    """Number of the person in the take, from 1; default: the one seen in most
    frames."""
    tracking: TrackingName = "game"
    """How the character follows the motion: faithful, as in clean; game, which gives
    way when hit, falls and gets up; or ragdoll, which does not follow."""
    save: Path = Path("play.npz")
    """File that the page records to, in any clip format; further recordings go to
    play.2.npz and so on. The page writes nothing else."""
    bind: str = "127.0.0.1"
    """Address to listen on; the default accepts connections from this machine only.
    Anyone who can connect may play and record."""
    port: int = 0
    """Port to listen on; 0 picks a free one."""
    open: bool = False
    """Open the page in the default browser."""

    def run(self) -> int:
        """Clean the take, and serve the page until interrupted."""
        require("viser", "playing", "view")
        from kinefilter.pipeline.look.player import Player
        from kinefilter.pipeline.look.viewer_server import check_address, opened_server
        from kinefilter.pipeline.physics.playground import Playground
        from kinefilter.scenes import SAMPLE  # loads mujoco

        check_address(self.bind, self.port)
        check_writable(self.save)
        keep(self.save, self.take)
        with suppress(KeyboardInterrupt):  # the regular way to quit
            ground = Playground(
                self._motion(self.take or SAMPLE), self.scene, self.tracking
            )
            with opened_server(self.bind, self.port) as server:
                player = Player(server, ground, self.save)
                shown = self.take or SAMPLE.name
                out.print(f"{player.address} plays {shown}; press Ctrl-C to quit")
                if self.open:
                    webbrowser.open(player.address)
                player.run()
        return 0

    def _motion(self, path: Path) -> Clip:
        from kinefilter.pipeline.cleaner import clean

        if path.suffix.lower() in WHOLE_CLIPS:
            return read_finite_clip(path)
        take = read_recording(path, format=self.format).take(self.body)
        with progress_bars() as progress:
            return clean(take, CleanConfig(physics=False), progress=progress).clip
