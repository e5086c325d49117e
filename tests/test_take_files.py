"""Takes as CSV files: what is read, what counts as missing, what is refused."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from real_data import TAKES, recorded
from text_files import write_text

from kinefilter.characters import KINECT_V1, KINECT_V2, InputError, State, Take
from kinefilter.pipeline.formats import read_take, write_take_csv

# Two joints are enough for most complaints.
HEADER = "time,Head.x,Head.y,Head.z,Head.state,HandLeft.x,HandLeft.y,HandLeft.z\n"
ROWS = ["0.0,0,1.6,2,2,0.4,1,2\n", "0.1,0,1.5,2,1,0.4,1,2\n", "0.2,0,1.4,2,2,,,\n"]


def v2_line(ticks: int, cell: str = "0.5,1.5,2.5,2,") -> str:
    return f"{ticks}," + cell * 25 + "\n"


def complaint(path: Path, **options: str) -> str:
    with pytest.raises(InputError) as caught:
        read_take(path, **options)
    message = str(caught.value)
    assert "\n" not in message
    return message


# Reading what was recorded


@recorded
def test_every_recorded_take_reads() -> None:
    paths = sorted(path for path in TAKES.rglob("*.csv*") if path.is_file())
    assert paths
    for path in paths:
        take = read_take(path)
        assert len(take) >= 2
        assert 25.0 < take.fps < 35.0
        assert np.array_equal(take.state == 0, np.isnan(take.positions[..., 0]))


@recorded
def test_labanotation_take_has_its_states_and_starts_at_zero() -> None:
    take = read_take(TAKES / "labanotation" / "joints.csv")
    assert take.skeleton is KINECT_V2
    assert take.time[0] == 0.0
    assert len(take) == 371
    assert 0.3 < np.mean(take.state == State.INFERRED) < 0.35
    np.testing.assert_array_equal(
        take.positions[0, 0], [0.0710328, -0.600598, 0.978207]
    )


@recorded
def test_precog_take_has_thirty_frames_a_second_and_joints_by_name() -> None:
    take = read_take(TAKES / "precog16" / "Seq1_1.csv.gz")
    assert take.skeleton is KINECT_V1
    assert take.fps == pytest.approx(30.0)
    head = take.positions[0, KINECT_V1.index("Head")]
    np.testing.assert_array_equal(head, [0.1686229, 0.5856628, 2.961215])


@recorded
def test_missing_hands_are_nan_and_not_tracked() -> None:
    take = read_take(TAKES / "ui-prmd" / "m01_s02_e05.csv")
    for hand in ("HandLeft", "HandRight"):
        j = KINECT_V1.index(hand)
        assert np.isnan(take.positions[:, j]).all()
        assert (take.state[:, j] == State.NOT_TRACKED).all()


# What counts as missing


def test_joints_absent_from_the_file_are_missing_for_the_whole_take(
    tmp_path: Path,
) -> None:
    take = read_take(write_text(tmp_path / "a", HEADER, *ROWS))
    assert take.skeleton is KINECT_V1
    seen = np.isfinite(take.positions).all(axis=-1).any(axis=0)
    assert {KINECT_V1.joints[j] for j in np.flatnonzero(seen)} == {"Head", "HandLeft"}


def test_joints_without_states_are_tracked_where_they_have_numbers(
    tmp_path: Path,
) -> None:
    take = read_take(write_text(tmp_path / "a", HEADER, *ROWS))
    assert take.state[:, KINECT_V1.index("HandLeft")].tolist() == [2, 2, 0]
    assert take.state[:, KINECT_V1.index("Head")].tolist() == [2, 1, 2]


@pytest.mark.parametrize("cells", ["0,0,0,2", "1,2,3,0", "1,nan,3,2", ",,,2", "1,,2,1"])
def test_a_joint_at_the_origin_untracked_or_incomplete_is_missing(
    tmp_path: Path, cells: str
) -> None:
    row = f"0.3,{cells},0.4,1,2\n"
    take = read_take(write_text(tmp_path / "a", HEADER, *ROWS, row))
    head = KINECT_V1.index("Head")
    assert np.isnan(take.positions[-1, head]).all()
    assert take.state[-1, head] == State.NOT_TRACKED


def test_repeated_stamps_blank_lines_and_windows_line_ends_are_normal(
    tmp_path: Path,
) -> None:
    lines = [line.replace("\n", "\r\n") for line in (HEADER, *ROWS, ROWS[-1], "\n")]
    path = tmp_path / "a.csv"
    path.write_bytes(b"\xef\xbb\xbf" + "".join(lines).encode())
    assert read_take(path).time.tolist() == [0.0, 0.1, 0.2, 0.2]


def test_content_and_not_the_name_decides_the_format(tmp_path: Path) -> None:
    plain = write_text(tmp_path / "take.bvh", v2_line(5), v2_line(333_338))
    zipped = tmp_path / "take.txt"
    zipped.write_bytes(gzip.compress(plain.read_bytes()))
    for path in (plain, zipped):
        take = read_take(path)
        assert take.skeleton is KINECT_V2
        assert take.time.tolist() == pytest.approx([0.0, 0.0333333])


def test_kinect_v1_joints_go_by_the_header_and_labels_are_ignored(
    tmp_path: Path,
) -> None:
    names = KINECT_V1.joints[::-1]
    row = ";".join(f"0.{j:02} 1 2" for j in range(20))
    path = write_text(
        tmp_path / "a", "; ".join(names), "\n", f"{row};kick\n", f"{row}\n"
    )
    take = read_take(path, format="kinect-v1")
    assert take.positions[1, :, 0].tolist() == [j / 100 for j in range(20)][::-1]
    assert take.time.tolist() == pytest.approx([0.0, 1 / 30])


def _continental(line: str) -> str:
    text = line.replace(",", ";")
    return text.replace(".", ",") if text[0].isdigit() else text


def _quoted(line: str) -> str:
    return '"' + line.rstrip("\n").replace(",", '","') + '"\n'


@pytest.mark.parametrize(
    "change",
    [
        lambda line: line.replace(",", "\t"),
        lambda line: line.replace(",", ";"),
        _continental,
        _quoted,
        lambda line: _quoted(line).replace(",", ";"),
        lambda line: line.replace("time", "Time"),
        lambda line: line.replace("\n", ",\n"),
        lambda line: f"{'' if line[0] == 't' else '7'},{line}",
        lambda line: ",".join([*line.strip().split(",")[::-1], "\n"]),
    ],
)
def test_a_table_is_read_as_spreadsheets_and_statistics_programs_write_it(
    tmp_path: Path, change: Callable[[str], str]
) -> None:
    lines = [HEADER, *ROWS, "0.3,,,,,0.4,1,2\n"]
    plain = read_take(write_text(tmp_path / "a", *lines))
    again = read_take(write_text(tmp_path / "b", *map(change, lines)))
    for name in ("time", "positions", "state"):
        np.testing.assert_array_equal(getattr(again, name), getattr(plain, name))


# Complaints


def cell(row: int, old: str, new: str) -> tuple[str, ...]:
    rows = list(ROWS)
    assert old in rows[row - 2]
    rows[row - 2] = rows[row - 2].replace(old, new, 1)
    return (HEADER, *rows)


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ((), ["empty"]),
        (("\n\n",), ["empty"]),
        (("hello\n",), ["row 1", "no known layout", "kinefilter CSV"]),
        (("PK\0\0\n",), ["binary"]),
        ((HEADER,), ["0 frames", "at least 2"]),
        ((HEADER, ROWS[0]), ["1 frame,", "at least 2"]),
        (cell(3, "0.4,1,2", "0.4,1"), ["row 3", "7 columns", "expected 8"]),
        (cell(3, "0.4,1,2", "0.4,1,2,3"), ["row 3", "9 columns", "expected 8"]),
        (cell(4, "1.4", "o.k."), ["row 4", "Head.y", "'o.k.'", "expected a number"]),
        (cell(2, "1.6", "inf"), ["row 2", "Head.y", "infinite"]),
        (cell(3, "1.5,2,1", "1.5,2,3"), ["row 3", "Head.state", "3", "0 not tracked"]),
        (cell(3, "0.1,", ","), ["row 3", "column time", "empty"]),
        (cell(3, "0.1,", "0.7,"), ["row 4", "time", "backwards", "0.7000"]),
        ((HEADER, "\n", ROWS[1], ROWS[0]), ["row 4", "backwards"]),
        ((HEADER, *["0,0,0,0,2,0,0,0\n"] * 3), ["no joint", "3 frames"]),
        ((HEADER, *["0,,,,,,,\n"] * 3), ["no joint is tracked"]),
        ((HEADER, *["0,0,250,2,2,40,80,2\n"] * 3), ["centimeters", "100"]),
        ((HEADER, *["0,0,1600,2,2,40,80,2\n"] * 3), ["millimeters", "1000"]),
        (
            ("time,Tail.x,Tail.y,Tail.z\n", "0,1,2,3\n"),
            ["row 1", "'Tail'", "HipCenter", "such as Head.x"],
        ),
        (("time,Head.x,Head.y,Head.z,Head.w\n",), ["'Head.w'", "unknown"]),
        (("time,Head.x,Head.z\n",), ["no column Head.y"]),
        (("time,Head.x,Head.x\n",), ["'Head.x'", "twice"]),
        (("time\n", "0\n"), ["names no joints"]),
        ((v2_line(5), v2_line(4)), ["row 2", "backwards"]),
        ((v2_line(5).replace("5,", "0.033,", 1),), ["row 1", "header, time,SpineBase"]),
        (("0.033," + "1," * 79 + "2\n",), ["row 1", "header, time,HipCenter.x"]),
        ((",,\n",), ["no known layout"]),
        ((v2_line(5), "7,1,2\n"), ["row 2", "3 columns", "expected 101"]),
        (("Head;Neck\n", "0 1 2;0 1 2\n"), ["row 1", "'Neck'", "20 joint names"]),
        (
            (
                ";".join(KINECT_V1.joints),
                "\n",
                "1 2 3;" * 20,
                "\n",
                "1 2 3;" * 19 + "1 2;4",
            ),
            ["row 3", "59 columns", "expected 60"],
        ),
    ],
)
def test_bad_takes_are_refused_naming_file_row_and_column(
    tmp_path: Path, lines: tuple[str, ...], words: list[str]
) -> None:
    path = write_text(tmp_path / "bad.csv", *lines)
    message = complaint(path)
    assert str(path) in message
    for word in words:
        assert word in message


def test_missing_folder_binary_and_damaged_files_are_refused(tmp_path: Path) -> None:
    assert "no such file" in complaint(tmp_path / "none.csv")
    assert "folder" in complaint(tmp_path)
    path = tmp_path / "x.csv"
    path.write_bytes(b"time,\xff\xfe\n")
    assert "not UTF-8" in complaint(path)
    for start in (b"Kaydara FBX Binary  \0", b"; FBX 7.4.0 project file\n"):
        path.write_bytes(start + b"\x1a\0\xe8")
        assert "FBX cannot be read; export it as BVH" in complaint(path)
    path.write_bytes(gzip.compress(HEADER.encode() * 1000)[:-20])
    assert "damaged gzip" in complaint(path)


def test_an_unknown_or_wrong_format_is_refused(tmp_path: Path) -> None:
    path = write_text(tmp_path / "a.csv", HEADER, *ROWS)
    assert "unknown take format 'fbx'" in complaint(path, format="fbx")
    assert "kinefilter, kinect-v2, kinect-v1" in complaint(path, format="fbx")
    assert "row 1 has 8 columns" in complaint(path, format="kinect-v2")
    assert "joint names" in complaint(path, format="kinect-v1")
    v2 = write_text(tmp_path / "b.csv", v2_line(1), v2_line(2))
    assert "expected the header 'time'" in complaint(v2, format="kinefilter")


def test_a_bad_cell_far_down_a_long_file_is_found(tmp_path: Path) -> None:
    rows = [f"{k},0,1.6,2,2,0.4,1,2\n" for k in range(5000)]
    rows[4321] = rows[4321].replace("0.4", "0,4;")
    path = write_text(tmp_path / "long.csv", HEADER, *rows)
    assert "row 4323" in complaint(path)


def test_a_take_with_missing_joints_survives_csv(tmp_path: Path) -> None:
    take = read_take(write_text(tmp_path / "a", HEADER, *ROWS))
    write_take_csv(take, tmp_path / "b.csv")
    again = read_take(tmp_path / "b.csv")
    for name in ("time", "positions", "state"):
        np.testing.assert_array_equal(getattr(again, name), getattr(take, name))


def test_takes_are_read_only(tmp_path: Path) -> None:
    take: Take = read_take(write_text(tmp_path / "a", HEADER, *ROWS))
    assert not take.positions.flags.writeable
