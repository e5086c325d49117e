"""How much of what others send is taken."""

from __future__ import annotations

from collections.abc import Hashable

LARGEST_MESSAGE = 2**15
"""Bytes of a message: twice those of six bodies of 25 joints with all their digits, and
less than a datagram holds."""
MOST_BODIES = 6
"""People at once: as many as a Kinect v2 sees."""
MOST_CONNECTIONS = 8
"""Senders, or readers, at once on a port. A guess: a room of sensors."""
_RATE = 240.0  # messages a second from one sender: eight times a Kinect's
_BURST = 60.0  # messages that may come at once after a pause
_FORGOTTEN = 10.0  # s after which a silent sender of datagrams makes room


class Rate:
    """Lets one sender's messages pass, up to a number a second.

    Args:
        now: The time [s], of any clock that does not go back.
    """

    def __init__(self, now: float) -> None:
        self._left, self.heard = _BURST, now

    def allows(self, now: float) -> bool:
        """Tell whether a message that comes now [s] may pass."""
        self._left = min(_BURST, self._left + (now - self.heard) * _RATE)
        self.heard = now
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True


class Peers:
    """The senders of datagrams, who never say goodbye."""

    def __init__(self) -> None:
        self._rates: dict[Hashable, Rate] = {}

    def rate(self, peer: Hashable, now: float) -> Rate | None:
        """Return a sender's rate, or None where there are too many senders."""
        if peer not in self._rates:
            if len(self._rates) >= MOST_CONNECTIONS:
                self._forget(now)
            if len(self._rates) >= MOST_CONNECTIONS:
                return None
            self._rates[peer] = Rate(now)
        return self._rates[peer]

    def _forget(self, now: float) -> None:
        self._rates = {
            peer: rate
            for peer, rate in self._rates.items()
            if now - rate.heard < _FORGOTTEN
        }
