"""What a batch takes for takes, and what it calls their clips."""

from __future__ import annotations

import errno
import gzip
import os
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from batch_folders import QUICK
from real_data import TAKES, recorded

from kinefilter.characters import InputError
from kinefilter.pipeline.batch.plan import clip_names, find_sources
from kinefilter.pipeline.batch.run import clean_files
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.formats.files import numbered
from kinefilter.pipeline.formats.takes import claims_take


def test_names_that_would_be_the_same_are_kept_apart() -> None:
    takes = ["a.csv", "a.bvh", "a.csv.gz", "b.csv.gz", "s/a.csv", "B.txt", "a.csv.txt"]
    names = clip_names(takes, ".bvh")
    assert len({name.casefold() for name in names}) == len(takes)
    assert names[4] == "s/a.bvh"
    assert clip_names(takes[::-1], ".bvh") == names[::-1]
    assert clip_names(["x.csv", "X.csv"], ".bvh") == ["x.csv.bvh", "2-X.csv.bvh"]
    assert clip_names(["t.1.csv", "t.2.csv"], ".bvh") == ["t.1.bvh", "t.2.bvh"]
    people = {*map(Path, clip_names(["t.csv", "t.1.csv"], ".bvh", several=True))}
    assert len({numbered(path, 1) for path in people} | people) == 4


def test_files_of_several_folders_are_kept_apart(takes: Path, tmp_path: Path) -> None:
    other = tmp_path / "other" / "takes"
    other.mkdir(parents=True)
    (other / "a.csv").write_text("a take")
    inputs = [str(takes), str(other), str(takes / "monday"), str(other / "a.csv")]
    found = {s.take for s in find_sources(inputs, str(tmp_path / "out"))}
    assert {"takes/a.csv", "takes-2/a.csv"} <= found
    assert len(found) == 7  # once each, and what is no take by its name not at all


def test_a_url_of_a_local_folder_is_its_path(takes: Path, tmp_path: Path) -> None:
    out = tmp_path / "my clips"
    words = ["--no-physics", "--method", "none", "--jobs", "1"]
    places = (out.as_uri(), str(out), out.as_uri().replace("///", "//localhost/"))
    for place in places:  # the first time only, there is something to do
        assert main(["batch", takes.as_uri(), f"--out={place}", *words]) == 0
        assert (out / "manifest.jsonl").exists()
    assert len(clean_files([takes.as_uri()], places[0], QUICK).kept) == 6
    assert len((out / "manifest.jsonl").read_text(encoding="utf-8").splitlines()) == 6


def test_clips_are_not_written_into_memory(takes: Path) -> None:
    with pytest.raises(InputError, match="memory://clips: clips there would be lost"):
        clean_files([str(takes)], "memory://clips")


def test_a_folder_without_rights_fails_alone(
    takes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scan, locked = os.scandir, takes / "monday"

    def scandir(path: str) -> Iterator[os.DirEntry[str]]:
        if Path(path) == locked:
            raise PermissionError(errno.EACCES, "Permission denied", path)
        return scan(path)

    monkeypatch.setattr(os, "scandir", scandir)
    rows = clean_files([str(takes)], str(tmp_path / "clips"), QUICK, jobs=1).rows
    assert {r.take for r in rows if r.status == "failed"} == {"monday/*"}
    assert "a.csv" in {r.take for r in rows if r.status == "done"}
    with pytest.raises(InputError, match=r"monday: cannot be searched \(Permission"):
        find_sources([str(locked)], str(tmp_path))


def test_an_empty_name_is_not_the_current_folder(
    takes: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(takes)
    for inputs, out in ((["", "."], "clips"), (["."], "")):
        with pytest.raises(InputError, match="empty name"):
            find_sources(inputs, out)


def test_the_output_folder_is_not_searched(takes: Path, tmp_path: Path) -> None:
    out = takes / "clips"
    out.mkdir()
    (out / "old.csv").write_text("a clip of an earlier run")
    assert "clips/old.csv" not in {s.take for s in find_sources([str(takes)], str(out))}
    with pytest.raises(InputError, match="also searched for takes"):
        find_sources([str(takes)], str(takes))
    with pytest.raises(InputError, match="no such file or folder"):
        find_sources([str(tmp_path / "absent")], str(out))


@pytest.mark.parametrize(
    ("text", "claims"),
    [
        ("time,SpineBase.x,SpineBase.y\n", True),
        ("TIME,SPINEBASE_X,SPINEBASE_Y\n", True),
        ("time,HeelLeft,ToeLeft\n", False),
        ("time,Spineless\n", False),
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


@recorded
def test_recordings_claim_to_be_takes_and_what_lies_beside_them_does_not() -> None:
    files = sorted(TAKES.rglob("*.*"))
    texts = [p for p in files if p.name.endswith((".csv", ".csv.gz", ".txt"))]
    notes = ("LICEN", "SOURCE", "README")
    assert len(texts) > 50
    for path in texts:
        assert claims_take(path) != path.name.startswith(notes), path


def test_settings_that_the_system_would_not_find_are_not_ignored(
    tmp_path: Path,
) -> None:
    (tmp_path / "a.csv").write_text("a take")
    (tmp_path / "Kinefilter.toml").write_text("cutoff = 4.0\n")
    with pytest.raises(InputError, match=r"Kinefilter\.toml: .*call it kinefilter"):
        find_sources([str(tmp_path)], str(tmp_path / "out"))


def test_a_protocol_that_is_not_installed_is_named(tmp_path: Path) -> None:
    pytest.importorskip("fsspec", reason="fsspec, of the extra cluster, is not here")
    with pytest.raises(InputError, match="no-such-thing"):
        find_sources(["no-such-thing://bucket/takes"], str(tmp_path))


@pytest.mark.parametrize("data", [None, b"PK no archive"])
def test_an_archive_that_is_missing_or_damaged_is_named(
    data: bytes | None, takes: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("fsspec", reason="fsspec, of the extra cluster, is not here")
    archive = tmp_path / "takes.zip"
    if data is not None:
        archive.write_bytes(data)
    for words in (
        [f"zip://::{archive}", "-o", "out"],
        [str(takes), "-o", "ftp://127.0.0.1:1/x"],
    ):
        assert main(["batch", *words]) == 2
        told = capsys.readouterr().err
        assert re.search(r"kinefilter: (zip|ftp)://.*: (access failed|cannot be)", told)
        assert "check the address" in told or "cannot be reached" in told


def test_a_folder_without_takes_is_refused_with_the_reason(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    takes = tmp_path / "takes"
    takes.mkdir()
    for name in ("b.csv", "a.csv"):
        (takes / name).write_text("what we did today\n")
    for _ in range(2):  # then, the manifest knows them
        assert main(["batch", str(takes), "-o", str(tmp_path / "out")]) == 2
        told = capsys.readouterr().err
        assert re.search(r"no take among 2 files; .*a\.csv: .*expected", told), told


def test_frames_of_a_take_are_no_other_files(tmp_path: Path) -> None:
    names = [f"{who}_{k:012}_keypoints.json" for who in "ab" for k in range(3, 6)]
    for name in [*names, "notes.json"]:
        (tmp_path / name).write_text('{"people": []}')
    found = {source.take for source in find_sources([str(tmp_path)], "out")}
    assert found == {names[0], names[3], "notes.json"}
