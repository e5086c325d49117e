"""What happened to frames and poses, counted; never more than a few kilobytes."""

from __future__ import annotations

from collections import Counter, deque
from enum import StrEnum
from typing import Any

import numpy as np

from .messages import Reason

_BIN = 1e-4  # s
_BINS = 10_000  # a second; what took longer counts as that
_RECENT = 300  # poses of the status line: ten seconds of one person


class Event(StrEnum):
    """What is counted."""

    FRAMES = "frames in"
    POSES = "poses out"
    FUSED = "of several sensors"
    DROPPED = "dropped, newer came"
    LATE = "late"
    REPEATED = "repeated"
    MISSING = "missing"
    RESTARTED = "clocks restarted"
    UNSEEN = "without a joint"
    RESTED = "bodies gone"
    CROWDED = "too many bodies"
    TOO_FAST = "faster than allowed"
    REFUSED = "connections refused"
    SLOW = "lost by slow readers"
    UNSENT = "not sent"
    FAILED = "people started over"
    DIVERGED = "simulations reset"
    IMPOSSIBLE = "impossible bodies"
    UNRECORDED = "not recorded"


class Latency:
    """A histogram of how long poses took, however many there are."""

    def __init__(self) -> None:
        self._bins = np.zeros(_BINS + 1, dtype=np.int64)
        self._recent: deque[float] = deque(maxlen=_RECENT)
        self.most = 0.0

    def add(self, seconds: float) -> None:
        """Count one [s]."""
        self._bins[min(int(max(seconds, 0.0) / _BIN), _BINS)] += 1
        self._recent.append(seconds)
        self.most = max(self.most, seconds)

    def quantile(self, share: float) -> float:
        """Return the time [s], to 0.1 ms, that a share of all took at most, or NaN."""
        total = np.cumsum(self._bins)
        if not total[-1]:
            return float("nan")
        return float((np.searchsorted(total, share * total[-1]) + 1) * _BIN)

    def recent(self, share: float) -> float:
        """Return the same [s] of the last 300 poses."""
        recent = np.array(self._recent)
        return float(np.quantile(recent, share)) if len(recent) else float("nan")


class Tally:
    """Counts of everything."""

    def __init__(self) -> None:
        self.events: Counter[Event] = Counter()
        self.malformed: Counter[Reason] = Counter()
        self.latency = Latency()
        """From a frame's coming in to its pose's going out."""
        self.notes: dict[int, tuple[str, ...]] = {}
        """What the user should know of the frames of the person in each slot; below 0,
        of each sensor."""

    def count(self, event: Event, times: int = 1) -> None:
        """Count that something happened."""
        self.events[event] += times

    def told(self) -> list[str]:
        """Return all notes, each once."""
        return list(dict.fromkeys(n for notes in self.notes.values() for n in notes))

    def as_json(self) -> dict[str, Any]:
        """Return all counts, and latencies in ms."""
        most, quantile = self.latency.most, self.latency.quantile
        known = {"p50": quantile(0.5), "p99": quantile(0.99), "max": most}
        return {
            **{event.name.lower(): self.events[event] for event in Event},
            "notes": self.told(),
            "malformed": {r.name.lower(): self.malformed[r] for r in Reason},
            "latency_ms": {k: v * 1e3 if most else None for k, v in known.items()},
        }
