"""What ``kinefilter render`` shows: motions, frames, cameras, the raw take."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import MakeClip
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from kinefilter import CleanConfig, Export, clean, read_take, scenes
from kinefilter.characters import KINECT_V2, Clip, InputError, Take, standard_body
from kinefilter.characters.motion import nearest_frames
from kinefilter.pipeline.formats import write_clip, write_take_csv
from kinefilter.pipeline.look.cameras import CAMERAS, axes_toward, camera_path
from kinefilter.pipeline.look.comparison import compare, raw_positions
from kinefilter.pipeline.look.drawing import read_finite_clip
from kinefilter.pipeline.look.options import Look
from kinefilter.pipeline.look.video import PART, output_paths, shown_frames, stretches
from kinefilter.scenes.library import perform

ASPECT = 16 / 9


def _take(clip: Clip, positions: NDArray[np.float64]) -> Take:
    return Take(clip.time, positions, clip.state, clip.skeleton)


@pytest.mark.parametrize(
    ("look", "times", "rate"),
    [
        (Look(), np.arange(31) / 30, 30),
        (Look(fps=10), np.arange(11) / 10, 10),
        (Look(begin=0.5, end=0.6), np.array([15, 16, 17, 18]) / 30, 30),
        (Look(fps=10, begin=0.25), 0.3 + np.arange(8) / 10, 10),
    ],
)
def test_the_frames_asked_for_are_shown(
    look: Look, times: np.ndarray, rate: float, make_clip: MakeClip
) -> None:
    clip = make_clip(time=5.0 + np.arange(31) / 30)
    shown, found = shown_frames(clip, look)
    assert shown.time == pytest.approx(5.0 + times)
    assert found == pytest.approx(rate)


@pytest.mark.parametrize("camera", CAMERAS)
def test_every_camera_has_everything_in_its_picture(
    camera: str, make_clip: MakeClip
) -> None:
    clip = make_clip(90, seed=3)
    path = camera_path(camera, clip, clip.positions, aspect=ASPECT, rate=30.0)
    half = np.tan(np.radians(path.fov / 2))
    edges = []
    for k, joints in enumerate(clip.positions):
        position, target = path.at(k)
        toward = (position - target) / np.linalg.norm(position - target)
        right, up = axes_toward(toward)
        depth = (position - joints) @ toward
        assert depth.min() > 0.0
        across = (joints - position) @ right / (depth * half * ASPECT)
        high = (joints - position) @ up / (depth * half)
        edges.append(np.abs([across, high]).max(axis=1))
    assert np.max(edges) < 0.95
    assert np.max(edges) > 0.6  # and not from far away
    assert path.stays == (camera not in ("orbit", "follow"))


def test_the_front_camera_looks_the_character_in_the_face(make_clip: MakeClip) -> None:
    clip = make_clip(30)
    level = np.zeros((30, 20, 4))
    level[..., 0], level[..., 2] = np.cos(0.5), np.sin(0.5)  # turned by 1 rad
    clip = replace(clip, rotations=level)
    path = camera_path("front", clip, clip.positions, aspect=ASPECT, rate=30.0)
    toward = (path.positions - path.targets)[0]
    assert np.arctan2(toward[0], toward[2]) == pytest.approx(1.0)


def test_an_orbit_ends_where_it_began(make_clip: MakeClip) -> None:
    clip = make_clip(90)
    path = camera_path("orbit", clip, clip.positions, aspect=ASPECT, rate=30.0)
    steps = np.linalg.norm(np.diff(path.positions, axis=0), axis=1)
    assert steps == pytest.approx(steps[0])
    closing = np.linalg.norm(path.positions[0] - path.positions[-1])
    assert closing == pytest.approx(steps[0])
    assert (path.positions[:, 1] > path.targets[:, 1]).all()


@pytest.mark.parametrize("camera", [c for c in CAMERAS if c not in ("orbit", "follow")])
def test_a_camera_that_stays_leaves_as_much_room_on_either_side(
    camera: str, make_clip: MakeClip
) -> None:
    clip = make_clip(90, seed=3)
    path = camera_path(camera, clip, clip.positions, aspect=ASPECT, rate=30.0)
    position, target = path.at(0)
    toward = (position - target) / np.linalg.norm(position - target)
    away = clip.positions.reshape(-1, 3) - position
    for axis in axes_toward(toward):
        edge = away @ axis / -(away @ toward)
        assert edge.max() == pytest.approx(-edge.min(), rel=0.01)


def test_a_camera_file_says_where_the_camera_is(
    make_clip: MakeClip, tmp_path: Path
) -> None:
    file = tmp_path / "camera.toml"
    file.write_text("position = [1, 2.5, 3]\ntarget = [0, 1, 0]\nfov = 50\n")
    clip = make_clip(3)
    path = camera_path(str(file), clip, clip.positions, aspect=1.0, rate=30.0)
    assert path.positions.tolist() == [[1.0, 2.5, 3.0]]
    assert path.targets.tolist() == [[0.0, 1.0, 0.0]]
    assert path.fov == 50.0


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("position = [1, 2]\ntarget = [0, 1, 0]", "position is"),
        ("position = [1, 2, 3]", "target is None"),
        ("position = [1, 2, nan]\ntarget = [0, 1, 0]", "position is"),
        ("position = [1, 2, 3]\ntarget = [0, 1, 0]\nfov = 0", "fov is 0"),
        ("position = [1, 2, 3]\ntarget = [0, 1, 0]\nzoom = 2", "unknown zoom"),
        ("position = [0, 3, 0]\ntarget = [0, 1, 0]", "straight up or down"),
        ("position = [1, 2, %s]\ntarget = [0, 1, 0]" % ("9" * 400), "position is"),
        ("position = ", "not TOML"),
        (f"position = {'[' * 5000}", "not TOML"),
        (f"position = {'9' * 5000}", "not TOML"),
        ("# " + "x" * 70_000, "larger than .* give another"),
    ],
)
def test_a_wrong_camera_file_is_refused(
    text: str, words: str, make_clip: MakeClip, tmp_path: Path
) -> None:
    file = tmp_path / "camera.toml"
    file.write_text(text)
    clip = make_clip(3)
    with pytest.raises(InputError, match=words):
        camera_path(str(file), clip, clip.positions, aspect=1.0, rate=30.0)


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 30))
def test_the_nearest_frame_is_that_of_least_distance_in_time(
    seed: int, count: int
) -> None:
    rng = np.random.default_rng(seed)
    stamps, times = np.sort(rng.random(count)), rng.uniform(-0.5, 1.5, 40)
    expected = np.abs(times[:, None] - stamps).argmin(axis=1)
    np.testing.assert_array_equal(nearest_frames(stamps, times), expected)


@pytest.mark.parametrize("keeps_frame", [False, True])
@pytest.mark.parametrize("tilt", [0.0, -0.15, 0.2])
def test_the_raw_take_is_put_where_cleaning_put_it(
    tilt: float, keeps_frame: bool, make_clip: MakeClip, tmp_path: Path
) -> None:
    clip = make_clip(40)
    moved_by = np.zeros(clip.state.shape)
    moved_by[10:20, 3] = np.sqrt(3.0)
    clip = replace(
        clip, moved_by_correction=moved_by, moved_by_physics=np.zeros_like(moved_by)
    )
    if keeps_frame:
        clip = replace(clip, tilt=tilt, floor=-0.8)
    y, z = clip.positions[..., 1] - 0.8, clip.positions[..., 2]
    raw = clip.positions.copy()
    raw[..., 1] = np.cos(tilt) * y + np.sin(tilt) * z
    raw[..., 2] = np.cos(tilt) * z - np.sin(tilt) * y
    raw[10:20, 3] += 1.0  # what cleaning corrected
    write_take_csv(_take(clip, raw), tmp_path / "take.csv")
    found = raw_positions(tmp_path / "take.csv", clip, clip.time)
    expected = clip.positions.copy()
    moved = found[10:20, 3]
    expected[10:20, 3] = moved
    assert found == pytest.approx(expected, abs=1e-4)
    assert np.linalg.norm(moved - clip.positions[10:20, 3], axis=1).min() > 1.0


@pytest.mark.parametrize("suffix", [".csv", ".bvh"])
def test_csv_and_bvh_show_the_same_joints_as_the_whole_clip(
    suffix: str, make_clip: MakeClip, tmp_path: Path
) -> None:
    body = standard_body(KINECT_V2)
    act = perform("walk", body, seed=0, fps=30.0)
    clip = make_clip(len(act), KINECT_V2, body=body)
    clip = replace(clip, root=act.positions[:, body.skeleton.root])
    clip = replace(clip, rotations=act.rotations)
    write_clip(clip, tmp_path / f"clip{suffix}")
    found = read_finite_clip(tmp_path / f"clip{suffix}")
    assert found.skeleton == clip.skeleton
    away = np.linalg.norm(found.positions - clip.positions, axis=-1)
    assert away.mean() < 0.02


def test_a_raw_take_is_no_clip(make_clip: MakeClip, tmp_path: Path) -> None:
    clip = make_clip(20)
    positions = clip.positions.copy()
    positions[4, 7] = np.nan
    write_take_csv(_take(clip, positions), tmp_path / "take.csv")
    with pytest.raises(InputError, match="frame 5 has no HandLeft"):
        read_finite_clip(tmp_path / "take.csv")


def test_usd_without_a_clip_is_refused(tmp_path: Path) -> None:
    (tmp_path / "clip.usda").write_text("#usda 1.0")
    with pytest.raises(InputError, match=r"clip\.usda: has no animated skeleton"):
        read_finite_clip(tmp_path / "clip.usda")


def test_a_take_of_another_clip_is_not_drawn_beside_it(
    make_clip: MakeClip, tmp_path: Path
) -> None:
    clip = make_clip(20)
    still = np.zeros(clip.state.shape)
    clip = replace(
        clip, moved_by_correction=still, moved_by_physics=still, tilt=0.0, floor=0.0
    )
    write_take_csv(make_clip(20, seed=1), tmp_path / "take.csv")
    with pytest.raises(InputError, match=r"--compare .*take\.csv.* not where the clip"):
        raw_positions(tmp_path / "take.csv", clip, clip.time)


@pytest.mark.parametrize("root", ["travel", "none"])
@pytest.mark.parametrize("suffix", [".bvh", ".usdc"])
def test_a_part_without_time_stamps_is_drawn_beside_its_part_of_the_take(
    suffix: str, root: Any, tmp_path: Path
) -> None:
    take, path = read_take(scenes.SAMPLE), tmp_path / "take.csv"
    take = replace(take, time=take.time + 1000.0)
    write_take_csv(take, path)
    whole = clean(take, CleanConfig(method="none", physics=False)).clip
    part = Export(begin=3.0, end=5.0, root=root)
    shown = []
    for kind in (".npz", suffix):
        write_clip(whole, tmp_path / f"clip{kind}", part)
        clip = read_finite_clip(tmp_path / f"clip{kind}")
        shown.append(raw_positions(path, clip, clip.time))
    np.testing.assert_allclose(shown[1], shown[0], atol=0.05)


def test_bvh_of_a_take_with_dropped_frames_has_its_time_stamps(tmp_path: Path) -> None:
    take, path = read_take(scenes.SAMPLE), tmp_path / "take.csv"
    take = take.at(np.delete(np.arange(len(take)), np.s_[20:60:2]))
    write_take_csv(take, path)
    whole = clean(take, CleanConfig(method="none", physics=False)).clip
    write_clip(whole, tmp_path / "clip.bvh")
    clip = read_finite_clip(tmp_path / "clip.bvh")
    assert np.abs(clip.time - take.time).max() > 0.2  # but for this, no trouble
    found = compare(clip, read_take(path))
    np.testing.assert_allclose(found.clip.time, take.time, atol=1e-4)
    drawn = raw_positions(path, clip, clip.time)
    np.testing.assert_allclose(drawn, found.raw, atol=0.01)


@pytest.mark.parametrize(
    ("out", "expected"),
    [
        ("{clip}.mp4", ["walk.mp4", "run.mp4"]),
        ("all.gif", ["all.walk.gif", "all.run.gif"]),
        ("f/%d.png", ["f/walk/%d.png", "f/run/%d.png"]),
        ("{clip}-%03d.png", ["walk-%03d.png", "run-%03d.png"]),
    ],
)
def test_several_clips_get_a_name_each(
    out: str, expected: list[str], tmp_path: Path
) -> None:
    clips = [Path("a/walk.npz"), Path("b/run.csv.gz")]
    assert output_paths(clips, tmp_path / out) == [tmp_path / name for name in expected]
    odd = [Path("5%d.npz")]  # in names of pictures, which are a pattern, %% means %
    assert output_paths(odd, tmp_path / "{clip}.gif") == [tmp_path / "5%d.gif"]
    pictures = tmp_path / "{clip}" / "{clip}-%d.png"
    assert output_paths(odd, pictures) == [tmp_path / "5%d" / "5%%d-%d.png"]
    with pytest.raises(InputError, match="one file"):
        output_paths([Path("a/walk.npz"), Path("a/walk.glb")], tmp_path / out)
    clips = [Path("a/walk.npz"), Path("b/walk.npz")]
    paths = [
        path.replace("walk", "a-walk").replace("run", "b-walk") for path in expected
    ]
    assert output_paths(clips, tmp_path / out) == [tmp_path / path for path in paths]


def test_parts_are_the_same_however_they_are_shared() -> None:
    for share in (1, 100, 700, 5000, 10**6):
        groups = stretches(1234, share)
        assert [k for group in groups for k in group] == list(range(1234))
        assert all(group.start % PART == 0 for group in groups)
