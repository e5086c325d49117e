"""A little of tests/abuse.py: damaged files and random options, always the same."""

from __future__ import annotations

import random
from pathlib import Path

import pytest
from abuse import tried
from abused_commands import Attempt, abuse_file, prepare
from abused_options import abuse_options, drawn

from kinefilter.pipeline.cli import COMMANDS


@pytest.fixture(scope="module")
def valid(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return prepare(tmp_path_factory.mktemp("abuse") / "valid")


@pytest.mark.parametrize(
    ("function", "seed", "count"), [(abuse_file, 1, 20), (abuse_options, 1, 8)]
)
def test_whatever_is_tried_is_done_or_refused(
    valid: dict[str, Path], tmp_path: Path, function: object, seed: int, count: int
) -> None:
    ends = set()
    for n in range(count):
        (tmp_path / str(n)).mkdir()
        rng = random.Random(f"{seed} {n}")
        row = tried(function, Attempt(n, rng, valid, tmp_path / str(n), 0.0))
        assert row["end"] != "lost", row
        ends.add(row["end"])
    assert ends == {"survived", "refused"}


def test_the_options_of_every_command_are_drawn_the_same_for_the_same_number() -> None:
    sets = [drawn(number) for number in range(100)]
    assert {words[0] for _, words in sets} == set(COMMANDS)
    assert drawn(99) == sets[99]
