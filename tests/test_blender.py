"""Blender puts every joint, the skin and the props where kinefilter says."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from kinefilter.characters import KINECT_V1, KINECT_V2, Body, Clip, Skeleton
from kinefilter.characters.rotations import matrix_from_wxyz, rotate
from kinefilter.characters.skin import skin_of
from kinefilter.pipeline.formats import Export, write_clip, write_people
from kinefilter.pipeline.formats.export import in_strict_t, resampled, with_frame_rate
from kinefilter.pipeline.formats.rig import rig_of
from kinefilter.scenes.library import random_body

Array = NDArray[np.float64]
MakeClip = Callable[..., Clip]
MILLIMETER = 1e-3
HALF_A_DEGREE = 0.5

BLENDER = os.environ.get("KINEFILTER_BLENDER") or (
    sys.executable if importlib.util.find_spec("bpy") else ""
)
pytestmark = pytest.mark.skipif(
    not BLENDER,
    reason="no Blender: python3.11 -m venv ../blender && ../blender/bin/pip install "
    "bpy==5.0.1, then KINEFILTER_BLENDER=../blender/bin/python pytest",
)


def in_blender(points: Array) -> Array:
    """Return points (..., 3) in Blender's axes: z up, the person facing -y."""
    return np.stack([points[..., 0], -points[..., 2], points[..., 1]], axis=-1)


def somebody(skeleton: Skeleton, seed: int) -> Body:
    """Return somebody whose trunk, shoulders and hips are not square."""
    rng = np.random.default_rng(seed)
    body = random_body(skeleton, rng)
    directions = body.directions + 0.2 * rng.normal(size=body.directions.shape)
    directions[skeleton.root] = 0.0
    directions /= np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-9)
    return replace(body, directions=directions)


CHARACTER = "character.usdc"
VARIANTS = {
    "clip.usda": Export(),
    "clip.usdc": Export(),
    "clip.usdz": Export(),
    "over.usda": Export(character=Path(CHARACTER)),
    "strict.usdc": Export(rest="t"),
    "z_up_cm.usdc": Export(up="z", units="cm", fps=24.0),
    "clip.glb": Export(),
    "strict.glb": Export(rest="t"),
    "sparse.glb": Export(keys=0.5),
    "clip.fbx": Export(blender=BLENDER),
    "strict.fbx": Export(rest="t", fps=24.0, blender=BLENDER),
    "clip.bvh": Export(),
    "strict.bvh": Export(rest="t"),
    "z_up_cm.bvh": Export(up="z", units="cm", fps=24.0, rotation_order="zxy"),
    "xyz.bvh": Export(rotation_order="xyz"),
    "xzy.bvh": Export(rotation_order="xzy"),
    "yxz.bvh": Export(rotation_order="yxz"),
    "yzx.bvh": Export(rotation_order="yzx"),
}
Seen = dict[str, tuple[Clip, dict[str, Array]]]


@pytest.fixture(scope="module")
def seen(
    make_clip: MakeClip,
    furnish: Callable[[Clip], Clip],
    tmp_path_factory: pytest.TempPathFactory,
) -> Seen:
    """Return, for each variant, the clip as it was written and what Blender saw."""
    folder, clips = tmp_path_factory.mktemp("blender"), {}
    for seed, (name, export) in enumerate(VARIANTS.items()):
        skeleton = (KINECT_V2, KINECT_V1)[seed % 2]
        # Stamps as sensors give them: late, and now and then one is missing.
        steps = np.random.default_rng(seed).choice([1 / 30, 1 / 29.9, 2 / 30], 12)
        body, time = somebody(skeleton, seed), 3.0 + np.cumsum(steps)
        clip = furnish(make_clip(skeleton=skeleton, seed=seed, time=time, body=body))
        if export.character is not None:
            export = replace(export, character=folder / export.character)
        write_clip(clip, folder / name, export)
        export = with_frame_rate(export, Path(name).suffix, clip.time, name)
        clip = resampled(clip, export.fps) if export.fps else clip
        clip = in_strict_t(clip) if export.rest == "t" else clip
        frames = np.arange(len(clip), dtype=float)
        if not name.endswith((".bvh", ".fbx")):
            rate = 24.0 if name.endswith(".glb") else round(clip.fps)  # Blender's own
            frames = (clip.time - clip.time[0]) * rate
        np.save(folder / f"{name}.frames.npy", frames)
        clips[name] = clip
    pair = together(make_clip)
    write_people(pair, folder / "pair.glb", Export())
    np.save(folder / "pair.glb.frames.npy", 24.0 * (pair[1].time - pair[0].time[0]))
    script = Path(__file__).with_name("blender_import.py")
    subprocess.run([BLENDER, str(script), str(folder)], check=True, timeout=300)
    return {
        name: (clip, dict(np.load(folder / f"{name}.npz")))
        for name, clip in {**clips, "pair.glb": pair[1]}.items()
    }


