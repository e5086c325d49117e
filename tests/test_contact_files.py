"""Contacts as a table that people edit, in USD, and on the command line."""

from __future__ import annotations

import csv
import gzip
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from pxr import Usd

from kinefilter.characters import CONTACTS, Clip, InputError
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.contents import contents_of
from kinefilter.pipeline.formats import (
    read_clip,
    read_contacts,
    write_clip,
    write_contacts,
)
from kinefilter.pipeline.target.feet import planted_feet
from kinefilter.scenes import SAMPLE

MakeClip = Callable[..., Clip]
Array = NDArray[np.float64]

HEADER = "time,HeelLeft,ToeLeft,HeelRight,ToeRight\n"
QUICK = ["--method", "none", "--no-physics"]


def table(path: Path, *rows: str, header: str = HEADER) -> Path:
    path.write_text(header + "".join(f"{row}\n" for row in rows), encoding="utf-8")
    return path


def complaint(path: Path, time: Array | None = None) -> str:
    with pytest.raises(InputError) as caught:
        read_contacts(path, np.arange(10) / 30.0 if time is None else time)
    message = str(caught.value)
    assert "\n" not in message
    assert path.name in message
    return message


# Tables


@settings(
    max_examples=40,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(
    start=st.floats(0.0, 1e6),
    steps=st.lists(st.floats(0.002, 100.0), max_size=20),
    seed=st.integers(0, 2**32 - 1),
    suffix=st.sampled_from([".csv", ".txt", ".npz"]),
)
def test_contacts_read_back_as_they_were_written(
    make_clip: MakeClip,
    tmp_path: Path,
    start: float,
    steps: list[float],
    seed: int,
    suffix: str,
) -> None:
    clip = make_clip(time=start + np.cumsum([0.0, *steps]), seed=seed)
    path = tmp_path / f"contacts{suffix}"
    (write_clip if suffix == ".npz" else write_contacts)(clip, path)
    found = read_contacts(path, clip.time)
    assert found.dtype == np.bool_
    np.testing.assert_array_equal(found, clip.contacts)


def test_the_table_is_a_header_and_a_row_a_frame(
    make_clip: MakeClip, tmp_path: Path
) -> None:
    clip = make_clip(25)
    write_contacts(clip, tmp_path / "c.csv")
    with (tmp_path / "c.csv").open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    assert header == ["time", *CONTACTS]
    assert [float(row[0]) for row in rows] == clip.time.tolist()
    flags = np.array([[int(cell) for cell in row[1:]] for row in rows])
    np.testing.assert_array_equal(flags, clip.contacts)
    assert HEADER.strip() == ",".join(header)


@settings(
    max_examples=30,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_row_per_change_says_the_same_as_one_per_frame(
    make_clip: MakeClip, tmp_path: Path, seed: int
) -> None:
    clip = make_clip(40, seed=seed)
    flags = np.repeat(clip.contacts[::4], 4, axis=0)
    changes = [0, *(1 + np.flatnonzero((flags[1:] != flags[:-1]).any(axis=1)))]
    rows = [
        f"{clip.time[k]:.4f}," + ",".join(str(int(flag)) for flag in flags[k])
        for k in changes
    ]
    path = table(tmp_path / "changes.csv", *rows)
    np.testing.assert_array_equal(read_contacts(path, clip.time), flags)


def test_a_single_row_holds_throughout_and_the_first_row_before_it_too(
    tmp_path: Path,
) -> None:
    time = 5.0 + np.arange(10) / 10.0
    path = table(tmp_path / "c.csv", "0,1,1,0,0")
    np.testing.assert_array_equal(
        read_contacts(path, time), np.tile([True, True, False, False], (10, 1))
    )
    path = table(tmp_path / "c.csv", "5.5,0,1,0,0", "5.7,0,0,0,1")
    found = read_contacts(path, time)
    assert found[:7].tolist() == [[False, True, False, False]] * 7
    assert found[7:].tolist() == [[False, False, False, True]] * 3


def test_spreadsheets_round_add_marks_blanks_and_blank_lines(tmp_path: Path) -> None:
    time = np.arange(4) / 30.0
    text = "\ufefftime, HeelLeft,ToeLeft ,HeelRight,ToeRight\r\n"
    text += "0.000,1,1,1,1\r\n\r\n0.033,0,1.0,1,1\r\n0.0670, 0,0,1,1\r\n"
    (tmp_path / "c.csv").write_text(text, encoding="utf-8")
    found = read_contacts(tmp_path / "c.csv", time)
    assert found[:, 1].tolist() == [True, True, False, False]
    assert found[:, 0].tolist() == [True, False, False, False]
    german = text.replace(",", ";").replace(".", ",")
    (tmp_path / "german.csv").write_text(german, encoding="utf-8")
    np.testing.assert_array_equal(read_contacts(tmp_path / "german.csv", time), found)
    assert contents_of(tmp_path / "german.csv")["kind"] == "contacts"
    (tmp_path / "c.csv.gz").write_bytes(gzip.compress(text.encode()))
    np.testing.assert_array_equal(read_contacts(tmp_path / "c.csv.gz", time), found)


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ([], ["row 2"]),
        (["0,1,1,1,1", "0.1,1,2,1,1"], ["row 3"]),
        (["0,1,1,1,1", "0.1,1,,1,1"], ["row 3"]),
        (["0,1,1,1,1", "0.1,1,0.5,1,1"], ["row 3"]),
        (["0,1,1,1,1", "0.1,1,yes,1,1"], ["row 3", "ToeLeft", "'yes'", "write 1 on"]),
        (["0,1,1,1,1", ",1,0,1,1"], ["row 3"]),
        (["0,1,1,1,1", "", "0.2,1,1,1"], ["row 4", "4 columns"]),
        (["0,1,1,1,1", "0.2,1,1,1,1", "0.1,0,0,0,0"], ["row 4"]),
        (["0,1,1,1,1", "inf,1,1,1,1"], ["row 3", "time"]),
        (["0,1,1,1,-1"], ["row 2"]),
    ],
)
def test_a_wrong_row_is_refused_by_its_number(
    tmp_path: Path, rows: list[str], words: list[str]
) -> None:
    message = complaint(table(tmp_path / "c.csv", *rows))
    for word in words:
        assert word in message


