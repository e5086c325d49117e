"""What ``kinefilter render`` shows: frames, cameras, the raw take, the scene."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from conftest import MakeClip

from kinefilter.characters import KINECT_V2, Clip, InputError, standard_body
from kinefilter.characters.humanoid import from_mujoco
from kinefilter.pipeline.formats import write_clip, write_take_csv
from kinefilter.pipeline.render import Look
from kinefilter.pipeline.render.backend import find_backend
from kinefilter.pipeline.render.cameras import CAMERAS, axes_toward, camera_path
from kinefilter.pipeline.render.motions import read_motion, shown_frames
from kinefilter.pipeline.render.naming import outputs
from kinefilter.pipeline.render.parts import stretches
from kinefilter.pipeline.render.raw_figure import RawFigure, figure_names
from kinefilter.pipeline.render.raw_take import raw_positions
from kinefilter.pipeline.render.scene import Scene
from kinefilter.pipeline.render.shot import Shot, Staged
from kinefilter.pipeline.render.surroundings import corners_of, props_around
from kinefilter.scenes import perform

ASPECT = 16 / 9


@pytest.mark.parametrize(
    ("look", "times", "rate"),
    [
        (Look(), np.arange(31) / 30, 30),
        (Look(fps=10), np.arange(11) / 10, 10),
        (Look(every=4), np.arange(8) * 4 / 30, 7.5),
        (Look(start=0.5, to=0.6), np.array([15, 16, 17, 18]) / 30, 30),
        (Look(fps=10, start=0.25, every=2), np.array([0.3, 0.5, 0.7, 0.9]), 5),
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
        ("position = ", "cannot be read as TOML"),
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


@pytest.mark.parametrize("keeps_distances", [False, True])
@pytest.mark.parametrize("tilt", [0.0, -0.15, 0.2])
def test_the_raw_take_is_put_where_cleaning_put_it(
    tilt: float, keeps_distances: bool, make_clip: MakeClip, tmp_path: Path
) -> None:
    clip = make_clip(40)
    moved_by = np.full(clip.state.shape, np.nan)
    if keeps_distances:
        moved_by[:] = 0.0
        moved_by[10:20, 3] = np.sqrt(3.0)
    clip = replace(
        clip, moved_by_correction=moved_by, moved_by_physics=np.zeros_like(moved_by)
    )
    y, z = clip.positions[..., 1] - 0.8, clip.positions[..., 2]
    raw = clip.positions.copy()
    raw[..., 1] = np.cos(tilt) * y + np.sin(tilt) * z
    raw[..., 2] = np.cos(tilt) * z - np.sin(tilt) * y
    raw[10:20, 3] += 1.0  # what cleaning corrected
    write_take_csv(replace(clip, positions=raw), tmp_path / "take.csv")
    found = raw_positions(tmp_path / "take.csv", clip, clip.time)
    expected = clip.positions.copy()
    moved = found[10:20, 3]
    expected[10:20, 3] = moved
    assert found == pytest.approx(expected, abs=1e-6)
    assert np.linalg.norm(moved - clip.positions[10:20, 3], axis=1).min() > 1.0


@pytest.mark.parametrize("suffix", [".csv", ".bvh"])
def test_csv_and_bvh_show_the_same_joints_as_the_whole_clip(
    suffix: str, make_clip: MakeClip, tmp_path: Path
) -> None:
    body = standard_body(KINECT_V2)
    act = perform("walk", body, seed=0, fps=30.0)
    clip = make_clip(len(act), KINECT_V2, body=body)
    clip = replace(clip, positions=act.positions, rotations=act.rotations)
    write_clip(clip, tmp_path / f"clip{suffix}")
    found = read_motion(tmp_path / f"clip{suffix}")
    assert found.skeleton == clip.skeleton
    away = np.linalg.norm(found.positions - clip.positions, axis=-1)
    assert away.mean() < 0.02


def test_a_raw_take_is_no_clip(make_clip: MakeClip, tmp_path: Path) -> None:
    clip = make_clip(20)
    positions = clip.positions.copy()
    positions[4, 7] = np.nan
    write_take_csv(replace(clip, positions=positions), tmp_path / "take.csv")
    with pytest.raises(InputError, match="frame 5 has no HandLeft"):
        read_motion(tmp_path / "take.csv")


def test_usd_is_refused_with_what_is_read(tmp_path: Path) -> None:
    (tmp_path / "clip.usda").write_text("#usda 1.0")
    with pytest.raises(InputError, match=r"render reads \.npz"):
        read_motion(tmp_path / "clip.usda")


def _scene(clip: Clip, *, figure: bool = False) -> Scene:
    return Scene(
        clip,
        clip.props,
        size=(64, 36),
        samples=0,
        facing=np.array([0.0, 0.0, 1.0]),
        reach=2.0,
        figure=figure_names(clip.skeleton) if figure else (),
    )


def test_every_corner_of_a_prop_is_where_the_model_has_it(
    make_clip: MakeClip, furnish: Callable[[Clip], Clip]
) -> None:
    clip = furnish(make_clip(12))
    scene = _scene(clip)
    boxes = 0
    for frame in (0, 11):
        scene.pose(frame)
        for prop in clip.props:
            corners = corners_of(prop, len(clip))[frame].reshape(-1, 8, 3)
            body = scene.model.body(f"prop:{prop.name}").id
            (geoms,) = np.nonzero(scene.model.geom_bodyid == body)
            for geom, expected in zip(geoms, corners, strict=True):
                middle = from_mujoco(scene.data.geom_xpos[geom])
                if prop.name == "the mesh":
                    continue  # MuJoCo moves a mesh's origin to its center of mass
                assert middle == pytest.approx(expected.mean(axis=0))
                size = scene.model.geom_size[geom]
                if prop.name == "the box":
                    turn = scene.data.geom_xmat[geom].reshape(3, 3)
                    signs = np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, 8).T
                    found = middle + from_mujoco((signs * size) @ turn.T)
                    assert np.sort(found, axis=0) == pytest.approx(
                        np.sort(expected, axis=0)
                    )
                    boxes += 1
                elif prop.name != "the ellipsoid":
                    assert size[:2] == pytest.approx([0.1, 0.2])
    assert boxes == 4


def test_the_skin_is_posed_by_the_clips_rotations(make_clip: MakeClip) -> None:
    clip = make_clip(6)
    scene = _scene(clip)
    view = mujoco.MjvScene(scene.model, maxgeom=100)
    scene.pose(5)
    mujoco.mjv_updateScene(
        scene.model,
        scene.data,
        mujoco.MjvOption(),
        None,
        mujoco.MjvCamera(),
        mujoco.mjtCatBit.mjCAT_ALL,
        view,
    )
    skin = from_mujoco(np.asarray(view.skinvert, dtype=float).reshape(-1, 3))
    for j, joint in enumerate(clip.positions[5]):
        away = np.linalg.norm(skin - joint, axis=1).min()
        assert away < 0.2, clip.skeleton.joints[j]
    assert np.abs(skin.mean(axis=0) - clip.positions[5].mean(axis=0)).max() < 0.2


def test_the_figures_bones_end_at_its_joints(make_clip: MakeClip) -> None:
    clip = make_clip(4)
    raw = clip.positions.copy()
    raw[2, 5] = np.nan
    scene = _scene(clip, figure=True)
    figure = RawFigure(scene.model, raw, clip)
    scene.pose(2)
    figure.pose(scene.data, 2)
    model, data, skeleton = scene.model, scene.data, clip.skeleton
    seen = 0
    for j, p in zip(skeleton.segments, skeleton.segment_parents, strict=True):
        bone = model.geom(f"bone:{skeleton.joints[j]}").id
        if 5 in (j, p):
            assert model.geom_rgba[bone, 3] == 0.0
            continue
        half = model.geom_size[bone, 1] * data.geom_xmat[bone].reshape(3, 3)[:, 2]
        ends = data.geom_xpos[bone] + half, data.geom_xpos[bone] - half
        assert from_mujoco(ends[0]) == pytest.approx(raw[2, j])
        assert from_mujoco(ends[1]) == pytest.approx(raw[2, p])
        turn = data.geom_xmat[bone].reshape(3, 3)
        assert turn @ turn.T == pytest.approx(np.eye(3), abs=1e-9)
        seen += 1
    assert seen > 10
    assert model.geom_rgba[model.geom(f"joint:{skeleton.joints[5]}").id, 3] == 0.0


def test_joints_are_green_where_reliable_and_red_where_not(make_clip: MakeClip) -> None:
    clip = make_clip(1)
    rates = np.linspace(0.0, 1.0, len(clip.skeleton))
    clip = replace(clip, reliability=rates[None])
    scene = _scene(clip, figure=True)
    RawFigure(scene.model, clip.positions, clip).pose(scene.data, 0)
    names = figure_names(clip.skeleton)[: len(rates)]
    colors = np.array([scene.model.geom(name).rgba for name in names])
    balance = colors[:, 1] - colors[:, 0]
    assert (np.diff(balance) > 0.0).all()
    assert balance[0] < -0.5
    assert balance[-1] > 0.3


def test_the_raw_take_stands_beside_the_character_and_in_the_picture(
    make_clip: MakeClip, tmp_path: Path
) -> None:
    clip = make_clip(20)
    still = np.zeros(clip.state.shape)
    clip = replace(clip, moved_by_correction=still, moved_by_physics=still)
    write_clip(clip, tmp_path / "clip.npz")
    write_take_csv(clip, tmp_path / "take.csv")
    look = Look(compare=tmp_path / "take.csv", camera="front")
    staged = Staged(Shot(tmp_path / "clip.npz", tmp_path / "clip.mp4", look))
    assert staged.raw is not None
    position, target = staged.camera.at(0)
    toward = (position - target) / np.linalg.norm(position - target)
    right, _ = axes_toward(toward)
    gap = (staged.clip.positions @ right).min(axis=1) - (staged.raw @ right).max(axis=1)
    assert (gap > 0.2).all()
    over = replace(look, place="over")
    staged = Staged(Shot(tmp_path / "clip.npz", tmp_path / "clip.mp4", over))
    assert staged.raw == pytest.approx(staged.clip.positions, abs=1e-6)


def test_a_take_of_another_clip_is_not_drawn_beside_it(
    make_clip: MakeClip, tmp_path: Path
) -> None:
    clip = make_clip(20)
    still = np.zeros(clip.state.shape)
    clip = replace(clip, moved_by_correction=still, moved_by_physics=still)
    write_take_csv(make_clip(20, seed=1), tmp_path / "take.csv")
    with pytest.raises(InputError, match=r"--compare .*take\.csv.* cm or more from"):
        raw_positions(tmp_path / "take.csv", clip, clip.time)


def test_a_scene_stands_where_the_clip_begins(make_clip: MakeClip) -> None:
    clip = make_clip(20)
    props = {prop.name: prop for prop in props_around(clip, clip, "chair")}
    assert "chair" in props
    start = np.median(clip.positions[:15, clip.skeleton.root], axis=0)
    away = props["chair"].positions[0] - start
    assert np.linalg.norm(away[[0, 2]]) == pytest.approx(0.4, abs=1e-6)


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
    assert outputs(clips, tmp_path / out) == [tmp_path / name for name in expected]
    with pytest.raises(InputError, match="one file"):
        outputs([Path("a/walk.npz"), Path("b/walk.npz")], tmp_path / out)


def test_parts_are_the_same_however_they_are_shared() -> None:
    whole = [part for group in stretches(1234, 10**6) for part in group]
    for share in (1, 100, 700, 5000):
        groups = stretches(1234, share)
        assert [part for group in groups for part in group] == whole
    assert [k for part in whole for k in part] == list(range(1234))


_DRAWN_TWICE = """
import sys, numpy as np
from pathlib import Path
from kinefilter.pipeline.render.look import Look
from kinefilter.pipeline.render.painter import Painter
from kinefilter.pipeline.render.scene import Scene
from kinefilter.pipeline.render.shot import Shot, Staged

