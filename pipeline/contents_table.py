"""What is in a file, for a terminal."""

from __future__ import annotations

from collections import Counter
from typing import Any

from rich.console import Group, RenderableType
from rich.table import Table

_LISTED = 30  # names of joints


def as_tables(contents: dict[str, Any]) -> RenderableType:
    """Return the contents of a file (``contents_of``) as lines and tables."""
    lines: list[RenderableType] = [
        f"{contents['file']}: {contents['kind']}, {contents['format']}"
    ]
    told = {"file", "kind", "format", "bodies", "notes", "states"}
    lines += _facts({k: v for k, v in contents.items() if k not in told})
    if "states" in contents:
        lines.append(_states(contents["states"]))
    for body in contents.get("bodies", []):
        most = ", seen in most frames" * (
            body["most_seen"] and len(contents["bodies"]) > 1
        )
        lines.append(f"body {body['body']} of {len(contents['bodies'])}{most}")
        told = {"body", "most_seen", "states", "failures"}
        lines += _facts({k: v for k, v in body.items() if k not in told})
        lines += [_states(body["states"]), *_failures(body["failures"])]
    return Group(*lines, *contents.get("notes", []))


def _facts(facts: dict[str, Any]) -> list[RenderableType]:
    return [
        f"  {key.replace('_', ' ')}: {_told(value)}" for key, value in facts.items()
    ]


def _told(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, dict):
        return ", ".join(f"{key} {_told(item)}" for key, item in value.items())
    if isinstance(value, list):
        more = f", ... ({len(value)})" if len(value) > _LISTED else ""
        return ", ".join(map(str, value[:_LISTED])) + more or "none"
    return "unknown" if value is None else str(value)


def _states(parts: dict[str, dict[str, float]]) -> Table:
    states = next(iter(parts.values()))
    table = Table(
        "part",
        *(state.replace("_", " ") for state in states),
        title="tracking states",
        title_justify="left",
    )
    for part, shares in parts.items():
        table.add_row(part, *(f"{share:.0%}" for share in shares.values()))
    return table


def _failures(failures: list[dict[str, Any]]) -> list[str]:
    """Return a line for each kind of failure of a part of the body."""
    counts = Counter((f["part"], f["kind"].replace("_", " ")) for f in failures)
    return [
        f"  tracker failure: {part} {kind}, {count} time{'s' * (count > 1)}"
        for (part, kind), count in counts.items()
    ] or ["  no tracker failure found"]
