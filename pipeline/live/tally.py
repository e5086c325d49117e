"""What happened to frames and poses, counted; never more than a few kilobytes."""

from __future__ import annotations

from collections import Counter, deque
from enum import StrEnum
from typing import Any

import numpy as np

from .messages import Reason

_BIN = 1e-4  # s
_BINS = 10_000  # a second; what took longer counts as that
_RECENT = 300  # poses that the status line speaks of: ten seconds of one person


class Event(StrEnum):
    """What can happen."""

    FRAMES = "frames in"
    POSES = "poses out"
    DROPPED = "dropped, newer came"
    LATE = "late"
    REPEATED = "repeated"
    MISSING = "missing"
    RESTARTED = "clocks begun anew"
    UNSEEN = "without a joint"
    RESTED = "bodies gone"
    CROWDED = "bodies too many"
    TOO_FAST = "faster than allowed"
    REFUSED = "connections refused"
    SLOW = "lost by slow readers"
    UNSENT = "not sent"
    FAILED = "people measured or followed anew"
    DIVERGED = "simulations begun anew"
    UNRECORDED = "not recorded"


class Latency:
    """How long poses took: a histogram of any number of them."""

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
        """Return the time [s] that a share of all stayed under, to 0.1 ms, or NaN."""
        total = np.cumsum(self._bins)
        if not total[-1]:
            return float("nan")
        return float((np.searchsorted(total, share * total[-1]) + 1) * _BIN)

    def recent(self, share: float) -> float:
        """Return the same of the last 300 [s]."""
        if not self._recent:
            return float("nan")
        return float(np.quantile(np.array(self._recent), share))


class Tally:
    """Counts of everything."""

    def __init__(self) -> None:
        self.events: Counter[Event] = Counter()
        self.malformed: Counter[Reason] = Counter()
        self.latency = Latency()
        """From a frame's coming in to its pose's going out."""

    def count(self, event: Event, times: int = 1) -> None:
        """Count that something happened."""
        self.events[event] += times

    def as_json(self) -> dict[str, Any]:
        """Return all counts, and latencies in ms."""
        latency = self.latency
        known = latency.most > 0.0
        return {
            **{event.name.lower(): self.events[event] for event in Event},
            "malformed": {
                reason.name.lower(): self.malformed[reason] for reason in Reason
            },
            "latency_ms": {
                "p50": latency.quantile(0.5) * 1e3 if known else None,
                "p99": latency.quantile(0.99) * 1e3 if known else None,
                "max": latency.most * 1e3 if known else None,
            },
        }
