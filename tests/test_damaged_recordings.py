"""Damaged files in the layouts of other programs are refused, saying where."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made_up_people import complaint, made_up
from published_layouts import azure_json, msr_action3d_text, msrc_12_text, ntu_text
from text_files import write_text

from kinefilter import CleanConfig, clean
from kinefilter.characters import KINECT_V1, Clip, InputError, Take
from kinefilter.pipeline.formats import read_recording, write_clip, write_take_csv
from kinefilter.pipeline.look.comparison import compare
from kinefilter.scenes.sensor import sample_take

MakeClip = Callable[..., Clip]


def test_msr_screen_coordinates_are_refused_naming_the_other_files(
    tmp_path: Path,
) -> None:
    rng = np.random.default_rng(0)
    rows = rng.uniform([100, 40, 400, 1], [220, 200, 900, 1], (40, 4))
    path = tmp_path / "a01_s01_e01_skeleton.txt"
    np.savetxt(path, rows, fmt="%.2f")
    assert "pixels" in complaint(path)
    assert "skeleton3D" in complaint(path)


def ntu_lines() -> list[str]:
    return ntu_text([made_up(3)]).splitlines(keepends=True)


def edited(lines: list[str], row: int, text: str) -> str:
    return "".join([*lines[: row - 1], text + "\n", *lines[row:]])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("".join(ntu_lines()[:40]), ["ends the file in frame 2 of 3", "cut off"]),
        (edited(ntu_lines(), 1, "9" * 15), ["ends the file in frame 4"]),
        (edited(ntu_lines(), 1, "2"), ["after the last of 2 frames", "row 1"]),
        (edited(ntu_lines(), 2, "many"), ["row 2", "'many'", "number of bodies"]),
        (edited(ntu_lines(), 2, "0"), ["row 3", "expected the number of bodies"]),
        (edited(ntu_lines(), 3, "7 0 1"), ["row 3", "3 values", "10 of a body"]),
        (edited(ntu_lines(), 4, "1000000"), ["row 4", "1000000 joints", "25"]),
        (edited(ntu_lines(), 6, "1 2 3"), ["row 6", "3 values", "12 of a joint"]),
        (edited(ntu_lines(), 6, "a" + " 2" * 11), ["row 6", "word"]),
        (edited(ntu_lines(), 6, "1e400" + " 2" * 11), ["row 6", "infinite"]),
        (edited(ntu_lines(), 6, "1 " * 11 + "7"), ["row 6", "'7'", "tracking state"]),
        ("1\n0\n", ["1 frame,", "at least 2"]),
        ("2\n0\n0\n", ["no one is tracked"]),
    ],
)
def test_damaged_ntu_files_are_refused_naming_the_row(
    tmp_path: Path, text: str, words: list[str]
) -> None:
    message = complaint(write_text(tmp_path / "a.skeleton", text))
    for word in words:
        assert word in message


def azure_with(**changes: object) -> str:
    data = json.loads(azure_json([made_up(3)], levels=True))
    frame = data["frames"][1]
    for key, value in changes.items():
        for owner in (data, frame, frame["bodies"][0]):
            if key in owner:
                owner[key] = value
                break
    return json.dumps(data)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (azure_json([made_up(3)])[:5000], ["not JSON", "cut off"]),
        ("{}", ["no list 'frames'"]),
        ('{"frames": {}}', ["no list 'frames'"]),
        ("[" * 100_000, ["row 1"]),
        ('{"a":' * 100_000, ["not JSON"]),
        ('{"frames": [1, 2]}', ["frame 1", "timestamp_usec"]),
        (azure_with(joint_names=["PELVIS"]), ["joint_names", "32"]),
        (azure_with(joint_names=["X"] * 10**6), ["joint_names", "1000000"]),
        (azure_with(timestamp_usec="soon"), ["frame 2", "timestamp_usec"]),
        (azure_with(timestamp_usec=0), ["frame 2", "backwards"]),
        (azure_with(bodies=None), ["frame 2", "bodies"]),
        (azure_with(body_id=[]), ["frame 2", "body_id"]),
        (azure_with(joint_positions=[[1, 2, 3]]), ["frame 2", "32 times three"]),
        (azure_with(joint_positions=[[1e400, 2, 3]] * 32), ["frame 2", "finite"]),
        (
            azure_with(body_id=7).replace(": 7", ": " + "9" * 5000),
            ["frame 2", "body_id"],
        ),
        (azure_with(confidence_level=[5] * 32), ["frame 2", "confidence"]),
        (azure_with(frames=[]), ["0 frames"]),
    ],
)
def test_damaged_azure_files_are_refused_naming_the_frame(
    tmp_path: Path, text: str, words: list[str]
) -> None:
    message = complaint(write_text(tmp_path / "a.json", text))
    for word in words:
        assert word in message


def test_other_damaged_files_are_refused_saying_where(tmp_path: Path) -> None:
    v1 = made_up(3, KINECT_V1)
    rows = msr_action3d_text(v1).splitlines(keepends=True)
    cut = write_text(tmp_path / "a", "".join(rows[:-1]))
    assert "59 rows" in complaint(cut)
    rows[30] = "1 2 3\n"
    assert "row 31" in complaint(write_text(tmp_path / "b", "".join(rows)))
    lines = msrc_12_text(v1).splitlines(keepends=True)
    lines[1] = lines[1].replace(" ", " x", 1)
    message = complaint(write_text(tmp_path / "c", "".join(lines)))
    assert "row 2, column HipCenter.x" in message


def test_bvh_of_unknown_joints_is_refused_naming_what_is_missing(
    make_clip: MakeClip, tmp_path: Path
) -> None:
    write_clip(make_clip(3), tmp_path / "clip.bvh")
    text = (tmp_path / "clip.bvh").read_text().replace("Elbow", "Tentacle")
    message = complaint(write_text(tmp_path / "a.bvh", text))
    for word in ("'ElbowLeft'", "2 missing", "kinect_v1", "found HipCenter"):
        assert word in message


def test_a_torn_last_row_of_a_killed_recording_is_left_out_and_a_note_says_so(
    tmp_path: Path,
) -> None:
    write_take_csv(made_up(3), tmp_path / "whole.csv")
    text = (tmp_path / "whole.csv").read_text()
    torn = write_text(tmp_path / "take.1.part.csv", text[:-30])
    recording = read_recording(torn)
    assert len(recording.takes[0]) == 2
    assert recording.notes == ("row 4 is incomplete: it is left out",)
    assert "row 4 has" in complaint(write_text(torn, text[:-30], "\n"))
    assert len(read_recording(write_text(torn, text[:-1])).takes[0]) == 3
    assert "row 4 has" in complaint(write_text(tmp_path / "take.csv", text[:-30]))


FAR = "over 10000 m away, so counted as missing: Head, at 0.5 s"


def _with_far_head(take: Take) -> Take:
    positions = take.positions.copy()
    positions[15, take.skeleton.index("Head"), 2] = 1e6
    return replace(take, positions=positions)


def _written(take: Take, path: Path) -> Path:
    if path.suffix == ".csv":
        write_take_csv(take, path)
    else:
        write_text(path, ntu_text([take]))
    return path


@pytest.mark.parametrize("name", ["take.csv", "take.skeleton"])
def test_a_joint_out_of_range_counts_as_missing_and_a_note_says_so(
    name: str, tmp_path: Path
) -> None:
    """One damaged number used to lose the whole take."""
    whole = made_up(30)
    path = _written(_with_far_head(whole), tmp_path / name)
    (take,), notes = read_recording(path).takes, read_recording(path).notes
    head = whole.skeleton.index("Head")
    assert notes == (FAR,)
    assert np.isnan(take.positions[15, head]).all()
    assert take.state[15, head] == 0
    assert np.isnan(take.positions).sum() == 3


def test_takes_with_many_joints_out_of_range_are_refused(tmp_path: Path) -> None:
    whole = made_up(30)
    far = replace(whole, positions=whole.positions + 1e6)
    assert "convert to meters" in complaint(_written(far, tmp_path / "far.csv"))
    with pytest.raises(InputError, match=r"frame 1 has a joint 1e\+06 m away"):
        clean(far)


def test_a_take_in_memory_with_a_joint_out_of_range_is_cleaned_and_told() -> None:
    take = sample_take().at(slice(60))
    config = CleanConfig(method="none", physics=False)
    result, usual = (clean(t, config) for t in (_with_far_head(take), take))
    (told,) = set(result.notes) - set(usual.notes)
    assert told == FAR
    assert result.clip.state[15, take.skeleton.index("Head")] == 0
    moved = np.abs(result.clip.positions - usual.clip.positions)
    assert moved.max() < 0.03
    raw = compare(result.clip, _with_far_head(take)).raw
    assert np.isnan(raw[15, take.skeleton.index("Head")]).all()
