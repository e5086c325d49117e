"""Twist bones take their share of a limb's twist, and nothing else changes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from rig_motions import performed
from rig_targets import write_target
from scipy.spatial.transform import Rotation

from kinefilter.characters import KINECT_V2, Clip
from kinefilter.characters.rotations import multiply
from kinefilter.pipeline.formats.clips import target_rig
from kinefilter.retarget.retargeting import angle_about, retarget, twisted
from kinefilter.retarget.rig_map import load_rig_map
from kinefilter.retarget.target_rig import TargetRig, Twist, built_rig

Array = NDArray[np.float64]
MakeClip = Callable[..., Clip]
every_rig = pytest.mark.parametrize("name", ["unreal", "unreal4"])
# What twists about each segment, against what, and where the segment ends.
PARTS = {
    "upperarm": ("upperarm", "clavicle", "lowerarm"),
    "lowerarm": ("hand", "lowerarm", "hand"),
    "thigh": ("thigh", "pelvis", "calf"),
    "calf": ("foot", "calf", "foot"),
}


def as_scipy(wxyz: Array) -> Rotation:
    return Rotation.from_quat(np.roll(wxyz, -1, axis=-1))


def twist(rotation: Rotation, axis: Array) -> Array:
    """Return the twist [rad] about an axis that is left after the shortest swing."""
    swung = rotation.apply(axis)
    swing = [Rotation.align_vectors(to[None], axis[None])[0] for to in swung]
    left = (Rotation.concatenate(swing).inv() * rotation).as_rotvec()
    assert np.abs(np.cross(left, axis)).max() < 1e-6
    return np.asarray(left @ axis)


@pytest.mark.parametrize(("name", "count"), [("unreal", 2), ("unreal4", 1)])
def test_each_takes_its_share_of_the_twist_of_its_segment(
    name: str, count: int
) -> None:
    clip = performed("punch").at(slice(0, 120, 3))
    rig = built_rig(load_rig_map(name), clip.body)
    turns, joint = retarget(clip, rig).rotations, rig.rest.names.index
    assert len(rig.twists) == 8 * count
    largest = 0.0
    for limb, names in PARTS.items():
        for side in "lr":
            of, above, end = (
                joint(n if n == "pelvis" else f"{n}_{side}") for n in names
            )
            segment = joint(f"{limb}_{side}")
            start, tip = rig.rest.positions[[segment, end]]
            axis = (tip - start) / np.linalg.norm(tip - start)
            between = as_scipy(turns[:, above]).inv() * as_scipy(turns[:, of])
            whole = twist(between, axis)
            for number in range(count):
                bone = joint(f"{limb}_twist_0{number + 1}_{side}")
                at = rig.rest.positions[bone] - start
                along = at @ axis / np.linalg.norm(tip - start)
                np.testing.assert_allclose(at, along * (tip - start), atol=1e-12)
                own = as_scipy(turns[:, segment]).inv() * as_scipy(turns[:, bone])
                share = along - 1.0 if of == segment else along
                wanted = share * whole[:, None] * axis
                np.testing.assert_allclose(own.as_rotvec(), wanted, atol=1e-6)
            largest = max(largest, float(np.abs(whole).max()))
    assert largest > 0.5


@every_rig
def test_limbs_are_the_same_to_the_bit_without_them(name: str) -> None:
    clip = performed("walk").at(slice(40))
    rig = built_rig(load_rig_map(name), clip.body)
    with_them, without = retarget(clip, rig), retarget(clip, replace(rig, twists={}))
    others = np.delete(np.arange(len(rig.rest)), list(rig.twists))
    assert np.array_equal(with_them.positions, without.positions)
    turned, still = (m.rotations[:, others] for m in (with_them, without))
    assert np.array_equal(turned, still)


def test_a_quarter_turn_of_the_hand_is_spread_over_the_forearm() -> None:
    axis = np.array([0.0, 0.6, 0.8])
    quarter = np.array([[np.cos(np.pi / 4), *np.sin(np.pi / 4) * axis]])
    bend = np.array([[np.cos(0.3), np.sin(0.3), 0.0, 0.0]])  # about x, across the axis
    hand = multiply(bend, quarter)
    assert angle_about(axis, hand) == pytest.approx(np.pi / 2)
    assert angle_about(axis, -hand) == pytest.approx(np.pi / 2)
    turns = {0: bend, 1: multiply(bend, hand)}
    (turn,) = twisted({2: Twist(0, 1, 0, axis, 0.5)}, turns)[2]
    eighth = np.array([np.cos(np.pi / 8), *np.sin(np.pi / 8) * axis])
    np.testing.assert_allclose(turn, multiply(bend[0], eighth), atol=1e-12)


def test_a_skeleton_from_a_file_has_those_that_it_has(
    make_clip: MakeClip, tmp_path: Path
) -> None:
    clip = make_clip(6, KINECT_V2, seed=4)
    whole = built_rig(load_rig_map("unreal"), clip.body)
    for rig in (whole, without(whole, "lowerarm_twist_02_l")):
        write_target(rig, tmp_path / "rest.usda", up="Y", meters=1.0)
        read = target_rig("unreal", tmp_path / "rest.usda", clip.body)
        assert {read.rest.names[n] for n in read.twists} == {
            rig.rest.names[n] for n in rig.twists
        }
        found, wanted = (retarget(clip, r).rotations for r in (read, whole))
        for n, name in enumerate(read.rest.names):
            there = whole.rest.names.index(name)
            np.testing.assert_allclose(found[:, n], wanted[:, there], atol=1e-5)


def without(rig: TargetRig, name: str) -> TargetRig:
    """Return a skeleton without its last bones from one on."""
    count = rig.rest.names.index(name)
    rest = replace(
        rig.rest,
        names=rig.rest.names[:count],
        parents=rig.rest.parents[:count],
        positions=rig.rest.positions[:count],
    )
    twists = {n: twist for n, twist in rig.twists.items() if n < count}
    return replace(rig, rest=rest, twists=twists)
