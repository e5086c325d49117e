"""Blender and three.js put other people's rigs where the retargeted motion has them."""

from __future__ import annotations

import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rig_motions import ARM, LEG, SIDES, performed

from kinefilter.characters import Clip, Skeleton
from kinefilter.characters.rotations import matrix_from_wxyz, rotate
from kinefilter.pipeline.formats import Export, write_clip
from kinefilter.retarget.retargeting import retarget
from kinefilter.retarget.rig_map import RIGS, WORDS, load_rig_map
from kinefilter.retarget.target_rig import built_rig

Array = NDArray[np.float64]
MILLIMETER = 1e-3
HALF_A_DEGREE = 0.5
IN_FBX = ("mixamo", "unreal", "lafan1", "rigify", "vrm")
"""Rigs written as FBX: every other kind of axes. Blender has to start for each."""
FILES = [f"{n}.{s}" for n in RIGS for s in ("bvh", "usdc", "glb")]
FILES += [f"{name}.fbx" for name in IN_FBX]
BLENDERS_RATE = 24.0  # frames a second, whatever it imports
FROM_BLENDER = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # z up becomes y up

BLENDER = os.environ.get("KINEFILTER_BLENDER") or (
    sys.executable if importlib.util.find_spec("bpy") else ""
)
THREE = os.environ.get("KINEFILTER_THREE", "")


every_rig = pytest.mark.parametrize("name", RIGS)


@pytest.fixture(scope="module")
def clip() -> Clip:
    """Return a walk of twelve frames."""
    return performed("walk").at(slice(40, 52))


def motion(clip: Clip, name: str) -> tuple[list[str], Array]:
    """Return names and positions of the joints of a rig."""
    rig = built_rig(load_rig_map(name), clip.body)
    return list(rig.rest.names), retarget(clip, rig).positions


in_three = pytest.mark.skipif(
    not THREE or shutil.which("node") is None,
    reason="no three.js: see test_three.py for how to install it",
)


@in_three
@every_rig
def test_threes_joints_are_where_the_motion_has_them(
    clip: Clip, tmp_path: Path, name: str
) -> None:
    path = tmp_path / "clip.bvh"
    write_clip(clip, path, Export(rig=name))
    # three.js moves no joint that has a colon in its name.
    path.write_text(path.read_text().replace("mixamorig:", ""))
    three = in_node("three_bvh.mjs", path, clip)
    names, wanted = motion(clip, name)
    columns = [three["names"].index(joint.rpartition(":")[2]) for joint in names]
    found = np.array(three["frames"])[:, columns]
    assert np.linalg.norm(found - wanted, axis=-1).max() < MILLIMETER


def in_node(script: str, path: Path, clip: Clip) -> dict[str, Any]:
    """Return what three.js makes of a file."""
    node = ["node", str(Path(__file__).with_name(script)), THREE]
    command = [*node, str(path), str(len(clip))]
    ran = subprocess.run(command, check=True, capture_output=True, timeout=60)
    found: dict[str, Any] = json.loads(ran.stdout)
    return found


