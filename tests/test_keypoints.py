"""Takes of MediaPipe, FreeMoCap, OpenPose, RTMPose, TRC and C3D, in their layouts.

Scripted motions are written as each tool writes them, and every joint has to be where
the script has it, on its own side and the right way up.
"""

from __future__ import annotations

import gzip
import io
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from published_layouts import (
    MEDIAPIPE,
    OPENCAP,
    POSE2SIM,
    freemocap_csv,
    landmarks,
    mmpose_json,
    openpose_frames,
    y_down,
    z_up,
)
from test_mocap_files import standing, write_c3d, write_trc
from text_files import write_text

from kinefilter import CleanConfig, clean
from kinefilter.characters import KINECT_V2, InputError, State, Take, standard_body
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.contents import contents_of
from kinefilter.pipeline.formats import read_clip, read_recording, read_take
from kinefilter.pipeline.formats.keypoints import BLAZEPOSE, BODY_25, WHOLE_BODY
from kinefilter.pipeline.formats.mocap import plain_name
from kinefilter.pipeline.formats.recording import Mocap
from kinefilter.pipeline.formats.takes import claims_take
from kinefilter.scenes.library import perform

Array = NDArray[np.float64]
BODY = standard_body(KINECT_V2, height=1.68)
LIMBS = ("Shoulder", "Elbow", "Wrist", "Hip", "Knee", "Ankle")
SURE = [f"{limb}{side}" for limb in LIMBS for side in ("Left", "Right")]
SURE += ["SpineBase"]
FEET, HANDS = ["FootLeft", "FootRight"], ["HandLeft", "HandRight"]


def scripted(name: str = "walk", frames: int = 90, seed: int = 3) -> Take:
    """Return a scripted motion as a take: y up, the person's left at +x at first."""
    motion = perform(name, BODY, seed=seed)
    positions = motion.positions[:frames]
    state = np.full(positions.shape[:2], State.TRACKED, dtype=np.uint8)
    return Take(motion.time[:frames], positions, state, KINECT_V2)


def apart(found: Take, truth: Take, joints: list[str]) -> float:
    """Return how far any of these joints is from the truth at most [m]."""
    columns = [KINECT_V2.index(joint) for joint in joints]
    off = found.positions[:, columns] - truth.positions[:, columns]
    return float(np.linalg.norm(off, axis=-1).max())


def write_npy(path: Path, array: Any) -> Path:
    np.save(path, array)
    return path


def hands_and_face(places: Array) -> Array:
    """Return FreeMoCap's array: the body, two hands and a face that nobody reads."""
    rest = np.full((len(places), 520, 3), 7.0)
    return np.concatenate([places, rest], axis=1)


def trc(path: Path, names: tuple[str, ...], take: Take, up: Any = None) -> Path:
    """Write landmarks as TRC in mm."""
    known = [plain_name(name) for name in names]
    places = landmarks(take, known) if up is None else up(landmarks(take, known))
    return write_trc(path, Mocap(names, 100.0 * places, None, 1 / 30, str(path)))


def test_names_and_order_are_those_that_mediapipe_documents() -> None:
    assert tuple(plain_name(name) for name in MEDIAPIPE) == BLAZEPOSE
    assert len(BLAZEPOSE) == 33
    assert (len(BODY_25), len(WHOLE_BODY)) == (25, 23)


WRITERS: dict[str, tuple[Callable[[Path, Take], Path], str, str, list[str]]] = {
    "mediapipe with travel": (
        lambda f, t: write_npy(f / "a.npy", y_down(landmarks(t, BLAZEPOSE))),
        "npy",
        "m",
        ["Head", *FEET, *HANDS],
    ),
    "freemocap npy": (
        lambda f, t: write_npy(
            f / "a.npy", hands_and_face(1000.0 * z_up(landmarks(t, BLAZEPOSE)))
        ),
        "npy",
        "mm",
        ["Head", *FEET, *HANDS],
    ),
    "freemocap csv": (
        lambda f, t: write_text(f / "a.csv", freemocap_csv(t)),
        "freemocap",
        "mm",
        ["Head", *FEET, *HANDS],
    ),
    "pose2sim": (
        lambda f, t: trc(f / "a.trc", POSE2SIM, t),
        "trc",
        "mm",
        ["Head", *FEET],
    ),
    "opencap": (lambda f, t: trc(f / "a.trc", OPENCAP, t), "trc", "mm", FEET),
    "pose2sim with blazepose, z up": (
        lambda f, t: trc(f / "a.trc", MEDIAPIPE, t, z_up),
        "trc",
        "mm",
        ["Head", *FEET, *HANDS],
    ),
    "c3d": (
        lambda f, t: write_c3d(
            f / "a.c3d",
            Mocap(
                POSE2SIM,
                100.0 * z_up(landmarks(t, [plain_name(n) for n in POSE2SIM])),
                None,
                1 / 30,
                "",
            ),
        ),
        "c3d",
        "mm",
        ["Head", *FEET],
    ),
    "openpose": (
        lambda f, t: write_text(f / "a.json", json.dumps(openpose_frames([t]))),
        "openpose",
        "mm",
        ["Head", *FEET],
    ),
}


