"""``kinefilter replay``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from kinefilter.pipeline.config import TakeFormat

from .terminal import err

if TYPE_CHECKING:
    from kinefilter.characters import Take
    from kinefilter.pipeline.live.endpoints import Address


@dataclass(frozen=True)
class Replay:
    """Send a recorded take to 'kinefilter live', at its own time stamps."""

    take: Positional[Path]
    """Recording in any of the formats of --format; .gz too."""
    out: Annotated[str, arg(metavar="ADDRESS")]
    """Where to send frames: udp://HOST:PORT, ws://HOST:PORT, wss://HOST:PORT, or - for
    the standard output."""
    speed: float = 1.0
    """Speed relative to that of the recording."""
    loop: bool = False
    """Begin again at the end."""
    token_file: Path | None = None
    """File with the token that the WebSocket server asks for."""
    certificate: Path | None = None
    """Certificate (PEM) to confidence for wss, besides those of the system."""
    format: TakeFormat | None = None
    """Layout of the take; default: detected from its content."""

    def run(self) -> int:
        """Send until the take ends."""
        import asyncio

        from kinefilter.pipeline.formats.takes import read_recording
        from kinefilter.pipeline.live.endpoints import read_address

        address = read_address(self.out, ("udp", "ws", "wss", "-"))
        takes = read_recording(self.take, format=self.format).takes
        sent = asyncio.run(self._sent(takes, address))
        frames = f"{sent} frame{'s' * (sent != 1)}"
        err.print(f"sent {frames} of {takes[0].skeleton.name}")
        return 0

    async def _sent(self, takes: tuple[Take, ...], address: Address) -> int:
        import asyncio

        from kinefilter.pipeline.live import open_sender, replay

        from .terminal import stopped_by_signals

        stop = asyncio.Event()
        with stopped_by_signals(stop):
            async with open_sender(
                address, token_file=self.token_file, certificate=self.certificate
            ) as sender:
                return await replay(
                    takes, sender, stop, speed=self.speed, loop=self.loop
                )
