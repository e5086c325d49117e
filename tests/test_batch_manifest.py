"""The manifest of a batch: whole lines or none, one run at a time."""

from __future__ import annotations

import errno
import json
import os
from dataclasses import replace
from pathlib import Path

import pytest
from batch_folders import clean_folder, rows_of, table_of
from rich.console import Console

from kinefilter import CleanConfig
from kinefilter.characters import InputError
from kinefilter.pipeline.batch import manifest
from kinefilter.pipeline.batch.manifest import Row, open_manifest, parse_rows, write_csv
from kinefilter.pipeline.batch.outcome_tables import as_tables
from kinefilter.pipeline.batch.run import Outcome
from kinefilter.pipeline.batch.store import remove_unfinished, store_at
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.commands import terminal
from kinefilter.pipeline.settings import Settings


@pytest.mark.usefixtures("here")
def test_the_manifest_holds_every_take_once_with_its_figures(
    takes: Path, tmp_path: Path
) -> None:
    (takes / "broken.csv").write_text((takes / "a.csv").read_text()[:2000])
    clean_folder(takes, tmp_path / "clips", Settings(CleanConfig(method="none")))
    table = {row["take"]: row for row in table_of(tmp_path / "clips")}
    assert set(table) == {"a.csv", "broken.csv", "monday/b.csv", "monday/late/c.csv"}
    assert [row.take for row in rows_of(tmp_path / "clips")].count("a.csv") == 1
    assert table["broken.csv"]["status"] == "failed"
    assert "broken.csv: row" in table["broken.csv"]["error"]
    done = table["monday/b.csv"]
    assert done["status"] == "done"
    assert done["output"] == "monday/b.bvh"
    assert done["frames"] == "21"
    assert float(done["motion_seconds"]) == pytest.approx(20 / 30, rel=0.1)
    assert 0.0 < float(done["jitter"]) < float(done["jitter_raw"])
    assert float(done["external_force_body_weights"]) > 0.0
    assert float(done["seconds"]) > 0.0


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize("cut", [1, 40, 200])
def test_a_torn_last_line_is_dropped_and_its_take_done_again(
    takes: Path, tmp_path: Path, cut: int
) -> None:
    lines = tmp_path / "clips" / "manifest.jsonl"
    clean_folder(takes, tmp_path / "clips")
    whole = lines.read_bytes()
    last = Row.from_json(whole.splitlines()[-1].decode()).take
    lines.write_bytes(whole[:-cut])
    again = clean_folder(takes, tmp_path / "clips")
    assert [row.take for row in again.rows] == [last]
    assert len(rows_of(tmp_path / "clips")) == 6


