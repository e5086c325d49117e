"""TRC: marker positions as text."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_mocap_files import standing, write_c3d, write_trc
from text_files import write_text

from kinefilter.characters import KINECT_V1, InputError
from kinefilter.pipeline.contents import contents_of
from kinefilter.pipeline.formats import read_take
from kinefilter.pipeline.formats.mocap import read_mocap
from kinefilter.pipeline.formats.recording import Mocap
from kinefilter.pipeline.formats.takes import claims_take
from kinefilter.pipeline.lab.database_build import database_from_mocap


def test_a_trc_file_holds_what_was_written_gaps_included(tmp_path: Path) -> None:
    mocap = standing(KINECT_V1, "plug_in_gait")
    mocap.positions[3, 2] = np.nan
    mocap.positions[5, -1] = np.nan  # the end of a row, where editors strip tabs
    path = write_trc(tmp_path / "a.trc", mocap)
    stripped = "\n".join(line.rstrip() for line in path.read_text().splitlines())
    with_commas = path.read_text().replace(".", ",")  # as in German
    texts = (stripped, with_commas)
    for file in (path, *(write_text(tmp_path / "b.trc", text) for text in texts)):
        again = read_mocap(file)
        assert again.names == mocap.names
        assert again.frame_time == pytest.approx(1 / 30, rel=1e-4)
        np.testing.assert_allclose(again.positions, 10.0 * mocap.positions, atol=1e-6)
    assert contents_of(path)["format"] == "trc"


def test_missing_rows_are_a_gap_and_a_wrong_rate_is_refused(tmp_path: Path) -> None:
    mocap = standing(KINECT_V1, "plug_in_gait")
    lines = write_trc(tmp_path / "a.trc", mocap).read_text().splitlines()
    fewer = write_text(tmp_path / "b.trc", "\n".join(lines[:9] + lines[12:]))
    frames = np.delete(np.arange(len(mocap.positions)), [3, 4, 5])
    np.testing.assert_allclose(read_take(fewer).time, frames / 30, atol=1e-4)
    markers = replace(mocap, names=tuple(f"m{k}" for k in range(len(mocap.names))))
    bare = write_trc(tmp_path / "m.trc", markers).read_text().splitlines()
    told = contents_of(write_text(tmp_path / "m.trc", "\n".join(bare[:9] + bare[12:])))
    assert told["seconds"] == pytest.approx(frames[-1] / 30, abs=1e-4)
    lines[2] = lines[2].replace("30\t30", "60\t60", 1)
    wrong = write_text(tmp_path / "c.trc", "\n".join(lines))
    with pytest.raises(InputError, match=r"says 60 frames/s, the column Time 30"):
        read_take(wrong)
    assert claims_take(wrong)  # so that a batch tells of it


@pytest.mark.parametrize("write", [write_trc, write_c3d])
def test_files_of_several_people_are_refused_naming_them(
    tmp_path: Path, write: Callable[[Path, Mocap], Path]
) -> None:
    one = standing(KINECT_V1, "plug_in_gait")
    names = [f"{who}:{name}" for who in ("Ann", "Bob") for name in one.names]
    twice = np.tile(one.positions, (1, 2, 1))
    both = Mocap(tuple(names), twice, None, one.frame_time, "both")
    path = write(tmp_path / "both.c3d", both)
    with pytest.raises(InputError, match=r"several people \(Ann, Bob\)"):
        read_take(path)
    assert claims_take(path)


def test_trc_joint_centers_become_a_database(tmp_path: Path) -> None:
    path = write_trc(tmp_path / "a.trc", standing(KINECT_V1, "plug_in_gait"))
    assert len(database_from_mocap([path], KINECT_V1)) >= 10


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("\n30\t", "\nfast\t", ["line 3", "DataRate 'fast'"]),
        ("\n30\t", "\n0\t", ["line 3", "DataRate '0'"]),
        ("DataRate\t", "\t", ["line 3", "DataRate ''"]),
        ("\n1\t0.000000\t", "\n1\t0.000000\tx\t", ["row 7", "columns"]),
        ("\n1\t0.000000\t", "\n1\tnow\t", ["row 7", "Time", "'now'"]),
        ("\n1\t0.000000\t", "\n1\tinf\t", ["row 7", "Time", "infinite"]),
    ],
)
def test_damaged_trc_files_are_refused_naming_the_row(
    tmp_path: Path, old: str, new: str, words: list[str]
) -> None:
    path = write_trc(tmp_path / "a.trc", standing(KINECT_V1, "plug_in_gait"))
    text = path.read_text("utf-8")
    assert old in text
    write_text(path, text.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        read_mocap(path)
    for word in (str(path), *words):
        assert word in str(caught.value)


@pytest.mark.parametrize(
    ("lines", "words"),
    [(3, "cut off"), (5, "has 0 frames"), (7, "has 1 frame,")],
)
def test_trc_files_that_end_early_are_refused(
    tmp_path: Path, lines: int, words: str
) -> None:
    path = write_trc(tmp_path / "a.trc", standing(KINECT_V1, "plug_in_gait"))
    kept = path.read_text("utf-8").splitlines(keepends=True)[:lines]
    with pytest.raises(InputError, match=words):
        read_mocap(write_text(path, *kept))


def test_a_trc_file_without_markers_is_refused(tmp_path: Path) -> None:
    path = write_trc(tmp_path / "a.trc", standing(KINECT_V1, "plug_in_gait"))
    lines = path.read_text("utf-8").splitlines()
    lines[3] = "Frame#\tTime"
    with pytest.raises(InputError, match="line 4 names no marker"):
        read_mocap(write_text(path, "\n".join(lines)))
