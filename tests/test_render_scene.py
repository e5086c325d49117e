"""What stands in the picture: skin, props, the raw figure."""

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
from numpy.typing import NDArray

from kinefilter.characters import Clip, InputError
from kinefilter.characters.humanoid import from_mujoco
from kinefilter.pipeline.formats import write_clip, write_take_csv
from kinefilter.pipeline.look.cameras import axes_toward
from kinefilter.pipeline.look.drawing import (
    RELIABILITY,
    UNKNOWN,
    Drawing,
    corners_of,
    reliability_colors,
)
from kinefilter.pipeline.look.options import Look
from kinefilter.pipeline.look.video import Composition, RenderTask, props_around
from kinefilter.pipeline.look.video_model import ClipModel, figure_names
from kinefilter.pipeline.look.video_opengl import find_backend


def _model(clip: Clip, raw: NDArray[np.float64] | None = None) -> ClipModel:
    return ClipModel(
        Drawing(clip, raw),
        size=(64, 36),
        samples=0,
        toward=np.array([0.0, 0.0, 1.0]),
    )


def test_every_corner_of_a_prop_is_where_the_model_has_it(
    make_clip: MakeClip, furnish: Callable[[Clip], Clip]
) -> None:
    clip = furnish(make_clip(12))
    scene = _model(clip)
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
    scene = _model(clip)
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
    scene = _model(clip, raw)
    scene.pose(2)
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


def test_joints_are_blue_where_reliable_and_red_where_not(make_clip: MakeClip) -> None:
    clip = make_clip(1)
    rates = np.linspace(0.0, 1.0, len(clip.skeleton))
    clip = replace(clip, reliability=rates[None])
    scene = _model(clip, clip.positions)
    scene.pose(0)
    names = figure_names(clip.skeleton)[: len(rates)]
    colors = np.array([scene.model.geom(name).rgba for name in names])
    balance = colors[:, 2] - colors[:, 0]
    assert (np.diff(balance) > 0.0).all()
    assert balance[0] < -0.5
    assert balance[-1] > 0.4


def test_joints_of_unknown_reliability_are_gray() -> None:
    colors = reliability_colors(np.array([np.nan, -0.1, 0.5, 1.1])) * 255.0
    found = [f"#{bytes(c).hex()}" for c in np.round(colors).astype(np.uint8)]
    assert found == [UNKNOWN, *RELIABILITY]


def test_the_raw_take_stands_beside_the_character_and_in_the_picture(
    make_clip: MakeClip, tmp_path: Path
) -> None:
    clip = make_clip(20)
    still = np.zeros(clip.state.shape)
    clip = replace(
        clip, moved_by_correction=still, moved_by_physics=still, tilt=0.0, floor=0.0
    )
    write_clip(clip, tmp_path / "clip.npz")
    write_take_csv(clip, tmp_path / "take.csv")
    look = Look(compare=tmp_path / "take.csv", camera="front")
    composed = Composition(
        RenderTask(tmp_path / "clip.npz", tmp_path / "clip.mp4", look)
    )
    assert composed.drawing.raw is not None
    position, target = composed.camera.at(0)
    toward = (position - target) / np.linalg.norm(position - target)
    right, _ = axes_toward(toward)
    gap = (composed.drawing.clip.positions @ right).min(axis=1) - (
        composed.drawing.raw @ right
    ).max(axis=1)
    assert (gap > 0.2).all()
    over = replace(look, place="over")
    composed = Composition(
        RenderTask(tmp_path / "clip.npz", tmp_path / "clip.mp4", over)
    )
    assert composed.drawing.raw == pytest.approx(
        composed.drawing.clip.positions, abs=1e-6
    )


def test_a_scene_stands_where_the_clip_begins(make_clip: MakeClip) -> None:
    clip = make_clip(20)
    props = {prop.name: prop for prop in props_around(clip, (), "chair")}
    assert "chair" in props
    start = np.median(clip.positions[:15, clip.skeleton.root], axis=0)
    away = props["chair"].positions[0] - start
    assert np.linalg.norm(away[[0, 2]]) == pytest.approx(0.4, abs=1e-6)


_DRAWN_TWICE = """
import sys, numpy as np
from pathlib import Path
from kinefilter.pipeline.look.options import Look
from kinefilter.pipeline.look.video_model import ClipModel
from kinefilter.pipeline.look.video_model import OffscreenRenderer
from kinefilter.pipeline.look.video import Composition, RenderTask

def renderer(camera):
    look = Look(size="160x90", camera=camera)
    composed = Composition(RenderTask(Path(sys.argv[1]), Path("clip.mp4"), look))
    model = ClipModel(
        composed.drawing, size=(160, 90), samples=0, toward=np.array([0.0, 0.0, 1.0])
    )
    return OffscreenRenderer(model, composed.camera)

fast, whole, orbit = renderer("front"), renderer("front"), renderer("orbit")
assert fast._background is not None
whole._background = None  # floor and sky too are drawn in every picture
for k in range(0, 40, 8):
    assert np.array_equal(fast.render(k), whole.render(k)), k
there = [orbit.render(k) for k in range(0, 40, 8)]
back = [orbit.render(k) for k in reversed(range(0, 40, 8))][::-1]
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
