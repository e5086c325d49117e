"""The page of ``play --in``: people in front of sensors, in the scene they share."""

import asyncio

import viser

from kinefilter.pipeline.live.live_session import Session
from kinefilter.pipeline.live.tally import Event

from .play_page import PlayPage

_RATE = 30.0  # 1/s, at which the page is drawn


class LivePage(PlayPage):
    """The shared scene of a live session on one page; all browsers see the same."""

    def __init__(self, server: viser.ViserServer, session: Session) -> None:
        assert session.scene is not None
        self._session, self._people = session, session.scene.people
        super().__init__(server, session.scene)

    async def follow(self) -> None:
        """Draw people until cancelled, in the event loop of the session."""
        scene = self._session.scene
        assert scene is not None
        while self._serve(0.0):
            if scene.people is not self._people:
                self._people = scene.people
                self._report("")  # that nobody was there, for instance
                self._draw_scene()
            self._show()
            await asyncio.sleep(1.0 / _RATE)

    def _status_rows(self) -> list[tuple[str, str]]:
        events = self._session.tally.events
        frames = f"{events[Event.FRAMES]} in, {events[Event.POSES]} poses"
        rows = [("people", str(len(self._people))), ("frames", frames)]
        return rows + super()._status_rows() if self._people else rows
