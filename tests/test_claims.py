"""README's figures: every one is a claim that a study measures."""

from __future__ import annotations

import csv
import re
from dataclasses import fields, replace
from itertools import groupby
from pathlib import Path

import pytest
from short_takes import write_short_sample

from kinefilter.characters import InputError
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.lab.studies import (
    STUDIES,
    Options,
    claims,
    fingerprint,
    recordings_folder,
    reproduce,
    shum,
    study,
)
from kinefilter.pipeline.lab.studies.cleaned_takes import _LOW_IS_WORSE
from kinefilter.pipeline.lab.studies.study import Panel, Series, Study
from kinefilter.pipeline.look.options import Look

ROOT = Path(__file__).parents[1]
NUMBER = re.compile(r"-?\d+(?:\.\d+)?")
PANEL = Panel("what", "cm", (Series("one", ["one"], [0.5], "bars"),))
CLAIM = claims.Claim(
    *("distance, cm", "0.50", "small", "one", "cm", "is", 0.01, "rounding", False)
)


def _table(file: str, *headings: str) -> dict[str, list[str]]:
    """Return the figures of sections by what their row says, where there are any."""
    text = (ROOT / file).read_text(encoding="utf-8")
    sections = [text.partition(f"## {h}\n")[2].partition("\n## ")[0] for h in headings]
    lines = [
        line
        for section in sections
        for line in section.splitlines()
        if re.match(r"\|(?!-)", line)
    ]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    found = {row[0]: NUMBER.findall(" ".join(row[1:])) for row in rows}
    assert len(found) == len(rows)
    return {says: figures for says, figures in found.items() if figures}


@pytest.mark.parametrize(
    ("file", "headings"),
    [
        ("README.md", ["Figures"]),
        (
            "pipeline/lab/RESULTS.md",
            [
                "Clips, reliability, failures, papers, speed",
                "Things that are held",
                "Seats",
            ],
        ),
        ("pipeline/lab/DEPARTURES.md", ["Presets on recorded people", "Trackers"]),
    ],
)
def test_every_figure_is_a_claim_and_every_claim_is_in_its_text(
    file: str, headings: list[str]
) -> None:
    table = _table(file, *headings)
    claimed = [claim for claim in claims.read_claims() if claim.where in file]
    by_row = groupby(claimed, key=lambda claim: claim.says)
    said = {says: [claim.figure for claim in group] for says, group in by_row}
    begins = {
        says: next((row for row in table if _same(row, says)), None) for says in said
    }
    assert None not in begins.values(), begins
    assert {begins[says]: figures for says, figures in said.items()} == table


def _same(row: str, says: str) -> bool:
    """Tell whether a row's words are those of a claim, but for what the paper has."""
    return row.partition(" (the paper")[0] == says


def test_readmes_prose_has_no_figure_that_nobody_measures() -> None:
    """Where it says what kinefilter cannot do, the table has the figures."""
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    limitations = readme.partition("## Limitations\n")[2].partition("\nLicense")[0]
    assert re.findall(r"\d+(?:\.\d+)? ?(?:%|cm|mm|ms|times)", limitations) == []


def test_every_claim_has_a_study_a_side_and_a_reason() -> None:
    found = claims.read_claims()
    assert len({(claim.name, claim.where) for claim in found}) == len(found)
    for claim in found:
        assert claim.study in STUDIES, claim.name
        assert claim.direction in ("is", "at most", "at least"), claim.name
        assert claim.within >= 0.0, claim.name
        assert claim.why, claim.name
        assert claim.holds(float(claim.figure)), claim.name


def test_a_claim_holds_on_its_side_within_its_tolerance() -> None:
    at_most = claims.Claim(**{**vars(CLAIM), "direction": "at most"})
    at_least = claims.Claim(**{**vars(CLAIM), "direction": "at least"})
    for measured, sides in {
        0.505: (True, True, True),
        0.52: (False, False, True),
        0.2: (False, True, False),
    }.items():
        held = tuple(one.holds(measured) for one in (CLAIM, at_most, at_least))
        assert held == sides, measured


def test_without_a_tolerance_the_last_digit_decides() -> None:
    assert claims.last_digit("98") == 1.0
    assert claims.last_digit("-0.50") == pytest.approx(0.01)


