"""Merges and cleans simultaneous takes of one person, and calibration files."""

import json
from collections.abc import Iterator, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from kinefilter.characters import Body, InputError, Origin, Skeleton, Take
from kinefilter.characters.arrays import Array, Flags, Indices, as_numbers, check_kind
from kinefilter.characters.motion import nearest_frames
from kinefilter.pipeline.clean_result import CleanResult
from kinefilter.pipeline.cleaner import Cleaner
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.correct import Corrector
from kinefilter.pipeline.draft import Draft
from kinefilter.pipeline.edits import Edit, check_edits, edited, read_edits
from kinefilter.pipeline.failures.sides import swapped_back
from kinefilter.pipeline.failures.trunk import steadied
from kinefilter.pipeline.formats.files import CALIBRATION, check_file, new_text
from kinefilter.pipeline.formats.recording import Recording
from kinefilter.pipeline.progress import Progress, over, silent
from kinefilter.pipeline.reliability import column_medians
from kinefilter.pipeline.stages import Correct
from kinefilter.pipeline.target.floor import leveled
from kinefilter.pipeline.uncertainty import uncertainty

from .alignment import IDENTITY, Alignment, check_sensors
from .fusion import Fused, Fusion, Sight
from .lag import Clock, Spline
from .person import find_person
from .rigid import Placement

_NEAREST = 0.6  # of a step: a frame of another sensor this near is not one of its own
_UNREADABLE = (OSError, InputError, LookupError, TypeError, ValueError, RecursionError)
_SHAPES = {"turn_xyzw": (4,), "shift_meters": (3,), "lag_seconds": ()}
_MAX_DISTANCE = 100.0  # m from one sensor to another


@dataclass(frozen=True, eq=False)
class Merged:
    """What several sensors recorded of a person, as one take.

    Attributes:
        take: The merged take, with the first sensor's clock and frame.
        reliability: Mean over the sensors that count, shape (T, J).
        shares: Share of each sensor in each joint, adding up to 1 or 0, (T, S, J).
        swapped: Which sensors had left and right swapped, shape (T, S).
        seen: Each sensor's joints [m] in the take's frame, (T, J, 3).
        alignments: Clock and place of the second sensor, the third and so on.
        takes: One per sensor, with gross failures repaired.
        notes: What users should know about who is who.
    """

    take: Take
    reliability: Array
    shares: Array
    swapped: Flags
    seen: tuple[Array, ...]
    alignments: tuple[Alignment, ...]
    takes: tuple[Take, ...]
    notes: tuple[str, ...] = ()

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
        """Return clock, place and share of each sensor, and what is uncertain."""
        apart = column_medians(self.residuals.reshape(len(self.takes), -1).T)
        rows = []
        pairs = zip(self.sources, (IDENTITY, *self.alignments), strict=True)
        for k, (source, (clock, placed, *_)) in enumerate(pairs):
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
        notes = list(self.all_notes())
        return {"frames": len(self.take), "sensors": rows, "notes": notes}

    def all_notes(self) -> Iterator[str]:
        """Yield what is uncertain, and what to do about it."""
        yield from self.notes
        hint = "give a --calibration from another take of the session"
        for source, found in zip(self.sources[1:], self.alignments, strict=True):
            if not found.clock_is_sure:
                yield f"{source}: people hardly move, so its lag is unsure; {hint}"
            elif not found.place_is_sure:
                doubt = "so the sensor's direction may be off by 30 degrees"
                yield f"{source}: people hardly walk, {doubt}; {hint}"


def merge(
    takes: Sequence[Take | Recording],
    *,
    body: int | None = None,
    calibration: Sequence[Alignment] = (),
    progress: Progress = silent,
) -> Merged:
    """Return one take of a person whom several sensors recorded.

    Args:
        takes: What each sensor recorded, of one person or of several; the merged take
            has the first one's clock and frame.
        body: Which person of the first recording, from 1; by default the one seen in
            most frames. In the others it is the person at the same place and time;
            sensors that do not see the person are left out.
        calibration: Clock and place of the other sensors, used as far as these takes do
            not determine them.
        progress: Wraps the loop over frames, for a progress bar.

    Raises:
        InputError: Fewer than two takes, or takes that do not belong together.
    """
    check_kind(takes, list | tuple, "the takes")
    for one in takes:
        check_kind(one, Take | Recording, "a take")
    recordings = [
        one if isinstance(one, Recording) else Recording((one,)) for one in takes
    ]
    if len(recordings) < 2:
        raise InputError("only one take is given; merge needs one per sensor")
    check_sensors(calibration, len(recordings))
    person = find_person(recordings, body, calibration)
    merged = fuse(person.takes, person.scores, person.alignments, progress)
    return replace(merged, notes=person.notes)


