from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pxr import Usd, UsdGeom, UsdSkel, UsdValidation

from kinefilter.characters import KINECT_V1, KINECT_V2, Clip, InputError, Skeleton
from kinefilter.pipeline.formats import read_usd_positions, write_clip

MakeClip = Callable[..., Clip]

both_skeletons = pytest.mark.parametrize("skeleton", [KINECT_V1, KINECT_V2])
TENTH_OF_A_MILLIMETER = 1e-4


@settings(
    max_examples=25,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(
    skeleton=st.sampled_from([KINECT_V1, KINECT_V2]),
    extension=st.sampled_from([".usda", ".usdc", ".usd"]),
    seed=st.integers(0, 2**32 - 1),
    wild=st.booleans(),
    start=st.floats(0.0, 1e4),
    steps=st.lists(st.sampled_from([0.0, 1 / 30, 0.5]), min_size=1, max_size=8),
)
def test_usd_skel_puts_every_joint_where_the_clip_has_it(
    make_clip: MakeClip,
    tmp_path: Path,
    skeleton: Skeleton,
    extension: str,
    seed: int,
    wild: bool,
    start: float,
    steps: list[float],
) -> None:
    time = start + np.cumsum([0.0, *steps])
    clip = make_clip(skeleton=skeleton, seed=seed, wild=wild, time=time)
    path = tmp_path / f"clip{extension}"
    write_clip(clip, path)
    read_time, names, positions = read_usd_positions(path)
    columns = [names.index(joint) for joint in skeleton.joints]
    # A repeated stamp has one sample, the last frame's.
    last = np.append(np.diff(time) > 0, True)
    np.testing.assert_allclose(read_time, (time - time[0])[last], rtol=0, atol=1e-6)
    np.testing.assert_allclose(
        positions[:, columns],
        clip.positions[last],
        rtol=0,
        atol=TENTH_OF_A_MILLIMETER,
    )


@both_skeletons
@pytest.mark.parametrize("extension", [".usda", ".usdc"])
def test_usd_validation_has_nothing_to_say(
    make_clip: MakeClip, tmp_path: Path, skeleton: Skeleton, extension: str
) -> None:
    path = tmp_path / f"clip{extension}"
    write_clip(make_clip(4, skeleton), path)
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    assert len(validators) > 10
    context = UsdValidation.ValidationContext(validators)
    errors = context.Validate(Usd.Stage.Open(str(path)))
    assert [error.GetErrorAsString() for error in errors] == []


@pytest.mark.parametrize(
    ("fps", "rate"), [(30.0, 30.0), (29.97, 30.0), (25.0, 25.0), (14.5, 14.5)]
)
def test_stage_says_axis_unit_rate_and_range(
    make_clip: MakeClip, tmp_path: Path, fps: float, rate: float
) -> None:
    write_clip(make_clip(time=7.0 + np.arange(31) / fps), tmp_path / "clip.usdc")
    stage = Usd.Stage.Open(str(tmp_path / "clip.usdc"))
    assert UsdGeom.GetStageUpAxis(stage) == "Y"
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    assert stage.GetTimeCodesPerSecond() == pytest.approx(rate)
    assert stage.GetFramesPerSecond() == stage.GetTimeCodesPerSecond()
    assert stage.GetStartTimeCode() == 0.0
    assert stage.GetEndTimeCode() == pytest.approx(30.0 * rate / fps, abs=1e-6)
    assert stage.GetDefaultPrim().GetPath() == "/Character"
    assert Usd.ModelAPI(stage.GetDefaultPrim()).GetKind() == "component"


@both_skeletons
def test_every_joint_has_a_rest_and_a_bind_transform_in_t_pose(
    make_clip: MakeClip, tmp_path: Path, skeleton: Skeleton
) -> None:
    clip = make_clip(3, skeleton)
    write_clip(clip, tmp_path / "clip.usdc")
    stage = Usd.Stage.Open(str(tmp_path / "clip.usdc"))
    prim = UsdSkel.Skeleton(stage.GetPrimAtPath("/Character/Skeleton"))
    query = UsdSkel.Cache().GetSkelQuery(prim)
    assert query.HasBindPose()
    assert query.HasRestPose()
    names = [joint.rpartition("/")[2] for joint in prim.GetJointsAttr().Get()]
    columns = [names.index(joint) for joint in skeleton.joints]
    bind = np.array(query.GetJointWorldBindTransforms())
    rest = np.array(query.ComputeJointSkelTransforms(0.0, atRest=True))
    np.testing.assert_allclose(bind, rest, atol=1e-9)
    np.testing.assert_allclose(
        bind[columns, 3, :3], clip.body.rest_positions, atol=1e-9
    )


@both_skeletons
def test_only_the_root_ever_changes_place_in_its_parent(
    make_clip: MakeClip, tmp_path: Path, skeleton: Skeleton
) -> None:
    write_clip(make_clip(6, skeleton, wild=True), tmp_path / "clip.usdc")
    stage = Usd.Stage.Open(str(tmp_path / "clip.usdc"))
    animation = UsdSkel.Animation(stage.GetPrimAtPath("/Character/Animation"))
    translations = animation.GetTranslationsAttr()
    samples = np.array([translations.Get(c) for c in translations.GetTimeSamples()])
    assert len(samples) == 6
    assert np.ptp(samples[:, 0], axis=0).max() > 0.0
    assert np.ptp(samples[:, 1:], axis=0).max() == 0.0


def test_rotations_keep_their_sign_across_thousands_of_frames(
    make_clip: MakeClip, tmp_path: Path
) -> None:
    write_clip(make_clip(2500), tmp_path / "clip.usdc")
    stage = Usd.Stage.Open(str(tmp_path / "clip.usdc"))
    attribute = stage.GetAttributeAtPath("/Character/Animation.rotations")
    samples = np.array([attribute.Get(code) for code in attribute.GetTimeSamples()])
    assert len(samples) == 2500
    assert np.sum(samples[1:] * samples[:-1], axis=-1).min() > 0.0


def test_the_extent_holds_the_whole_motion(make_clip: MakeClip, tmp_path: Path) -> None:
    clip = make_clip(50)
    write_clip(clip, tmp_path / "clip.usdc")
    stage = Usd.Stage.Open(str(tmp_path / "clip.usdc"))
    low, high = np.array(
        UsdGeom.Boundable(stage.GetDefaultPrim()).GetExtentAttr().Get()
    )
    assert (low < clip.positions.min(axis=(0, 1))).all()
    assert (high > clip.positions.max(axis=(0, 1))).all()


def test_positions_are_read_in_world_meters(
    make_clip: MakeClip, tmp_path: Path
) -> None:
    clip = make_clip(3)
    write_clip(clip, tmp_path / "clip.usda")
    stage = Usd.Stage.Open(str(tmp_path / "clip.usda"))
    UsdGeom.XformCommonAPI(stage.GetDefaultPrim()).SetTranslate((100.0, 0.0, 0.0))
    UsdGeom.XformCommonAPI(stage.GetDefaultPrim()).SetRotate((0.0, 90.0, 0.0))
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    stage.Save()
    _, names, positions = read_usd_positions(tmp_path / "clip.usda")
    x, y, z = np.moveaxis(clip.positions[:, 0], -1, 0)
    expected = 0.01 * np.stack([z + 100.0, y, -x], axis=-1)
    np.testing.assert_allclose(
        positions[:, names.index("HipCenter")], expected, atol=1e-6
    )


def test_files_without_an_animated_skeleton_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_usd_positions(tmp_path / "none.usda")
    (tmp_path / "text.usda").write_text("text")
    with pytest.raises(InputError, match="cannot be read as USD"):
        read_usd_positions(tmp_path / "text.usda")
    (tmp_path / "empty.usda").write_text("#usda 1.0\n")
    with pytest.raises(InputError, match="no animated skeleton"):
        read_usd_positions(tmp_path / "empty.usda")
