"""Clips on other people's rigs as files, and those people's skeletons out of files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from pxr import Usd, UsdSkel, UsdValidation
from rig_motions import performed
from rig_targets import in_usd, up_axis, write_target
from usd_positions import read_usd_positions

from kinefilter.characters import KINECT_V1, Clip, InputError, Prop
from kinefilter.characters.rotations import about_y, rotate
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.formats import (
    Export,
    check_writable,
    clips,
    read_bvh,
    write_clip,
)
from kinefilter.pipeline.formats.clips import target_rig
from kinefilter.pipeline.formats.rig import rig_of
from kinefilter.pipeline.formats.usd_character import check_character
from kinefilter.pipeline.formats.usd_reader import rest_arrays
from kinefilter.retarget import rig_map as rig_map_module
from kinefilter.retarget.retargeting import retarget
from kinefilter.retarget.rig_map import RIGS, load_rig_map
from kinefilter.retarget.target_rig import TargetRig, built_rig

Array = NDArray[np.float64]
SAMPLE = Path(__file__).parents[1] / "scenes" / "takes" / "wave_punch_bend.csv"
TENTH_OF_A_MILLIMETER = 1e-4

MIXAMO = Export(rig="mixamo")

every_rig = pytest.mark.parametrize("name", RIGS)


@pytest.fixture(scope="module")
def clip() -> Clip:
    """Return a short walk."""
    walk = performed("walk")
    return walk.at(slice(50))


@every_rig
@pytest.mark.parametrize("export", [Export(), Export(up="z", units="cm")])
def test_every_joint_of_a_bvh_is_where_the_retargeted_motion_has_it(
    clip: Clip, tmp_path: Path, name: str, export: Export
) -> None:
    write_clip(clip, tmp_path / "clip.bvh", replace(export, rig=name))
    rig, bvh = built_rig(load_rig_map(name), clip.body), read_bvh(tmp_path / "clip.bvh")
    columns = [bvh.names.index(joint) for joint in rig.rest.names]
    found = up_axis(bvh.positions[:, columns] * export.meters_per_unit, export)
    wanted = retarget(clip, rig).positions
    assert np.abs(found - wanted).max() < TENTH_OF_A_MILLIMETER
    assert {n for n in bvh.names if not n.endswith("End")} == set(rig.rest.names)


@every_rig
@pytest.mark.parametrize("export", [Export(), Export(up="z", units="cm")])
def test_every_joint_of_a_usd_is_where_the_retargeted_motion_has_it(
    clip: Clip, tmp_path: Path, name: str, export: Export
) -> None:
    path = tmp_path / "clip.usdc"
    write_clip(clip, path, replace(export, rig=name))
    rig = built_rig(load_rig_map(name), clip.body)
    _, names, positions = read_usd_positions(path)
    assert list(names) == in_usd(rig.rest.names)
    wanted = retarget(clip, rig).positions
    away = np.abs(up_axis(positions, export) - wanted)
    assert away.max() < TENTH_OF_A_MILLIMETER


@pytest.mark.parametrize("name", ["mixamo", "unreal"])
@pytest.mark.parametrize("suffix", [".usda", ".usdc", ".usdz"])
def test_usd_validation_has_nothing_to_say(
    clip: Clip, tmp_path: Path, name: str, suffix: str
) -> None:
    thing = Prop("thing", (), np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]]))
    path = tmp_path / f"clip{suffix}"
    write_clip(replace(clip, props=(thing,)), path, Export(rig=name, units="cm"))
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    stage = Usd.Stage.Open(str(path))
    errors = UsdValidation.ValidationContext(validators).Validate(stage)
    assert [error.GetErrorAsString() for error in errors] == []
    prims = {prim.GetName() for prim in stage.Traverse()}
    assert prims == {"Character", "Skeleton", "Animation"}


def test_only_root_pelvis_and_ik_bones_of_an_unreal_clip_change_place(
    clip: Clip, tmp_path: Path
) -> None:
    write_clip(clip, tmp_path / "clip.usdc", Export(rig="unreal"))
    stage = Usd.Stage.Open(str(tmp_path / "clip.usdc"))
    animation = UsdSkel.Animation(stage.GetPrimAtPath("/Character/Animation"))
    places = animation.GetTranslationsAttr()
    first, last = (np.array(places.Get(c)) for c in (0, len(clip) - 1))
    moved = np.abs(last - first).max(axis=1) > 0.0
    joints = [j.rpartition("/")[2] for j in animation.GetJointsAttr().Get()]
    assert [joint for joint, far in zip(joints, moved, strict=True) if far] == [
        *("root", "pelvis", "ik_foot_l", "ik_foot_r", "ik_hand_gun", "ik_hand_l"),
    ]


@pytest.mark.parametrize("name", ["unreal", "unreal4"])
@pytest.mark.parametrize("root", ["travel", "in-place"])
def test_ik_bones_are_where_hands_and_feet_are(
    clip: Clip, tmp_path: Path, name: str, root: str
) -> None:
    travel = "travel" if root == "travel" else "in-place"
    write_clip(clip, tmp_path / "clip.usdc", Export(rig=name, root=travel))
    stage = Usd.Stage.Open(str(tmp_path / "clip.usdc"))
    prim = stage.GetPrimAtPath("/Character/Skeleton")
    query = UsdSkel.Cache().GetSkelQuery(UsdSkel.Skeleton(prim))
    joints = [joint.rpartition("/")[2] for joint in query.GetJointOrder()]
    followed = [("ik_hand_gun", "hand_r")]
    followed += [(f"ik_{end}", end) for end in ("foot_l", "foot_r", "hand_l", "hand_r")]
    for code in (0, 24, 49):
        transforms = np.array(query.ComputeJointSkelTransforms(code))
        for bone, end in followed:
            there, here = (transforms[joints.index(joint)] for joint in (end, bone))
            np.testing.assert_allclose(here, there, atol=1e-5)


# Targets


@every_rig
@pytest.mark.parametrize("units", ["m", "cm"])
def test_a_bvh_target_gives_the_motion_of_the_same_skeleton(
    clip: Clip, tmp_path: Path, name: str, units: str
) -> None:
    target, path = tmp_path / "rest.bvh", tmp_path / "clip.bvh"
    export = Export(rig=name, units="cm" if units == "cm" else "m")
    write_clip(clip, target, export)
    write_clip(clip, path, replace(export, target=target))
    again, first = read_bvh(path), read_bvh(target)
    assert again.names == first.names
    # The sole is guessed, as BVH knows none.
    shift = again.positions - first.positions
    root = [n for n in range(len(first.names)) if first.names[n] != "root"]
    assert np.abs(shift[:, root]).max() < 1e-3 / export.meters_per_unit


@every_rig
def test_a_bvh_target_with_z_up_gives_the_same_motion_as_one_with_y_up(
    clip: Clip, tmp_path: Path, name: str
) -> None:
    found = []
    for up in ("y", "z"):
        target, path = tmp_path / f"{up}_rest.bvh", tmp_path / f"{up}.bvh"
        write_clip(clip, target, Export(rig=name, up=up))
        write_clip(clip, path, Export(rig=name, target=target))
        found.append(read_bvh(path).positions)
    np.testing.assert_allclose(*found, atol=2e-3)


def test_a_target_that_faces_elsewhere_faces_where_the_person_does(
    clip: Clip,
) -> None:
    rig = built_rig(load_rig_map("mixamo"), clip.body)
    turned = replace(rig.rest, positions=rotate(about_y(2.0), rig.rest.positions))
    wanted = retarget(clip, rig).positions
    found = retarget(clip, TargetRig(turned, rig.parts, 0.0)).positions
    np.testing.assert_allclose(found, wanted, atol=1e-9)


# What is refused


@pytest.fixture
def mixamo(clip: Clip, tmp_path: Path) -> str:
    """Return a BVH of Mixamo's skeleton as text."""
    path = tmp_path / "good.bvh"
    write_clip(clip, path, Export(rig="mixamo"))
    lines = path.read_text().splitlines()
    start = next(n for n, line in enumerate(lines) if line.startswith("Frames"))
    lines[start] = "Frames: 1"
    return "\n".join(lines[: start + 3]) + "\n"


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("mixamorig:LeftLeg", "Knee", "no joint LeftLeg, which mixamo has; found"),
        ("mixamorig:LeftArm", "leftleg", "has 2 joints 'LeftLeg'"),
        ("HIERARCHY", "HIERARCHY\nROOT Other\n{\nOFFSET 0 0 0\nCHANNELS 0\n}",
         "has 2 roots (Other, mixamorig:Hips)"),
        ("MOTION", "", "expected"),
    ],
)  # fmt: skip
def test_a_bad_target_is_refused_and_nothing_written(
    clip: Clip, mixamo: str, tmp_path: Path, old: str, new: str, words: str
) -> None:
    assert old in mixamo
    target, path = tmp_path / "rest.bvh", tmp_path / "clip.usda"
    target.write_text(mixamo.replace(old, new, 1))
    for work in (check_writable, lambda p, e: write_clip(clip, p, e)):
        with pytest.raises(InputError) as caught:
            work(path, Export(rig="mixamo", target=target))
        assert str(target) in str(caught.value)
        assert words in str(caught.value)
        assert not path.exists()


