"""The summary of ``clean``: tables for people, JSON for programs."""

from dataclasses import asdict
from typing import Any

import numpy as np
from rich.console import Group, RenderableType
from rich.table import Table

from kinefilter.characters import Origin, Term

from .clean_result import CleanResult
from .contents import failures_as_json, gaps_as_json, origin_shares
from .failures import describe_failures
from .formats.plain import finite

_ROWS = (
    ("bone-length variation", "bone_length_cv", "{:.2g}"),
    ("jitter, m/s³", "jitter", "{:.0f}"),
    ("lowest point, mm", "lowest_point_mm", "{:+.1f}"),
    ("moved from raw, cm", "moved_cm", "{:.2f}"),
    ("amplitude kept", "amplitude_kept", "{:.3f}"),
    ("feet slide, mm/frame", "skate_mm_per_frame", "{:.1f}"),
    ("feet slide over 0.2 m/s", "skate_share_over_0p2", "{:.1%}"),
    ("unexplained force, body weights", "unexplained_force", "{:.2f}"),
    ("planted soles float, mm", "float_mm", "{:.1f}"),
)
_WORST = 5


def as_json(result: CleanResult) -> dict[str, Any]:
    """Return the figures of a cleaned take, ready for ``json.dump``."""
    clip, rates = result.clip, result.clip.reliability.mean(axis=0)
    figures: dict[str, Any] = {
        "source": clip.source,
        "skeleton": clip.skeleton.name,
        "frames": len(clip),
        "seconds": float(clip.time[-1] - clip.time[0]),
        "fps": clip.fps,
        "body": {"height_m": clip.body.height, "mass_kg": clip.body.mass},
        "reliability": dict(zip(clip.skeleton.joints, rates.tolist(), strict=True)),
        "share_outside_database": result.share_outside,
        **{f"share_{name}": share for name, share in origin_shares(clip).items()},
        "gaps": gaps_as_json(clip.time),
        "failures": failures_as_json(result.failures),
        "notes": list(result.notes),
    }
    for stage, quality in result.stages.items():
        figures[stage] = asdict(quality)
    if result.trace is not None:
        figures["physics"] |= {
            "tracking_error_mm": float(result.trace.tracking_error.mean() * 1e3),
            "external_force_body_weights": float(result.trace.external_force.mean()),
            "frames_reset": int(result.trace.reset.sum()),
        }
    finished: dict[str, Any] = finite(figures)
    return finished


def as_tables(result: CleanResult) -> RenderableType:
    """Return the same figures for a terminal."""
    clip = result.clip
    head = (
        f"{clip.source}: {len(clip)} frames, {clip.time[-1] - clip.time[0]:.1f} s, "
        f"{clip.skeleton.name}, {clip.body.height:.2f} m, {clip.body.mass:.0f} kg"
    )
    stages = Table("", *result.stages, title="per stage", title_justify="left")
    for label, key, form in _ROWS:
        values = [getattr(quality, key) for quality in result.stages.values()]
        cells = (form.format(v) if np.isfinite(v) else "-" for v in values)
        stages.add_row(label, *cells)
    rates = clip.reliability.mean(axis=0)
    columns = ("joint", "reliability", "decided by", "filled")
    joints = Table(*columns, title="least reliable joints", title_justify="left")
    for j in np.argsort(rates, kind="stable")[:_WORST]:
        # The term that cost most, not the most frequent: one decides in every frame.
        cost = 1.0 - clip.reliability[:, j]
        terms = np.bincount(clip.deciding_term[:, j], weights=cost)
        joints.add_row(
            clip.skeleton.joints[j],
            f"{rates[j]:.2f}",
            Term(int(terms.argmax())).words,
            f"{np.mean(clip.origin[:, j] == Origin.FILLED):.0%}",
        )
    shares = (f"{name} {share:.0%}" for name, share in origin_shares(clip).items())
    lines = [f"of all joints: {', '.join(shares)}"]
    if np.isfinite(result.share_outside):
        share = f"{result.share_outside:.0%}"
        lines.append(f"frames with postures unfamiliar to the method: {share}")
    failures = describe_failures(result.failures, clip.time[0])
    lines += [f"tracker failure: {failure}" for failure in failures]
    return Group(head, stages, joints, *lines, *result.notes)
