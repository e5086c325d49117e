"""The scripts beside the tests: they load, and CONTRIBUTING has a line on each."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SCRIPTS = [
    path.relative_to(ROOT).as_posix()
    for path in (ROOT / "tests").rglob("*.py")
    if re.search("^if __name__ ==", path.read_text(encoding="utf-8"), re.MULTILINE)
]
FOR_BLENDER = ["tests/blender_extension.py", "tests/blender_import.py"]
"""Blender runs them, in a Python of its own."""


def test_contributing_lists_the_scripts() -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    listed = re.findall(r"^- `(tests/[a-z_/]+\.py)", text, re.MULTILINE)
    assert listed == sorted([*SCRIPTS, *FOR_BLENDER])


@pytest.mark.parametrize("script", SCRIPTS)
def test_what_a_script_asks_kinefilter_for_is_there(script: str) -> None:
    assert "__file__" in runpy.run_path(str(ROOT / script), run_name="loaded")