def test_a_target_with_a_bone_of_no_length_is_refused(
    mixamo: str, tmp_path: Path
) -> None:
    lines = mixamo.splitlines()
    shin = next(n for n, line in enumerate(lines) if "LeftLeg" in line)
    lines[shin + 2] = "OFFSET 0 0 0"
    (tmp_path / "rest.bvh").write_text("\n".join(lines) + "\n")
    export = Export(rig="mixamo", target=tmp_path / "rest.bvh")
    with pytest.raises(
        InputError, match=r"LeftUpLeg.* and .*LeftLeg.* are in one place"
    ):
        check_writable(tmp_path / "clip.bvh", export)


@pytest.mark.parametrize("content", ["", "#usda 1.0\n", "no usd", None])
def test_a_usd_target_without_a_skeleton_is_refused(
    tmp_path: Path, content: str | None
) -> None:
    target = tmp_path / "rest.usda"
    if content is not None:
        target.write_text(content)
    with pytest.raises(InputError, match=r"rest\.usda"):
        target_rig("mixamo", target, performed("stand_idle", skeleton=KINECT_V1).body)


def test_no_usd_that_is_given_is_opened_in_this_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    motion = performed("stand_idle", skeleton=KINECT_V1)
    clip = Clip.of(motion)
    write_clip(clip, tmp_path / "rest.usda")
    write_clip(clip, tmp_path / "a.usda", Export(character=tmp_path / "body.usda"))

    def opened(path: object) -> None:
        raise AssertionError(path)

    monkeypatch.setattr(Usd.Stage, "Open", opened)
    with pytest.raises(InputError, match="rest"):
        target_rig("mixamo", tmp_path / "rest.usda", clip.body)
    check_character(tmp_path / "body.usda", rig_of(clip.body), Export())


