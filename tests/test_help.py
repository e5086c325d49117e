"""The help of commands, as it looks on a terminal, and of classes in Python."""

from __future__ import annotations

import inspect
import itertools
import re
from dataclasses import fields

import pytest

from kinefilter import CleanResult, Pose, PostureDatabase, Take
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.correct import Correction, Observation
from kinefilter.pipeline.merge import Merged
from kinefilter.pipeline.pairs import PairedTake


@pytest.mark.parametrize("name", ["batch", "clean", "evaluate", "live", "view"])
def test_help_wraps_a_line_only_where_the_next_word_does_not_fit(
    name: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    with pytest.raises(SystemExit):
        main([name, "--help"])
    lines = [line[2:-2] for line in capsys.readouterr().out.splitlines()]
    wrapped = 0
    for line, following in itertools.pairwise(lines):
        indent, after = (len(text) - len(text.lstrip()) for text in (line, following))
        if indent == after >= 4 and following.strip():
            wrapped += 1
            assert len(f"{line.rstrip()} {following.split()[0]}") > len(line), line
    assert wrapped > 5


def test_the_version_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert re.fullmatch(r"kinefilter \d+\.\d+\.\d+\n", capsys.readouterr().out)


PUBLIC = (
    *(CleanResult, Correction, Merged, Observation),
    *(PairedTake, Pose, PostureDatabase, Take),
)


@pytest.mark.parametrize("kind", PUBLIC)
def test_every_field_of_what_functions_take_and_return_is_explained(kind: type) -> None:
    told = inspect.getdoc(kind) or ""
    for field in fields(kind):
        assert f"    {field.name}: " in told, field.name
