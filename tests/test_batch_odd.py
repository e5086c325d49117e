"""No take, whatever it holds or is called, ends a batch."""

from __future__ import annotations

import io
import json
import os
import socket
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from batch_folders import clean_folder, rows_of, table_of
from batch_takes import Here, short_take
from rich.console import Console

from kinefilter.characters import InputError
from kinefilter.pipeline.batch import run
from kinefilter.pipeline.batch.manifest import ClipRow, Row, open_manifest
from kinefilter.pipeline.batch.outcome_tables import as_tables
from kinefilter.pipeline.batch.plan import Job, clip_names, unique_names
from kinefilter.pipeline.batch.run import Outcome
from kinefilter.pipeline.batch.store import store_at
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.formats import write_take_csv
from kinefilter.pipeline.formats.files import check_file
from kinefilter.pipeline.formats.plain import printable
from kinefilter.pipeline.look.comparison import read_comparison
from kinefilter.pipeline.metrics import METRICS

CLIP = ClipRow("a.bvh", "1", "", 1, 9, 0.3, 2.0, 1.0, None, None, None, 0, ())


def _lines(out: Path) -> list[dict[str, Any]]:
    """Return the rows as any strict reader of JSON sees them."""

    def refuse(constant: str) -> None:
        raise AssertionError(constant)

    text = (out / "manifest.jsonl").read_bytes().decode("utf-8")
    rows = [json.loads(line, parse_constant=refuse) for line in text.splitlines()]
    json.dumps(rows, ensure_ascii=False).encode("utf-8")
    return rows


@pytest.mark.usefixtures("here")
def test_figures_that_do_not_exist_are_empty(tmp_path: Path) -> None:
    takes = tmp_path / "takes"
    takes.mkdir()
    write_take_csv(short_take(2), takes / "two.csv")
    take = short_take(12)
    uneven = np.cumsum(np.where(np.arange(12) % 3 == 0, 0.4, 1 / 30))
    write_take_csv(replace(take, time=uneven), takes / "uneven.csv")
    write_take_csv(take, takes / "whole.csv")
    outcome = clean_folder(takes, tmp_path / "clips")
    assert [row.status for row in outcome.rows] == ["done"] * 3
    figures = {row["take"]: row["clips"][0] for row in _lines(tmp_path / "clips")}
    for odd in ("two.csv", "uneven.csv"):
        assert figures[odd]["jitter"] is figures[odd]["jitter_raw"] is None
    assert figures["whole.csv"]["jitter"] > 0.0
    table = {row["take"]: row for row in table_of(tmp_path / "clips")}
    assert table["two.csv"]["jitter"] == ""
    assert not clean_folder(takes, tmp_path / "clips").rows  # read back as written