def fuse(
    takes: Sequence[Take],
    scores: Sequence[Array],
    alignments: Sequence[Alignment],
    progress: Progress = silent,
) -> Merged:
    """Fuse takes with reliability (T, J) each, and alignments of all but the first."""
    skeleton = max((take.skeleton for take in takes), key=len)
    each = list(zip(takes, scores, (IDENTITY, *alignments), strict=True))
    time = _frame_times([found.clock.inverse(take.time) for take, _, found in each])
    columns = [_sights(time, *one, skeleton) for one in each]
    fusion = Fusion(skeleton, len(takes))
    frames = list(zip(*columns, strict=True))
    elapsed = np.diff(time, prepend=2.0 * time[0] - time[1])
    found = fusion.precompute(frames, elapsed)
    steps = list(zip(frames, elapsed.tolist(), *found, strict=True))
    fused: list[Fused] = []
    for sweep in ("learn", "merge"):  # the first learns where sensors misplace joints
        fusion.start()
        fused = [fusion.step(*step) for step in over(steps, sweep, progress)]
    arrays = map(np.array, zip(*fused, strict=True))
    positions, state, reliability, shares, swapped = arrays
    source = " + ".join(take.source for take in takes)
    by_kinect = any(take.by_kinect for take in takes)
    # Where sensors disagree which way the trunk faces, its lines get short.
    take = steadied(Take(time, positions, state, skeleton, source, by_kinect), ())
    seen = (np.array([sight.positions for sight in column]) for column in columns)
    known = (tuple(alignments), tuple(takes))
    return Merged(take, reliability, shares, swapped, tuple(seen), *known)


def _frame_times(stamps: Sequence[Array]) -> Array:
    """Return times [s] of the sensor with most frames, and of others in its gaps."""
    time, *rest = sorted(stamps, key=len, reverse=True)
    least = _NEAREST * float(np.median(np.diff(time)))
    for others in rest:
        away = np.abs(others - time[nearest_frames(time, others)])
        time = np.union1d(time, others[away > least])
    kept = np.concatenate([[True], np.diff(time) > 1e-4])
    return np.asarray(time[kept])


def _sights(
    time: Array, take: Take, score: Array, found: Alignment, skeleton: Skeleton
) -> list[Sight]:
    """Return what a sensor sees at some times of the first one's clock."""
    stamps = found.clock.at(time)
    positions = found.placed.apply(Spline(take.time, take.positions).at(stamps))
    rows = nearest_frames(take.time, stamps)
    joints = _joint_map(take.skeleton, skeleton)
    positions = np.where(joints[:, None] < 0, np.nan, positions[:, joints])
    missing = np.isnan(positions[..., 0])
    reliability, state = (
        np.where(missing, 0, values[rows][:, joints]) for values in (score, take.state)
    )
    frames = zip(positions, reliability, state, strict=True)
    return [Sight(*frame, found.placed.shift) for frame in frames]


def _joint_map(given: Skeleton, wanted: Skeleton) -> Indices:
    """Return the index in a skeleton of each joint of another, -1 where it has none."""
    indices = {wanted.joints[wanted.root]: given.root}
    indices[wanted.joints[wanted.girdle]] = given.girdle
    indices |= {joint: k for k, joint in enumerate(given.joints)}
    return np.array([indices.get(joint, -1) for joint in wanted.joints])


def write_calibration(merged: Merged, path: Path) -> None:
    """Write place and clock of the sensors, for other takes of the session (JSON)."""
    sensors: list[dict[str, Any]] = [{"source": Path(merged.sources[0]).name}]
    for source, found in zip(merged.sources[1:], merged.alignments, strict=True):
        sensors.append(
            {
                "source": Path(source).name,
                "lag_seconds": found.clock.lag - found.clock.start,
                "turn_xyzw": found.placed.turn.as_quat().tolist(),
                "shift_meters": found.placed.shift.tolist(),
            }
        )
    with new_text(path) as file:
        calibration = {"file": CALIBRATION, "sensors": sensors}
        file.write(json.dumps(calibration, indent=2) + "\n")


def read_calibration(path: Path | None) -> tuple[Alignment, ...]:
    """Read a calibration, none without a path; raise InputError if it is invalid."""
    if path is None:
        return ()
    check_file(path)
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(found, dict) or found.get("file") != CALIBRATION:
            raise ValueError(f"not a {CALIBRATION}")
        alignments = []
        for sensor in found["sensors"][1:]:
            turn, shift, lag = (
                as_numbers(sensor[key], key, shape, finite=True).astype(float)
                for key, shape in _SHAPES.items()
            )
            if np.abs(shift).max() > _MAX_DISTANCE:
                raise ValueError(f"a sensor is over {_MAX_DISTANCE:g} m away")
            clock = Clock(0.0, float(lag))
            placed = Placement(Rotation.from_quat(turn), shift)
            alignments.append(Alignment(clock, placed, np.nan, np.inf, np.inf))
    except _UNREADABLE as error:
        raise InputError(
            f"{path}: not a calibration from 'kinefilter merge --save-calibration' "
            f"({str(error)[:80]})"
        ) from None
    return tuple(alignments)


_SURE = 0.01  # m of uncertainty at which a joint's weight is its reliability
_MOVED = 0.1  # m by which correction moves a joint whose weight then drops to 1/e


