"""``kinefilter ratings``: what raters say of systems, and which answers it refuses."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

from kinefilter.pipeline.cli import main
from kinefilter.pipeline.lab.ratings import Key, Raters, holm, summarize, wilcoxon

ONE = Key("p", ["A", "B", "C"], ["m"], [(0, 0), (1, 0), (2, 0)], [(0,), (1,), (2,)])
"""Three systems, one motion, one clip at a time."""
GRADES = np.array([[3, 5, 8], [4, 4, 7], [2, 6, 9], [5, 6, 6], [1, 4, 7], [3, 8, 9]])


def _raters(grades: Any) -> Raters:
    return {
        f"r{n}": [((k,), (int(grade),)) for k, grade in enumerate(row)]
        for n, row in enumerate(grades)
    }


def test_means_and_intervals_are_those_of_scipy() -> None:
    found = summarize(_raters(GRADES), ONE)
    for column, name in zip(GRADES.T, "ABC", strict=True):
        row = found["systems"][name]
        assert row["mean"] == pytest.approx(column.mean())
        assert row["sd"] == pytest.approx(stats.tstd(column))
        interval = stats.ttest_1samp(column, 0).confidence_interval(0.95)
        assert row["ci95"] == pytest.approx([interval.low, interval.high])
        assert np.isnan(row["preferred"])
        assert row["motions"] == {"m": pytest.approx(column.mean())}
    pair = found["pairs"][1]
    assert pair["systems"] == ["A", "C"]
    related = stats.ttest_rel(GRADES[:, 0], GRADES[:, 2]).confidence_interval(0.95)
    assert pair["ci95"] == pytest.approx([related.low, related.high])
    assert pair["mean"] == pytest.approx((GRADES[:, 0] - GRADES[:, 2]).mean())


def test_signed_ranks_are_counted_out() -> None:
    differences = np.array([1.0, -2.0, 3.5, 4.0, 5.0, 6.5, 7.0])
    ranks = np.arange(1, 8)
    sums = [
        sum(r for r, s in zip(ranks, way, strict=True) if s)
        for way in product((0, 1), repeat=7)
    ]
    least = 2  # the rank of the only negative one
    expected = 2 * np.mean([total <= least for total in sums])
    assert wilcoxon(differences) == pytest.approx(expected)
    assert wilcoxon(np.zeros(4)) == 1.0


def test_holms_correction_steps_down() -> None:
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.6, 0.7]) == [1.0, 1.0]
    assert holm([0.2]) == [0.2]
    found = summarize(_raters(GRADES), ONE)
    single = [pair["p"] for pair in found["pairs"]]
    assert [pair["p_holm"] for pair in found["pairs"]] == pytest.approx(holm(single))


def test_one_rater_has_means_but_no_intervals() -> None:
    found = summarize(_raters(GRADES[:1]), ONE)
    assert found["systems"]["C"]["mean"] == 8
    assert np.isnan(found["systems"]["C"]["ci95"]).all()
    assert {pair["p"] for pair in found["pairs"]} == {1.0}


def test_pairs_say_who_is_preferred_and_who_contradicts_themselves() -> None:
    key = Key(
        "p",
        ["A", "B"],
        ["m", "n"],
        [(0, 0), (1, 0), (1, 1), (0, 1)],
        [(0, 1), (2, 3), (0, 1)],
    )
    raters = {
        "sure": [((0, 1), (3, 7)), ((2, 3), (6, 6)), ((1, 0), (7, 3))],
        "unsure": [((1, 0), (4, 2)), ((3, 2), (1, 9)), ((0, 1), (5, 1))],
        "lazy": [((1, 0), (5, 5)), ((3, 2), (5, 5)), ((0, 1), (5, 5))],
    }
    found = summarize(raters, key)
    assert found["systems"]["A"]["preferred"] == pytest.approx((1 + 4 / 2) / 9)
    assert found["systems"]["B"]["preferred"] == pytest.approx((4 + 4 / 2) / 9)
    (pair,) = found["pairs"]
    assert (pair["better"], pair["equal"]) == ([1, 4], 4)
    # A: of 3 and 3 as one, with 6; of 2 and 5 with 1; 5.
    assert found["systems"]["A"]["mean"] == pytest.approx(np.mean([4.5, 2.25, 5]))
    sure, unsure, lazy = found["raters"].values()
    assert (sure["twice"], sure["reversed"], sure["apart"]) == (1, 0, 0)
    assert (unsure["twice"], unsure["reversed"], unsure["apart"]) == (1, 1, 3)
    assert lazy["same_grade"]
    assert not unsure["same_grade"]


KEY: dict[str, Any] = {
    "page": "0123",
    "systems": ["old", "new", "raw"],
    "motions": ["walk"],
    "clips": [{"system": name, "motion": "walk"} for name in ("new", "raw", "old")],
    "trials": [[0, 1], [2, 0], [1, 2], [1, 0]],
}


def _answers(rater: str) -> dict[str, Any]:
    """Return the answers of somebody who likes the first clip of the key best."""
    rows = [
        {"shown": trial[::-1], "grades": [3 if clip else 8 for clip in trial[::-1]]}
        for trial in KEY["trials"]
    ]
    return {"page": KEY["page"], "rater": rater, "answers": rows}


@pytest.fixture
def answered(tmp_path: Path) -> Path:
    """Return a folder of a key and the answers of two raters."""
    (tmp_path / "page.key.json").write_text(json.dumps(KEY))
    (tmp_path / "answers").mkdir()
    for rater in ("Zoë", "bob"):
        text = json.dumps(_answers(rater))
        (tmp_path / "answers" / f"{rater}.json").write_text(text)
    return tmp_path


def _ratings(folder: Path, *more: str) -> int:
    key, out = str(folder / "page.key.json"), str(folder / "figures.json")
    return main(
        ["ratings", str(folder / "answers"), "--key", key, "--json", out, *more]
    )


def test_ratings_prints_and_writes_what_raters_said(
    answered: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _ratings(answered) == 0
    told = capsys.readouterr().out
    for words in ("new", "8.00", "100 %", "2 raters"):
        assert words in told
    found = json.loads((answered / "figures.json").read_text(encoding="utf-8"))
    means = {name: row["mean"] for name, row in found["systems"].items()}
    assert means == {"old": 3, "new": 8, "raw": 3}
    assert set(found["raters"]) == {"Zoë", "bob"}


def _first(found: dict[str, Any], change: dict[str, Any]) -> dict[str, Any]:
    rows = [found["answers"][0] | change, *found["answers"][1:]]
    return found | {"answers": rows}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda k: k | {"page": "another"}, r"of page 'another'.*key is of page"),
        (lambda _: {}, "of no page"),
        (lambda k: k | {"rater": "Zoë"}, "second file of rater 'Zoë'"),
        (lambda k: k | {"rater": " "}, "answers of a rater"),
        (lambda k: k | {"answers": k["answers"][1:]}, "not the 4 answers"),
        (lambda k: _first(k, {"shown": [0, 99]}), "not the 4 answers"),
        (lambda k: _first(k, {"shown": ["0", None]}), "damaged"),
        (lambda k: _first(k, {"grades": [3, None]}), "answer 1 .*ask the rater"),
        (lambda k: _first(k, {"grades": [3, 10]}), "answer 1 .*from 1 to 9"),
        (lambda k: _first(k, {"grades": [3, True]}), "answer 1"),
        (lambda k: _first(k, {"grades": [3]}), "answer 1"),
        (lambda k: k | {"answers": [3]}, "damaged"),
        (lambda _: [1], "not JSON of"),
    ],
)
def test_wrong_answers_are_refused(
    answered: Path,
    capsys: pytest.CaptureFixture[str],
    change: Callable[[Any], Any],
    message: str,
) -> None:
    text = json.dumps(change(_answers("zed")))
    (answered / "answers" / "zed.json").write_text(text)
    assert _ratings(answered) == 2
    told = capsys.readouterr().err
    assert re.search(message, told), told
    assert "zed.json" in told
    assert not (answered / "figures.json").exists()


def test_without_answers_or_key_nothing_is_told(
    answered: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _ratings(answered, "--key", str(answered / "answers" / "bob.json")) == 2
    assert "not the key of a page" in capsys.readouterr().err
    key = str(answered / "page.key.json")
    assert main(["ratings", key, "--key", key]) == 2
    assert "no answers given" in capsys.readouterr().err
    assert _ratings(answered, "--json", key) == 2
    assert "overwrite" in capsys.readouterr().err


@pytest.mark.parametrize(
    "change",
    [
        {"systems": ["old", "new", "other"]},
        {"systems": ["old", "old", "raw"]},
        {"clips": KEY["clips"][:2]},
        {"clips": KEY["clips"][:1] * 3},
        {"trials": [[0, 1]]},
        {"trials": [[0, 1], [2, 9]]},
        {"trials": [[0, 1, 2]]},
        {"trials": "012"},
    ],
)
def test_a_damaged_key_is_refused(
    answered: Path, capsys: pytest.CaptureFixture[str], change: dict[str, Any]
) -> None:
    (answered / "page.key.json").write_text(json.dumps(KEY | change))
    assert _ratings(answered) == 2
    assert "not the key of a page" in capsys.readouterr().err


def test_raters_in_doubt_are_told(
    answered: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    told = {"lazy": [[5, 5]] * 4, "torn": [[3, 4], [3, 4], [3, 4], [3, 4]]}
    told["vague"] = [[1, 2], [3, 4], [3, 4], [8, 3]]
    for rater, grades in told.items():
        found = _answers(rater)
        for row, given in zip(found["answers"], grades, strict=True):
            row["grades"] = given
        (answered / "answers" / f"{rater}.json").write_text(json.dumps(found))
    assert _ratings(answered) == 0
    said = capsys.readouterr().out
    assert "lazy gave everything the same grade" in said
    assert "torn preferred the other clip the second time in 1 of 1" in said
    assert "vague graded the same clips 4.0 apart" in said
    assert "bob" not in said
