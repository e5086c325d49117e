"""Folders of takes into folders of clips: what is done, kept and told."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from batch_folders import QUICK, clean_folder, rows_of, table_of
from batch_takes import Here, short_take
from published_layouts import ntu_text

from kinefilter import CleanConfig, Cleaner, clean, read_take, write_clip
from kinefilter.characters import InputError
from kinefilter.pipeline.batch import run
from kinefilter.pipeline.batch.manifest import Row, Status
from kinefilter.pipeline.batch.outcome_tables import as_tables
from kinefilter.pipeline.batch.plan import Job, find_sources, plan_jobs
from kinefilter.pipeline.batch.run import Outcome, clean_files
from kinefilter.pipeline.batch.store import store_at
from kinefilter.pipeline.batch.task import clean_file
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.formats import read_bvh, write_take_csv
from kinefilter.pipeline.lab.simulation import simulate
from kinefilter.pipeline.settings import Settings

FLAGS = ["--method", "none", "--no-physics"]


def _files(folder: Path) -> set[str]:
    return {
        path.relative_to(folder).as_posix()
        for path in folder.rglob("*")
        if path.is_file() and not path.name.startswith("manifest")
    }


@pytest.mark.usefixtures("here")
def test_the_tree_of_takes_is_mirrored_and_the_rest_passed_over(
    takes: Path, tmp_path: Path
) -> None:
    outcome = clean_folder(takes, tmp_path / "clips")
    assert _files(tmp_path / "clips") == {"a.bvh", "monday/b.bvh", "monday/late/c.bvh"}
    assert not outcome.failed
    passed = {row.take for row in outcome.rows if row.status == "no take"}
    assert passed == {"notes.txt", "labels.csv", "about.json"}
    assert len(read_bvh(tmp_path / "clips" / "a.bvh").positions) == 20


@pytest.mark.usefixtures("here")
def test_a_clip_of_a_batch_is_that_of_clean(takes: Path, tmp_path: Path) -> None:
    settings = Settings(CleanConfig())
    clean_folder(takes / "monday", tmp_path / "clips", settings)
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
    cleaner = Cleaner(config)
    cleaner.clean(one)
    again = cleaner.clean(other).clip.positions
    np.testing.assert_array_equal(again, clean(other, config).clip.positions)


@pytest.mark.usefixtures("here")
def test_what_is_done_is_not_done_again(takes: Path, tmp_path: Path) -> None:
    out = tmp_path / "clips"
    clean_folder(takes, out)
    lines = (out / "manifest.jsonl").read_bytes()
    again = clean_folder(takes, out)
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
    clean_folder(takes, out)
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
    again = clean_folder(takes, out, settings)
    assert {row.take for row in again.rows if row.status == "done"} == redone
    assert _files(out) == {"a.bvh", "monday/b.bvh", "monday/late/c.bvh"}
    after = (out / "monday" / "late" / "c.bvh").read_bytes()
    assert (after != before) == ("monday/late/c.csv" in redone)


@pytest.mark.usefixtures("here")
def test_a_database_counts_by_its_content(takes: Path, tmp_path: Path) -> None:
    contacts = tmp_path / "contacts.csv"
    contacts.write_text("time,HeelLeft,ToeLeft,HeelRight,ToeRight\n0,1,1,1,1\n")
    settings = Settings(replace(QUICK.config, contacts=contacts))
    late = takes / "monday" / "late"
    clean_folder(late, tmp_path / "clips", settings)
    os.utime(contacts, (1e9, 1e9))
    assert not clean_folder(late, tmp_path / "clips", settings).rows
    contacts.write_text("time,HeelLeft,ToeLeft,HeelRight,ToeRight\n0,0,0,1,1\n")
    assert len(clean_folder(late, tmp_path / "clips", settings).rows) == 1


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize("where", ["command", "folder"])
def test_contacts_are_of_one_take(takes: Path, tmp_path: Path, where: str) -> None:
    contacts = takes / "contacts.csv"
    contacts.write_text("time,HeelLeft,ToeLeft,HeelRight,ToeRight\n0,1,1,1,1\n")
    out, settings = tmp_path / "clips", QUICK
    if where == "command":
        settings = Settings(replace(QUICK.config, contacts=contacts))
    else:
        (takes / "kinefilter.toml").write_text('contacts = "contacts.csv"\n')
    with pytest.raises(
        InputError, match=r"one take, not for both a\.csv and monday/b\.csv"
    ):
        clean_folder(takes, out, settings)
    assert not out.exists()


@pytest.mark.usefixtures("here")
def test_contacts_are_of_one_person(takes: Path, tmp_path: Path) -> None:
    config = replace(QUICK.config, contacts=takes / "labels.csv")
    with pytest.raises(InputError, match="one person"):
        clean_folder(
            takes / "monday" / "late", tmp_path / "clips", Settings(config, body="all")
        )


@pytest.mark.usefixtures("here")
def test_contacts_beside_a_take_are_of_that_take(takes: Path, tmp_path: Path) -> None:
    """What else lies there, a list of labels and the contacts, is no second take."""
    late = takes / "monday" / "late"
    (late / "contacts.csv").write_text(
        "time,HeelLeft,ToeLeft,HeelRight,ToeRight\n0,1,1,1,1\n"
    )
    (late / "labels.csv").write_text("take,label\nc,wave\n")
    (late / "kinefilter.toml").write_text('contacts = "contacts.csv"\n')
    outcome = clean_folder(takes, tmp_path / "clips")
    assert sum(row.status == "done" for row in outcome.rows) == 3


@pytest.mark.usefixtures("here")
def test_a_failed_take_is_tried_again_and_then_counts_as_done(
    takes: Path, tmp_path: Path
) -> None:
    whole = (takes / "a.csv").read_text()
    (takes / "a.csv").write_text(whole[:2000])
    assert len(clean_folder(takes, tmp_path / "clips").failed) == 1
    assert len(clean_folder(takes, tmp_path / "clips").failed) == 1
    (takes / "a.csv").write_text(whole)
    again = clean_folder(takes, tmp_path / "clips")
    assert [row.status for row in again.rows] == ["done"]
    assert {row["status"] for row in table_of(tmp_path / "clips")} == {"done"}


def test_where_nothing_can_be_written_nothing_is_begun(
    takes: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("not a folder")
    out = str(tmp_path / "file" / "clips")
    assert main(["batch", str(takes), "-o", out, *FLAGS]) == 2
    assert "cannot be written" in capsys.readouterr().err


@pytest.mark.usefixtures("here")
def test_a_take_is_never_overwritten(takes: Path) -> None:
    (takes / "monday" / "monday").mkdir()
    write_take_csv(short_take(20), takes / "monday" / "monday" / "b.csv")
    before = (takes / "monday" / "b.csv").read_bytes()
    with pytest.raises(InputError, match="would overwrite a take"):
        clean_files([str(takes / "monday")], str(takes), QUICK, suffix=".csv")
    assert (takes / "monday" / "b.csv").read_bytes() == before


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
    assert [row["body"] for row in table_of(tmp_path / "c")] == ["1", "2"]
    again = clean_files([str(two)], str(tmp_path / "c"), settings, suffix=".bvh")
    assert not again.rows
    one_of_them = clean_files([str(two)], str(tmp_path / "d"), QUICK).rows[0]
    assert "cleaned body 1 of 2" in "; ".join(one_of_them.clips[0].notes)


def test_exit_codes_say_what_became_of_the_batch(
    takes: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In a process of its own, as users run it."""
    (takes / "[red]broken.skeleton").write_text("nothing of the kind")
    out = tmp_path / "clips"
    command = ["batch", str(takes), "-o", str(out), *FLAGS, "--jobs", "1"]
    assert main(command) == 1
    printed = capsys.readouterr().out
    for words in (
        "3 takes cleaned, 1 failed",
        "frames/s",
        "worst takes",
        "[red]broken",
    ):
        assert words in printed
    (takes / "[red]broken.skeleton").unlink()
    assert main(command) == 0
    assert "0 takes cleaned, 0 failed, 3 already done" in capsys.readouterr().out
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
        (["../wrong"], "wrong/kinefilter.toml: unknown scene 'nope'; known: basic,"),
        (
            ["../wrong", "--scene", "no"],
            "kinefilter: unknown scene 'no'; known: basic,",
        ),
        (["../wrong", "--scene", "box"], "kinefilter.toml: unknown rig 'mixmo'"),
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
    own = takes.with_name("wrong") / "kinefilter.toml"
    own.parent.mkdir()
    own.write_text('scene = "nope"\nrig = "mixmo"\n')
    own.with_name("a.csv").write_text("")
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

    outcome = clean_folder(takes, tmp_path / "clips")
    rows = [row for row in outcome.rows if row.clips]
    for k, row in enumerate(rows):
        clip = replace(row.clips[0], external_force_body_weights=float(k))
        rows[k] = replace(row, clips=(clip,))
    Console(width=200).print(as_tables(Outcome(rows=rows)))
    printed = capsys.readouterr().out
    places = [printed.index(row.take) for row in rows]
    assert places == sorted(places, reverse=True)


