"""The page of a report: one HTML file that asks nobody for anything."""

from __future__ import annotations

import html
import json
import os
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import Any

from kinefilter.characters import InputError
from kinefilter.pipeline.formats.files import atomic_path, check_folder

from .compared import Compared
from .contents import contents_of
from .limits import Limit

_SCRIPTS = ("arrays.js", "figures.js", "maps.js", "tables.js", "page.js")


def check_report(path: Path) -> None:
    """Raise, before any work is done, what write_report would raise after it.

    Raises:
        InputError: It is not named as a web page, or nothing can be written there.
    """
    if path.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"{path}: a report is a web page; name it .html")
    check_folder(path)


def write_report(
    compared: Compared, path: str | os.PathLike[str], limits: Sequence[Limit] = ()
) -> None:
    """Write a page with everything in it, which appears whole or not at all.

    Args:
        compared: A clip and its take.
        path: The HTML file.
        limits: What fails in the table of metrics.

    Raises:
        InputError: The file cannot be written.
    """
    page = page_of(contents_of(compared, limits))
    with atomic_path(path) as temporary:
        temporary.write_text(page, encoding="utf-8", errors="replace")


def page_of(contents: dict[str, Any]) -> str:
    """Return the HTML that shows contents; no name in them becomes markup."""
    page = _part("page.html").replace("@STYLE@", _part("page.css"))
    page = page.replace("@SCRIPT@", "\n".join(_part(name) for name in _SCRIPTS))
    # What comes from files comes last, so that nothing in it is taken for a place.
    head, body = page.split("@TITLE@")
    middle, end = body.split("@DATA@")
    title = html.escape(f"kinefilter: {contents['source']}")
    return head + title + middle + _escaped(contents) + end


def _part(name: str) -> str:
    folder = resources.files(__package__).joinpath("template")
    return folder.joinpath(name).read_text(encoding="utf-8")


def _escaped(contents: dict[str, Any]) -> str:
    """Return JSON that cannot end the script element it stands in."""
    text = json.dumps(contents, allow_nan=False, separators=(",", ":"))
    for mark in "<>&":
        text = text.replace(mark, f"\\u{ord(mark):04x}")
    return text
