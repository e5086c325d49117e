"""The command line: what it prints, writes and refuses."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from kinefilter import Cleaner
from kinefilter.characters import KINECT_V1, KINECT_V2
from kinefilter.pipeline import checks
from kinefilter.pipeline.cli import COMMANDS, main
from kinefilter.pipeline.database import PostureDatabase, builtin_database
from kinefilter.pipeline.formats import read_clip, read_take
from kinefilter.scenes import SAMPLE

ROOT = Path(__file__).parents[1]


def _refused(
    arguments: list[str], folder: Path, capsys: pytest.CaptureFixture[str]
) -> str:
    """Assert exit code 2, one line of error, nothing new in the folder; return it."""
    before = sorted(folder.iterdir())
    assert main(arguments) == 2
    printed = capsys.readouterr()
    assert printed.err.count("\n") == 1
    assert printed.err.startswith("kinefilter: ")
    assert sorted(folder.iterdir()) == before
    return printed.err


def _edited(tmp_path: Path, name: str, text: str) -> Path:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


def _sample_rows() -> list[str]:
    return SAMPLE.read_text(encoding="utf-8").splitlines()


def test_clean_writes_the_clip_and_prints_the_figures(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, figures = tmp_path / "clip.npz", tmp_path / "figures.json"
    assert main(["clean", str(SAMPLE), "-o", str(out), "--json", str(figures)]) == 0
    printed = capsys.readouterr().out
    for words in ("raw", "corrected", "physics", "jitter", "least reliable", "frames"):
        assert words in printed
    take, clip = read_take(SAMPLE), read_clip(out)
    assert len(clip) == len(take)
    found = json.loads(figures.read_text(encoding="utf-8"))
    assert found["frames"] == len(take)
    for stage in ("raw", "corrected", "physics"):
        assert set(found[stage]) >= {
            "bone_length_cv",
            "jitter",
            "skate_mm_per_frame",
            "skate_share_over_0p2",
            "penetration_mm",
            "float_mm",
            "amplitude_kept",
        }
    assert found["physics"]["jitter"] < found["raw"]["jitter"]


@pytest.mark.parametrize(
    ("name", "edit", "message"),
    [
        ("empty.csv", lambda _: "", r"empty\.csv.*empty"),
        ("text.csv", lambda rows: _replace_cell(rows, 3, 5, "abc"), r"'abc'"),
        ("short.csv", lambda rows: _drop_cell(rows, 4), r"row 5|line 5"),
        ("back.csv", lambda rows: _swap(rows, 10, 20), r"time goes backwards"),
        ("one.csv", lambda rows: "\n".join(rows[:2]), r"one\.csv"),
        ("zero.csv", lambda rows: _zeros(rows), r"zero\.csv"),
        ("words.csv", lambda _: "hello\nworld\n", r"words\.csv"),
    ],
)
def test_bad_takes_are_refused_in_one_line(
    name: str,
    edit: object,
    message: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert callable(edit)
    path = _edited(tmp_path, name, edit(_sample_rows()))
    error = _refused(
        ["clean", str(path), "-o", str(tmp_path / "clip.usda")], tmp_path, capsys
    )
    assert re.search(message, error), error
    assert name in error


def _replace_cell(rows: list[str], row: int, column: int, text: str) -> str:
    cells = rows[row].split(",")
    cells[column] = text
    return "\n".join([*rows[:row], ",".join(cells), *rows[row + 1 :]])


def _drop_cell(rows: list[str], row: int) -> str:
    return "\n".join([*rows[:row], rows[row].rpartition(",")[0], *rows[row + 1 :]])


def _swap(rows: list[str], one: int, two: int) -> str:
    rows = rows.copy()
    rows[one], rows[two] = rows[two], rows[one]
    return "\n".join(rows)


def _zeros(rows: list[str]) -> str:
    zeros = ",".join(["0"] * 80)
    return "\n".join([rows[0], *(f"{k / 30:.4f},{zeros}" for k in range(30))])


def test_a_missing_take_and_an_unknown_extension_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    absent = str(tmp_path / "absent.csv")
    error = _refused(
        ["clean", absent, "-o", str(tmp_path / "c.usda")], tmp_path, capsys
    )
    assert "absent.csv" in error
    error = _refused(
        ["clean", str(SAMPLE), "-o", str(tmp_path / "clip.abc")], tmp_path, capsys
    )
    assert ".abc" in error
    assert ".usda" in error
    error = _refused(["clean", "", "-o", str(tmp_path / "c.usda")], tmp_path, capsys)
    assert "an argument is empty" in error


def test_a_take_is_never_overwritten(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    take = tmp_path / "take.csv"
    take.write_bytes(SAMPLE.read_bytes())
    error = _refused(["clean", str(take), "-o", str(take)], tmp_path, capsys)
    assert "overwrite" in error
    assert take.read_bytes() == SAMPLE.read_bytes()


@pytest.mark.parametrize("option", ["scene", "config", "database", "model", "contacts"])
@pytest.mark.parametrize("written", ["json", "save-contacts"])
def test_no_file_that_an_option_names_is_overwritten(
    option: str, written: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    suffix = {"scene": ".xml", "config": ".toml"}.get(option, ".csv")
    file = _edited(tmp_path, f"mine{suffix}", "cutoff = 4.0\n")
    command = ["clean", str(SAMPLE), "-o", str(tmp_path / "clip.bvh")]
    named = [f"--{option}", str(file), f"--{written}", str(file)]
    error = _refused([*command, *named], tmp_path, capsys)
    assert f"would overwrite {file}" in error
    assert file.read_text(encoding="utf-8") == "cutoff = 4.0\n"


def test_a_database_of_another_skeleton_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "v2.npz"
    builtin_database(KINECT_V2).save(path)
    arguments = ["clean", str(SAMPLE), "-o", str(tmp_path / "c.bvh")]
    error = _refused([*arguments, "--database", str(path)], tmp_path, capsys)
    assert "kinect_v2" in error
    assert "kinect_v1" in error


def test_a_broken_database_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = _edited(tmp_path, "db.npz", "no archive")
    arguments = ["clean", str(SAMPLE), "-o", str(tmp_path / "c.bvh")]
    error = _refused([*arguments, "--database", str(path)], tmp_path, capsys)
    assert "db.npz" in error


def test_an_impossible_height_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["clean", str(SAMPLE), "-o", str(tmp_path / "c.bvh")]
    error = _refused([*arguments, "--height", "175"], tmp_path, capsys)
    assert "meters" in error


@pytest.mark.parametrize("cutoff", ["0.01", "-3", "nan", "inf"])
def test_an_impossible_cutoff_is_refused(
    cutoff: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["clean", str(SAMPLE), "-o", str(tmp_path / "c.bvh")]
    assert "cutoff" in _refused([*arguments, f"--cutoff={cutoff}"], tmp_path, capsys)


@pytest.mark.parametrize(
    ("name", "flags", "words"),
    [
        ("clip.usda", ["--fps", "0"], "--fps 0"),
        ("clip.usda", ["--fps", "1e9"], "--fps 1e+09"),
        ("clip.csv", ["--up", "z"], "--up"),
        ("clip.bvh", ["--character", "sam.usda"], "--character"),
        ("clip.usda", ["--character", f"{SAMPLE}/sam.usda"], "is a file"),
        ("clip.usda", ["--character", "clip.usda"], "would overwrite"),
    ],
)
def test_an_impossible_export_is_refused_before_any_work(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    name: str,
    flags: list[str],
    words: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    error = _refused(["clean", str(SAMPLE), "-o", name, *flags], tmp_path, capsys)
    assert words in error


def test_flags_of_the_export_reach_the_files(tmp_path: Path) -> None:
    out, sam = tmp_path / "clip.usda", tmp_path / "sam.usdc"
    quick = ["--method", "none", "--no-physics", "--fps", "24"]
    flags = ["--up", "z", "--units", "cm", "--rest", "t", "--character", str(sam)]
    assert main(["clean", str(SAMPLE), "-o", str(out), *quick, *flags]) == 0
    text = out.read_text(encoding="utf-8")
    for words in ('upAxis = "Z"', "metersPerUnit = 0.01", "= 24\n", "@./sam.usdc@"):
        assert words in text
    assert sam.stat().st_size > 0


def test_names_are_printed_as_they_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Those too that rich would take for styles, ends of styles or pictures."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a[").mkdir()
    take, clip = "a[/b]:cat:.csv", "[red]clip:cat:.bvh"
    Path(take).write_bytes(SAMPLE.read_bytes())
    quick = ["--method", "none", "--no-physics"]
    assert main(["clean", take, "-o", clip, *quick]) == 0
    printed = capsys.readouterr().out
    assert f"{take}: " in printed
    assert f"wrote {clip}\n" in printed
    assert main(["info", take]) == 0
    assert f"{take}: " in capsys.readouterr().out
    assert "a[/c]:cat:" in _refused(["info", "a[/c]:cat:"], tmp_path, capsys)


def test_names_cannot_break_lines_or_steer_the_terminal(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["info", "a\x1b[31m\nb\x85c\u3000é.csv"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "a%1B[31m%0Ab%85c\u3000é.csv" in line


def test_what_is_too_long_for_the_memory_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    take = _edited(tmp_path, "take.csv", "\n".join(_sample_rows()[:40]))
    words = ["clean", str(take), "-o", str(tmp_path / "clip.bvh")]
    monkeypatch.setattr(checks, "_LARGE", 0)
    assert main([*words, "--method", "none", "--no-physics"]) == 0
    monkeypatch.setattr(checks, "_NEEDED", 10**15)
    assert "GB of memory" in _refused(words, tmp_path, capsys)
    monkeypatch.setattr(checks, "check_extent", _full)
    assert "not enough memory" in _refused(words, tmp_path, capsys)


def _full(*_: object) -> None:
    raise MemoryError


@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize("asked", [signal.SIGINT, signal.SIGTERM])
def test_a_request_to_end_is_answered_in_one_line(
    asked: signal.Signals,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """As Ctrl-C gives it, or a batch system; afterwards all is as it was."""
    before = signal.getsignal(signal.SIGTERM)
    monkeypatch.setattr(
        "kinefilter.pipeline.contents.contents_of",
        lambda *_, **__: signal.raise_signal(asked),
    )
    assert main(["info", str(SAMPLE)]) == 130
    assert capsys.readouterr().err == "kinefilter: interrupted\n"
    assert signal.getsignal(signal.SIGTERM) is before


def test_an_unknown_flag_ends_with_code_2(tmp_path: Path) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["clean", str(SAMPLE), "-o", str(tmp_path / "c.bvh"), "--colour", "red"])
    assert caught.value.code == 2
    assert list(tmp_path.iterdir()) == []


def test_a_database_given_by_name_is_used(tmp_path: Path) -> None:
    """One that holds two postures far from the take: everything lies outside."""
    whole = builtin_database(KINECT_V1)
    path, figures = tmp_path / "tiny.npz", tmp_path / "figures.json"
    kept = np.flatnonzero(whole.labels == "chair")[-2:]
    tiny = PostureDatabase(whole.positions[kept], whole.labels[kept], KINECT_V1)
    tiny.save(path)
    arguments = ["clean", str(SAMPLE), "-o", str(tmp_path / "c.csv"), "--no-physics"]
    main([*arguments, "--database", str(path), "--json", str(figures)])
    found = json.loads(figures.read_text(encoding="utf-8"))
    assert found["share_outside_database"] > 0.5
    assert "physics" not in found


@pytest.mark.usefixtures("brief_bench")
def test_bench_measures_every_stage(tmp_path: Path) -> None:
    figures = tmp_path / "bench.json"
    assert main(["bench", "--json", str(figures)]) == 0
    found = json.loads(figures.read_text(encoding="utf-8"))
    stages = found["ms_per_frame"]
    assert set(stages) == {*(stage.name for stage in Cleaner().stages), "total"}
    assert set(stages) >= {"reliability", "correct", "orientation", "physics"}
    assert all(value > 0 for value in stages.values())
    assert found["mj_step_ms_per_frame"] > 0
    assert found["search"]["share_of_frames_lower_energy"] >= 0.95


def test_help_has_every_command_in_a_group_with_one_sentence(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["--help"])
    assert caught.value.code == 0
    printed = capsys.readouterr().out
    for group in (
        "- daily: clean, batch, merge, info, render, report, view, character, "
        "blender\n",
        "- live: live, replay, play\n",
        "- learning: pair, train, database\n",
        "- lab: evaluate, simulate, rate, ratings, reproduce, bench\n",
    ):
        assert group in printed
    listed = re.findall(r"(?m)^[│ ]+(?:• )?(\w+) {2,}[A-Z]", printed)
    assert listed == COMMANDS
    files = (ROOT / "pipeline").rglob("commands/*.py")
    defined = re.findall(
        r"(?m)^class (\w+)", "".join(file.read_text() for file in files)
    )
    parts = {"DatabaseBuild", "DatabaseInfo"}  # of the command database
    assert {name.capitalize() for name in listed} == set(defined) - parts


def test_without_a_command_nothing_is_done(capsys: pytest.CaptureFixture[str]) -> None:
    for arguments in ([], ["polish", "take.csv"]):
        with pytest.raises(SystemExit) as caught:
            main(arguments)
        assert caught.value.code == 2
    assert "clean" in capsys.readouterr().err


@pytest.mark.parametrize("flags", [[], ["-u"]], ids=["buffered", "unbuffered"])
@pytest.mark.parametrize("words", [["--help"], ["info", "--json"], ["info"]])
def test_output_that_nobody_reads_ends_a_command_quietly(
    flags: list[str], words: list[str]
) -> None:
    read, written = os.pipe()
    os.close(read)
    command = [sys.executable, *flags, "-m", "kinefilter", *words, SAMPLE]
    done = subprocess.run(
        command, stdout=written, stderr=subprocess.PIPE, text=True, check=False
    )
    os.close(written)
    assert done.stderr == ""
    # What prints the help may mind it by itself, and say nothing.
    assert done.returncode == 141 or words == ["--help"]


def test_a_group_may_stand_before_its_commands(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(SystemExit):
        main(["lab", "bench", "--help"])
    assert "kinefilter bench" in capsys.readouterr().out
    with pytest.raises(SystemExit) as refused:
        main(["daily", "bench"])
    assert refused.value.code == 2


def test_a_link_to_itself_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    link = tmp_path / "take.csv"
    link.symlink_to(link)
    assert main(["clean", str(link), "-o", str(tmp_path / "clip.bvh")]) == 2
    assert "is a link to a missing file" in capsys.readouterr().err
