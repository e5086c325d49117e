"""What a batch prints at its end: counts, pace, and where to look."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Group, RenderableType
from rich.table import Table

from kinefilter.pipeline.formats.plain import counted

from .manifest import ClipRow, Row
from .run import Outcome

_WORST = 5
_MOST_FAILED = 20  # names; the manifest has all


def as_tables(outcome: Outcome) -> RenderableType:
    """Return the outcome for a terminal.

    The worst takes are those in which the largest external force pulled the character:
    no body can do what a tracker invents. Without physics they are those that the
    database covers the least.
    """
    rows = [*outcome.kept, *outcome.rows]
    clips = [(row, clip) for row in rows for clip in row.clips]

    def badness(pair: tuple[Row, ClipRow]) -> tuple[float, float]:
        force = pair[1].external_force_body_weights or 0.0
        return force, pair[1].share_outside_database or 0.0

    clips.sort(key=badness, reverse=True)
    tables = [_worst_table(clips[:_WORST])] if clips else []
    if outcome.failed:
        table = Table(title="failed", title_justify="left")
        for name in ("take", "why"):
            table.add_column(name, overflow="fold")
        for row in outcome.failed[:_MOST_FAILED]:
            table.add_row(row.take, row.error)
        more = len(outcome.failed) - _MOST_FAILED
        table.caption = f"and {more} more, see the manifest" if more > 0 else None
        tables.append(table)
    return Group(_counts(outcome), *tables)


def _counts(outcome: Outcome) -> str:
    rows = [*outcome.kept, *outcome.rows]
    done = sum(row.status == "done" for row in outcome.rows)
    kept = sum(row.status == "done" for row in outcome.kept)
    others = sum(row.status == "no take" for row in rows)
    frames = sum(clip.frames for row in outcome.rows for clip in row.clips)
    seconds = max(outcome.seconds, 1e-9)
    words = [f"{counted(done, 'take')} cleaned", f"{len(outcome.failed)} failed"]
    together = [len(row.sensors) for row in rows if row.status == "done"]
    sessions, alone = sum(n > 1 for n in together), together.count(1)
    words += [f"{counted(sessions, 'clip')} of several sensors"] * bool(sessions)
    words += [f"{alone} without a partner, see manifest.csv"] * bool(alone)
    words += [f"{kept} done before"] * bool(kept)
    damaged = len(outcome.damaged)
    words += [f"{damaged} with damage, see manifest.csv"] * bool(damaged)
    words += [f"{counted(others, 'other file')} skipped"] * bool(others)
    if outcome.rows:
        words.append(
            f"{counted(frames, 'frame')} in {outcome.seconds:.1f} s: "
            f"{frames / seconds:.0f} frames/s, {done / seconds:.2f} takes/s"
        )
    return ", ".join(words)


def _worst_table(worst: Sequence[tuple[Row, ClipRow]]) -> Table:
    table = Table(title=f"worst take{'s' * (len(worst) != 1)}", title_justify="left")
    table.add_column("take", overflow="fold")
    for name in ("force", "outside", "slide", "jitter", "failures"):
        table.add_column(name, no_wrap=True, justify="right")
    table.caption = (
        "external force in body weights; frames outside the database; feet slide in mm "
        "a frame; jitter as a share of raw; failures of the tracker"
    )
    for row, clip in worst:
        share = None
        if clip.jitter is not None and clip.jitter_raw:
            share = clip.jitter / clip.jitter_raw
        figures = (
            (clip.external_force_body_weights, ".2f"),
            (clip.share_outside_database, ".0%"),
            (clip.skate_mm_per_frame, ".1f"),
            (share, ".2f"),
            (clip.failures, "d"),
        )
        table.add_row(
            row.take if len(row.clips) == 1 else f"{row.take}, body {clip.body}",
            *("-" if value is None else format(value, form) for value, form in figures),
        )
    return table
