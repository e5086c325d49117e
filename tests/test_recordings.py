"""Takes in the layouts of other programs, one person or several."""

from __future__ import annotations

import gzip
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from numpy.typing import NDArray
from published_layouts import (
    azure_json,
    msr_action3d_text,
    msrc_12_text,
    ntu_text,
)

from kinefilter.characters import (
    KINECT_V1,
    KINECT_V2,
    Clip,
    InputError,
    Skeleton,
    State,
    Take,
)
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.config import TakeFormat
from kinefilter.pipeline.formats import (
    read_clip,
    read_recording,
    read_take,
    read_takes,
    write_clip,
)
from kinefilter.pipeline.formats.takes import FORMATS
from kinefilter.pipeline.simulate import simulate

Array = NDArray[np.float64]
MakeClip = Callable[..., Clip]


def made_up(
    frames: int = 6, skeleton: Skeleton = KINECT_V2, *, seed: int = 0, fps: float = 30.0
) -> Take:
    rng = np.random.default_rng(seed)
    place = np.array([0.8 * seed, 0.2, 2.5])
    positions = place + rng.uniform(-0.5, 0.5, (frames, len(skeleton), 3))
    state = rng.integers(1, 3, positions.shape[:2]).astype(np.uint8)
    return Take(np.arange(frames) / fps, positions, state, skeleton)


def without(take: Take, frames: list[int]) -> Take:
    positions, state = take.positions.copy(), take.state.copy()
    positions[frames], state[frames] = np.nan, State.NOT_TRACKED
    return replace(take, positions=positions, state=state)