def test_one_take_is_not_told_as_several(capsys: pytest.CaptureFixture[str]) -> None:
    from rich.console import Console

    def row(take: str, status: Status) -> Row:
        return Row(take, status, "a.bvh", "1", seconds=1.0)

    one = [row("a", "done"), row("b", "no take")]
    for rows in (one, one * 2):
        Console(width=200).print(as_tables(Outcome(rows=rows, seconds=1.0)))
    first, second = capsys.readouterr().out.splitlines()
    assert first.startswith("1 take cleaned, 0 failed, 1 other file skipped (b), ")
    assert second.startswith("2 takes cleaned, 0 failed, 2 other files skipped")


def test_the_longest_take_is_begun_first(
    takes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun: list[str] = []

    class Watched(Here):
        def submit(self, job: Job) -> None:
            begun.append(job.take)
            super().submit(job)

    monkeypatch.setattr(run, "open_crew", Watched)
    write_take_csv(short_take(60), takes / "z.csv")
    clean_folder(takes, tmp_path / "clips")
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
    monkeypatch.setattr(run, "open_crew", Tired)
    assert main(command) == 130
    done = {row.take for row in rows_of(out)}
    assert 0 < len(done) < 6
    assert {row["take"] for row in table_of(out)} <= done
    monkeypatch.setattr(run, "open_crew", Here)
    assert main(command) == 0
    assert len(rows_of(out)) == 6


@pytest.mark.usefixtures("here")
def test_a_store_by_url_gives_the_same_clips_as_its_folder(
    takes: Path, tmp_path: Path
) -> None:
    """``local://`` is one that other processes reach too."""
    pytest.importorskip("fsspec", reason="fsspec, of the extra cluster, is not here")
    clean_folder(takes, tmp_path / "here")
    url = f"local://{tmp_path}/there"
    (takes / "monday" / "kinefilter.toml").write_text("cutoff = 6.0\n")
    outcome = clean_files([f"local://{takes}"], url, QUICK, suffix=".bvh")
    assert not outcome.failed
    assert len(outcome.rows) == 6
    names = {"a.bvh", "monday/b.bvh", "monday/late/c.bvh"}
    for name in names:
        here, there = tmp_path / "here" / name, tmp_path / "there" / name
        assert here.read_bytes() == there.read_bytes()
    left = {p.name for p in (tmp_path / "there").rglob("*") if p.is_file()}
    (part,) = left - {Path(name).name for name in names} - {"manifest.csv"}
    assert part.endswith(".jsonl")
    again = clean_files([f"local://{takes}"], url, QUICK, suffix=".bvh")
    assert not again.rows
    assert len(again.kept) == 6


def test_a_worker_that_would_do_another_thing_refuses(takes: Path) -> None:
    out = store_at(str(takes.parent / "clips"))
    sources = find_sources([str(takes / "a.csv")], out.root)
    (job,) = plan_jobs(sources, out, QUICK, ".bvh")
    elsewhere = clean_file(replace(job, fingerprint="of another kinefilter"))
    assert (elsewhere.status, elsewhere.clips) == ("failed", ())
    assert "another kinefilter" in elsewhere.error
    assert clean_file(job).status == "done"