@pytest.mark.parametrize("tool", WRITERS)
@pytest.mark.parametrize("name", ["walk", "punch"])
def test_every_joint_is_where_the_script_has_it(
    tmp_path: Path, tool: str, name: str
) -> None:
    write, layout, unit, more = WRITERS[tool]
    truth = scripted(name)
    recording = read_recording(write(tmp_path, truth))
    assert (recording.format, recording.unit) == (layout, unit)
    (found,) = recording.takes
    assert found.skeleton is KINECT_V2
    np.testing.assert_allclose(found.time, truth.time - truth.time[0], atol=1e-4)
    assert apart(found, truth, [*SURE, *more]) < 1e-4
    seen = {KINECT_V2.joints[j] for j in np.flatnonzero(found.state.all(axis=0))}
    assert seen == {*SURE, *more, "SpineShoulder"}


@pytest.mark.parametrize("tool", ["freemocap npy", "opencap", "openpose"])
def test_cleaning_takes_no_errors_of_a_kinect_off(tmp_path: Path, tool: str) -> None:
    truth = scripted("squat")
    take = read_take(WRITERS[tool][0](tmp_path, truth))
    columns = [KINECT_V2.index(joint) for joint in SURE]
    errors = []
    for given in (take, replace(take, by_kinect=True)):
        clip = clean(given, CleanConfig(physics=False)).clip
        # It stands on the floor below the sensor.
        off = (clip.positions - truth.positions)[:, columns]
        off = off - np.median(off, axis=(0, 1))
        errors.append(np.linalg.norm(off, axis=-1).mean())
        if given is take:
            assert clip.body.height == pytest.approx(BODY.height, abs=0.02)
    assert errors[0] < 0.005 < 0.02 < errors[1]


def test_mmpose_puts_everybody_on_the_floor(tmp_path: Path) -> None:
    one = scripted("punch")
    beside = Take(
        one.time, one.positions + np.array([1.2, 0.0, 0.3]), one.state, KINECT_V2
    )
    for named in (True, False):
        text = mmpose_json([one, beside], named=named)
        recording = read_recording(write_text(tmp_path / "a.json", text))
        assert (recording.format, len(recording.takes)) == ("mmpose", 2)
        for found, truth in zip(recording.takes, (one, beside), strict=True):
            off = (found.positions - truth.positions)[..., [0, 2]]
            columns = [KINECT_V2.index(j) for j in (*SURE, "Head", "SpineMid")]
            assert np.abs(off[:, columns]).max() < 1e-6
            height = np.ptp(found.positions[:, columns, 1], axis=1)
            wanted = np.ptp(truth.positions[:, columns, 1], axis=1)
            np.testing.assert_allclose(height, wanted, atol=1e-6)


def test_openpose_files_of_frames_are_one_take_with_their_gaps(tmp_path: Path) -> None:
    truth = scripted()
    sure = np.ones((len(truth), len(BODY_25)))
    sure[10, BODY_25.index("lwrist")] = 0.0
    frames = openpose_frames([truth], sure)
    for k, frame in enumerate(frames):
        if k != 20:
            write_text(tmp_path / f"cam_{k:012}_keypoints.json", json.dumps(frame))
    write_text(tmp_path / f"other_{3:012}_keypoints.json", json.dumps(frames[3]))
    take = read_take(tmp_path / f"cam_{4:012}_keypoints.json")
    np.testing.assert_allclose(take.time, np.delete(truth.time, 20), atol=1e-9)
    left = KINECT_V2.index("WristLeft")
    assert take.state[10, left] == State.NOT_TRACKED
    assert (np.delete(take.state[:, left], 10) == State.TRACKED).all()
    claimed = [p for p in tmp_path.iterdir() if claims_take(p)]
    assert sorted(p.name[:8] for p in claimed) == ["cam_0000", "other_00"]