@pytest.fixture(scope="module")
def folder(clip: Clip, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder of files on every rig, and which frames to look at."""
    if not BLENDER:
        pytest.skip("no Blender: see test_blender.py for how to install it")
    folder, frames = tmp_path_factory.mktemp("rigs"), np.arange(len(clip), dtype=float)
    for file in map(folder.joinpath, FILES):
        blender = BLENDER if file.suffix == ".fbx" else None
        write_clip(clip, file, Export(rig=file.stem, blender=blender))
        rate = BLENDERS_RATE / clip.fps if file.suffix == ".glb" else 1.0
        np.save(folder / f"{file.name}.frames.npy", frames * rate)
    return folder


@pytest.fixture(scope="module")
def seen(folder: Path) -> dict[str, dict[str, Array]]:
    """Return what Blender sees in these files, by their names."""
    script = Path(__file__).with_name("blender_import.py")
    subprocess.run([BLENDER, str(script), str(folder)], check=True, timeout=300)
    return {name: dict(np.load(folder / f"{name}.npz")) for name in FILES}


@in_three
@pytest.mark.parametrize("name", IN_FBX)
def test_three_has_the_joints_of_an_fbx_in_centimeters_with_the_axes_of_the_rig(
    clip: Clip, folder: Path, name: str
) -> None:
    three = in_node("three_fbx.mjs", folder / f"{name}.fbx", clip)
    rig = built_rig(load_rig_map(name), clip.body)
    moved = retarget(clip, rig)
    plain = [re.sub(r"[:.]", "", joint) for joint in rig.rest.names]  # as three has
    frames = np.array(three["frames"])[:, [three["names"].index(n) for n in plain]]
    away = frames[..., :3] / 100.0 - moved.positions
    assert np.linalg.norm(away, axis=-1).max() < MILLIMETER
    axes = np.eye(3) if rig.rest.axes is None else matrix_from_wxyz(rig.rest.axes)
    wanted = matrix_from_wxyz(moved.rotations) @ axes
    found = matrix_from_wxyz(np.roll(frames[..., 3:], 1, axis=-1))
    assert apart(found, wanted).max() < HALF_A_DEGREE


def columns(blender: dict[str, Array], names: Iterable[str]) -> list[int]:
    """Return where joints are in what Blender saw; USD has other names for some."""
    known = [re.sub(r"\W", "_", name) for name in blender["names"].tolist()]
    return [known.index(re.sub(r"\W", "_", name)) for name in names]


@pytest.mark.parametrize("file", FILES)
def test_blenders_joints_are_where_the_motion_has_them_and_turn_as_it_turns_them(
    clip: Clip, seen: dict[str, dict[str, Array]], file: str
) -> None:
    blender, (name, _, suffix) = seen[file], file.partition(".")
    rig = built_rig(load_rig_map(name), clip.body)
    moved, some = retarget(clip, rig), columns(blender, rig.rest.names)
    away = blender["heads"][:, some] @ FROM_BLENDER.T - moved.positions
    assert np.linalg.norm(away, axis=-1).max() < MILLIMETER
    if suffix == "bvh" and rig.rest.axes_in_bvh:
        return  # such bones are at rest in no pose at all
    turns = blender["turns"][:, some] @ np.swapaxes(blender["axes"][some], 1, 2)
    turned = FROM_BLENDER @ turns @ FROM_BLENDER.T
    assert apart(turned, matrix_from_wxyz(moved.rotations)).max() < HALF_A_DEGREE


@pytest.mark.parametrize("file", [f for f in FILES if f.endswith(("glb", "fbx"))])
def test_blenders_bones_have_the_axes_of_the_rig(
    clip: Clip, seen: dict[str, dict[str, Array]], file: str
) -> None:
    blender, rig_map = seen[file], load_rig_map(file.partition(".")[0])
    rig = built_rig(rig_map, clip.body)
    some = columns(blender, rig.rest.names)
    axes = FROM_BLENDER @ blender["axes"][some]
    wanted = np.eye(3) if rig.rest.axes is None else matrix_from_wxyz(rig.rest.axes)
    assert apart(axes, np.broadcast_to(wanted, axes.shape)).max() < HALF_A_DEGREE


@pytest.mark.parametrize(
    ("name", "suffix"),
    [
        *(
            (name, "glb")
            for name in ("mixamo", "unreal", "unreal4", "lafan1", "rigify")
        ),
        *((name, "fbx") for name in ("mixamo", "unreal", "lafan1", "rigify")),
    ],
)
def test_an_axis_of_each_limb_points_where_the_clip_has_the_limb(
    clip: Clip, seen: dict[str, dict[str, Array]], name: str, suffix: str
) -> None:
    skeleton, rig_map = clip.skeleton, load_rig_map(name)
    for part, segment in limb_segments(skeleton):
        bone = clip.positions[:, segment] - clip.positions[:, skeleton.parents[segment]]
        (turned,) = rig_map.of(part)
        (axis, along), _ = turned.axes or ((), ())
        assert along == "on"
        way = axis_of(seen[f"{name}.{suffix}"], rig_map.prefix + turned.name, axis)
        assert angle(way, bone).max() < HALF_A_DEGREE, turned.name


@pytest.mark.parametrize("name", ["mixamo", "lafan1"])
@pytest.mark.parametrize("suffix", ["glb", "fbx"])
def test_the_other_axis_of_each_limb_is_twisted_as_the_clip_has_it(
    clip: Clip, seen: dict[str, dict[str, Array]], name: str, suffix: str
) -> None:
    """At rest these limbs are where the T-pose has them, the clip's own rest pose."""
    rig_map = load_rig_map(name)
    for part, segment in limb_segments(clip.skeleton):
        (turned,) = rig_map.of(part)
        _, (axis, word) = turned.axes or ((), ())
        wanted = rotate(clip.rotations[:, segment], np.array(WORDS[word]))
        way = axis_of(seen[f"{name}.{suffix}"], rig_map.prefix + turned.name, axis)
        assert angle(way, wanted).max() < HALF_A_DEGREE, turned.name


def limb_segments(skeleton: Skeleton) -> Iterator[tuple[str, int]]:
    """Yield the parts of the limbs without hands and feet, and their segments."""
    for side in SIDES:
        for parts, joints in (ARM, LEG):
            for part, end in zip(parts[:2], joints[1:], strict=True):
                yield f"{side} {part}", skeleton.index(f"{end}{side.capitalize()}")


def axis_of(blender: dict[str, Array], bone: str, axis: str) -> Array:
    """Return where an axis (``x``, ``-x``) of a bone points in each frame, (T, 3)."""
    (column,) = columns(blender, [bone])
    way = blender["turns"][:, column, :, "xyz".index(axis[-1])]
    return np.asarray((-1.0 if axis[0] == "-" else 1.0) * way @ FROM_BLENDER.T)


def angle(some: Array, others: Array) -> Array:
    """Return the angles between vectors (T, 3) [degrees], shape (T,)."""
    sines = np.linalg.norm(np.cross(some, others), axis=-1)
    return np.degrees(np.arctan2(sines, np.sum(some * others, axis=-1)))


def apart(some: Array, others: Array) -> Array:
    """Return the angles between rotations (..., 3, 3) [degrees], shape (...)."""
    away = np.linalg.norm(some - others, axis=(-2, -1)) / np.sqrt(8.0)
    return np.asarray(np.degrees(2.0 * np.arcsin(np.minimum(away, 1.0))))
