"""The help of commands: how it looks on a terminal."""

from __future__ import annotations

import itertools
import re

import pytest

from kinefilter.pipeline.cli import main


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
