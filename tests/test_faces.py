"""Where faces look: read from Azure Kinect, kept in takes, followed by heads."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from published_layouts import azure_json
from text_files import write_text

from kinefilter import CleanConfig, Cleaner
from kinefilter.characters import KINECT_V2, Take, standard_body
from kinefilter.characters.errors import InputError
from kinefilter.characters.rotations import IDENTITY, about_y, about_z, rotate, unit
from kinefilter.pipeline.formats import read_recording
from kinefilter.pipeline.formats.azure import JOINTS
from kinefilter.retarget import Neck
from kinefilter.scenes.library import perform
from kinefilter.scenes.sensor import SENSORS, in_sensor_frame

Array = NDArray[np.float64]
Change = Callable[[Array, int], object]

_FACE = ("EAR_LEFT", "EAR_RIGHT", "EYE_LEFT", "EYE_RIGHT", "NOSE")
_PLACES = ((0.07, 0.0), (-0.07, 0.0), (0.03, 0.09), (-0.03, 0.09), (0.0, 0.12))
"""Of these, to the left of the head and ahead [m]."""
_ROWS = [JOINTS.index(name) for name in _FACE]
_YAW = 0.5  # rad by which faces look to the left of the chest
_FLIP = np.array([-1000.0, -1000.0, 1000.0])  # to the axes and unit of the file


def turning() -> Take:
    """Return a person who turns around in front of the sensor, seen without error."""
    motion = perform("turn", standard_body(KINECT_V2), seed=9001, fps=30.0)
    joints = in_sensor_frame(motion.positions, SENSORS["azure"])
    return Take(motion.time, joints, np.full(joints.shape[:2], 2), KINECT_V2)


def ahead_of(take: Take, yaw: float = 0.0) -> Array:
    """Return where the chest faces, turned to the left [rad], sensor frame, (T, 3)."""
    left, right = KINECT_V2.sides("Shoulder")
    across = (take.positions[:, left] - take.positions[:, right]) * [1.0, 0.0, 1.0]
    return rotate(about_y(yaw - np.pi / 2.0), unit(across))


def read(
    take: Take, folder: Path, change: Change = lambda *_: None, level: int = 2
) -> tuple[Take, str]:
    """Return a take with faces as it is read, and notes; ``change`` damages joints."""
    data = json.loads(azure_json([take]))
    for k, ahead in enumerate(ahead_of(take, _YAW)):
        (body,) = data["frames"][k]["bodies"]
        joints = np.array(body["joint_positions"])
        head = joints[_ROWS[:2]].mean(axis=0)
        left = np.cross([0.0, 1.0, 0.0], ahead)
        for row, (x, z) in zip(_ROWS, _PLACES, strict=True):
            joints[row] = head + (x * left + z * ahead) * _FLIP
        change(joints, k)
        body["joint_positions"] = joints.tolist()
        body["confidence_levels"] = [level if k in _ROWS else 2 for k in range(32)]
    path = write_text(folder / "a.json", json.dumps(data))
    recording = read_recording(path)
    return recording.takes[0], "\n".join(recording.notes)


def test_a_face_looks_from_the_ears_to_eyes_and_nose(tmp_path: Path) -> None:
    take, notes = read(turning(), tmp_path)
    assert take.face is not None
    np.testing.assert_allclose(take.face, ahead_of(take, _YAW), atol=1e-6)
    assert "follow the face" not in notes


def test_faces_that_are_not_surely_seen_are_unknown(tmp_path: Path) -> None:
    take, _ = read(turning(), tmp_path, level=1)
    assert take.face is not None
    assert np.isnan(take.face).all()
    assert (take.state == 2 - (np.arange(25) == KINECT_V2.index("Head"))).all()


def _behind(joints: Array, _: int) -> None:
    joints[_ROWS[2:]] = 2.0 * joints[_ROWS[:2]].mean(axis=0) - joints[_ROWS[2:]]


def _constant(joints: Array, _: int) -> None:
    joints[_ROWS[2:]] = joints[_ROWS[:2]].mean(axis=0) + 100.0 * np.eye(3)[0]


def _shuffled(joints: Array, frame: int) -> None:
    joints[_ROWS] = np.random.default_rng(frame).permutation(joints[_ROWS])


def _random(joints: Array, frame: int) -> None:
    aside = np.random.default_rng(frame).normal(size=3)
    joints[_ROWS[2:]] = joints[_ROWS[:2]].mean(axis=0) + 100.0 * unit(aside)


@pytest.mark.parametrize("change", [_behind, _constant, _shuffled, _random])
def test_faces_that_do_not_fit_the_body_are_ignored_with_a_note(
    tmp_path: Path, change: Change
) -> None:
    take, notes = read(turning(), tmp_path, change)
    assert take.face is None
    assert "eyes, ears and nose do not fit the body" in notes


def test_joints_of_another_order_show_no_face(tmp_path: Path) -> None:
    def other(joints: Array, _: int) -> None:
        joints[_ROWS] = joints[[JOINTS.index(n) for n in JOINTS[:5]]]

    take, _ = read(turning(), tmp_path, other)
    assert take.face is None or np.isnan(take.face).all()


def test_a_take_keeps_the_faces_of_its_frames_but_none_where_sides_were_swapped() -> (
    None
):
    take = turning()
    take = replace(take, face=ahead_of(take))
    assert take.face is not None
    np.testing.assert_array_equal(take.at(slice(3, 9)).face, take.face[3:9])
    swapped = take.swapped(slice(4)).face
    assert swapped is not None
    assert np.isnan(swapped[:4]).all()
    np.testing.assert_array_equal(swapped[4:], take.face[4:])
    with pytest.raises(InputError, match="face"):
        replace(take, face=np.zeros((3, 3)))


@pytest.mark.parametrize("yaw", [-2.8, -1.0, 0.0, 0.4, 3.1])
def test_a_head_turns_with_a_face_as_far_as_heads_do(yaw: float) -> None:
    neck = Neck(standard_body(KINECT_V2))
    rotations = np.tile(IDENTITY, (len(KINECT_V2), 1))
    face = rotate(about_y(yaw), [0.0, 0.0, 1.0])
    heads = neck.along
    turns = [
        neck.turn(neck.faces(face, rotations, heads), np.array([weight]))[0]
        for weight in (1e9, 1.0, 0.01, 0.0)
    ]
    assert turns[0] == pytest.approx(yaw, abs=1e-6) or abs(yaw) > np.radians(60.0)
    assert np.abs(turns[0]) < np.radians(80.0)
    assert (np.diff(np.abs(turns)) <= 1e-9).all()
    assert turns[-1] == 0.0


@pytest.mark.parametrize("roll", [0.0, np.pi])
def test_a_cleaned_head_follows_the_face_also_of_a_sensor_upside_down(
    roll: float,
) -> None:
    take, heads = turning(), []
    for yaw in (None, _YAW, -_YAW):
        face = None if yaw is None else rotate(about_z(roll), ahead_of(take, yaw))
        seen = replace(take, positions=rotate(about_z(roll), take.positions), face=face)
        clip = Cleaner(CleanConfig(method="none", physics=False)).clean(seen).clip
        looks = rotate(clip.rotations[:, KINECT_V2.index("Head")], [0.0, 0.0, 1.0])
        chest = ahead_of(replace(take, positions=clip.positions))
        left = np.cross([0.0, 1.0, 0.0], chest)
        heads.append(
            np.median(np.arctan2(np.vecdot(looks, left), np.vecdot(looks, chest)))
        )
    without, left, right = heads
    assert abs(without) < 0.15
    assert left == pytest.approx(_YAW, abs=0.12)
    assert right == pytest.approx(-_YAW, abs=0.12)