@pytest.mark.parametrize(
    "header",
    ["", "time,HeelLeft,ToeLeft,HeelRight\n", "t,a,b,c,d\n"],
)
def test_a_wrong_header_is_refused_with_the_right_one(
    tmp_path: Path, header: str
) -> None:
    message = complaint(table(tmp_path / "c.csv", "0,1,1,1,1", header=header))
    assert "row 1" in message
    assert HEADER.strip() in message
    assert "--save-contacts" in message


def test_contacts_of_another_time_are_refused(tmp_path: Path) -> None:
    time = 100.0 + np.arange(30) / 30.0
    for times in (["0", "1"], ["300"], ["300", "301"]):
        path = table(tmp_path / "c.csv", *(f"{t},1,1,1,1" for t in times))
        message = complaint(path, time)
        assert "100.000 to 100.967" in message
        assert "this take" in message


@pytest.mark.parametrize("name", ["none.csv", "none.npz"])
def test_a_missing_file_is_refused(tmp_path: Path, name: str) -> None:
    assert "no such file" in complaint(tmp_path / name)


def test_what_is_no_clip_and_no_text_is_refused(tmp_path: Path) -> None:
    (tmp_path / "c.npz").write_text("no archive")
    assert "npz" in complaint(tmp_path / "c.npz")
    (tmp_path / "c.csv").write_bytes(b"\xff\xfe\x00\x81")
    assert "UTF-8" in complaint(tmp_path / "c.csv")


def test_an_older_table_is_left_if_the_new_one_cannot_be_written(
    make_clip: MakeClip, tmp_path: Path
) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="is a file"):
        write_contacts(make_clip(3), tmp_path / "file" / "c.csv")


