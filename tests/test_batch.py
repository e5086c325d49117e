"""Folders of takes into folders of clips: what is found, done, kept and told."""

from __future__ import annotations

import csv
import errno
import gzip
import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from batch_takes import Here, short_take
from published_layouts import ntu_text

from kinefilter.characters import InputError
from kinefilter.pipeline import CleanConfig, clean, read_take, write_clip
from kinefilter.pipeline.batch import Outcome, as_tables, clean_files, manifest, run
from kinefilter.pipeline.batch.local import LocalStore
from kinefilter.pipeline.batch.manifest import open_manifest, write_csv
from kinefilter.pipeline.batch.naming import clip_names, numbered
from kinefilter.pipeline.batch.places import store_at
from kinefilter.pipeline.batch.plan import Job, plan_jobs
from kinefilter.pipeline.batch.row import Row, parse_rows, row_from_json
from kinefilter.pipeline.batch.sources import find_sources
from kinefilter.pipeline.batch.task import clean_file
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.formats import read_bvh, write_take_csv
from kinefilter.pipeline.formats.takes import claims_take
from kinefilter.pipeline.run import make_corrector
from kinefilter.pipeline.settings import Settings
from kinefilter.pipeline.simulate import simulate

QUICK = Settings(CleanConfig(method="none", physics=False))
FLAGS = ["--method", "none", "--no-physics"]
DATA = Path(__file__).parents[1].parent / "shared" / "data"


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let batches of the test work in its own process."""
    monkeypatch.setattr(run, "_crew", Here)


@pytest.fixture
def takes(tmp_path: Path) -> Path:
    """Return a folder with three takes and what else lies in such folders."""
    folder = tmp_path / "takes"
    (folder / "monday" / "late").mkdir(parents=True)
    for k, name in enumerate(("a", "monday/b", "monday/late/c")):
        write_take_csv(short_take(20 + k, seed=k), folder / f"{name}.csv")
    (folder / "notes.txt").write_text("what we did today\n")
    (folder / "labels.csv").write_text("take,label\na,wave\n")
    (folder / "about.json").write_text('{"studio": 4, "frames": 20}\n')
    (folder / "clip.npz").write_bytes(b"PK")
    (folder / ".hidden.csv").write_text("no take\n")
    return folder


def _files(folder: Path) -> set[str]:
    return {
        path.relative_to(folder).as_posix()
        for path in folder.rglob("*")
        if path.is_file() and not path.name.startswith("manifest")
    }


def _rows(out: Path) -> list[Row]:
    lines = (out / "manifest.jsonl").read_text().splitlines()
    return [row_from_json(line) for line in lines]


def _table(out: Path) -> list[dict[str, str]]:
    with (out / "manifest.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def _clean(takes: Path, out: Path, settings: Settings = QUICK) -> Outcome:
    return clean_files([str(takes)], str(out), settings, suffix=".bvh")


@pytest.mark.usefixtures("here")
def test_the_tree_of_takes_is_mirrored_and_the_rest_passed_over(
    takes: Path, tmp_path: Path
) -> None:
    outcome = _clean(takes, tmp_path / "clips")
    assert _files(tmp_path / "clips") == {"a.bvh", "monday/b.bvh", "monday/late/c.bvh"}
    assert not outcome.failed
    passed = {row.take for row in outcome.rows if row.status == "no take"}
    assert passed == {"notes.txt", "labels.csv", "about.json"}
    assert len(read_bvh(tmp_path / "clips" / "a.bvh").positions) == 20


@pytest.mark.usefixtures("here")
def test_a_clip_of_a_batch_is_that_of_clean(takes: Path, tmp_path: Path) -> None:
    settings = Settings(CleanConfig())
    _clean(takes / "monday", tmp_path / "clips", settings)
    for name in ("b", "late/c"):
        result = clean(read_take(takes / "monday" / f"{name}.csv"))
        alone = tmp_path / "alone.bvh"
        write_clip(result.clip, alone)
        written = tmp_path / "clips" / f"{name}.bvh"
        assert written.read_bytes() == alone.read_bytes()


@pytest.mark.parametrize(
    "config",
    [
        CleanConfig(),
        CleanConfig(method="local-pca", search="stochastic"),
        CleanConfig(method="kalman"),
        CleanConfig(method="one-euro"),
        CleanConfig(method="nearest"),
    ],
)
def test_a_method_forgets_the_take_before(config: CleanConfig) -> None:
    config = replace(config, physics=False)
    one, other = short_take(30), short_take(30, start=150, seed=1)
    method = make_corrector(one.skeleton, config)
    clean(one, config, corrector=method)
    again = clean(other, config, corrector=method).clip.positions
    np.testing.assert_array_equal(again, clean(other, config).clip.positions)


@pytest.mark.usefixtures("here")
def test_the_manifest_holds_every_take_once_with_its_figures(
    takes: Path, tmp_path: Path
) -> None:
    (takes / "broken.csv").write_text((takes / "a.csv").read_text()[:2000])
    _clean(takes, tmp_path / "clips", Settings(CleanConfig(method="none")))
    table = {row["take"]: row for row in _table(tmp_path / "clips")}
    assert set(table) == {"a.csv", "broken.csv", "monday/b.csv", "monday/late/c.csv"}
    assert [row.take for row in _rows(tmp_path / "clips")].count("a.csv") == 1
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
def test_what_is_done_is_not_done_again(takes: Path, tmp_path: Path) -> None:
    out = tmp_path / "clips"
    _clean(takes, out)
    lines = (out / "manifest.jsonl").read_bytes()
    again = _clean(takes, out)
    assert not again.rows
    assert len(again.kept) == 6
    assert (out / "manifest.jsonl").read_bytes() == lines


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(
    ("change", "redone"),
    [
        ("take", {"a.csv"}),
        ("clip", {"a.csv"}),
        ("clip gone", {"a.csv"}),
        ("touched", set()),
        ("settings", {"a.csv", "monday/b.csv", "monday/late/c.csv"}),
        ("folder", {"monday/b.csv", "monday/late/c.csv"}),
    ],
)
def test_only_what_changed_is_done_again(
    takes: Path, tmp_path: Path, change: str, redone: set[str]
) -> None:
    out = tmp_path / "clips"
    _clean(takes, out)
    before = (out / "monday" / "late" / "c.bvh").read_bytes()
    settings = QUICK
    if change == "take":
        write_take_csv(short_take(25), takes / "a.csv")
    elif change == "clip":
        with (out / "a.bvh").open("a") as file:
            file.write("\n")
    elif change == "clip gone":
        (out / "a.bvh").unlink()
    elif change == "touched":
        for path in (takes / "a.csv", out / "a.bvh"):
            os.utime(path, (1e9, 1e9))
    elif change == "settings":
        settings = Settings(replace(QUICK.config, cutoff=3.0))
    else:
        (takes / "monday" / "kinefilter.toml").write_text("cutoff = 3.0\n")
    again = _clean(takes, out, settings)
    assert {row.take for row in again.rows if row.status == "done"} == redone
    assert _files(out) == {"a.bvh", "monday/b.bvh", "monday/late/c.bvh"}
    after = (out / "monday" / "late" / "c.bvh").read_bytes()
    assert (after != before) == ("monday/late/c.csv" in redone)


@pytest.mark.usefixtures("here")
def test_a_database_counts_by_its_content(takes: Path, tmp_path: Path) -> None:
    contacts = tmp_path / "contacts.csv"
    contacts.write_text("time,HeelLeft,ToeLeft,HeelRight,ToeRight\n0,1,1,1,1\n")
    settings = Settings(replace(QUICK.config, contacts=contacts))
    _clean(takes, tmp_path / "clips", settings)
    os.utime(contacts, (1e9, 1e9))
    assert not _clean(takes, tmp_path / "clips", settings).rows
    contacts.write_text("time,HeelLeft,ToeLeft,HeelRight,ToeRight\n0,0,0,1,1\n")
    assert len(_clean(takes, tmp_path / "clips", settings).rows) == 6


@pytest.mark.usefixtures("here")
def test_a_failed_take_is_tried_again_and_then_counts_as_done(
    takes: Path, tmp_path: Path
) -> None:
    whole = (takes / "a.csv").read_text()
    (takes / "a.csv").write_text(whole[:2000])
    assert len(_clean(takes, tmp_path / "clips").failed) == 1
    assert len(_clean(takes, tmp_path / "clips").failed) == 1
    (takes / "a.csv").write_text(whole)
    again = _clean(takes, tmp_path / "clips")
    assert [row.status for row in again.rows] == ["done"]
    assert {row["status"] for row in _table(tmp_path / "clips")} == {"done"}


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize("cut", [1, 40, 200])
def test_a_torn_last_line_is_dropped_and_its_take_done_again(
    takes: Path, tmp_path: Path, cut: int
) -> None:
    lines = tmp_path / "clips" / "manifest.jsonl"
    _clean(takes, tmp_path / "clips")
    whole = lines.read_bytes()
    last = row_from_json(whole.splitlines()[-1].decode()).take
    lines.write_bytes(whole[:-cut])
    again = _clean(takes, tmp_path / "clips")
    assert [row.take for row in again.rows] == [last]
    assert len(_rows(tmp_path / "clips")) == 6


def test_a_damaged_line_that_is_not_the_last_is_refused() -> None:
    row = Row("a", "done", "a.bvh", "1", "", "", 1.0).as_json() + "\n"
    with pytest.raises(InputError, match=r"m\.jsonl: line 2 is damaged"):
        parse_rows((row + "{\n" + row).encode(), "m.jsonl")
    rows, length = parse_rows((row + row + "{").encode(), "m.jsonl")
    assert len(rows) == 2
    assert length == 2 * len(row)


def test_two_runs_do_not_write_into_one_folder(tmp_path: Path) -> None:
    store = LocalStore(str(tmp_path / "clips"))
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

    store = LocalStore(str(tmp_path))
    row = Row("a", "done", "a.bvh", "1", "", "", 1.0)
    with open_manifest(store) as opened:
        opened.append([row])
        with monkeypatch.context() as patched:
            patched.setattr(manifest.os, "fsync", full)
            with pytest.raises(InputError, match="No space left"):
                opened.append([replace(row, take="b")])
        opened.append([replace(row, take="c")])
    assert [row.take for row in _rows(tmp_path)] == ["a", "c"]


def test_where_nothing_can_be_written_nothing_is_begun(
    takes: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("not a folder")
    out = str(tmp_path / "file" / "clips")
    assert main(["batch", str(takes), "-o", out, *FLAGS]) == 2
    assert "cannot be written" in capsys.readouterr().err


def test_names_that_would_be_the_same_are_kept_apart() -> None:
    takes = ["a.csv", "a.bvh", "a.csv.gz", "b.csv.gz", "s/a.csv", "B.txt", "a.csv.txt"]
    names = clip_names(takes, ".bvh")
    assert len({name.casefold() for name in names}) == len(takes)
    assert names[4] == "s/a.bvh"
    assert clip_names(takes[::-1], ".bvh") == names[::-1]
    assert clip_names(["x.csv", "X.csv"], ".bvh") == ["x.csv.bvh", "2-X.csv.bvh"]
    assert clip_names(["t.1.csv", "t.2.csv"], ".bvh") == ["t.1.bvh", "t.2.bvh"]
    people = clip_names(["t.csv", "t.1.csv"], ".bvh", several=True)
    assert len({numbered(name, 1) for name in people} | set(people)) == 4


def test_files_of_several_folders_are_kept_apart(takes: Path, tmp_path: Path) -> None:
    other = tmp_path / "other" / "takes"
    other.mkdir(parents=True)
    (other / "a.csv").write_text("a take")
    inputs = [str(takes), str(other), str(takes / "monday"), str(other / "a.csv")]
    found = {s.take for s in find_sources(inputs, str(tmp_path / "out"))}
    assert {"takes/a.csv", "takes-2/a.csv"} <= found
    assert len(found) == 7  # once each, and what is no take by its name not at all


def test_the_output_folder_is_not_searched(takes: Path, tmp_path: Path) -> None:
    out = takes / "clips"
    out.mkdir()
    (out / "old.csv").write_text("a clip of an earlier run")
    assert "clips/old.csv" not in {s.take for s in find_sources([str(takes)], str(out))}
    with pytest.raises(InputError, match="searched for takes itself"):
        find_sources([str(takes)], str(takes))
    with pytest.raises(InputError, match="no such file or folder"):
        find_sources([str(tmp_path / "absent")], str(out))


@pytest.mark.usefixtures("here")
def test_a_take_is_never_overwritten(takes: Path) -> None:
    (takes / "monday" / "monday").mkdir()
    write_take_csv(short_take(20), takes / "monday" / "monday" / "b.csv")
    before = (takes / "monday" / "b.csv").read_bytes()
    with pytest.raises(InputError, match="would overwrite a take"):
        clean_files([str(takes / "monday")], str(takes), QUICK, suffix=".csv")
    assert (takes / "monday" / "b.csv").read_bytes() == before


@pytest.mark.parametrize(
    ("text", "claims"),
    [
        ("time,SpineBase.x,SpineBase.y\n", True),
        ("time,HeelLeft,ToeLeft\n", False),
        ("HipCenter; Spine; Head\n", True),
        ("take;label\n", False),
        ("1 2 3 4\n", True),
        ("what we did today\n", False),
        ("12\n", True),
        ('{"bone_list": []', True),
        ('{"frames": 20}', False),
        ("HIERARCHY\n", True),
    ],
)
def test_takes_are_told_from_notes_by_how_they_begin(
    text: str, claims: bool, tmp_path: Path
) -> None:
    plain, zipped = tmp_path / "plain.txt", tmp_path / "zipped.txt.gz"
    plain.write_text(text)
    zipped.write_bytes(gzip.compress(text.encode()))
    assert claims_take(plain) == claims
    assert claims_take(zipped) == claims


@pytest.mark.skipif(not DATA.exists(), reason="recordings (../shared/data) not here")
def test_recordings_claim_to_be_takes_and_what_lies_beside_them_does_not() -> None:
    files = sorted((DATA / "takes").rglob("*.*"))
    texts = [p for p in files if p.name.endswith((".csv", ".csv.gz", ".txt"))]
    notes = ("LICEN", "SOURCE", "README")
    assert len(texts) > 50
    for path in texts:
        assert claims_take(path) != path.name.startswith(notes), path


@pytest.mark.usefixtures("here")
def test_all_people_of_a_take_get_a_clip_each(tmp_path: Path) -> None:
    two = tmp_path / "two.skeleton"
    one = simulate("basic", "wave", seed=1).take
    other = replace(one, positions=one.positions + np.array([1.0, 0, 0]))
    two.write_text(ntu_text([one, other]))
    settings = Settings(QUICK.config, body="all")
    outcome = clean_files([str(two)], str(tmp_path / "c"), settings, suffix=".bvh")
    assert _files(tmp_path / "c") == {"two.1.bvh", "two.2.bvh"}
    assert [clip.body for clip in outcome.rows[0].clips] == [1, 2]
    assert [row["body"] for row in _table(tmp_path / "c")] == ["1", "2"]
    again = clean_files([str(two)], str(tmp_path / "c"), settings, suffix=".bvh")
    assert not again.rows


def test_exit_codes_say_what_became_of_the_batch(
    takes: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In a process of its own, as users run it."""
    (takes / "broken.skeleton").write_text("nothing of the kind")
    out = tmp_path / "clips"
    command = ["batch", str(takes), "-o", str(out), *FLAGS, "--jobs", "1"]
    assert main(command) == 1
    printed = capsys.readouterr().out
    for words in ("3 takes cleaned, 1 failed", "frames/s", "worst takes", "broken"):
        assert words in printed
    (takes / "broken.skeleton").unlink()
    assert main(command) == 0
    assert "0 takes cleaned, 0 failed, 3 done before" in capsys.readouterr().out
    assert _files(out) == {"a.usdc", "monday/b.usdc", "monday/late/c.usdc"}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["absent"], "no such file or folder"),
        ([".", "--jobs", "0"], "--jobs 0"),
        ([".", "--config", "absent.toml"], "absent.toml"),
        ([".", "--config", "wrong.toml"], "wrong.toml: unknown key 'colour'"),
        ([".", "--model", "absent.npz"], "absent.npz"),
        ([".", "--up", "z", "--to", "csv"], "--up"),
        ([".", "--character", "sam.usda"], "--character sam.usda"),
        ([".", "--scheduler", "tcp://x:1", "--jobs", "2"], "--scheduler"),
        ([".", "--cutoff", "0.1"], "--cutoff"),
    ],
)
def test_wrong_commands_write_nothing(
    takes: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    arguments: list[str],
    words: str,
) -> None:
    (takes / "wrong.toml").write_text('colour = "red"\n')
    monkeypatch.chdir(takes)
    before = sorted(takes.rglob("*"))
    assert main(["batch", *arguments, "-o", "clips"]) == 2
    error = capsys.readouterr().err
    assert error.startswith("kinefilter: ")
    assert words in error
    assert sorted(takes.rglob("*")) == before


