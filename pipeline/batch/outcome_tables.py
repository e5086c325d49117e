"""Summary of a batch for the terminal: counts, speed, worst and failed takes."""

from collections.abc import Iterable, Sequence

from rich.console import Group, RenderableType
from rich.table import Table

from kinefilter.pipeline.formats.plain import counted
from kinefilter.pipeline.metrics import METRICS

from .manifest import ClipRow, Row
from .run import Outcome

_FIGURES = ("force", "outside", "slide", "jitter", "failures")
_MAX_WORST = 5
_MAX_FAILED = 20  # the manifest has all
_MAX_OTHERS = 3


def as_tables(outcome: Outcome) -> RenderableType:
    """Return the outcome as tables for the terminal.

    The worst takes are those with the largest external force, since tracker errors look
    like motion that no body can perform; without physics, those that the database
    covers the least.
    """
    clips = worst_first([*outcome.kept, *outcome.rows])
    tables = [_worst_table(clips[:_MAX_WORST])] if clips else []
    if outcome.failed:
        table = Table(title="failed", title_justify="left")
        for name in ("take", "error"):
            table.add_column(name, overflow="fold")
        for row in outcome.failed[:_MAX_FAILED]:
            place, found, error = row.error.partition(f"{row.take}: ")
            # The path of the take stands beside its name already.
            named = found and place[-1:] in ("", "/")
            table.add_row(row.take, error if named else row.error)
        more = len(outcome.failed) - _MAX_FAILED
        table.caption = f"and {more} more, see the manifest" if more > 0 else None
        tables.append(table)
    return Group(_counts(outcome), *tables)


def worst_first(rows: Iterable[Row]) -> list[tuple[Row, ClipRow]]:
    """Return all clips with their rows, those with the largest external force first."""

    def badness(pair: tuple[Row, ClipRow]) -> tuple[float, float]:
        force = pair[1].external_force_body_weights or 0.0
        return force, pair[1].share_outside_database or 0.0

    clips = [(row, clip) for row in rows for clip in row.clips]
    return sorted(clips, key=badness, reverse=True)


def figures_of(row: Row, clip: ClipRow) -> dict[str, str]:
    """Return the name of a clip's take and its main figures, formatted."""
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
    texts = ["-" if value is None else format(value, form) for value, form in figures]
    name = row.take if len(row.clips) == 1 else f"{row.take}, body {clip.body}"
    return {"take": name} | dict(zip(_FIGURES, texts, strict=True))


def _counts(outcome: Outcome) -> str:
    rows = [*outcome.kept, *outcome.rows]
    done = sum(row.status == "done" for row in outcome.rows)
    kept = sum(row.status == "done" for row in outcome.kept)
    others = sorted(row.take for row in rows if row.status == "no take")
    names = ", ".join([*others[:_MAX_OTHERS], *["..."] * (len(others) > _MAX_OTHERS)])
    sensors = [len(row.sensors) for row in rows if row.status == "done"]
    sessions, alone = sum(n > 1 for n in sensors), sensors.count(1)
    damaged, earlier = len(outcome.damaged), outcome.earlier
    counts = (
        (True, f"{counted(done, 'take')} cleaned, {len(outcome.failed)} failed"),
        (sessions, f"{counted(sessions, 'clip')} of several sensors"),
        (alone, f"{alone} without a partner (see manifest.csv)"),
        (kept, f"{kept} already done"),
        (earlier, f"{earlier} of an earlier run only (see manifest.csv)"),
        (damaged, f"{damaged} with damage (see manifest.csv)"),
        (others, f"{counted(len(others), 'other file')} skipped ({names})"),
    )
    words = [text for count, text in counts if count]
    if done:
        frames = sum(clip.frames for row in outcome.rows for clip in row.clips)
        seconds = max(outcome.seconds, 1e-9)
        words.append(
            f"{counted(frames, 'frame')} in {outcome.seconds:.1f} s: "
            f"{frames / seconds:.0f} frames/s, {done / seconds:.2f} takes/s"
        )
    return ", ".join(words)


def _worst_table(worst: Sequence[tuple[Row, ClipRow]]) -> Table:
    table = Table(title=f"worst take{'s' * (len(worst) != 1)}", title_justify="left")
    table.add_column("take", overflow="fold")
    for name in _FIGURES:
        table.add_column(name, no_wrap=True, justify="right")
    table.caption = (
        "external force in body weights; frames outside the database; "
        f"{METRICS['skate_mm_per_frame']}; jitter relative to the raw take; tracker "
        "failures"
    )
    for row, clip in worst:
        table.add_row(*figures_of(row, clip).values())
    return table