# USD


@pytest.mark.parametrize("suffix", [".usda", ".usdc"])
def test_contacts_and_external_force_are_attributes_of_the_usd_character(
    make_clip: MakeClip, tmp_path: Path, suffix: str
) -> None:
    clip = make_clip(time=2.0 + np.array([0.0, 1.0, 2.0, 2.0, 5.0, 6.0]) / 30.0)
    path = tmp_path / f"clip{suffix}"
    write_clip(clip, path)
    stage = Usd.Stage.Open(str(path))
    character = stage.GetDefaultPrim()
    names = character.GetAttribute("kinefilter:contactNames").Get()
    assert tuple(names) == CONTACTS
    contacts = character.GetAttribute("kinefilter:contacts")
    force = character.GetAttribute("kinefilter:externalForce")
    # Of the two frames at one time, the last.
    frames = [0, 1, 3, 4, 5]
    assert contacts.GetTimeSamples() == [0.0, 1.0, 2.0, 5.0, 6.0]
    assert force.GetTimeSamples() == contacts.GetTimeSamples()
    for code, frame in zip(contacts.GetTimeSamples(), frames, strict=True):
        assert list(contacts.Get(code)) == clip.contacts[frame].tolist()
        assert force.Get(code) == pytest.approx(clip.external_force[frame])


def test_where_nothing_was_simulated_usd_says_no_force(
    make_clip: MakeClip, tmp_path: Path
) -> None:
    clip = make_clip(4)
    force = np.array([0.1, np.nan, np.nan, 0.4])
    write_clip(replace(clip, external_force=force), tmp_path / "clip.usda")
    stage = Usd.Stage.Open(str(tmp_path / "clip.usda"))
    samples = (
        stage.GetDefaultPrim().GetAttribute("kinefilter:externalForce").GetTimeSamples()
    )
    assert samples == [0.0, 3.0]
    assert "nan" not in (tmp_path / "clip.usda").read_text(encoding="utf-8")


# The command line


def _clean(out: Path, *arguments: str, take: Path = SAMPLE) -> Clip:
    assert main(["clean", str(take), "-o", str(out), *QUICK, *arguments]) == 0
    return read_clip(out)


def test_saved_contacts_are_those_of_the_clip_and_used_again_give_them_again(
    tmp_path: Path,
) -> None:
    saved = tmp_path / "contacts.csv"
    clip = _clean(tmp_path / "one.npz", "--save-contacts", str(saved))
    np.testing.assert_array_equal(read_contacts(saved, clip.time), clip.contacts)
    assert clip.contacts.any()
    for source in (saved, tmp_path / "one.npz"):
        again = _clean(tmp_path / "two.npz", "--contacts", str(source))
        np.testing.assert_array_equal(again.contacts, clip.contacts)


