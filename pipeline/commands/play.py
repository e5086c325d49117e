"""The command ``play``."""

import asyncio
import webbrowser
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, UseAppendAction, arg

from kinefilter.characters import Clip, InputError, TrackingName
from kinefilter.pipeline.config import CleanConfig, TakeFormat
from kinefilter.pipeline.extras import require
from kinefilter.pipeline.formats.clips import check_writable
from kinefilter.pipeline.formats.export import WHOLE_CLIPS
from kinefilter.pipeline.live.background import meanwhile
from kinefilter.pipeline.look.drawing import read_finite_clip
from kinefilter.pipeline.settings import Settings

from .terminal import keep, out, progress_bars, stopped_by_signals


@dataclass(frozen=True)
class Play:
    """Interact with a character in the browser: push it, throw balls, let it fall.

    Prints the address of a page. The character performs a take in a loop; drag it or
    throw balls with the mouse, and use buttons and keys to release and reattach it,
    pause, slow down, restart, and record a clip. Several characters share the scene and
    push each other, and each is recorded to a clip of its own. With --in, the people in
    front of a sensor play instead. Needs pip install "kinefilter[view]", and for --in
    "kinefilter[live]".
    """

    scene: Annotated[Positional[str], arg(metavar="SCENE")] = "basic"
    """Surroundings: a scene (an unknown name lists the scenes), or an MJCF file
    (.xml)."""
    take: UseAppendAction[tuple[Path, ...]] = ()
    """The motion to perform: a take in any of the formats of --format, or a clip (.npz,
    USD or GLB); default: the sample take. Repeat it for several characters, who begin
    beside each other."""
    sources: UseAppendAction[
        Annotated[tuple[str, ...], arg(name="in", metavar="ADDRESS")]
    ] = ()
    """Where to listen for frames of people, as for 'live'; instead of --take."""
    skeleton: Literal["kinect_v1", "kinect_v2"] = "kinect_v2"
    """Skeleton whose joints these frames contain."""
    height: float | None = None
    """Height of these people [m]; default: each is measured in the first second."""
    format: TakeFormat | None = None
    """Format of the take; default: detected from its content."""
    body: int | Literal["all"] | None = None
    """Number of the person in the take, from 1, or 'all', who begin where they were to
    each other; default: the one seen in most frames."""
    tracking: TrackingName = "game"
    """How the character follows the motion: faithful, as in clean; game, which gives
    way when hit, falls and gets up; or ragdoll, which does not follow."""
    save: Path = Path("play.npz")
    """File that the page records to, in any clip format; further recordings go to
    play.2.npz and so on, with .1, .2 and so on added for several characters. The page
    writes nothing else."""
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
        if self.sources:
            return self._live()
        if self.height is not None:
            raise InputError("--height is for people in front of a sensor; give --in")
        check_writable(self.save)
        keep(self.save, *self.take)
        if self.body == "all" and len(self.take) > 1:
            raise InputError("--body all needs a single --take")
        with suppress(KeyboardInterrupt):  # the regular way to quit
            takes = self.take or (SAMPLE,)
            motions = [motion for path in takes for motion in self._motions(path)]
            placed = self.body == "all"
            ground = Playground(motions, self.scene, self.tracking, placed=placed)
            with opened_server(self.bind, self.port) as server:
                player = Player(server, ground, self.save)
                shown = ", ".join(map(str, self.take)) or SAMPLE.name
                out.print(f"{player.address} plays {shown}; press Ctrl-C to quit")
                if self.open:
                    webbrowser.open(player.address)
                try:
                    player.run()
                finally:
                    if (ground.recording or 0) > 1:
                        out.print(player.save_recording())
        return 0

    def _live(self) -> int:
        """Serve the page of the people in front of sensors until interrupted."""
        require("websockets", "following people", "live")
        from kinefilter.pipeline.live.live_config import LiveConfig
        from kinefilter.pipeline.live.live_session import Session
        from kinefilter.pipeline.look.live_page import LivePage
        from kinefilter.pipeline.look.viewer_server import opened_server

        if self.take:
            raise InputError("--in is played instead of --take; give only one of them")
        how = {name: getattr(self, name) for name in ("scene", "tracking", "height")}
        config = LiveConfig(self.sources, (), skeleton=self.skeleton, **how)
        session = Session(config, shown=True)
        with opened_server(self.bind, self.port) as server:
            page = LivePage(server, session)

            def started(used: Sequence[object]) -> None:
                heard = ", ".join(map(str, used))
                out.print(f"{page.address} plays {heard}; press Ctrl-C to quit")
                if self.open:
                    webbrowser.open(page.address)

            async def follow() -> None:
                stop = asyncio.Event()
                with stopped_by_signals(stop):
                    async with meanwhile(page.follow()) as (drawing,):
                        drawing.add_done_callback(lambda _: stop.set())
                        await session.run(stop, started)

            asyncio.run(follow())
        return 0

    def _motions(self, path: Path) -> list[Clip]:
        if path.suffix.lower() in WHOLE_CLIPS:
            return [read_finite_clip(path)]
        config, clips = CleanConfig(physics=False), list[Clip]()
        settings = Settings(config, format=self.format, body=self.body)
        read = [settings.read(path)]
        with progress_bars() as progress:
            cleaned = settings.clean(read, settings.people(read), progress=progress)
            for _, result, _ in cleaned:
                if isinstance(result, InputError):
                    raise result
                clips.append(result.clip)
        return clips