def test_a_usd_target_without_rest_transforms_is_refused(tmp_path: Path) -> None:
    stage = Usd.Stage.CreateNew(str(tmp_path / "rest.usda"))
    UsdSkel.Skeleton.Define(stage, "/Rig").CreateJointsAttr(["Hips", "Hips/Spine"])
    stage.Save()
    export = Export(rig="mixamo", target=tmp_path / "rest.usda")
    with pytest.raises(InputError, match="no rest transform for each of its 2 joints"):
        check_writable(tmp_path / "clip.bvh", export)


EDITS = st.lists(
    st.tuples(
        st.floats(0.0, 1.0),
        st.integers(0, 12),
        st.binary(max_size=6)
        | st.sampled_from(
            [b"{", b"}", b"\n", b"1e300", b"nan", b"-1", b"[", b'"', b"0"]
        ),
    ),
    min_size=1,
    max_size=4,
)


@pytest.fixture(scope="module")
def files(clip: Clip, tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """Return a map and skeletons in each format, by the suffix of their files."""
    folder = tmp_path_factory.mktemp("good")
    rig = built_rig(load_rig_map("mixamo"), clip.body)
    write_target(rig, folder / "rest.usda", up="Y", meters=1.0)
    write_clip(clip.at(slice(2)), folder / "rest.bvh", MIXAMO)
    source = Path(rig_map_module.__file__).with_name("rigs") / "mixamo.toml"
    return {
        ".toml": source.read_bytes(),
        ".usda": (folder / "rest.usda").read_bytes(),
        ".bvh": (folder / "rest.bvh").read_bytes(),
    }


@settings(
    max_examples=120,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(suffix=st.sampled_from([".toml", ".usda", ".bvh"]), edits=EDITS)
def test_a_damaged_map_or_target_is_followed_or_refused(
    clip: Clip,
    files: dict[str, bytes],
    tmp_path: Path,
    suffix: str,
    edits: list[tuple[float, int, bytes]],
) -> None:
    data = files[suffix]
    for place, length, piece in edits:
        start = int(place * len(data))
        data = data[:start] + piece + data[start + length :]
    path = tmp_path / f"damaged{suffix}"
    path.write_bytes(data)
    name, target = (str(path), None) if suffix == ".toml" else ("mixamo", path)
    try:
        with pytest.MonkeyPatch.context() as here:  # a process for each takes long
            here.setattr(clips, "read_usd", lambda _, file: rest_arrays(file))
            rig = target_rig(name, target, clip.body)
    except InputError:
        return
    motion = retarget(clip.at(slice(3)), rig)
    assert np.isfinite(motion.positions).all()
    assert np.isfinite(motion.rotations).all()


@pytest.mark.parametrize(
    ("out", "flags", "words"),
    [
        ("clip.bvh", ["--rig", "maya"], "unknown rig 'maya'"),
        ("clip.bvh", ["--rig", "none.toml"], "none.toml"),
        ("clip.csv", ["--rig", "mixamo"], "--rig does not apply to .csv"),
        ("clip.npz", ["--rig", "vrm", "--target", "rest.bvh"], "--target does not"),
        ("clip.bvh", ["--target", "rest.bvh"], "needs --rig"),
        ("clip.bvh", ["--rig", "vrm", "--target", "rest.fbx"], "expected .bvh, .usda"),
        ("clip.bvh", ["--rig", "vrm", "--target", "rest.bvh"], "rest.bvh"),
        ("clip.bvh", ["--rig", "vrm", "--rest", "t"], "--rest is only"),
        ("clip.usda", ["--rig", "vrm", "--character", "c.usda"], "--character is"),
    ],
)
def test_what_does_not_go_together_ends_with_2_and_writes_nothing(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    out: str,
    flags: list[str],
    words: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["clean", str(SAMPLE), "-o", out, *flags]) == 2
    assert words in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_clip_does_not_overwrite_its_target_or_map(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mixamo: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("rest.bvh").write_text(mixamo)
    flags = ["--rig", "mixamo", "--target", "rest.bvh"]
    assert main(["clean", str(SAMPLE), "-o", "rest.bvh", *flags]) == 2
    assert Path("rest.bvh").read_text() == mixamo


def test_the_command_line_writes_a_rig(tmp_path: Path) -> None:
    path = tmp_path / "clip.bvh"
    flags = ["--rig", "unity", "--method", "none", "--no-physics"]
    assert main(["clean", str(SAMPLE), "-o", str(path), *flags]) == 0
    assert read_bvh(path).names[:3] == ("Hips", "Spine", "Chest")
