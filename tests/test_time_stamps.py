"""Time stamps that are no seconds, uneven, far from zero or too few."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from kinefilter import CleanConfig, Clip, clean, read_take
from kinefilter.characters import InputError, Take
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.formats.sheets import write_take_csv
from kinefilter.pipeline.look.comparison import compare
from kinefilter.pipeline.look.page import page_contents

TAKE = read_take("scenes/takes/wave_punch_bend.csv")
QUICK = CleanConfig(method="none", physics=False)


def _first(frames: int) -> Take:
    names = ("time", "positions", "state")
    return replace(TAKE, **{name: getattr(TAKE, name)[:frames] for name in names})


def _write(factor: float, shift: float, path: Path) -> Path:
    take = _first(30)
    write_take_csv(replace(take, time=take.time * factor + shift), path)
    return path


@pytest.mark.parametrize("shift", [0.0, 1.7e9])
@pytest.mark.parametrize(
    ("factor", "unit"),
    [
        (10**3, "milliseconds"),
        (10**6, "microseconds"),
        (10**7, "ticks of 100 ns"),
        (10**9, "nanoseconds"),
    ],
)
def test_stamps_in_other_units_are_refused_with_the_factor(
    factor: int, unit: str, shift: float, tmp_path: Path
) -> None:
    path = _write(factor, shift * factor, tmp_path / "take.csv")
    words = f"look like {unit}: divide them by {factor}$"
    with pytest.raises(InputError, match=words):
        read_take(path)
    take = _first(30)
    with pytest.raises(InputError, match=words):
        clean(replace(take, time=(take.time + shift) * factor), QUICK)


def test_takes_given_and_read_are_refused_in_the_same_words(tmp_path: Path) -> None:
    take, path = _first(30), tmp_path / "take.csv"
    stamps = np.append(np.arange(29) * 1e-5, 9.0)
    for other in (
        replace(take, positions=np.full_like(take.positions, np.nan)),
        replace(take, time=stamps),
    ):
        write_take_csv(other, path)
        with pytest.raises(InputError) as read:
            read_take(path)
        with pytest.raises(InputError) as given:
            clean(other)
        words = [str(e.value).partition(": ")[2] for e in (read, given)]
        assert words[0] == words[1]


def test_frames_seconds_apart_are_no_motion(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"2\.99\d* s apart.*record more frames"):
        read_take(_write(90.0, 0.0, tmp_path / "slow.csv"))
    assert read_take(_write(20.0, 0.0, tmp_path / "slower.csv")).fps > 1.0


def test_stamps_too_close_together_ask_for_their_unit(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"unit of the times \(seconds, or 100 ns in"):
        read_take(_write(1e-4, 0.0, tmp_path / "fast.csv"))


@pytest.mark.parametrize("shift", [-500.0, 1e9, 1.7e9])
def test_where_stamps_begin_does_not_matter(shift: float, tmp_path: Path) -> None:
    take = read_take(_write(1.0, shift, tmp_path / "take.csv"))
    assert take.time[0] == pytest.approx(TAKE.time[0] + shift)
    plain, moved = clean(_first(30), QUICK), clean(take, QUICK)
    np.testing.assert_allclose(moved.clip.positions, plain.clip.positions, atol=1e-4)
    assert moved.stages["corrected"].jitter == pytest.approx(
        plain.stages["corrected"].jitter, rel=1e-3
    )


def test_stamps_too_far_from_zero_to_tell_frames_apart_are_refused(
    tmp_path: Path,
) -> None:
    with pytest.raises(InputError, match="subtract the first"):
        read_take(_write(1.0, 1e13, tmp_path / "take.csv"))


@pytest.mark.parametrize(
    ("stamp", "words"),
    [
        ("nan", "is empty, expected a time"),
        ("", "is empty, expected a time"),
        ("1x6", "is '1x6', expected a number; correct or delete the row"),
        ("inf", "is infinite"),
        ("-inf", "is infinite"),
        ("-1", "goes backwards"),
        ("1e30", r"is 1e\+30, expected a time"),
    ],
)
def test_a_stamp_that_is_no_time_is_named(
    stamp: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = _write(1.0, 0.0, tmp_path / "take.csv")
    rows = path.read_text().splitlines()
    rows[10] = stamp + rows[10][rows[10].index(",") :]
    path.write_text("\n".join(rows))
    with pytest.raises(InputError, match=f"row 11, column time {words}"):
        read_take(path)
    assert main(["info", str(path)]) == 2
    assert "row 11" in capsys.readouterr().err


@pytest.fixture
def two() -> Clip:
    """Two frames: nothing of which jitter could be measured."""
    return clean(_first(2)).clip


def test_figures_of_two_frames_that_are_not_known_are_told_as_empty(
    two: Clip, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    take, figures = tmp_path / "two.csv", tmp_path / "two.json"
    write_take_csv(_first(2), take)
    command = ["clean", str(take), "-o", str(tmp_path / "two.bvh"), "--json"]
    assert main([*command, str(figures)]) == 0
    table = capsys.readouterr().out
    assert "nan" not in table.lower()
    row = next(line for line in table.splitlines() if "jitter" in line)
    assert row.count("-") == 3
    known = json.loads(figures.read_text())
    assert [known[stage]["jitter"] for stage in ("raw", "corrected")] == [None, None]
    page = page_contents(compare(two, _first(2)), ())
    assert next(m for m in page["metrics"] if m["name"] == "jitter")["clean"] is None
    json.dumps(page, allow_nan=False)


def test_without_four_even_frames_only_jitter_is_unknown() -> None:
    time = np.cumsum(np.tile([0.02, 0.03, 0.1], 10))
    found = clean(replace(_first(30), time=time), QUICK).stages["corrected"]
    unknown = {name for name, value in asdict(found).items() if not np.isfinite(value)}
    assert unknown <= {"jitter", "flight_error"}
    assert "jitter" in unknown


def test_bvh_that_leaves_the_clock_of_its_take_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kept = np.delete(np.arange(len(TAKE)), np.s_[20:60:2])
    take, clip = tmp_path / "take.csv", tmp_path / "take.bvh"
    write_take_csv(TAKE.at(kept), take)
    quick = ["--method", "none", "--no-physics"]
    words = "0.59 s off the take's time stamps; with --fps 30 it"

    def printed(*options: str) -> str:
        assert main(["clean", str(take), "-o", str(clip), *quick, *options]) == 0
        return " ".join(capsys.readouterr().out.split())

    assert words in printed()
    assert "time stamps" not in printed("--fps", "30")
    assert "time stamps" not in printed("--end", "0.6")
    batch = ["batch", str(take), "-o", str(tmp_path / "out"), "--to", "bvh", *quick]
    assert main(batch) == 0
    assert words in (tmp_path / "out" / "manifest.jsonl").read_text(encoding="utf-8")
    write_take_csv(TAKE, take)
    assert "time stamps" not in printed()