def clean_session(
    takes: Sequence[Take | Recording],
    config: CleanConfig | None = None,
    *,
    body: int | None = None,
    calibration: Sequence[Alignment] = (),
    edits: Sequence[Edit] | None = None,
    progress: Progress = silent,
) -> tuple[CleanResult, Merged]:
    """Clean several sensors' takes of a person; return the result and the merged take.

    Each sensor's take is corrected separately, with left and right as agreed among the
    sensors, since methods know a sensor's errors and depend on where it stands. The
    corrected takes are fused, weighted also by their uncertainty, and pass through the
    remaining stages. The first take's clock is the clip's.

    Arguments and errors are those of ``merge`` and ``Cleaner``. ``edits`` are manual
    corrections to the merged take, by default those that the config names.
    """
    config = CleanConfig() if config is None else config
    check_kind(config, CleanConfig, "the config")
    if edits is None:
        edits = read_edits(config.edits) if config.edits else ()
    config = replace(config, edits=None)
    merged = merge(takes, body=body, calibration=calibration, progress=progress)
    check_edits(merged.take, edits)  # before any work is done
    cleaner, before = _cleaner(merged, config, (), progress), None
    if edits:
        before = cleaner.unedited(merged.take, progress)
        cleaner = _cleaner(merged, config, edits, progress)
    result = cleaner.clean(merged.take, edits=edits, before=before, progress=progress)
    return result, merged


def _cleaner(
    merged: Merged, config: CleanConfig, edits: Sequence[Edit], progress: Progress
) -> Cleaner:
    """Return a cleaner for a merged take that uses each sensor's corrected joints."""
    # Alignments hold in the sensors' own frames, so these are not leveled; failures
    # were repaired before sides were settled.
    corrector = _without_failures(Cleaner(replace(config, tilt=0.0)).until("correct"))
    corrected, scores, measured = [], [], []
    pairs = zip(merged.takes, (IDENTITY, *merged.alignments), strict=True)
    stamps, skeleton = merged.take.time, merged.take.skeleton
    for k, (take, found) in enumerate(pairs):
        time = found.clock.inverse(take.time)
        frames = np.searchsorted(stamps, time).clip(max=len(stamps) - 1)
        swapped = merged.swapped[frames, k]  # as the sensors agree
        take = swapped_back(take, np.stack([swapped, swapped], axis=1))
        take = edited(take, edits, time - stamps[0])
        draft = corrector.whole(take, progress)
        positions = np.where(draft.missing[..., None], np.nan, draft.positions)
        corrected.append(replace(take, positions=positions))
        moved = np.linalg.norm(draft.positions - take.positions, axis=2)
        sure = (_SURE / uncertainty(draft)) ** 2
        scores.append(draft.reliability * sure * np.exp(-np.nan_to_num(moved) / _MOVED))
        own = _sights(stamps, take, draft.origin == Origin.MEASURED, found, skeleton)
        measured.append([sight.reliability for sight in own])
    fused = fuse(corrected, scores, merged.alignments, progress)
    share = np.einsum("tsj,stj->tj", fused.shares, measured)
    # A person who turns away from one sensor is not a failure of all sensors.
    cleaner = _without_failures(Cleaner(config))
    return cleaner.replaced(Corrected(config, fused.take.positions, share < 0.5))


def _without_failures(cleaner: Cleaner) -> Cleaner:
    names = [stage.name for stage in cleaner.stages]
    return cleaner.without("failures") if "failures" in names else cleaner


class Corrected(Correct):
    """Uses joints that were corrected already; without any, corrects them itself.

    ``places`` are the joints [m] of a take (T, J, 3) or of the next frame (J, 3), in
    the sensor frame, NaN where there are none; ``changed``, of a take (T, J), are those
    that correction changed at most of the sensors, by their shares.
    """

    in_parts = False
    local = False  # the joints are those of the whole take

    def __init__(
        self,
        config: CleanConfig,
        places: Array | None = None,
        changed: Flags | bool = True,
    ) -> None:
        super().__init__(config)
        self._plain = Correct(replace(config, method="none", model=None, preset=None))
        self.places, self._changed = places, changed

    def start(self, body: Body) -> None:
        """Reset the state for a new motion."""
        super().start(body)
        self._plain.start(body)

    def copied(self) -> Corrector:
        """Return the method with a state of its own; reading it again takes long."""
        return deepcopy(self._corrector)

    def step(self, draft: Draft) -> None:
        """Correct the next frame."""
        if self.places is None:
            super().step(draft)
        else:
            self._plain.step(draft)
            self._apply(draft, self.places)

    def whole(self, draft: Draft, progress: Progress) -> None:
        """Correct a take."""
        if self.places is None:
            super().whole(draft, progress)
        else:
            self._plain.whole(draft, progress)
            known = self._apply(draft, self.places)
            draft.origin[known & self._changed & ~draft.missing] = Origin.CORRECTED

    @staticmethod
    def _apply(draft: Draft, places: Array) -> Flags:
        """Move joints to where they were corrected, and return which (..., J)."""
        places = leveled(places, draft.turn.tilt, draft.turn.roll)
        known = ~np.isnan(places[..., 0])
        draft.positions = np.where(known[..., None], places, draft.positions)
        return known