def test_openpose_in_two_dimensions_is_refused_with_what_to_do(tmp_path: Path) -> None:
    flat = {"pose_keypoints_2d": [1.0] * 75}
    for person in (flat, {**flat, "pose_keypoints_3d": []}):
        frames = [{"version": 1.3, "people": [person]}] * 9
        path = write_text(tmp_path / "a.json", json.dumps(frames))
        with pytest.raises(InputError, match=r"'pose_keypoints_3d'.*--3d"):
            read_take(path)
    bodies = [{"keypoints": [[1.0, 2.0]] * 17, "keypoint_scores": [1.0] * 17}]
    frames = [{"frame_id": k, "instances": bodies} for k in range(9)]
    path = write_text(tmp_path / "a.json", json.dumps(frames))
    with pytest.raises(InputError, match=r"frame 1 has 'keypoints' of shape \(17, 2\)"):
        read_take(path)


def test_visibility_tells_what_is_tracked_inferred_and_missing(tmp_path: Path) -> None:
    truth = scripted()
    sure = np.ones((len(truth), 33, 1))
    sure[:, BLAZEPOSE.index("relbow")] = 0.49
    sure[:, BLAZEPOSE.index("lknee")] = 0.0
    sure[:, BLAZEPOSE.index("lear")] = 0.3
    sure[:, BLAZEPOSE.index("rwrist")] = 0.5
    array = np.concatenate([y_down(landmarks(truth, BLAZEPOSE)), sure], axis=2)
    state = read_take(write_npy(tmp_path / "a.npy", array)).state[5]
    wanted = {"ElbowRight": 1, "KneeLeft": 0, "Head": 1, "WristRight": 2, "HipLeft": 2}
    found = {joint: state[KINECT_V2.index(joint)] for joint in wanted}
    assert found == wanted


def test_landmarks_about_the_hips_are_told_to_have_no_travel(tmp_path: Path) -> None:
    truth = scripted("walk")
    places = y_down(landmarks(truth, BLAZEPOSE))
    hips = [BLAZEPOSE.index("lhip"), BLAZEPOSE.index("rhip")]
    places -= places[:, hips].mean(axis=1, keepdims=True)
    recording = read_recording(write_npy(tmp_path / "a.npy", places))
    assert "the hips stay over one place" in recording.notes[1]
    (found,) = recording.takes
    assert (found.state[:, KINECT_V2.root] == State.TRACKED).all()
    root = KINECT_V2.root
    off = found.positions - found.positions[:, [root]]
    wanted = truth.positions - truth.positions[:, [root]]
    columns = [KINECT_V2.index(j) for j in SURE]
    np.testing.assert_allclose(off[:, columns], wanted[:, columns], atol=2e-3)
    assert np.ptp(found.positions[:, root], axis=0).max() < 1e-3
    places[..., 1] -= places[..., 1].max(axis=1, keepdims=True)  # feet on a floor
    lifted = read_recording(write_npy(tmp_path / "b.npy", places))
    assert lifted.notes == recording.notes
    assert "the hips stay" not in str(
        read_recording(WRITERS["openpose"][0](tmp_path, truth)).notes
    )


def test_times_are_those_of_the_file_or_thirty_frames_a_second_and_told(
    tmp_path: Path,
) -> None:
    truth = scripted()
    slow = Take(truth.time * 2.0, truth.positions, truth.state, KINECT_V2)
    text = freemocap_csv(slow, start="2024-01-01 12:00:00.250")
    recording = read_recording(write_text(tmp_path / "a.csv", text))
    np.testing.assert_allclose(recording.takes[0].time, slow.time, atol=1e-5)
    assert "assumed" not in str(recording.notes)
    recording = read_recording(write_text(tmp_path / "a.csv", freemocap_csv(slow)))
    np.testing.assert_allclose(recording.takes[0].time, truth.time, atol=1e-9)
    assert "30 frames a second assumed (--take-fps" in recording.notes[0]
    again = freemocap_csv(slow).replace("'a': 1, 'b': 2", "1").replace(",", ";")
    german = read_recording(write_text(tmp_path / "b.csv", again.replace(".", ",")))
    np.testing.assert_array_equal(
        german.takes[0].positions, recording.takes[0].positions
    )


def test_landmarks_of_a_picture_are_told_from_those_of_the_world(
    tmp_path: Path,
) -> None:
    places = y_down(landmarks(scripted(), BLAZEPOSE)) * [0.3, 0.5, 0.3]
    (note,) = (
        n
        for n in read_recording(write_npy(tmp_path / "a.npy", places)).notes
        if "no unit" in n
    )
    assert "pose_world_landmarks" in note