def test_a_claim_is_judged_by_the_cell_of_its_study(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorded = claims.Claim(**{**vars(CLAIM), "row": "two", "recordings": True})
    absent = claims.Claim(**{**vars(CLAIM), "row": "three"})
    monkeypatch.setattr(claims, "read_claims", lambda: [CLAIM, recorded, absent])
    (tmp_path / "small.csv").write_text("what,cm\none,0.503\ntwo,0.9\n", "utf-8")
    one, two, three = claims.judge(tmp_path, ["small"], recordings=True)
    assert (one.measured, one.held, one.row[-1]) == (0.503, True, "yes")
    assert (two.measured, two.held, two.row[-1]) == (0.9, False, "no")
    assert (three.measured, three.held) == (None, False)
    two = claims.judge(tmp_path, ["small"], recordings=False)[1]
    assert (two.held, two.row[-1]) == (None, "not measured: no recordings")
    assert claims.judge(tmp_path, ["other"], recordings=True) == []
    quick = claims.judge(tmp_path, ["small"], recordings=True, quick=True)
    assert [verdict.held for verdict in quick] == [None, None, None]


def test_every_claim_has_its_cell_in_the_study(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of those studies that are quick: a name that changed would be found late."""
    whole = shum._standard_postures
    monkeypatch.setattr(shum, "_standard_postures", lambda *who: whole(*who)[::20])
    for name, sizes in (
        ("shum-table-3", {"motions": 1}),
        ("cleaned-takes", {"count": 1}),
    ):
        study = STUDIES[name][0](Options(), **sizes)
        cells = {(row[0], column) for row in study.rows for column in study.columns}
        for claim in claims.read_claims():
            if claim.study == name:
                assert (claim.row, claim.column) in cells, claim.name
        if name == "cleaned-takes":
            assert set(_LOW_IS_WORSE) < {row for row, _ in cells}


def test_all_says_which_claims_held_and_goes_on_where_it_ended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    made_of: list[str] = []

    def measured(name: str, *_: object, **__: object) -> Study:
        made_of.append(name)
        return Study("Made up", ("what", "cm"), (("one", 0.5),), (PANEL,))

    studies = "kinefilter.pipeline.lab.studies"
    monkeypatch.setattr(f"{studies}.STUDIES", {"small": STUDIES["speed"]})
    monkeypatch.setattr(f"{studies}.check_names", lambda _: None)
    monkeypatch.setattr(f"{studies}.reproduce", measured)
    monkeypatch.setattr(
        f"{studies}.study.make_pictures", lambda *_, **__: iter(["drawn"])
    )
    monkeypatch.setattr(claims, "read_claims", lambda: [CLAIM])
    arguments = ["reproduce", "--all", str(tmp_path / "all")]
    assert main(arguments) == 0
    assert "1 of 1 claims held" in capsys.readouterr().out
    with (tmp_path / "all" / "claims.csv").open(encoding="utf-8", newline="") as file:
        (row,) = csv.DictReader(file)
    assert (row["README"], row["measured"], row["held"]) == ("0.50", "0.5", "yes")
    (tmp_path / "all" / "small.csv").write_text("what,cm\none,0.6\n", "utf-8")
    assert main(arguments) == 1  # taken as it is, and 0.6 is not 0.5
    assert "is up to date" in capsys.readouterr().out
    assert made_of == ["small"]
    assert main([*arguments, "--quick"]) == 0  # not of the same making
    assert "not judged" in capsys.readouterr().out
    assert made_of == ["small", "small"]
    assert main(["reproduce", "small", "-o", str(tmp_path / "one")]) == 0
    monkeypatch.setattr(claims, "read_claims", lambda: [replace(CLAIM, figure="0.60")])
    assert main(["reproduce", "small", "-o", str(tmp_path / "one")]) == 1


def test_the_fingerprint_changes_with_what_is_measured(tmp_path: Path) -> None:
    (tmp_path / "take.csv").write_text("1", "utf-8")
    first = fingerprint(tmp_path, seed=0, quick=False)
    assert fingerprint(tmp_path, seed=0, quick=False) == first
    assert fingerprint(tmp_path, seed=1, quick=False) != first
    assert fingerprint(tmp_path, seed=0, quick=True) != first
    (tmp_path / "take.csv").write_text("12", "utf-8")
    assert fingerprint(tmp_path, seed=0, quick=False) != first


@pytest.mark.parametrize(
    "arguments",
    [
        ["reproduce"],
        ["reproduce", "speed"],
        ["reproduce", "speed", "--all", "out"],
        ["reproduce", "--all", "out", "-o", "other"],
        ["reproduce", "--all", "out", "--data", "absent"],
    ],
)
def test_what_contradicts_itself_is_refused(
    arguments: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    assert capsys.readouterr().err.startswith("kinefilter: ")
    assert list(tmp_path.iterdir()) == []


def test_recordings_are_looked_for_where_they_are_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    work = tmp_path / "work"
    work.mkdir()
    monkeypatch.chdir(work)
    assert recordings_folder(None) is None
    (tmp_path / "shared" / "data").mkdir(parents=True)
    assert recordings_folder(None) is not None
    assert recordings_folder(tmp_path) == tmp_path
    with pytest.raises(InputError, match="recordings"):
        reproduce("methods-new-people", Options(data=tmp_path), quick=True)


def test_a_picture_that_cannot_be_made_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise InputError("no OpenGL")

    monkeypatch.setattr(study, "_animate", refuse)
    folder = tmp_path / "pictures"
    folder.mkdir()
    monkeypatch.setattr(study, "SAMPLE", write_short_sample(tmp_path / "few", 39))
    told = list(study.make_pictures(folder))
    assert "no OpenGL" in told[0]
    assert [line.split()[0] for line in told] == ["not"] * len(told)
    assert list(folder.iterdir()) == []
    options = {field.name for field in fields(Look)}
    assert all(part.keys() <= options for *_, part in study._MIMED)