def painter(camera, **how):
    look = Look(size="160x90", camera=camera)
    staged = Staged(Shot(Path(sys.argv[1]), Path("clip.mp4"), look))
    scene = Scene(
        staged.clip, staged.props, size=(160, 90), samples=0,
        facing=np.array([0.0, 0.0, 1.0]), reach=2.0,
    )
    return Painter(scene, staged.camera, **how)

fast, whole, orbit = painter("front"), painter("front", whole=True), painter("orbit")
for k in range(0, 40, 8):
    assert np.array_equal(fast.paint(k), whole.paint(k)), k
there = [orbit.paint(k) for k in range(0, 40, 8)]
back = [orbit.paint(k) for k in reversed(range(0, 40, 8))][::-1]
assert np.array_equal(there, back)
assert not np.array_equal(there[0], there[1])
for each in (fast, whole, orbit):
    each.close()
print("the same")
"""


def test_a_picture_depends_on_no_other_and_not_on_how_the_floor_is_drawn(
    make_clip: MakeClip, furnish: Callable[[Clip], Clip], tmp_path: Path
) -> None:
    try:
        backend = find_backend()
    except InputError as error:
        pytest.skip(str(error))
    write_clip(furnish(make_clip(40)), tmp_path / "clip.npz")
    done = subprocess.run(
        [sys.executable, "-c", _DRAWN_TWICE, tmp_path / "clip.npz"],
        env={**os.environ, **backend.environment},
        capture_output=True,
        text=True,
    )
    assert "the same" in done.stdout, done.stderr
