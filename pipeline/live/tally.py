"""Counts and latencies of a live session, in a few kilobytes however long it runs."""

from collections import Counter, deque
from enum import StrEnum
from typing import Any

import numpy as np

from .messages import Reason

_BIN = 1e-4  # s
_BINS = 10_000  # one second; longer latencies are counted in the last bin
_RECENT = 300  # poses in the status line: ten seconds of one person


class Event(StrEnum):
    """What is counted; in JSON by name, on the terminal by value."""

    FRAMES = "frames in"
    POSES = "poses out"
    OBEYED = "commands"
    FUSED = "fused from several sensors"
    DROPPED = "dropped for a newer frame"
    LATE = "late"
    REPEATED = "repeated"
    MISSING = "missing"
    RESTARTED = "clock restarts"
    UNSEEN = "without a visible joint"
    RESTED = "people left"
    EXCHANGED = "ids exchanged"
    CROWDED = "over the limit of bodies"
    TOO_FAST = "over the rate limit"
    REFUSED = "connections refused"
    SLOW = "lost by slow readers"
    UNSENT = "not sent"
    FAILED = "people started over"
    DIVERGED = "simulations reset"
    IMPOSSIBLE = "impossible bodies"
    UNRECORDED = "not recorded"


class Latency:
    """Histogram of pose latencies, of constant size."""

    def __init__(self) -> None:
        self._bins = np.zeros(_BINS + 1, dtype=np.int64)
        self._recent: deque[float] = deque(maxlen=_RECENT)
        self.most = 0.0

    def add(self, seconds: float) -> None:
        """Count one latency [s]."""
        self._bins[min(int(max(seconds, 0.0) / _BIN), _BINS)] += 1
        self._recent.append(seconds)
        self.most = max(self.most, seconds)

    def quantile(self, share: float) -> float:
        """Return a quantile of all latencies [s], to 0.1 ms; NaN without any."""
        total = np.cumsum(self._bins)
        if not total[-1]:
            return float("nan")
        return float((np.searchsorted(total, share * total[-1]) + 1) * _BIN)

    def recent(self, share: float) -> float:
        """Return a quantile of the last 300 latencies [s]; NaN without any."""
        return float(np.quantile(self._recent, share)) if self._recent else float("nan")


class Tally:
    """Event counts, latencies and notes of a session."""

    def __init__(self) -> None:
        self.events: Counter[Event] = Counter()
        self.malformed: Counter[Reason] = Counter()
        self.latency = Latency()  # from the arrival of a frame to sending its pose
        # What the user should know: by person's slot, -1, -2, ... for the sensors, or
        # the reason of the first malformed frame, or of stamps that are no seconds.
        self.notes: dict[int | Reason, tuple[str, ...]] = {}

    def all_notes(self) -> list[str]:
        """Return all notes, without repeats."""
        return list(dict.fromkeys(n for notes in self.notes.values() for n in notes))

    def as_json(self) -> dict[str, Any]:
        """Return all counts, and latencies in ms."""
        most, quantile = self.latency.most, self.latency.quantile
        known = {"p50": quantile(0.5), "p99": quantile(0.99), "max": most}
        return {
            **{event.name.lower(): self.events[event] for event in Event},
            "notes": self.all_notes(),
            "malformed": {r.name.lower(): self.malformed[r] for r in Reason},
            "latency_ms": {k: v * 1e3 if most else None for k, v in known.items()},
        }