def test_an_edited_table_changes_the_clip_where_it_was_edited(tmp_path: Path) -> None:
    saved = tmp_path / "contacts.csv"
    clip = _clean(tmp_path / "one.npz", "--save-contacts", str(saved))
    header, *rows = saved.read_text(encoding="utf-8").splitlines()
    edited = slice(len(rows) // 2, len(rows) // 2 + 10)
    assert planted_feet(clip.contacts)[edited].all()
    rows[edited] = [f"{row.split(',')[0]},0,0,1,1" for row in rows[edited]]
    table(saved, *rows, header=f"{header}\n")
    again = _clean(tmp_path / "two.npz", "--contacts", str(saved))
    stands = planted_feet(again.contacts)
    assert not stands[edited, 0].any()
    assert stands[edited, 1].all()
    foot = clip.skeleton.index("FootLeft")
    away = np.linalg.norm(again.positions - clip.positions, axis=2)
    near = np.zeros(len(clip), dtype=np.bool_)
    near[edited.start - 40 : edited.stop + 40] = True
    # The parts of a stance that was cut stand where each of them was measured.
    assert away[~near].max() < 0.01
    moves, before = (
        np.ptp(c.positions[edited, foot], axis=0).max() for c in (again, clip)
    )
    assert moves > 100.0 * before
    still, free = (np.ptp(c.positions[edited, foot], axis=0) for c in (clip, again))
    assert still.max() < 5e-4 < free.max()


@pytest.mark.parametrize(("feet", "share"), [("never", 0.0), ("always", 1.0)])
def test_feet_never_or_always_stand(tmp_path: Path, feet: str, share: float) -> None:
    clip = _clean(tmp_path / "clip.npz", "--feet", feet)
    assert planted_feet(clip.contacts).mean() == share


def test_a_lower_floor_has_the_body_higher_over_it(tmp_path: Path) -> None:
    take, rows = tmp_path / "take.csv", SAMPLE.read_text().splitlines()
    take.write_text("\n".join(rows[:60]))
    under = ("-1.2", "-1.45", "-3e0")  # the sample's floor: its sensor is at zero
    low, high, far = (
        _clean(tmp_path / "clip.npz", "--feet", "never", f"--floor={floor}", take=take)
        for floor in under
    )
    for clip, lift in ((high, 0.25), (far, 1.8)):
        np.testing.assert_allclose(
            clip.positions, low.positions + np.array([0.0, lift, 0.0]), atol=1e-4
        )
    own = _clean(tmp_path / "clip.npz", "--feet", "never", "--floor", "none", take=take)
    zero = _clean(tmp_path / "clip.npz", "--feet", "never", "--floor", "0", take=take)
    np.testing.assert_array_equal(own.positions, zero.positions)


@pytest.mark.parametrize("value", ["nan", "inf", "-inf"])
@pytest.mark.parametrize("flag", ["--floor", "--tilt"])
def test_a_floor_that_is_nowhere_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], flag: str, value: str
) -> None:
    arguments = ["clean", str(SAMPLE), "-o", str(tmp_path / "c.npz"), *QUICK]
    assert main([*arguments, f"{flag}={value}"]) == 2
    assert flag in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("rows", "words"),
    [(["0,1,1,1,1", "0.5,1,1,7,1"], "row 3"), (["900,1,1,1,1"], "900.000")],
)
def test_wrong_contacts_end_with_code_2_and_nothing_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], rows: list[str], words: str
) -> None:
    wrong = table(tmp_path / "wrong.csv", *rows)
    arguments = ["clean", str(SAMPLE), "-o", str(tmp_path / "clip.npz"), *QUICK]
    arguments += ["--contacts", str(wrong), "--json", str(tmp_path / "f.json")]
    assert main([*arguments, "--save-contacts", str(tmp_path / "c.csv")]) == 2
    error = capsys.readouterr().err
    assert "wrong.csv" in error
    assert words in error
    assert error.count("\n") == 1
    assert list(tmp_path.iterdir()) == [wrong]


def test_contacts_are_not_saved_over_what_is_needed_or_in_a_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mine = table(tmp_path / "mine.csv", "0,1,1,1,1")
    out = str(tmp_path / "clip.npz")
    arguments = ["clean", str(SAMPLE), "-o", out, *QUICK]
    for options in (
        ["--contacts", str(mine), "--save-contacts", str(mine)],
        ["--save-contacts", out],
        ["--save-contacts", str(SAMPLE)],
        ["--save-contacts", str(mine / "c.csv")],
    ):
        assert main([*arguments, *options]) == 2
        assert capsys.readouterr().err.startswith("kinefilter: ")
    assert list(tmp_path.iterdir()) == [mine]


@pytest.mark.skipif(sys.platform != "linux", reason="it has a /proc")
def test_no_clip_is_written_where_its_contacts_cannot_be(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["clean", str(SAMPLE), "-o", str(tmp_path / "clip.npz"), "--no-physics"]
    assert main([*words, "--save-contacts", "/proc/contacts.csv"]) == 2
    assert "/proc/contacts.csv: cannot be written" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
