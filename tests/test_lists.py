"""What has a name in two places has it in both."""

from __future__ import annotations

from pathlib import Path
from typing import get_args, get_type_hints

from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.lab.commands.learn import Train
from kinefilter.pipeline.lab.commands.measure import Reproduce
from kinefilter.pipeline.lab.studies import STUDIES
from kinefilter.pipeline.methods import LEARNED, METHODS, PRESETS, SCORERS

ROOT = Path(__file__).parents[1]


def test_every_method_can_be_chosen() -> None:
    chosen = get_type_hints(CleanConfig)
    assert {*METHODS} == {*get_args(get_args(chosen["method"])[0])}
    assert {*SCORERS} == {*get_args(chosen["scoring"])}
    assert {*LEARNED} == {*get_args(get_type_hints(Train)["method"])}
    for command in (chosen, get_type_hints(Train)):
        assert {*PRESETS} == {*get_args(get_args(command["preset"])[0])}


def test_every_method_is_where_the_table_says() -> None:
    for name, method in METHODS.items():
        made = method.load()
        assert callable(made), name
        assert method.options == () or set(method.options) <= set(CleanConfig.__dict__)


def test_every_study_is_in_the_help() -> None:
    listed = (Reproduce.__doc__ or "").replace("\n", " ").replace(",", " ")
    words = listed.replace(";", " ").replace(".", " ").split()
    assert [name for name in STUDIES if name not in words] == []


def test_who_is_in_mujocos_world_is_as_readme_says() -> None:
    floors = ("characters", "retarget", "scenes", "pipeline")
    sources = [path for floor in floors for path in (ROOT / floor).rglob("*.py")]
    users = {
        path.parent.relative_to(ROOT).as_posix()
        for path in sources
        if "_mujoco(" in path.read_text("utf-8")
    }
    assert users == {
        *("characters", "scenes/library", "scenes/sensor"),
        *("pipeline/physics", "pipeline/look"),
    }


def test_readme_can_be_read_in_one_go() -> None:
    assert len((ROOT / "README.md").read_text("utf-8").splitlines()) < 150
