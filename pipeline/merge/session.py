"""Takes that several sensors recorded of the same person at the same time, made one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from kinefilter.characters import InputError, Skeleton, Take
from kinefilter.characters.arrays import Array, Flags, Indices
from kinefilter.pipeline.formats.recording import Recording
from kinefilter.pipeline.progress import Progress, over, silent
from kinefilter.pipeline.reliability import column_medians

from .alignment import HERE, Alignment
from .fusion import Fused, Fusion, Sight
from .lag import Track
from .person import find_person

_NEAREST = 0.6  # of a frame: others of the same moment are no frames of their own


@dataclass(frozen=True, eq=False)
class Merged:
    """What several sensors recorded of a person, as one take."""

    take: Take
    """At the first sensor's clock and in its frame."""
    reliability: Array
    """Mean reliability of the sensors that count, shape (T, J)."""
    shares: Array
    """How much of each joint is of which sensor, adding up to 1 or 0, (T, S, J)."""
    exchanged: Flags
    """Which sensors had left and right exchanged, shape (T, S)."""
    seen: tuple[Array, ...]
    """Each sensor's joints at the frames of the take, in its frame [m], (T, J, 3)."""
    alignments: tuple[Alignment, ...]
    """Of the second sensor, the third and so on."""
    takes: tuple[Take, ...]
    """Each sensor's take of the person, with gross failures mended."""
    notes: tuple[str, ...] = ()
    """What users should know about who is who."""

    def untangled(self) -> list[tuple[Take, Array]]:
        """Return each sensor's take with its sides as all sensors have them.

        With times [s] (T,) of its frames, counted from the merged take's first.
        """
        takes = []
        for k, take in enumerate(self.takes):
            time = (HERE, *self.alignments)[k].clock.undone(take.time)
            frames = np.searchsorted(self.take.time, time)
            frames = frames.clip(max=len(self.take) - 1)
            since = time - self.take.time[0]
            takes.append((take.exchanged(self.exchanged[frames, k]), since))
        return takes

    @property
    def sources(self) -> tuple[str, ...]:
        """Where the takes came from."""
        return tuple(take.source for take in self.takes)

    @property
    def residuals(self) -> Array:
        """Distance of each sensor's joints from the merged ones [m], (S, T, J)."""
        apart = np.stack(self.seen) - self.take.positions
        return np.asarray(np.linalg.norm(apart, axis=3))

    def figures(self) -> dict[str, Any]:
        """Return where, when and how much each sensor is, and what is unsure."""
        apart = column_medians(self.residuals.reshape(len(self.takes), -1).T)
        rows = []
        for k, (source, (clock, placed, *_)) in enumerate(
            zip(self.sources, (HERE, *self.alignments), strict=True)
        ):
            x, _, z = placed.turn.apply([0.0, 0.0, 1.0])
            rows.append(
                {
                    "source": source,
                    "lag_seconds": clock.lag - clock.start,
                    "drift": clock.drift,
                    "turned_degrees": float(np.degrees(np.arctan2(x, z))),
                    "away_meters": float(np.linalg.norm(placed.shift)),
                    "share": float(self.shares[:, k].mean()),
                    "apart_meters": float(apart[k]),
                }
            )
        return {"frames": len(self.take), "sensors": rows, "notes": list(self.told())}

    def told(self) -> Iterator[str]:
        """Yield what is unsure, and what to do about it."""
        yield from self.notes
        for source, found in zip(self.sources[1:], self.alignments, strict=True):
            if not found.clock_is_sure:
                yield (
                    f"{source}: people hardly move, so that its lag is unsure; give a "
                    "--calibration from another take of the session"
                )
            elif not found.place_is_sure:
                yield (
                    f"{source}: people stay where they are, so that where the sensor "
                    "is may be off by 30 degrees; give a --calibration from another "
                    "take of the session"
                )