def test_figures_of_a_short_take_are_null_in_json(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_take_csv(short_take(2), tmp_path / "two.csv")
    words = ["--method", "none", "--json", str(tmp_path / "two.json")]
    words += ["--report", str(tmp_path / "two.html")]
    out = str(tmp_path / "two.bvh")
    assert main(["clean", str(tmp_path / "two.csv"), "-o", out, *words]) == 0
    figures = json.loads((tmp_path / "two.json").read_text())
    assert figures["raw"]["jitter"] is None
    assert (tmp_path / "two.html").exists()
    capsys.readouterr()
    assert main(["info", out, "--json"]) == 0
    assert "NaN" not in capsys.readouterr().out


@pytest.mark.parametrize("wrong", [object(), np.float32(1.0), {1, 2}])
def test_a_row_that_cannot_be_written_is_that_of_a_failed_take(
    tmp_path: Path, wrong: Any
) -> None:
    store = store_at(str(tmp_path))
    row = Row("a", "done", "a.bvh", "1", clips=(replace(CLIP, jitter=wrong),))
    with open_manifest(store) as manifest:
        written = manifest.append([row, replace(row, take="b", clips=(CLIP,))])
        manifest.append(written)
    assert [row.status for row in written] == ["failed", "done"]
    assert rows_of(tmp_path) == written
    assert "cannot be written" in written[0].error


def test_an_interrupt_while_rows_are_written_leaves_each_once(
    takes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rows that were received are not lost either."""

    class Interrupted(Here):
        def submit(self, job: Job) -> None:
            if len(self.jobs) == 1 and getattr(self, "came", False):
                raise KeyboardInterrupt
            super().submit(job)

        def finished(self) -> list[tuple[Job, Row | None]]:
            self.came = True
            return super().finished()

    monkeypatch.setattr(run, "open_crew", Interrupted)
    with pytest.raises(KeyboardInterrupt):
        clean_folder(takes, tmp_path / "clips")
    assert len(rows_of(tmp_path / "clips")) == 1


NAMES = {
    b"caf\xe9.csv": "caf%E9.csv",
    b"new\nline.csv": "new%0Aline.csv",
    b"red\x1b[31m.csv": "red%1B[31m.csv",
    "日本.csv".encode(): "日本.csv",
    b"l" * 251 + b".csv": "l" * 251 + ".csv",
    "é".encode() * 125 + b".csv": "é" * 125 + ".csv",
}


@pytest.mark.skipif(os.name == "nt", reason="names are of characters there")
@pytest.mark.parametrize("suffix", ["usdc", "usdz", "bvh", "csv", "npz"])
@pytest.mark.usefixtures("here")
def test_takes_of_any_name_are_cleaned(
    tmp_path: Path, suffix: str, capsys: pytest.CaptureFixture[str]
) -> None:
    takes = tmp_path / "takes"
    takes.mkdir()
    for name in NAMES:
        write_take_csv(short_take(8), takes / "a")
        (takes / "a").rename(takes / os.fsdecode(name))
    broken = os.fsdecode(b"b\xe9\n.skeleton")
    (takes / broken).write_text("no take")
    words = ["--to", suffix, "--method", "none", "--no-physics"]
    assert main(["batch", str(takes), "-o", str(tmp_path / "out"), *words]) == 1
    rows = {row["take"]: row for row in _lines(tmp_path / "out")}
    assert set(rows) == {*NAMES.values(), "b%E9%0A.skeleton"}
    assert "b%E9%0A.skeleton" in rows["b%E9%0A.skeleton"]["error"]
    for take in NAMES.values():
        assert rows[take]["status"] == "done", rows[take]["error"]
        assert (tmp_path / "out" / rows[take]["output"]).stat().st_size > 0
    assert {row["take"] for row in table_of(tmp_path / "out")} == set(rows)
    assert "6 takes cleaned, 1 failed" in capsys.readouterr().out


@pytest.mark.usefixtures("here")
def test_a_console_of_ascii_is_told_all(
    takes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (takes / "é\u2603.skeleton").write_text("no take")
    printed = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(printed, "ascii"))
    words = ["--method", "none", "--no-physics"]
    assert main(["batch", str(takes), "-o", str(tmp_path / "out"), *words]) == 1
    assert rb"\u2603.skeleton" in printed.getvalue()


def test_what_no_file_can_hold_is_written_as_in_urls() -> None:
    assert printable("é 日本.csv") == "é 日本.csv"
    assert printable("a\n\x1b\udce9\u2028") == "a%0A%1B%E9%28"


def test_names_that_are_cut_stay_apart() -> None:
    names = clip_names(["x/" + "é" * 125 + end for end in ("a.csv", "b.csv")], ".usdc")
    assert len(set(names)) == 2
    assert all(len(Path(name).name.encode()) < 250 for name in names)


def test_numbers_of_thousands_of_equal_names_are_found_at_once() -> None:
    asked = 0

    def key(name: str) -> str:
        nonlocal asked
        asked += 1
        return name

    names = unique_names(["day/take.csv"] * 2000, key)
    assert names[:3] == ["day/take.csv", "day/2-take.csv", "day/3-take.csv"]
    assert len(set(names)) == 2000
    assert asked < 10 * len(names)


@pytest.mark.usefixtures("here")
def test_what_is_no_file_is_told_and_never_opened(takes: Path, tmp_path: Path) -> None:
    (takes / "folder.csv").mkdir()
    (takes / "gone.csv").symlink_to("nowhere.csv")
    (takes / "round.csv").symlink_to("round.csv")
    wrong = dict.fromkeys(("gone.csv", "round.csv"), "a link to a missing file")
    if hasattr(os, "mkfifo"):
        os.mkfifo(takes / "pipe.csv")
        (takes / "null.csv").symlink_to(os.devnull)
        here = Path.cwd()
        os.chdir(takes)  # a socket's path is short
        with socket.socket(socket.AF_UNIX) as unix:
            unix.bind("socket.csv")
        os.chdir(here)
        wrong |= dict.fromkeys(("pipe.csv", "null.csv", "socket.csv"), "a pipe, a sock")
    for _ in range(2):
        outcome = clean_folder(takes, tmp_path / "clips")
        errors = {row.take: row.error for row in outcome.failed}
        assert errors.keys() == wrong.keys()
        assert all(words in errors[take] for take, words in wrong.items())
    done = {row.take for row in outcome.kept if row.status == "done"}
    assert done == {"a.csv", "monday/b.csv", "monday/late/c.csv"}
    with pytest.raises(InputError, match="restore that file or remove the link"):
        check_file(takes / "gone.csv")


@pytest.mark.usefixtures("here")
def test_a_take_that_cannot_be_read_any_more_ends_no_later_run(
    takes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clean_folder(takes, tmp_path / "clips")
    os.utime(takes / "a.csv", (1e9, 1e9))
    opened = Path.open

    def refused(path: Path, *options: Any, **more: Any) -> Any:
        if path.name == "a.csv":
            raise PermissionError(13, "Permission denied")
        return opened(path, *options, **more)

    monkeypatch.setattr(Path, "open", refused)
    again = clean_folder(takes, tmp_path / "clips")
    assert [(row.take, row.status) for row in again.rows] == [("a.csv", "failed")]
    assert "Permission denied" in again.rows[0].error


@pytest.mark.usefixtures("here")
def test_damage_is_told_with_its_seconds(
    takes: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    take = short_take(90)
    positions, mirror = take.positions.copy(), take.skeleton.mirror
    positions[30:60] = positions[30:60][:, mirror]
    write_take_csv(replace(take, positions=positions), takes / "damaged.csv")
    words = ["--method", "none", "--no-physics"]
    out = tmp_path / "clips"
    assert main(["batch", str(takes), "-o", str(out), *words]) == 0
    assert "1 with damage" in capsys.readouterr().out
    damaged = str(takes / "damaged.csv")
    assert main(["clean", damaged, "-o", f"{out}/x.npz", *words]) == 0
    told = [
        line.removeprefix("tracker failure: ")
        for line in capsys.readouterr().out.splitlines()
        if line.startswith("tracker failure: ")
    ]
    assert told[0].startswith("body left and right swapped (1.0 to ")
    damage = {row.take: row.clips[0].damage for row in rows_of(out) if row.clips}
    assert damage == {
        "damaged.csv": tuple(told),
        "a.csv": (),
        "monday/b.csv": (),
        "monday/late/c.csv": (),
    }
    cells = {row["take"]: row["damage"] for row in table_of(out)}
    assert cells["damaged.csv"] == "; ".join(told)
    shown = read_comparison(out / "x.npz", takes / "damaged.csv").damage
    assert shown == tuple(told)
    words.append("--fail-on-damage")
    assert main(["clean", damaged, "-o", f"{out}/x.bvh", *words]) == 1
    assert main(["clean", str(takes / "a.csv"), "-o", f"{out}/x.bvh", *words]) == 0
    assert main(["batch", str(takes), "-o", str(out), *words]) == 1


def test_rows_without_damage_are_still_read() -> None:
    row = Row("a", "done", "a.bvh", "1", clips=(replace(CLIP, failures=2),))
    values = json.loads(row.as_json())
    del values["clips"][0]["damage"], values["sensors"]
    old = Row.from_json(json.dumps(values))
    assert old == row
    assert "1 with damage" in _printed(Outcome(kept=[old]))


def test_worst_takes_are_told_without_their_figures() -> None:
    row = Row("a", "done", "a.bvh", "1", clips=(replace(CLIP, jitter=None),))
    told = " ".join(_printed(Outcome(rows=[row])).split())
    assert "worst take" in told
    assert METRICS["skate_mm_per_frame"] in told  # in the words of report


def _printed(outcome: Outcome) -> str:
    console = Console(width=200, file=io.StringIO())
    console.print(as_tables(outcome))
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()
