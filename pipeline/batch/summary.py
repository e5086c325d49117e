"""What a batch tells at its end: counts, pace, and where to look."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Group, RenderableType
from rich.table import Table

from .row import ClipRow, Row
from .run import Outcome

_WORST = 5
_MOST_FAILED = 20  # names; the manifest has all


def as_tables(outcome: Outcome) -> RenderableType:
    """Return the outcome for a terminal.

    The worst takes are those in which the character was pulled the most from outside:
    what a tracker invents no body can do. Without physics they are those that the
    database knows the least.
    """
    parts: list[RenderableType] = [_counts(outcome)]
    if worst := _worst([*outcome.kept, *outcome.rows]):
        parts.append(_worst_table(worst))
    if outcome.failed:
        parts.append(_failed_table(outcome.failed))
    return Group(*parts)


def _counts(outcome: Outcome) -> str:
    done = [row for row in outcome.rows if row.status == "done"]
    others = [row for row in [*outcome.kept, *outcome.rows] if row.status == "no take"]
    frames = sum(clip.frames for row in outcome.rows for clip in row.clips)
    kept = sum(row.status == "done" for row in outcome.kept)
    seconds = max(outcome.seconds, 1e-9)
    words = [f"{len(done)} takes cleaned", f"{len(outcome.failed)} failed"]
    if kept:
        words.append(f"{kept} done before")
    if others:
        words.append(f"{len(others)} other files passed over")
    if outcome.rows:
        words.append(
            f"{frames} frames in {outcome.seconds:.1f} s: "
            f"{frames / seconds:.0f} frames/s, {len(done) / seconds:.2f} takes/s"
        )
    return ", ".join(words)


def _worst(rows: Sequence[Row]) -> list[tuple[Row, ClipRow]]:
    """Return the worst clips, the worst first."""
    clips = [(row, clip) for row in rows for clip in row.clips]
    return sorted(clips, key=lambda pair: _badness(pair[1]), reverse=True)[:_WORST]


def _badness(clip: ClipRow) -> tuple[float, float]:
    return (
        clip.external_force_body_weights or 0.0,
        clip.share_outside_database or 0.0,
    )


def _worst_table(worst: Sequence[tuple[Row, ClipRow]]) -> Table:
    table = Table(title="worst takes", title_justify="left")
    table.add_column("take", overflow="fold")
    for name in ("force", "outside", "slide", "jitter", "failures"):
        table.add_column(name, no_wrap=True, justify="right")
    table.caption = (
        "force from outside in body weights; frames outside the database; feet slide "
        "in mm a frame; jitter as a share of raw; failures of the tracker"
    )
    for row, clip in worst:
        table.add_row(
            row.take if len(row.clips) == 1 else f"{row.take}, body {clip.body}",
            _told(clip.external_force_body_weights, "{:.2f}"),
            _told(clip.share_outside_database, "{:.0%}"),
            _told(clip.skate_mm_per_frame, "{:.1f}"),
            _told(clip.jitter / clip.jitter_raw if clip.jitter_raw else None, "{:.2f}"),
            str(clip.failures),
        )
    return table


def _failed_table(failed: Sequence[Row]) -> Table:
    table = Table(title="failed", title_justify="left")
    table.add_column("take", overflow="fold")
    table.add_column("why", overflow="fold")
    for row in failed[:_MOST_FAILED]:
        table.add_row(row.take, row.error)
    if len(failed) > _MOST_FAILED:
        table.caption = f"and {len(failed) - _MOST_FAILED} more, see the manifest"
    return table


def _told(value: float | None, form: str) -> str:
    return "-" if value is None else form.format(value)