def merge(
    takes: Sequence[Take | Recording],
    *,
    body: int | None = None,
    calibration: Sequence[Alignment] = (),
    progress: Progress = silent,
) -> Merged:
    """Return one take of a person whom several sensors recorded.

    Args:
        takes: What each sensor recorded, of a person or of everybody; the first one's
            clock and frame are those of the merged take.
        body: Which person of the first recording, from 1; by default the main one. In
            the others it is whoever is there at the same time; sensors that do not see
            the person are left out.
        calibration: Where and when the other sensors are, as far as these takes do not
            tell it.
        progress: Wraps the loop over frames, for a progress bar.

    Raises:
        InputError: Fewer than two takes, or takes that do not belong together.
    """
    recordings = [
        take if isinstance(take, Recording) else Recording((take,), "take")
        for take in takes
    ]
    if len(recordings) < 2:
        raise InputError("one take given; merge needs one of each sensor")
    if calibration and len(calibration) != len(recordings) - 1:
        raise InputError(
            f"the calibration is of {len(calibration) + 1} sensors, and "
            f"{len(recordings)} takes are given; give them in its order"
        )
    person = find_person(recordings, body, calibration)
    merged = fuse(person.takes, person.scores, person.alignments, progress)
    return replace(merged, notes=person.notes)


def fuse(
    takes: Sequence[Take],
    scores: Sequence[Array],
    alignments: Sequence[Alignment],
    progress: Progress = silent,
) -> Merged:
    """Return the take that several make, whose reliability is (T, J) each.

    The alignments are of the second take, the third and so on.
    """
    skeleton = max((take.skeleton for take in takes), key=len)
    each = list(zip(takes, scores, (HERE, *alignments), strict=True))
    time = _frames([found.clock.undone(take.time) for take, _, found in each])
    columns = [_at(time, *one, skeleton) for one in each]
    fusion = Fusion(skeleton, len(takes))
    frames = list(zip(*columns, strict=True))
    elapsed = np.diff(time, prepend=2.0 * time[0] - time[1])
    sides, headings = fusion.ahead(frames, elapsed)
    found: list[Fused] = []
    for sweep in ("learn", "merge"):  # where sensors misplace joints is learned first
        fusion.start()
        found = [
            fusion.step(frames[k], float(elapsed[k]), sides[k], headings[k])
            for k in over(range(len(time)), sweep, progress)
        ]
    positions, state, reliability, shares, exchanged = (
        np.array(x) for x in zip(*found, strict=True)
    )
    source = " + ".join(take.source for take in takes)
    by_kinect = any(take.by_kinect for take in takes)
    return Merged(
        Take(time, positions, state, skeleton, source, by_kinect),
        reliability,
        shares,
        exchanged,
        tuple(np.array([sight.positions for sight in column]) for column in columns),
        tuple(alignments),
        tuple(takes),
    )


def _frames(stamps: Sequence[Array]) -> Array:
    """Return the moments of the merged take [s], of the stamps of each sensor's frames.

    Those of the sensor with the most frames, and of the others where it has none.
    """
    time, *rest = sorted(stamps, key=len, reverse=True)
    least = _NEAREST * float(np.median(np.diff(time)))
    for others in rest:
        away = np.abs(others - time[_nearest(time, others)])
        time = np.union1d(time, others[away > least])
    kept = np.concatenate([[True], np.diff(time) > 1e-4])
    return np.asarray(time[kept])


def _nearest(stamps: Array, times: Array) -> Indices:
    return np.searchsorted(0.5 * (stamps[1:] + stamps[:-1]), times, "right")


def _at(
    time: Array, take: Take, score: Array, found: Alignment, skeleton: Skeleton
) -> list[Sight]:
    """Return what a sensor sees at some moments of the first one's clock."""
    stamps = found.clock.at(time)
    positions = found.placed.apply(Track(take.time, take.positions).at(stamps))
    row = _nearest(take.time, stamps)
    joints = _mapped(take.skeleton, skeleton)
    places = np.where(joints[:, None] < 0, np.nan, positions[:, joints])
    missing = np.isnan(places[..., 0])
    trust, state = (
        np.where(missing, 0, values[row][:, joints]) for values in (score, take.state)
    )
    rows = zip(places, trust, state, strict=True)
    return [Sight(*row, found.placed.shift) for row in rows]


def _mapped(given: Skeleton, wanted: Skeleton) -> Indices:
    """Return which joint of a skeleton is each of another's, -1 where it has none."""
    roles = {wanted.joints[wanted.root]: given.root}
    roles[wanted.joints[wanted.girdle]] = given.girdle
    roles |= {joint: k for k, joint in enumerate(given.joints)}
    return np.array([roles.get(joint, -1) for joint in wanted.joints])
