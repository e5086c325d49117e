"""What is known of a take that was looked at: a line of the manifest."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from kinefilter.characters import InputError
from kinefilter.pipeline.cleaner import CleanResult


@dataclass(frozen=True, slots=True)
class ClipRow:
    """A clip of one person, and its main figures; None where there is nothing."""

    output: str
    """Path below the output folder, split by ``/``."""
    stamp: str
    """Size and time of the file, as it was when it was written."""
    sha256: str
    """Hash of its bytes."""
    body: int
    """Which person of the take, counted from 1."""
    frames: int
    """Frames of the take."""
    motion_seconds: float
    """How long the motion lasts [s]."""
    jitter_raw: float
    """Jitter of the take [m/s^3], see ``Quality``."""
    jitter: float
    """Jitter of the clip [m/s^3]."""
    skate_mm_per_frame: float | None
    """How far feet slide on the floor, mean [mm per frame]."""
    external_force_body_weights: float | None
    """What the simulation pulled beside what a floor could bear, mean."""
    share_outside_database: float | None
    """Share of the frames whose posture the database does not hold."""
    failures: int
    """How often the tracker failed grossly."""
    notes: tuple[str, ...]
    """What the user should know."""


@dataclass(frozen=True, slots=True)
class Row:
    """A take that was looked at."""

    take: str
    """Path below the folder that was searched."""
    status: Literal["done", "failed", "no take"]
    """no take: a file of another kind; failed: at least one clip is missing."""
    output: str
    """Path of the clip below the output folder, without a person's number."""
    stamp: str
    """Size and time of the take's file, as it was when it was read."""
    sha256: str
    """Hash of its bytes; empty if it could not be read."""
    settings: str
    """Fingerprint of the settings, see ``fingerprint``."""
    seconds: float
    """How long it took [s]."""
    clips: tuple[ClipRow, ...] = ()
    """What was written, a clip a person."""
    error: str = ""
    """Why a clip is missing."""

    def as_json(self) -> str:
        """Return the row as a line, without its end."""
        return json.dumps(asdict(self), allow_nan=False)


def row_from_json(line: str) -> Row:
    """Return the row of a line.

    Raises:
        ValueError: The line is damaged, or of another version.
    """
    values = json.loads(line)
    try:
        clips = [
            ClipRow(**{**clip, "notes": tuple(clip["notes"])})
            for clip in values.pop("clips")
        ]
        return Row(**values, clips=tuple(clips))
    except (TypeError, KeyError, AttributeError) as error:
        raise ValueError(f"no row of a manifest: {error}") from None


def clip_row(
    result: CleanResult, output: str, stamp: str, sha256: str, body: int
) -> ClipRow:
    """Return the main figures of a clip that was written."""
    clip, last = result.clip, list(result.stages.values())[-1]
    figures: dict[str, Any] = {
        "jitter_raw": result.stages["raw"].jitter,
        "jitter": last.jitter,
        "skate_mm_per_frame": _finite(last.skate_mm_per_frame),
        "external_force_body_weights": (
            None
            if result.trace is None
            else _finite(float(result.trace.external_force.mean()))
        ),
        "share_outside_database": _finite(result.share_outside),
    }
    return ClipRow(
        output=output,
        stamp=stamp,
        sha256=sha256,
        body=body,
        frames=len(clip),
        motion_seconds=float(clip.time[-1] - clip.time[0]),
        **figures,
        failures=len(result.failures),
        notes=result.notes,
    )


def _finite(value: float) -> float | None:
    """Return the value, or None (JSON has no NaN) where nothing could be measured."""
    return value if np.isfinite(value) else None


def parse_rows(data: bytes, name: str) -> tuple[list[Row], int]:
    """Return the rows of a manifest, and how many bytes are whole lines.

    A last line that is torn is dropped: whoever wrote it was killed.

    Raises:
        InputError: Another line is damaged.
    """
    rows = []
    start = 0
    for number, line in enumerate(data.splitlines(keepends=True), start=1):
        end = start + len(line)
        try:
            rows.append(row_from_json(line.decode()))
        except ValueError as error:
            if end == len(data):
                break
            raise InputError(
                f"{name}: line {number} is damaged ({error}); delete it, and its take "
                "is cleaned again"
            ) from None
        if not line.endswith(b"\n"):
            rows.pop()
            break
        start = end
    return rows, start