def write_text(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def complaint(path: Path, **options: str) -> str:
    with pytest.raises(InputError) as caught:
        read_recording(path, **options)
    message = str(caught.value)
    assert str(path) in message
    assert "\n" not in message
    return message


# One person


def test_ntu_keeps_positions_states_and_thirty_frames_a_second(tmp_path: Path) -> None:
    take = made_up()
    recording = read_recording(write_text(tmp_path / "a", ntu_text([take])))
    assert (recording.format, len(recording.takes)) == ("ntu", 1)
    again = recording.takes[0]
    assert again.skeleton is KINECT_V2
    np.testing.assert_array_equal(again.positions, take.positions)
    np.testing.assert_array_equal(again.state, take.state)
    np.testing.assert_allclose(again.time, take.time)


def test_ntu_joints_that_are_not_tracked_are_missing(tmp_path: Path) -> None:
    take = made_up()
    state = take.state.copy()
    state[2, 5] = State.NOT_TRACKED
    text = ntu_text([replace(take, state=state)])
    again = read_take(write_text(tmp_path / "a", text))
    assert np.isnan(again.positions[2, 5]).all()
    assert np.isnan(again.positions).sum() == 3


def test_azure_joints_are_those_of_kinect_v2_in_meters(tmp_path: Path) -> None:
    take = made_up()
    recording = read_recording(write_text(tmp_path / "a", azure_json([take])))
    assert (recording.format, recording.unit) == ("azure", "mm")
    again = recording.takes[0]
    assert again.skeleton is KINECT_V2
    np.testing.assert_allclose(again.positions, take.positions, atol=1e-12)
    np.testing.assert_allclose(again.time, take.time, atol=1e-6)
    assert (again.state == State.TRACKED).all()


def test_a_person_before_an_azure_kinect_faces_it_and_keeps_left_and_right(
    tmp_path: Path,
) -> None:
    """Camera axes: x right, y down, z forward; who faces it has the left hand right."""
    text = azure_json([made_up(2)])
    data = json.loads(text)
    names = data["joint_names"]
    for frame in data["frames"]:
        places = frame["bodies"][0]["joint_positions"]
        places[names.index("HAND_LEFT")] = [600.0, 0.0, 2000.0]
        places[names.index("HAND_RIGHT")] = [-600.0, 0.0, 2000.0]
        places[names.index("FOOT_LEFT")] = [100.0, 900.0, 1900.0]
    take = read_take(write_text(tmp_path / "a", json.dumps(data)))
    left, right, foot = (
        take.positions[0, KINECT_V2.index(joint)]
        for joint in ("HandLeft", "HandRight", "FootLeft")
    )
    # As Kinect v2 has it (labanotation takes): the left at smaller x, feet below.
    np.testing.assert_allclose(left, [-0.6, 0.0, 2.0])
    np.testing.assert_allclose(right, [0.6, 0.0, 2.0])
    np.testing.assert_allclose(foot, [-0.1, -0.9, 1.9])


def test_azure_confidence_low_is_inferred_and_none_is_missing(tmp_path: Path) -> None:
    data = json.loads(azure_json([made_up()], levels=True))
    body = data["frames"][1]["bodies"][0]
    wrist, ear = (data["joint_names"].index(n) for n in ("WRIST_LEFT", "EAR_LEFT"))
    body["confidence_level"] = [2] * 32
    body["confidence_level"][wrist], body["confidence_level"][ear] = 1, 0
    take = read_take(write_text(tmp_path / "a", json.dumps(data)))
    assert take.state[1, KINECT_V2.index("WristLeft")] == State.INFERRED
    # The head is the mean of both ears: no better than the worse.
    assert take.state[1, KINECT_V2.index("Head")] == State.NOT_TRACKED
    assert np.isnan(take.positions[1, KINECT_V2.index("Head")]).all()
    assert (take.state[1] == State.TRACKED).sum() == 23


def test_msr_action3d_has_its_own_order_and_fifteen_frames_a_second(
    tmp_path: Path,
) -> None:
    take = made_up(4, KINECT_V1)
    path = write_text(tmp_path / "a", msr_action3d_text(take))
    again = read_take(path)
    assert read_recording(path).format == "msr-action3d"
    assert again.skeleton is KINECT_V1
    assert again.fps == pytest.approx(15.0)
    np.testing.assert_array_equal(again.positions, take.positions)
    first = np.loadtxt(path)[0, :3]
    shoulder = KINECT_V1.index("ShoulderRight")
    np.testing.assert_array_equal(again.positions[0, shoulder], first)


def test_msr_confidence_of_a_half_is_inferred(tmp_path: Path) -> None:
    text = msr_action3d_text(made_up(2, KINECT_V1), confidence=0.5)
    assert (read_take(write_text(tmp_path / "a", text)).state == State.INFERRED).all()


def test_msr_screen_coordinates_are_refused_naming_the_other_files(
    tmp_path: Path,
) -> None:
    rng = np.random.default_rng(0)
    rows = rng.uniform([100, 40, 400, 1], [220, 200, 900, 1], (40, 4))
    path = tmp_path / "a01_s01_e01_skeleton.txt"
    np.savetxt(path, rows, fmt="%.2f")
    assert "pixels" in complaint(path)
    assert "skeleton3D" in complaint(path)


@pytest.mark.parametrize("split", [" ", ",", "   "])
def test_msrc_12_has_microseconds_and_ones_that_are_no_states(
    tmp_path: Path, split: str
) -> None:
    take = made_up(5, KINECT_V1)
    path = write_text(tmp_path / "a", msrc_12_text(take, split=split))
    again = read_take(path)
    assert read_recording(path).format == "msrc-12"
    np.testing.assert_array_equal(again.positions, take.positions)
    np.testing.assert_allclose(again.time, take.time, atol=1e-6)
    assert (again.state == State.TRACKED).all()


def test_msrc_12_with_states_keeps_them(tmp_path: Path) -> None:
    take = made_up(5, KINECT_V1)
    text = msrc_12_text(take, take.state.astype(float))
    again = read_take(write_text(tmp_path / "a", text))
    np.testing.assert_array_equal(again.state, take.state)


@pytest.mark.parametrize("skeleton", [KINECT_V1, KINECT_V2], ids=lambda s: s.name)
def test_kinefilters_own_bvh_is_a_take_of_the_same_joints(
    make_clip: MakeClip, tmp_path: Path, skeleton: Skeleton
) -> None:
    clip = make_clip(8, skeleton)
    write_clip(clip, tmp_path / "clip.bvh")
    recording = read_recording(tmp_path / "clip.bvh")
    take = recording.takes[0]
    assert (recording.format, recording.unit) == ("bvh", "m")
    assert take.skeleton is skeleton
    known = np.isfinite(take.positions[0, :, 0])
    assert known.sum() == 20 + (skeleton is KINECT_V2)
    np.testing.assert_allclose(
        take.positions[:, known], clip.positions[:, known], atol=2e-6
    )
    assert take.fps == pytest.approx(clip.fps)


def test_every_format_is_detected_and_can_be_forced(
    make_clip: MakeClip, tmp_path: Path
) -> None:
    v1, v2 = made_up(4, KINECT_V1), made_up(4)
    write_clip(make_clip(4), tmp_path / "clip.bvh")
    texts = {
        "msrc-12": msrc_12_text(v1),
        "msr-action3d": msr_action3d_text(v1),
        "ntu": ntu_text([v2]),
        "azure": azure_json([v2]),
        "bvh": (tmp_path / "clip.bvh").read_text(),
    }
    assert {*texts, "kinefilter", "kinect-v2", "kinect-v1"} == set(FORMATS)
    assert tuple(FORMATS) == get_args(TakeFormat)
    for name, text in texts.items():
        zipped = tmp_path / "take.csv"
        zipped.write_bytes(gzip.compress(text.encode()))
        plain = write_text(tmp_path / "take", "\n" * (name != "azure") + text)
        for path in (plain, zipped):
            assert read_recording(path).format == name
            forced = read_recording(path, format=name)
            assert len(forced.takes[0]) >= 4


# Several people


def test_two_people_are_two_takes_in_the_order_in_which_they_appear(
    tmp_path: Path,
) -> None:
    late, early = without(made_up(8, seed=1), [0, 1, 7]), made_up(8, seed=2)
    for text in (ntu_text([late, early]), azure_json([late, early])):
        path = write_text(tmp_path / "a", text)
        first, second = read_takes(path)
        assert (len(first), len(second)) == (8, 5)
        np.testing.assert_allclose(first.positions, early.positions, atol=1e-12)
        np.testing.assert_allclose(second.time, late.time[2:7], atol=1e-6)
        assert second.source.endswith("body 2")
        np.testing.assert_array_equal(read_take(path).positions, first.positions)
        np.testing.assert_array_equal(
            read_take(path, body=2).positions, second.positions
        )


def test_the_person_seen_in_most_frames_is_the_one_that_is_read(
    tmp_path: Path,
) -> None:
    take, other = without(made_up(9, seed=1), [3, 4, 5]), made_up(9, seed=2)
    recording = read_recording(write_text(tmp_path / "a", ntu_text([take, other])))
    assert recording.main == 1


def test_frames_that_lack_a_person_are_missing_in_their_take(tmp_path: Path) -> None:
    take = without(made_up(8), [3, 4])
    again = read_take(write_text(tmp_path / "a", ntu_text([take])))
    np.testing.assert_array_equal(again.positions, take.positions)
    np.testing.assert_array_equal(again.state, take.state)


def moving(frames: int, start: float, speed: float) -> Take:
    """Return a body that moves along x at a speed [m/s] from a place [m]."""
    shape = made_up(1).positions[0] - made_up(1).positions[0].mean(axis=0)
    time = np.arange(frames) / 30.0
    path = np.stack([start + speed * time, 0.0 * time, 2.0 + 0.0 * time], axis=-1)
    state = np.full((frames, len(KINECT_V2)), State.TRACKED, dtype=np.uint8)
    return Take(time, shape + path[:, None], state, KINECT_V2)


@pytest.mark.parametrize(
    ("gap", "jump", "people"), [(10, 0.3, 1), (10, 0.7, 2), (75, 0.3, 2)]
)
def test_a_body_that_comes_back_soon_and_near_is_the_same_person(
    tmp_path: Path, gap: int, jump: float, people: int
) -> None:
    frames = 20 + gap + 20
    before, after = moving(frames, 0.0, 0.0), moving(frames, jump, 0.0)
    before = without(before, list(range(20, frames)))
    after = without(after, list(range(20 + gap)))
    path = write_text(tmp_path / "a", ntu_text([before, after]))
    takes = read_takes(path)
    assert len(takes) == people
    assert len(takes[0]) == (frames if people == 1 else 20)


def test_two_who_come_back_at_once_go_on_as_who_was_nearest(tmp_path: Path) -> None:
    frames, lost = 40, list(range(15, 40))
    back = list(range(20))
    one, other = moving(frames, 0.0, 0.0), moving(frames, 0.45, 0.0)
    again_one, again_other = moving(frames, 0.1, 0.0), moving(frames, 0.5, 0.0)
    bodies = [without(one, lost), without(other, lost)]
    bodies += [without(again_other, back), without(again_one, back)]
    text = ntu_text(bodies, numbers=(1, 2, 3, 4))
    takes = read_takes(write_text(tmp_path / "a", text))
    assert len(takes) == 2
    for take, places in zip(takes, [(0.0, 0.1), (0.45, 0.5)], strict=True):
        centers = take.positions[[0, -1]].mean(axis=1)[:, 0]
        np.testing.assert_allclose(centers, places, atol=1e-9)


def test_what_is_seen_in_one_frame_is_nobody(tmp_path: Path) -> None:
    ghost = without(made_up(6, seed=3), [0, 1, 3, 4, 5])
    path = write_text(tmp_path / "a", ntu_text([made_up(6), ghost]))
    assert len(read_takes(path)) == 1


def test_a_body_that_is_not_there_is_refused(tmp_path: Path) -> None:
    path = write_text(tmp_path / "a", ntu_text([made_up()]))
    for body in (0, 2):
        with pytest.raises(InputError, match=f"no body {body}.*info"):
            read_take(path, body=body)


# Complaints


def ntu_lines() -> list[str]:
    return ntu_text([made_up(3)]).splitlines(keepends=True)


def edited(lines: list[str], row: int, text: str) -> str:
    return "".join([*lines[: row - 1], text + "\n", *lines[row:]])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("".join(ntu_lines()[:40]), ["ends the file in frame 2 of 3", "cut off"]),
        (edited(ntu_lines(), 1, "9" * 15), ["ends the file in frame 4"]),
        (edited(ntu_lines(), 1, "2"), ["goes on after 2 frames", "row 1"]),
        (edited(ntu_lines(), 2, "many"), ["row 2", "'many'", "number of bodies"]),
        (edited(ntu_lines(), 2, "0"), ["row 3", "expected the number of bodies"]),
        (edited(ntu_lines(), 3, "7 0 1"), ["row 3", "3 values", "10 of a body"]),
        (edited(ntu_lines(), 4, "1000000"), ["row 4", "1000000 joints", "25"]),
        (edited(ntu_lines(), 6, "1 2 3"), ["row 6", "3 values", "12 of a joint"]),
        (edited(ntu_lines(), 6, "a" + " 2" * 11), ["row 6", "word"]),
        (edited(ntu_lines(), 6, "1e400" + " 2" * 11), ["row 6", "infinite"]),
        (edited(ntu_lines(), 6, "1 " * 11 + "7"), ["row 6", "'7'", "tracking state"]),
        ("1\n0\n", ["1 frame,", "at least 2"]),
        ("2\n0\n0\n", ["nobody is tracked"]),
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
        (azure_json([made_up(3)])[:5000], ["no JSON", "cut off"]),
        ("{}", ["without 'frames'"]),
        ('{"frames": {}}', ["without 'frames'"]),
        ("[" * 100_000, ["row 1"]),
        ('{"a":' * 100_000, ["no JSON"]),
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


def test_a_body_twice_in_a_frame_is_refused(tmp_path: Path) -> None:
    text = ntu_text([made_up(3), made_up(3, seed=1)], numbers=(4, 4))
    assert "frame 1 has body 4 twice" in complaint(write_text(tmp_path / "a", text))


def test_bvh_of_unknown_joints_is_refused_naming_what_is_missing(
    make_clip: MakeClip, tmp_path: Path
) -> None:
    write_clip(make_clip(3), tmp_path / "clip.bvh")
    text = (tmp_path / "clip.bvh").read_text().replace("Elbow", "Tentacle")
    message = complaint(write_text(tmp_path / "a.bvh", text))
    for word in ("'ElbowLeft'", "2 missing", "kinect_v1", "found HipCenter"):
        assert word in message


# Cleaned


def people(tmp_path: Path) -> Path:
    """Return an NTU file of two people, one of whom is gone for half a second."""
    takes = [
        simulate("basic", "wave", skeleton="kinect_v2", seed=seed).take
        for seed in (1, 2)
    ]
    count = min(map(len, takes))
    one, other = (
        Take(t.time[:count], t.positions[:count], t.state[:count], t.skeleton)
        for t in takes
    )
    other = without(other, [*range(10), *range(60, 75)])
    return write_text(tmp_path / "two.skeleton", ntu_text([one, other]))


def test_clean_writes_a_clip_for_each_person(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, out = people(tmp_path), tmp_path / "clip.npz"
    quick = ["--no-physics", "--method", "none"]
    assert main(["clean", str(path), "-o", str(out), "--body", "all", *quick]) == 0
    assert not out.exists()
    clips = [read_clip(tmp_path / f"clip.{k}.npz") for k in (1, 2)]
    takes = read_takes(path)
    for clip, take in zip(clips, takes, strict=True):
        np.testing.assert_array_equal(clip.time, take.time)
        assert np.isfinite(clip.positions).all()
    capsys.readouterr()
    assert main(["clean", str(path), "-o", str(out), *quick]) == 0
    assert "body 1 of 2" in capsys.readouterr().out
    np.testing.assert_array_equal(read_clip(out).positions, clips[0].positions)


def test_an_azure_take_is_cleaned_like_one_of_kinect_v2(tmp_path: Path) -> None:
    take = simulate("basic", "wave", skeleton="kinect_v2", seed=1).take
    path = write_text(tmp_path / "a.json", azure_json([take]))
    out = tmp_path / "clip.npz"
    assert main(["clean", str(path), "-o", str(out), "--method", "local-pca"]) == 0
    clip = read_clip(out)
    assert clip.skeleton is KINECT_V2
    assert len(clip) == len(take)


def test_an_unknown_body_is_refused_and_nothing_is_written(tmp_path: Path) -> None:
    path = write_text(tmp_path / "a", ntu_text([made_up()]))
    assert main(["clean", str(path), "-o", str(tmp_path / "c.usda"), "--body=3"]) == 2
    assert [p.name for p in tmp_path.iterdir()] == ["a"]
