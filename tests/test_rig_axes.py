"""Bones of other people's rigs keep their own axes in files, whichever way is up."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from pxr import Usd, UsdSkel
from rig_motions import performed
from rig_targets import in_usd, up_axis, write_target
from usd_positions import read_usd_positions

from kinefilter.characters import Clip
from kinefilter.characters.rotations import inverse, multiply, rotation_vector
from kinefilter.pipeline.formats import Export, read_bvh, write_clip
from kinefilter.retarget.retargeting import retarget
from kinefilter.retarget.rig_map import load_rig_map
from kinefilter.retarget.target_rig import built_rig

Array = NDArray[np.float64]
TENTH_OF_A_MILLIMETER = 1e-4

MIXAMO = Export(rig="mixamo")


@pytest.fixture(scope="module")
def clip() -> Clip:
    """Return a short walk."""
    walk = performed("walk")
    return walk.at(slice(20))


def test_a_bvh_of_lafan1_has_its_axes_in_the_motion(clip: Clip, tmp_path: Path) -> None:
    """All bones go on along x; the motion turns them, from no pose at all."""
    write_clip(clip, tmp_path / "clip.bvh", Export(rig="lafan1", units="cm"))
    bvh = read_bvh(tmp_path / "clip.bvh")
    along = ("LeftLeg", "RightFoot", "Spine2", "Head", "LeftArm", "RightHand")
    for name in along:
        x, *others = bvh.offsets[bvh.names.index(name)]
        assert x > 1.0
        assert np.abs(others).max() < 1e-6
    rig = built_rig(load_rig_map("lafan1"), clip.body)
    assert rig.rest.axes is not None
    wanted = multiply(retarget(clip, rig).rotations, rig.rest.axes)
    found = bvh.rotations[:, [bvh.names.index(name) for name in rig.rest.names]]
    apart = rotation_vector(multiply(inverse(wanted), found))
    assert np.abs(apart).max() < 1e-6


@pytest.mark.parametrize("export", [Export(), Export(up="z", units="cm")])
def test_bones_in_usd_have_their_own_axes_whichever_way_is_up(
    clip: Clip, tmp_path: Path, export: Export
) -> None:
    write_clip(clip, tmp_path / "clip.usda", replace(export, rig="unreal"))
    stage = Usd.Stage.Open(str(tmp_path / "clip.usda"))
    skeleton = UsdSkel.Skeleton(stage.GetPrimAtPath("/Character/Skeleton"))
    names = [j.rpartition("/")[2] for j in skeleton.GetJointsAttr().Get()]
    bind = np.array(skeleton.GetBindTransformsAttr().Get())
    axes = dict(zip(names, bind[:, :3, :3], strict=True))  # a row is an axis
    places = dict(zip(names, bind[:, 3, :3], strict=True))
    if export.up == "z":  # as Unreal has it
        np.testing.assert_allclose(axes["root"], np.eye(3), atol=1e-6)
    for bone, tip, sign in (
        *(("thigh_l", "calf_l", -1.0), ("calf_r", "foot_r", 1.0)),
        *(("upperarm_l", "lowerarm_l", 1.0), ("lowerarm_r", "hand_r", -1.0)),
    ):
        along = places[tip] - places[bone]
        along /= np.linalg.norm(along)
        np.testing.assert_allclose(axes[bone][0], sign * along, atol=1e-6)
    up = up_axis(axes["foot_l"], export)
    np.testing.assert_allclose(up[0], [0.0, 1.0, 0.0], atol=1e-6)
    assert up[1] @ [0.0, 0.0, -1.0] > 0.99


def bind_transforms(path: Path, name: str) -> Array:
    """Return where and how the joints of a USD skeleton are at rest, (J, 4, 4)."""
    stage = Usd.Stage.Open(str(path))
    skeleton = UsdSkel.Skeleton(stage.GetPrimAtPath(f"/{name}/Skeleton"))
    return np.array(skeleton.GetBindTransformsAttr().Get())


@pytest.mark.usefixtures("usd_here")
@pytest.mark.parametrize(("up", "meters"), [("Y", 1.0), ("Z", 0.01)])
@pytest.mark.parametrize("name", ["mixamo", "unreal"])
def test_a_usd_target_gives_the_motion_of_the_same_skeleton_and_keeps_its_axes(
    clip: Clip, tmp_path: Path, name: str, up: str, meters: float
) -> None:
    built = built_rig(load_rig_map(name), clip.body)
    target, path = tmp_path / "rest.usda", tmp_path / "clip.usdc"
    write_target(built, target, up=up, meters=meters)
    axes = Export(up="z" if up == "Z" else "y", units="cm" if meters < 1 else "m")
    write_clip(clip, path, replace(axes, rig=name, target=target))
    _, names, positions = read_usd_positions(path)
    wanted = retarget(clip, built).positions
    assert list(names) == in_usd(built.rest.names)
    assert np.abs(up_axis(positions, axes) - wanted).max() < TENTH_OF_A_MILLIMETER
    theirs, ours = bind_transforms(target, "Rig"), bind_transforms(path, "Character")
    np.testing.assert_allclose(ours[:, :3, :3], theirs[:, :3, :3], atol=1e-6)
    np.testing.assert_allclose(ours[:, 3, :3], 0.5 * theirs[:, 3, :3], atol=1e-5)


@pytest.mark.usefixtures("usd_here")
def test_bones_of_a_target_with_z_up_keep_their_axes_in_a_clip_with_y_up(
    clip: Clip, tmp_path: Path
) -> None:
    built = built_rig(load_rig_map("mixamo"), clip.body)
    target, path = tmp_path / "rest.usda", tmp_path / "clip.usda"
    write_target(built, target, up="Z", meters=1.0)
    write_clip(clip, path, replace(MIXAMO, target=target))
    theirs, ours = bind_transforms(target, "Rig"), bind_transforms(path, "Character")
    wanted = up_axis(theirs[:, :3, :3], Export(up="z"))  # a row is an axis
    np.testing.assert_allclose(ours[:, :3, :3], wanted, atol=1e-6)


def test_a_bvh_is_on_a_usd_target_with_axes_of_its_own(
    clip: Clip, tmp_path: Path
) -> None:
    built = built_rig(load_rig_map("unreal"), clip.body)
    target, path = tmp_path / "rest.usda", tmp_path / "clip.bvh"
    write_target(built, target, up="Y", meters=1.0)
    write_clip(clip, path, Export(rig="unreal", target=target))
    bvh = read_bvh(path)
    columns = [bvh.names.index(name) for name in built.rest.names]
    away = np.abs(bvh.positions[:, columns] - retarget(clip, built).positions)
    assert away.max() < TENTH_OF_A_MILLIMETER