def test_the_frame_rate_of_a_take_without_time_stamps_can_be_given(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_npy(tmp_path / "a.npy", y_down(landmarks(scripted(), BLAZEPOSE)))
    assumed = read_recording(path)
    told = read_recording(path, fps=60.0)
    np.testing.assert_allclose(told.takes[0].time, 0.5 * assumed.takes[0].time)
    assert told.notes == assumed.notes[1:]
    clip = str(tmp_path / "clip.npz")
    asked = ["clean", str(path), "--no-physics", "--take-fps"]
    assert main([*asked, "60", "-o", clip]) == 0
    assert read_clip(clip).time[-1] == pytest.approx(told.takes[0].time[-1])
    page = str(tmp_path / "page.html")
    assert main(["report", clip, "--take", str(path), "-o", page]) == 0
    capsys.readouterr()
    for rate in ("0", "nan", "1e9"):
        assert main([*asked, rate, "-o", clip]) == 2
        assert "--take-fps" in capsys.readouterr().err
    text = freemocap_csv(scripted(), start="2024-01-01 12:00:00.250")
    stamped = write_text(tmp_path / "a.csv", text)
    with pytest.raises(InputError, match=r"a\.csv: has time stamps; give no"):
        read_take(stamped, fps=60.0)


@pytest.mark.parametrize("shape", [(9, 25, 3), (9, 33, 2), (9, 33), (0, 33, 3)])
def test_arrays_of_other_things_are_refused(
    tmp_path: Path, shape: tuple[int, ...]
) -> None:
    path = write_npy(tmp_path / "a.npy", np.ones(shape))
    with pytest.raises(InputError, match=r"a\.npy: (float64 of shape|has 0 frames)"):
        read_take(path)
    assert claims_take(path) == (shape == (0, 33, 3))


def test_arrays_never_run_what_is_in_them_nor_ask_for_much(tmp_path: Path) -> None:
    path = tmp_path / "a.npy"
    np.save(path, np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(InputError, match=r"a\.npy: cannot be read as npy"):
        read_take(path)
    data = io.BytesIO()
    header = {"descr": "<f8", "fortran_order": False, "shape": (10**12, 33, 3)}
    np.lib.format.write_array_header_1_0(data, header)  # type: ignore[arg-type]
    for damaged in (data.getvalue() + b"\0" * 99, b"\x82\xff\n" * 99):
        path.write_bytes(damaged)
        with pytest.raises(InputError, match=r"a\.npy: cannot be read as npy"):
            read_take(path)


def test_zipped_arrays_are_read(tmp_path: Path) -> None:
    truth = scripted()
    path = WRITERS["freemocap npy"][0](tmp_path, truth)
    zipped = tmp_path / "b.npy.gz"
    zipped.write_bytes(gzip.compress(path.read_bytes()))
    assert apart(read_take(zipped), truth, SURE) < 1e-6


def test_info_tells_takes_from_bare_markers(tmp_path: Path) -> None:
    contents = contents_of(trc(tmp_path / "a.trc", POSE2SIM, scripted()))
    assert (contents["kind"], contents["format"]) == ("take", "trc")
    assert contents["bodies"][0]["joints_never_seen"]
    mocap = standing(KINECT_V2, "plug_in_gait")
    assert contents_of(write_c3d(tmp_path / "a.c3d", mocap))["kind"] == "take"
    names = tuple(f"M{k}" for k in range(len(mocap.names)))
    bare = Mocap(names, mocap.positions, None, 1 / 30, "")
    assert contents_of(write_trc(tmp_path / "b.trc", bare))["kind"] == "mocap"
    with pytest.raises(
        InputError, match=r"b\.trc: no joint.*landmarks of MediaPipe.*found M0"
    ):
        read_take(tmp_path / "b.trc")
    # In a folder of takes they are mocap that lies beside them.
    claimed = [claims_take(tmp_path / name) for name in ("a.trc", "a.c3d", "b.trc")]
    assert claimed == [True, True, False]


@pytest.mark.usefixtures("here")
def test_batch_cleans_what_is_a_take_in_a_folder_of_freemocap(tmp_path: Path) -> None:
    folder, out = tmp_path / "session", tmp_path / "clips"
    folder.mkdir()
    truth = scripted(frames=30)
    write_npy(
        folder / "skeleton.npy",
        hands_and_face(1000.0 * z_up(landmarks(truth, BLAZEPOSE))),
    )
    write_npy(folder / "reprojection_error.npy", np.ones((30, 553)))
    trc(folder / "same.trc", POSE2SIM, truth)
    assert main(["batch", str(folder), "-o", str(out), "--to", "csv"]) == 0
    assert {p.name for p in out.glob("*.csv")} >= {"skeleton.csv", "same.csv"}
    assert not (out / "reprojection_error.csv").exists()