@pytest.mark.usefixtures("here")
def test_the_worst_takes_come_first(
    takes: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from rich.console import Console

    outcome = _clean(takes, tmp_path / "clips")
    rows = [row for row in outcome.rows if row.clips]
    for k, row in enumerate(rows):
        clip = replace(row.clips[0], external_force_body_weights=float(k))
        rows[k] = replace(row, clips=(clip,))
    Console(width=200).print(as_tables(Outcome(rows=rows)))
    printed = capsys.readouterr().out
    places = [printed.index(row.take) for row in rows]
    assert places == sorted(places, reverse=True)


def test_the_longest_take_is_begun_first(
    takes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun: list[str] = []

    class Watched(Here):
        def submit(self, job: Job) -> None:
            begun.append(job.source.take)
            super().submit(job)

    monkeypatch.setattr(run, "_crew", Watched)
    write_take_csv(short_take(60), takes / "z.csv")
    _clean(takes, tmp_path / "clips")
    assert begun[0] == "z.csv"
    assert begun[1] == "monday/late/c.csv"


def test_an_interrupted_run_writes_its_table_and_goes_on(
    takes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Tired(Here):
        def finished(self) -> list[tuple[Job, Row | None]]:
            if len(self.jobs) < 2:
                raise KeyboardInterrupt
            return super().finished()

    out = tmp_path / "clips"
    command = ["batch", str(takes), "-o", str(out), *FLAGS]
    monkeypatch.setattr(run, "_crew", Tired)
    assert main(command) == 130
    done = {row.take for row in _rows(out)}
    assert 0 < len(done) < 6
    assert {row["take"] for row in _table(out)} <= done
    monkeypatch.setattr(run, "_crew", Here)
    assert main(command) == 0
    assert len(_rows(out)) == 6


@pytest.mark.usefixtures("here")
def test_a_store_by_url_gives_the_same_clips_as_its_folder(
    takes: Path, tmp_path: Path
) -> None:
    """``file://`` is one that other processes reach too."""
    pytest.importorskip("fsspec", reason="fsspec, of the extra cluster, is not here")
    _clean(takes, tmp_path / "here")
    url = f"file://{tmp_path}/there"
    (takes / "monday" / "kinefilter.toml").write_text("cutoff = 6.0\n")
    outcome = clean_files([f"file://{takes}"], url, QUICK, suffix=".bvh")
    assert not outcome.failed
    assert len(outcome.rows) == 6
    names = {"a.bvh", "monday/b.bvh", "monday/late/c.bvh"}
    for name in names:
        here, there = tmp_path / "here" / name, tmp_path / "there" / name
        assert here.read_bytes() == there.read_bytes()
    left = {p.name for p in (tmp_path / "there").rglob("*") if p.is_file()}
    (part,) = left - {Path(name).name for name in names} - {"manifest.csv"}
    assert part.endswith(".jsonl")
    again = clean_files([f"file://{takes}"], url, QUICK, suffix=".bvh")
    assert not again.rows
    assert len(again.kept) == 6


def test_a_protocol_that_is_not_installed_is_named(tmp_path: Path) -> None:
    pytest.importorskip("fsspec", reason="fsspec, of the extra cluster, is not here")
    with pytest.raises(InputError, match="no-such-thing"):
        find_sources(["no-such-thing://bucket/takes"], str(tmp_path))


def test_what_a_killed_process_left_is_cleared_away(tmp_path: Path) -> None:
    left = tmp_path / "a" / ".0b0f7d1c5d8e4c6e9a6f1f0c8d2b3a4e.usdc"
    left.parent.mkdir()
    left.write_text("half a clip")
    others = [tmp_path / ".hidden", tmp_path / "a" / ".config.toml"]
    for other in others:
        other.write_text("somebody's")
    LocalStore(str(tmp_path)).remove_unfinished()
    assert not left.exists()
    assert all(other.exists() for other in others)


def test_the_table_is_written_whole(tmp_path: Path) -> None:
    store = store_at(str(tmp_path))
    rows = [Row("b, c", "failed", "", "1", "", "", 1.0, error='"x"\ny')]
    write_csv(rows, store)
    assert [row["take"] for row in _table(tmp_path)] == ["b, c"]
    assert _table(tmp_path)[0]["error"] == '"x"\ny'
    assert [path.name for path in tmp_path.iterdir()] == ["manifest.csv"]


def test_rows_say_all_there_is_to_say_as_json() -> None:
    row = Row("é", "failed", "é.bvh", "1-2", "", "f", 0.5, error="no\nway")
    assert row_from_json(row.as_json()) == row
    assert "\n" not in row.as_json()
    assert json.loads(row.as_json())["take"] == "é"


def test_a_worker_that_would_do_another_thing_refuses(takes: Path) -> None:
    out = LocalStore(str(takes.parent / "clips"))
    sources = find_sources([str(takes / "a.csv")], out.root)
    (job,) = plan_jobs(sources, out, QUICK, ".bvh")
    elsewhere = clean_file(replace(job, fingerprint="of another kinefilter"))
    assert (elsewhere.status, elsewhere.clips) == ("failed", ())
    assert "another kinefilter" in elsewhere.error
    assert clean_file(job).status == "done"
