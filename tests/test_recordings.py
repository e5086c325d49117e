"""Takes of one person in the layouts of other programs."""

from __future__ import annotations

import gzip
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from made_up_people import made_up
from published_layouts import (
    azure_json,
    freemocap_csv,
    mmpose_json,
    msr_action3d_text,
    msrc_12_text,
    ntu_text,
    openpose_frames,
)
from skeletons import every_skeleton
from test_mocap_files import standing, write_trc
from text_files import write_text

from kinefilter.characters import KINECT_V1, KINECT_V2, Clip, Skeleton, State
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.config import TakeFormat
from kinefilter.pipeline.formats import read_clip, read_recording, read_take, write_clip
from kinefilter.pipeline.formats.takes import FORMATS, claims_take
from kinefilter.pipeline.lab.simulation import simulate

MakeClip = Callable[..., Clip]
_AT_ONCE = ("azure", "trc")  # no blank line before them in the text


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


@every_skeleton
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


def test_a_report_in_json_is_no_take_even_with_a_semicolon(tmp_path: Path) -> None:
    report = tmp_path / "walk.json"
    report.write_text('{\n  "notes": ["ElbowLeft was moved; check it"]\n}\n')
    assert not claims_take(report)


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
        "freemocap": freemocap_csv(v2),
        "openpose": json.dumps(openpose_frames([v2])),
        "mmpose": mmpose_json([v2]),
        "trc": write_trc(
            tmp_path / "a.trc", standing(KINECT_V2, "keypoints")
        ).read_text(),
    }
    elsewhere = {"kinefilter", "kinect-v2", "kinect-v1", "npy", "c3d"}
    assert {*texts, *elsewhere} == set(FORMATS)
    assert tuple(FORMATS) == get_args(TakeFormat)
    for name, text in texts.items():
        zipped = tmp_path / "take.csv"
        zipped.write_bytes(gzip.compress(text.encode()))
        plain = write_text(tmp_path / "take", "\n" * (name not in _AT_ONCE) + text)
        for path in (plain, zipped):
            assert read_recording(path).format == name
            forced = read_recording(path, format=name)
            assert len(forced.takes[0]) >= 4


def test_an_azure_take_is_cleaned_like_one_of_kinect_v2(tmp_path: Path) -> None:
    take = simulate("basic", "wave", skeleton="kinect_v2", seed=1).take
    path = write_text(tmp_path / "a.json", azure_json([take]))
    out = tmp_path / "clip.npz"
    assert main(["clean", str(path), "-o", str(out), "--method", "local-pca"]) == 0
    clip = read_clip(out)
    assert clip.skeleton is KINECT_V2
    assert len(clip) == len(take)
