"""What has a name in two places has it in both."""

from __future__ import annotations

from pathlib import Path
from typing import get_args

from kinefilter.pipeline.commands import Reproduce
from kinefilter.pipeline.config import LearnedMethod, Method
from kinefilter.pipeline.correct.methods import FILTERS, FROM_DATABASE, LEARNED
from kinefilter.pipeline.studies import STUDIES
from kinefilter.scenes import SCENES

ROOT = Path(__file__).parents[1]


def test_every_method_can_be_chosen() -> None:
    assert set(get_args(Method)) == {*FILTERS, *FROM_DATABASE, *LEARNED}
    assert set(get_args(LearnedMethod)) == set(LEARNED)


def test_every_study_is_in_the_help() -> None:
    listed = (Reproduce.__doc__ or "").replace("\n", " ").replace(",", " ")
    words = listed.replace(";", " ").replace(".", " ").split()
    assert [name for name in STUDIES if name not in words] == []


def test_every_scene_is_in_the_help() -> None:
    text = (ROOT / "pipeline" / "config.py").read_text(encoding="utf-8")
    assert [scene for scene in SCENES if scene not in text] == []


def test_readme_can_be_read_in_one_go() -> None:
    assert len((ROOT / "README.md").read_text("utf-8").splitlines()) < 150