def test_rows_of_a_later_run_count_in_a_store_though_the_clock_went_back(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    store = store_at("memory://clock")
    for nanoseconds, status in ((2 * 10**18, "failed"), (10**18, "done")):
        monkeypatch.setattr(manifest.time, "time_ns", lambda n=nanoseconds: n)
        with open_manifest(store) as lines:
            lines.append([Row("a", status, "a.bvh", "1", "", "", 1.0)])
    with open_manifest(store) as lines:
        assert lines.rows["a"].status == "done"


def test_a_damaged_line_that_is_not_the_last_is_refused() -> None:
    row = Row("a", "done", "a.bvh", "1", "", "", 1.0).as_json() + "\n"
    with pytest.raises(InputError, match=r"m\.jsonl: line 2 is damaged"):
        parse_rows((row + "{\n" + row).encode(), "m.jsonl")
    rows, length = parse_rows((row + row + "{").encode(), "m.jsonl")
    assert len(rows) == 2
    assert length == 2 * len(row)


def test_two_runs_do_not_write_into_one_folder(tmp_path: Path) -> None:
    store = store_at(str(tmp_path / "clips"))
    refused = pytest.raises(InputError, match="another run")
    with open_manifest(store), refused, open_manifest(store):
        pass
    with open_manifest(store):
        pass  # let go of


def test_a_full_disk_leaves_the_manifest_as_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    store = store_at(str(tmp_path))
    row = Row("a", "done", "a.bvh", "1", "", "", 1.0)
    with open_manifest(store) as opened:
        opened.append([row])
        with monkeypatch.context() as patched:
            patched.setattr(os, "fsync", full)
            with pytest.raises(InputError, match="No space left"):
                opened.append([replace(row, take="b")])
        opened.append([replace(row, take="c")])
    assert [row.take for row in rows_of(tmp_path)] == ["a", "c"]


def test_what_a_killed_process_left_is_cleared_away(tmp_path: Path) -> None:
    left = tmp_path / "a" / ".0b0f7d1c5d8e4c6e9a6f1f0c8d2b3a4e.usdc"
    left.parent.mkdir()
    left.write_text("half a clip")
    others = [tmp_path / ".hidden", tmp_path / "a" / ".config.toml"]
    for other in others:
        other.write_text("somebody's")
    remove_unfinished(store_at(str(tmp_path)))
    assert not left.exists()
    assert all(other.exists() for other in others)


def test_the_table_is_written_whole(tmp_path: Path) -> None:
    store = store_at(str(tmp_path))
    rows = [Row("b, c", "failed", "", "1", "", "", 1.0, error='"x"\ny')]
    write_csv(rows, store)
    assert [row["take"] for row in table_of(tmp_path)] == ["b, c"]
    assert table_of(tmp_path)[0]["error"] == '"x"\ny'
    assert [path.name for path in tmp_path.iterdir()] == ["manifest.csv"]


def test_rows_say_all_there_is_to_say_as_json() -> None:
    row = Row("é", "failed", "é.bvh", "1-2", "", "f", 0.5, error="no\nway")
    assert Row.from_json(row.as_json()) == row
    assert "\n" not in row.as_json()
    assert json.loads(row.as_json())["take"] == "é"


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize("seconds", [0.0, 60.0])
def test_a_log_gets_a_line_of_progress_now_and_then(
    takes: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    seconds: float,
) -> None:
    monkeypatch.setattr(terminal, "_LOGGED", seconds)
    options = ["--method", "none", "--no-physics"]
    assert main(["batch", str(takes), "-o", str(tmp_path / "clips"), *options]) == 0
    with terminal.progress_bars() as progress:
        assert list(progress("physics", 2)) == [0, 1]
    lines = capsys.readouterr().err.splitlines()
    assert lines[:1] + lines[-3:] == (
        [] if seconds else ["clean 0/6", "clean 6/6", "physics 0/2", "physics 1/2"]
    )


@pytest.mark.usefixtures("here")
def test_a_take_that_is_gone_keeps_its_row_and_clip(
    takes: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "clips"
    command = ["batch", str(takes), "-o", str(out), "--method", "none", "--no-physics"]
    assert main(command) == 0
    assert "earlier" not in capsys.readouterr().out
    (takes / "a.csv").unlink()
    assert main(command) == 0
    said = capsys.readouterr().out
    assert "2 already done, 1 of an earlier run only (see manifest.csv)" in said
    assert "a.csv" in {row["take"] for row in table_of(out)}
    assert (out / "a.usdc").exists()


@pytest.mark.parametrize(
    ("error", "shown"),
    [
        ("/takes/a/b.csv: row 3 is short", "row 3 is short"),
        ("/x/aa/b.csv: is no contacts file", "/x/aa/b.csv: is no contacts file"),
        ("its process died twice", "its process died twice"),
    ],
)
def test_the_summary_gives_an_error_without_the_path_of_its_take(
    error: str, shown: str, capsys: pytest.CaptureFixture[str]
) -> None:
    row = Row("a/b.csv", "failed", "a/b.usdc", "", error=error)
    Console(width=200).print(as_tables(Outcome(rows=[row])))
    assert f"a/b.csv │ {shown}" in capsys.readouterr().out
