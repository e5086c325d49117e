"""Poses sent to an engine's VMC port, as datagrams."""

from __future__ import annotations

from .datagrams import Datagrams
from .poses import LivePose
from .tally import Event, Tally
from .vmc import VmcFigure, absence


class Engine:
    """Sends each person to a port of their own: the first to PORT, the next to PORT+1.

    Where nobody listens datagrams are lost, as they are meant to be: an engine that
    comes back goes on with the next pose.

    Args:
        out: Sends to the first port.
        tally: What counts datagrams that the system does not take.
    """

    def __init__(self, out: Datagrams, tally: Tally) -> None:
        self._out, self._tally = out, tally
        self._figures: dict[int, VmcFigure] = {}
        self._since: float | None = None

    def send(self, live: LivePose) -> None:
        """Send the datagrams of a pose."""
        figure = self._figures.get(live.slot)
        if figure is None or figure.body is not live.body:
            figure = self._figures[live.slot] = VmcFigure(live.body)
        if self._since is None:
            self._since = live.time
        for datagram in figure.bundles(live.pose, live.time - self._since):
            self._send(live.slot, datagram)

    def gone(self, body: str, slot: int) -> None:  # noqa: ARG002 - as all sinks
        """Say that nobody is there."""
        self._send(slot, absence())

    async def flushed(self) -> None:
        """Do not wait: datagrams do not."""

    def _send(self, slot: int, datagram: bytes) -> None:
        if not self._out.send(datagram, further=slot):
            self._tally.count(Event.UNSENT)