def together(make_clip: MakeClip) -> list[Clip]:
    """Return clips of two people, the second of whom comes half a second later."""
    first = make_clip(40, skeleton=KINECT_V2, seed=8)
    second = make_clip(30, skeleton=KINECT_V2, seed=9, body=somebody(KINECT_V2, 9))
    return [first, replace(second, time=first.time[0] + 0.5 + second.time)]


def test_two_people_in_one_file_are_two_armatures(
    make_clip: MakeClip, seen: Seen
) -> None:
    first, second = together(make_clip)
    _, blender = seen["pair.glb"]
    joints = second.skeleton.joints
    plain = [name.removesuffix(".001") for name in blender["names"].tolist()]
    names = np.reshape(plain, (2, -1)).tolist()  # Blender gives no name twice
    one, other = np.split(blender["heads"], 2, axis=1)
    away = other[:, [names[1].index(j) for j in joints]] - in_blender(second.positions)
    assert np.linalg.norm(away, axis=-1).max() < MILLIMETER
    # Half a second is a frame of the first.
    of_first = in_blender(first.positions[15 : 15 + len(second)])
    away = one[: len(of_first), [names[0].index(j) for j in joints]] - of_first
    assert np.linalg.norm(away, axis=-1).max() < MILLIMETER


every_variant = pytest.mark.parametrize("name", VARIANTS)
every_usd = pytest.mark.parametrize(
    "name", [name for name in VARIANTS if not name.endswith(".bvh")]
)


@every_variant
def test_every_joint_is_where_the_clip_has_it_in_every_frame(
    seen: Seen, name: str
) -> None:
    clip, blender = seen[name]
    names = blender["names"].tolist()
    heads = blender["heads"][:, [names.index(j) for j in clip.skeleton.joints]]
    away = np.linalg.norm(heads - in_blender(clip.positions), axis=-1)
    assert away.shape == (len(clip), len(clip.skeleton))
    assert away.max() < MILLIMETER


@every_variant
def test_every_bone_turns_as_its_segment_does(seen: Seen, name: str) -> None:
    clip, blender = seen[name]
    rig, names = rig_of(clip.body), blender["names"].tolist()
    columns = [names.index(node) for node in rig.names]
    found = blender["turns"][:, columns] @ np.swapaxes(blender["axes"][columns], 1, 2)
    turned = clip.rotations[:, rig.segments]
    wanted = np.concatenate([turned[..., :1], in_blender(turned[..., 1:])], axis=-1)
    assert degrees_apart(found, matrix_from_wxyz(wanted)).max() < HALF_A_DEGREE


def degrees_apart(some: Array, others: Array) -> Array:
    """Return the angles between rotations (..., 3, 3) [degrees], shape (...)."""
    away = np.linalg.norm(some - others, axis=(-2, -1)) / np.sqrt(8.0)
    return np.asarray(np.degrees(2.0 * np.arcsin(np.minimum(away, 1.0))))


@every_usd
def test_the_skin_is_bound_to_the_armature_and_moves_with_it(
    seen: Seen, name: str
) -> None:
    clip, blender = seen[name]
    skin = skin_of(clip.body)
    assert blender["modifiers"].tolist() == ["ARMATURE"]
    assert blender["groups"] == len(set(skin.segments[skin.weights > 0].tolist()))
    assert blender["moved"].shape == (len(clip), len(skin.points), 3)
    rest = in_blender(skin.points)
    np.testing.assert_allclose(blender["rest"][0], rest, atol=1e-5)
    moved = in_blender(posed(clip))
    assert np.linalg.norm(blender["moved"] - moved, axis=-1).max() < MILLIMETER
    assert np.ptp(blender["moved"], axis=0).max() > 0.1


def posed(clip: Clip) -> Array:
    """Return the skin moved by linear blend skinning, shape (T, P, 3)."""
    skin, body, parents = skin_of(clip.body), clip.body, clip.skeleton.parents
    starts = np.array([j if p < 0 else p for j, p in enumerate(parents)])
    moved = np.zeros((len(clip), len(skin.points), 3))
    for segments, weights in zip(skin.segments.T, skin.weights.T, strict=True):
        arms = skin.points - body.rest_positions[starts[segments]]
        turned = rotate(clip.rotations[:, segments], arms)
        moved += weights[:, None] * (clip.positions[:, starts[segments]] + turned)
    return moved


@every_usd
def test_props_are_where_the_scene_has_them(seen: Seen, name: str) -> None:
    clip, blender = seen[name]
    names = blender["props"].tolist()
    assert len(names) == len(clip.props) == 5
    for prop in clip.props:
        known = prop.name.replace(" ", "_") if ".usd" in name else prop.name
        path = blender["places"][:, names.index(known)]
        away = path - in_blender(np.broadcast_to(prop.positions, path.shape))
        assert np.linalg.norm(away, axis=-1).max() < MILLIMETER
