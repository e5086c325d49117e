"""Edits beside takes, mostly of a batch, and cleaning a take of it again with them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from batch_folders import QUICK, clean_folder, make_folder, rows_of, table_of
from batch_takes import Here, short_take, write_session

from kinefilter import CleanConfig, InputError
from kinefilter.pipeline.batch.manifest import Row, open_manifest, read_rows
from kinefilter.pipeline.batch.store import store_at
from kinefilter.pipeline.batch.task import clean_again, find_takes
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.edits import Edit, edits_text
from kinefilter.pipeline.formats import write_take_csv
from kinefilter.pipeline.formats.export import Export
from kinefilter.pipeline.settings import Settings, as_table, overlaid, settings_in

LAME = Edit("distrust", 0.1, 0.3, ("left-leg",))
BLIND = Edit("distrust", 0.1, 0.4, ("right-arm",))


@pytest.fixture(autouse=True)
def here(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("kinefilter.pipeline.batch.run.open_crew", Here)


@pytest.fixture
def takes(tmp_path: Path) -> Path:
    return make_folder(tmp_path / "takes")


@pytest.fixture
def out(tmp_path: Path, takes: Path) -> Path:
    clean_folder(takes, tmp_path / "out")
    return tmp_path / "out"


def _edit(take: Path, edit: Edit) -> None:
    take.with_suffix(".edits.toml").write_text(edits_text([edit]))


def _row(out: Path, take: str = "a.csv") -> Row:
    (row,) = (row for row in read_rows(out) if row.take == take)
    return row


def _files(folder: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_edits_beside_a_take_are_applied_and_clean_it_again_when_they_change(
    takes: Path, out: Path
) -> None:
    before = (out / "a.bvh").read_bytes()
    clips = [before]
    for edit in (LAME, BLIND):
        _edit(takes / "a.csv", edit)
        assert [row.take for row in clean_folder(takes, out).rows] == ["a.csv"]
        assert f"edited: {edit.summary}" in _row(out).clips[0].notes
        clips.append((out / "a.bvh").read_bytes())
    assert len(set(clips)) == 3
    (takes / "a.edits.toml").unlink()
    assert [row.take for row in clean_folder(takes, out).rows] == ["a.csv"]
    assert (out / "a.bvh").read_bytes() == before


def test_a_clip_beside_an_edited_take_is_passed_over_and_a_second_take_told(
    takes: Path, out: Path
) -> None:
    _edit(takes / "a.csv", LAME)
    (takes / "a.bvh").write_bytes((out / "a.bvh").read_bytes())
    status = {row.take: row.status for row in clean_folder(takes, out).rows}
    assert status == {"a.csv": "done", "a.bvh": "no take"}
    (takes / "a.txt").write_bytes((takes / "a.csv").read_bytes())
    failed = {row.take: row.error for row in clean_folder(takes, out).failed}
    assert failed.keys() == {"a.csv", "a.txt"}
    for error in failed.values():
        assert "a.edits.toml: lies beside a.csv and a.txt" in error
        assert "--" not in error


def test_named_edits_and_people_leave_those_beside_the_take_alone(
    takes: Path, tmp_path: Path
) -> None:
    _edit(takes / "a.csv", LAME)
    everyone = clean_folder(takes, tmp_path / "all", replace(QUICK, body="all"))
    assert not any(
        "edited" in n for r in everyone.rows for c in r.clips for n in c.notes
    )
    other = tmp_path / "other.toml"
    other.write_text(edits_text([BLIND]))
    (takes / "monday" / "kinefilter.toml").write_text(f'edits = "{other}"')
    (takes / "monday" / "late" / "c.csv").unlink()
    _edit(takes / "monday" / "b.csv", LAME)
    clean_folder(takes, tmp_path / "out")
    row = _row(tmp_path / "out", "monday/b.csv")
    assert f"edited: {BLIND.summary}" in row.clips[0].notes
    with pytest.raises(InputError, match="its batch has --edits"):
        clean_again(row, tmp_path / "out", find_takes(row, [takes]))


@pytest.mark.parametrize("name", ["a.csv", "monday/late/c.csv"])
def test_a_take_cleaned_again_is_as_a_batch_makes_it_and_leaves_nothing_to_do(
    takes: Path, out: Path, tmp_path: Path, name: str
) -> None:
    _edit(takes / name, LAME)
    row = _row(out, name)
    old = _files(out)
    again = clean_again(row, out, find_takes(row, [tmp_path, takes]))
    assert _row(out, name) == again == rows_of(out)[-1]
    clip = Path(name).with_suffix(".bvh")
    assert {n for n, data in _files(out).items() if data != old.get(n)} == {
        clip.name,
        "manifest.jsonl",
        "manifest.csv",
    }
    (line,) = (line for line in table_of(out) if line["take"] == name)
    assert f"edited: {LAME.summary}" in line["notes"]
    kept = clean_folder(takes, out)
    assert kept.rows == []
    clean_folder(takes, tmp_path / "fresh")
    assert (out / clip).read_bytes() == (tmp_path / "fresh" / clip).read_bytes()
    _edit(takes / name, BLIND)  # and once more
    clean_again(again, out, find_takes(again, [takes]))
    assert clean_folder(takes, out).rows == []


def test_options_of_the_batch_hold_where_the_take_is_cleaned_again(
    takes: Path, tmp_path: Path
) -> None:
    (takes / "monday" / "kinefilter.toml").write_text("cutoff = 3.0\nbegin = 0.1")
    slow = replace(QUICK, export=Export(fps=25.0))
    clean_folder(takes, tmp_path / "out", slow)
    row = _row(tmp_path / "out", "monday/b.csv")
    assert row.options == {
        "method": "none",
        "physics": False,
        "cutoff": 3.0,
        "begin": 0.1,
        "fps": 25.0,
    }
    _edit(takes / "monday" / "b.csv", LAME)
    clean_again(row, tmp_path / "out", find_takes(row, [takes]))
    assert clean_folder(takes, tmp_path / "out", slow).rows == []


def test_a_session_is_cleaned_again_with_the_edits_beside_its_first_take(
    tmp_path: Path,
) -> None:
    takes, out = tmp_path / "takes", tmp_path / "out"
    takes.mkdir()
    first, _ = write_session(takes, "dance", short_take(120))
    settings = replace(QUICK, sessions="{name}_{sensor}.csv")
    clean_folder(takes, out, settings)
    row = _row(out, "dance")
    assert find_takes(row, [takes]) == [takes / "dance_A.csv", takes / "dance_B.csv"]
    _edit(first, LAME)
    done = clean_again(row, out, find_takes(row, [takes]))
    assert f"edited: {LAME.summary}" in done.clips[0].notes
    assert clean_folder(takes, out, settings).rows == []


def test_clean_does_not_pass_over_edits_beside_the_take_in_silence(
    takes: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _edit(takes / "a.csv", LAME)
    edits = str(takes / "a.edits.toml")
    command = ["clean", str(takes / "a.csv"), "-o", str(takes / "a.npz")]
    for words, told in (([], True), (["--edits", edits], False)):
        assert main([*command, *words, "--method", "none", "--no-physics"]) == 0
        assert (f"add --edits {edits}" in capsys.readouterr().err) == told


def _other_take(takes: Path, _: Path) -> None:
    write_take_csv(short_take(25, seed=9), takes / "a.csv")


def _other_clip(_: Path, out: Path) -> None:
    (out / "a.bvh").write_text("by hand")


def _bad_edits(takes: Path, _: Path) -> None:
    _edit(takes / "a.csv", Edit("exchange", 50.0, 60.0))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda takes, _: (takes / "a.csv").unlink(), "not found; give .*--take"),
        (_other_take, "a.csv: is not the take"),
        (_other_clip, "a.bvh: was changed since"),
        (_bad_edits, "a.edits.toml: exchange 1: .*no frame is"),
    ],
)
def test_nothing_changes_where_a_take_cannot_be_cleaned_again(
    takes: Path, out: Path, change: object, words: str
) -> None:
    row = _row(out)
    _edit(takes / "a.csv", LAME)
    change(takes, out)  # type: ignore[operator]
    before = _files(out)
    with pytest.raises(InputError, match=words):
        clean_again(row, out, find_takes(row, [takes]))
    assert _files(out) == before


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"settings": "0" * 32}, "options that it did not record"),
        ({"options": {"method": "none"}}, "options that it did not record"),
        ({"options": {"colour": "red"}}, "options of a.csv: unknown key 'colour'"),
        ({"options": {"blender": "/bin/sh"}}, "unknown key 'blender'"),
        ({"options": {"body": "all"}}, "for one person"),
        ({"output": "../a.bvh"}, "is not in"),
        ({"output": "/tmp/a.bvh"}, "is not in"),
    ],
)
def test_a_row_that_does_not_say_how_it_was_made_is_refused(
    takes: Path, out: Path, values: dict[str, object], words: str
) -> None:
    row = replace(_row(out), **values)  # type: ignore[arg-type]
    before = _files(out.parent)
    with pytest.raises(InputError, match=words):
        clean_again(row, out, find_takes(row, [takes]))
    assert _files(out.parent) == before


def test_no_take_is_cleaned_again_while_a_batch_runs(takes: Path, out: Path) -> None:
    row = _row(out)
    with (
        open_manifest(store_at(str(out))),
        pytest.raises(InputError, match="another run is writing"),
    ):
        clean_again(row, out, find_takes(row, [takes]))


@pytest.mark.parametrize(
    "config",
    [
        CleanConfig(preset="shum-2013", floor=0.2),
        CleanConfig(same_person=(Path("/x/b.csv"),)),
    ],
)
def test_settings_are_the_same_after_a_table(config: CleanConfig) -> None:
    settings = Settings(
        config,
        Export(fps=24.0, rig="unreal"),
        body=2,
        sessions="{name}_{sensor}.csv",
        sensors=("a", "b"),
    )
    read = settings_in(as_table(settings), "row", Path("/"))
    assert overlaid(Settings(), read) == settings
    assert as_table(Settings()) == {}
