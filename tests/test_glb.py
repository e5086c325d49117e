"""GLB: what it keeps, what Khronos' validator says, where three.js has the joints."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from skeletons import every_skeleton
from usd_positions import read_usd_positions

from kinefilter import CleanConfig, clean
from kinefilter.characters import KINECT_V2, Clip, InputError, Skeleton
from kinefilter.characters.rotations import inverse, multiply, rotation_vector
from kinefilter.pipeline.contents import contents_of
from kinefilter.pipeline.formats import (
    Export,
    read_clip,
    read_take,
    write_clip,
    write_people,
)
from kinefilter.pipeline.formats.clips import target_rig
from kinefilter.pipeline.formats.glb import _keys
from kinefilter.pipeline.formats.rig import retargeted_motion
from kinefilter.pipeline.look.comparison import compare
from kinefilter.retarget.retargeting import retarget
from kinefilter.retarget.rig_map import RIGS
from kinefilter.scenes import SAMPLE

MakeClip = Callable[..., Clip]
Furnish = Callable[[Clip], Clip]
MILLIMETER = 1e-3
HALF = 0.5 + 1e-6  # of the last digit
TO_USD = re.compile(r"\W")  # what a name in USD may not have

FOLDER = os.environ.get("KINEFILTER_THREE", "")
in_three = pytest.mark.skipif(
    not FOLDER
    or not Path(FOLDER, "node_modules", "gltf-validator").is_dir()
    or shutil.which("node") is None,
    reason="no three.js or glTF validator: install Node and, in an empty folder, npm "
    "install three@0.187.0 gltf-validator@2.0.0-dev.3.10 "
    "@pixiv/three-vrm-animation@3.5.5, then "
    "KINEFILTER_THREE=that folder pytest",
)


def three(path: Path, times: list[float] | None = None) -> dict[str, Any]:
    script = Path(__file__).with_name("three_gltf.mjs")
    command = ["node", str(script), FOLDER, str(path)]
    if times is not None:
        command.append(json.dumps(times))
    ran = subprocess.run(command, check=True, capture_output=True, timeout=60)
    found: dict[str, Any] = json.loads(ran.stdout)
    return found


def with_a_gap(clip: Clip) -> Clip:
    """Return a clip with a long gap before its sixth frame."""
    time = clip.time.copy()
    time[5:] += 10.0
    return replace(clip, time=time)


def test_it_gives_back_where_every_joint_came_from(
    make_clip: MakeClip, furnish: Furnish, tmp_path: Path
) -> None:
    clip = with_a_gap(furnish(make_clip(8, KINECT_V2)))
    force = clip.external_force.copy()
    force[3:5] = np.nan
    clip = replace(clip, external_force=force, tilt=-0.1, floor=0.7)
    write_clip(clip, tmp_path / "clip.glb")
    found = read_clip(tmp_path / "clip.glb")
    np.testing.assert_allclose(found.time, clip.time, rtol=0, atol=1e-6)
    assert (found.body.height, found.body.mass) == (clip.body.height, clip.body.mass)
    for name in ("origin", "deciding_term", "contacts", "state"):
        np.testing.assert_array_equal(getattr(found, name), getattr(clip, name))
    per_cent, millimeter = HALF * 0.01, HALF * 0.001
    for name, half in (
        *(("reliability", per_cent), ("external_force", per_cent)),
        *(("moved_by_correction", millimeter), ("moved_by_physics", millimeter)),
        ("uncertainty", millimeter),
    ):
        given, read = getattr(clip, name), getattr(found, name)
        np.testing.assert_allclose(read, given, rtol=0, atol=half, err_msg=name)
    assert (found.tilt, found.floor) == (clip.tilt, clip.floor)
    assert [prop.name for prop in found.props] == [prop.name for prop in clip.props]
    for prop, other in zip(clip.props, found.props, strict=True):
        np.testing.assert_allclose(other.positions, prop.positions, atol=1e-6)
        np.testing.assert_allclose(other.rotations, prop.rotations, atol=1e-6)
        for shape, read in zip(prop.shapes, other.shapes, strict=True):
            for field in ("size", "position", "rotation", "color", "points"):
                np.testing.assert_allclose(
                    getattr(read, field), getattr(shape, field), atol=1e-6
                )
            assert read.kind == shape.kind
            np.testing.assert_array_equal(read.triangles, shape.triangles)


@pytest.mark.usefixtures("usd_here")
def test_its_take_is_known_again(tmp_path: Path) -> None:
    """Minutes from its beginning, which is not 0, and with repeated stamps."""
    one = read_take(SAMPLE)
    some = np.sort(np.r_[np.arange(60), np.arange(0, 60, 7)])
    take = one.at(some)
    late = np.where(some < 30, 100.0, 180.0)
    take = replace(take, time=take.time + late)
    clip = clean(take, CleanConfig(physics=False)).clip
    for name in ("clip.glb", "clip.usdc"):
        write_clip(clip, tmp_path / name)
        shown = compare(read_clip(tmp_path / name), take)
        np.testing.assert_allclose(shown.clip.time, take.time, rtol=0, atol=1e-6)
        np.testing.assert_allclose(shown.clip.positions, clip.positions, atol=1e-5)


def test_keyframes_are_apart_in_single_precision(make_clip: MakeClip) -> None:
    clip = make_clip(
        6, KINECT_V2, time=np.array([0, 0.1, 0.1 + 1e-9, 5e5, 5e5 + 1e-3, 6e5])
    )
    rows, stamps, held = _keys(clip, 0.0)
    assert (np.diff(stamps.astype(np.float32)) > 0.0).all()
    assert rows.tolist() == [0, 2, 2, 4, 4, 5]
    assert held == [2, 4]


@in_three
@every_skeleton
@pytest.mark.parametrize("export", [Export(), Export(rest="t", fps=24.0)])
def test_it_is_valid_and_three_has_every_joint_where_the_clip_has_it(
    make_clip: MakeClip,
    furnish: Furnish,
    tmp_path: Path,
    skeleton: Skeleton,
    export: Export,
) -> None:
    clip = with_a_gap(furnish(make_clip(20, skeleton, seed=5)))
    write_clip(clip, tmp_path / "clip.glb", export)
    found, clip = three(tmp_path / "clip.glb"), read_clip(tmp_path / "clip.glb")
    assert found["issues"] == []
    known = found["extras"]["kinefilter"]
    kept = np.delete(np.arange(len(found["times"])), known["held"])
    columns = [found["names"].index(joint) for joint in skeleton.joints]
    away = np.array(found["frames"])[kept][:, columns] - clip.positions
    assert np.linalg.norm(away, axis=-1).max() < MILLIMETER
    for held in known["held"]:  # nothing moves in the gap
        still = np.subtract(found["frames"][held], found["frames"][held - 1])
        assert np.abs(still).max() < 1e-6
    shares = np.transpose(found["reliability"])[kept] / 100.0
    np.testing.assert_allclose(shares, clip.reliability, atol=1e-6)


@in_three
@every_skeleton
def test_three_draws_the_curves_between_the_keys_that_are_left(
    make_clip: MakeClip, furnish: Furnish, tmp_path: Path, skeleton: Skeleton
) -> None:
    clip = with_a_gap(furnish(make_clip(40, skeleton, seed=5)))
    write_clip(clip, tmp_path / "clip.glb", Export(keys=0.8))
    times = [*clip.time, *np.linspace(clip.time[4], clip.time[5] - 1 / 30, 50)]
    found = three(tmp_path / "clip.glb", times)
    assert found["issues"] == []
    columns = [found["names"].index(joint) for joint in skeleton.joints]
    held = np.repeat(clip.positions[4:5], 50, axis=0)
    away = np.array(found["frames"])[:, columns] - [*clip.positions, *held]
    assert 0.2 * MILLIMETER < np.linalg.norm(away, axis=-1).max() < 0.81 * MILLIMETER


@in_three
@pytest.mark.parametrize("keys", [None, 0.5])
def test_people_in_one_file_move_at_their_own_times(
    make_clip: MakeClip, furnish: Furnish, tmp_path: Path, keys: float | None
) -> None:
    first, second = furnish(make_clip(40, KINECT_V2)), make_clip(30, KINECT_V2, seed=9)
    first = replace(first, time=first.time + 2.0)
    second = replace(second, time=first.time[0] + 0.5 + second.time)
    path = tmp_path / "clip.glb"
    write_people([first, second], path, Export(keys=keys))
    times = (second.time - first.time[0]).tolist()
    found = three(path, [0.0, *times])
    assert found["issues"] == []
    columns = [found["names"].index(joint) for joint in KINECT_V2.joints]
    one, other = np.split(np.array(found["frames"]), 2, axis=1)
    for places, wanted in (
        (other[1:], second.positions),
        (other[0], second.positions[0]),  # not there yet
        (one[1:26], first.positions[15:]),
        (one[0], first.positions[0]),
        (one[26:], first.positions[-1]),  # gone
    ):
        away = np.linalg.norm(places[..., columns, :] - wanted, axis=-1)
        assert away.max() < MILLIMETER
    people = found["extras"]["kinefilter"]["people"]
    assert [len(known["time"]) for known in people] == [40, 30]
    with pytest.raises(InputError, match="holds 2 people"):
        read_clip(path)


@in_three
@pytest.mark.parametrize(
    ("rig", "keys"), [("unreal", None), ("vrm", None), *((rig, 0.9) for rig in RIGS)]
)
def test_rigs_are_where_usd_has_them(
    make_clip: MakeClip, tmp_path: Path, rig: str, keys: float | None
) -> None:
    clip = make_clip(16, KINECT_V2, seed=2)
    write_clip(clip, tmp_path / "clip.glb", Export(rig=rig, keys=keys))
    write_clip(clip, tmp_path / "clip.usda", Export(rig=rig))
    found = three(tmp_path / "clip.glb", clip.time.tolist())
    _, names, positions = read_usd_positions(tmp_path / "clip.usda")
    columns = [names.index(TO_USD.sub("_", name)) for name in found["names"]]
    away = np.array(found["frames"]) - positions[:, columns]
    assert np.linalg.norm(away, axis=-1).max() < MILLIMETER
    # What has no mesh needs the skin all the same: Blender makes an armature of it.
    assert found["issues"] == ["UNUSED_OBJECT /skins/0"]


@pytest.mark.parametrize(
    ("rig", "wanted"),
    [
        (None, {"KneeLeft": "AnkleLeft", "HipLeftPivot": "HipLeft", "Head": "Head"}),
        (
            "rigify",
            {"shin.L": "AnkleLeft", "spine": "SpineBase", "hand.R": "HandRight"},
        ),
    ],
)
def test_it_says_which_segment_turns_a_bone(
    make_clip: MakeClip, tmp_path: Path, rig: str | None, wanted: dict[str, str]
) -> None:
    clip, path = make_clip(3, KINECT_V2), tmp_path / "clip.glb"
    write_clip(clip, path, Export(rig=rig))
    data = path.read_bytes()
    size = int.from_bytes(data[12:16], "little")
    (animation,) = json.loads(data[20 : 20 + size])["animations"]
    known = animation["extras"]["kinefilter"]
    found = {n: known["joints"][j] for n, j in known["turnedBy"].items()}
    assert found.items() >= wanted.items()


@in_three
def test_vrma_moves_every_bone_as_the_vrm_rig_moves(
    make_clip: MakeClip, tmp_path: Path
) -> None:
    """The bones of VRM are along the world's axes at rest, so nothing is converted."""
    clip = make_clip(6, KINECT_V2, seed=2)
    write_clip(clip, tmp_path / "clip.vrma")
    found = three(tmp_path / "clip.vrma")
    rig = target_rig("vrm", None, clip.body)
    moved = retargeted_motion(rig, retarget(clip, rig), clip.skeleton, "travel")
    turns = moved.rig.local_rotations(moved.rotations)
    assert set(found["bones"]["turns"]) == set(moved.rig.names)
    for n, name in enumerate(moved.rig.names):
        xyzw = np.reshape(found["bones"]["turns"][name], (-1, 4))
        apart = multiply(inverse(turns[:, n]), np.roll(xyzw, 1, axis=1))
        assert np.abs(rotation_vector(apart)).max() < 1e-5, name
    hips = np.reshape(found["bones"]["hips"], (-1, 3))
    np.testing.assert_allclose(hips, moved.places[0], atol=1e-5)
    np.testing.assert_allclose(
        found["bones"]["rest"], moved.rig.positions[0], atol=1e-5
    )


def test_info_says_what_is_in_those_of_rigs(
    make_clip: MakeClip, tmp_path: Path
) -> None:
    clip = make_clip(4, KINECT_V2)
    write_clip(clip, tmp_path / "clip.vrma")
    found = contents_of(tmp_path / "clip.vrma")
    assert (found["format"], found["joints"], found["frames"]) == ("vrma", 22, 4)


def test_others_are_refused_by_name(make_clip: MakeClip, tmp_path: Path) -> None:
    clip = make_clip(4, KINECT_V2)
    write_clip(clip, tmp_path / "rig.glb", Export(rig="vrm"))
    write_clip(clip, tmp_path / "clip.glb")
    data = (tmp_path / "clip.glb").read_bytes()
    (tmp_path / "half.glb").write_bytes(data[: len(data) // 2])
    (tmp_path / "text.glb").write_text("HIERARCHY")
    for name, words in {
        "rig.glb": "another skeleton",
        "half.glb": "ends before its data",
        "text.glb": "text.glb: ",
    }.items():
        with pytest.raises(InputError, match=words):
            read_clip(tmp_path / name)
    with pytest.raises(InputError, match=r"clip\.glb: is a clip.*give the take"):
        read_take(tmp_path / "clip.glb")
