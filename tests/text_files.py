"""Small files of text."""

from __future__ import annotations

from pathlib import Path


def write_text(path: Path, *parts: str) -> Path:
    path.write_text("".join(parts), encoding="utf-8")
    return path
