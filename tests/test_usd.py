from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from pxr import Sdf, Usd, UsdGeom, UsdSkel, UsdValidation
from skeletons import every_skeleton
from usd_positions import read_usd_positions

from kinefilter.characters import (
    KINECT_V1,
    KINECT_V2,
    Clip,
    InputError,
    Origin,
    Skeleton,
    Term,
)
from kinefilter.characters.rotations import rotate
from kinefilter.characters.skin import INFLUENCES, skin_of
from kinefilter.pipeline.formats import Export, read_clip, write_clip

MakeClip = Callable[..., Clip]
Furnish = Callable[[Clip], Clip]

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


@every_skeleton
@pytest.mark.parametrize("scene", [False, True])
@pytest.mark.parametrize(
    ("extension", "export"),
    [
        (".usda", Export()),
        (".usdc", Export(up="z", units="cm")),
        (".usdz", Export(fps=24.0, rest="t")),
        (".usda", Export(character=Path("sam.usda"), units="cm")),
        (".usdc", Export(character=Path("sam.usdc"))),
    ],
)
def test_usd_validation_has_nothing_to_say(
    make_clip: MakeClip,
    furnish: Furnish,
    tmp_path: Path,
    skeleton: Skeleton,
    extension: str,
    export: Export,
    scene: bool,
) -> None:
    clip = make_clip(4, skeleton)
    if export.character is not None:
        export = replace(export, character=tmp_path / export.character)
    write_clip(furnish(clip) if scene else clip, tmp_path / f"clip{extension}", export)
    for path in tmp_path.iterdir():
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


@every_skeleton
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


@every_skeleton
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


# The skin


def skinned(stage: Usd.Stage, code: float) -> NDArray[np.float64]:
    """Return the points of the skin as OpenUSD itself moves them, shape (P, 3)."""
    cache, mesh = UsdSkel.Cache(), UsdGeom.Mesh(stage.GetPrimAtPath("/Character/Skin"))
    root = UsdSkel.Root(stage.GetDefaultPrim())
    cache.Populate(root, Usd.PrimDefaultPredicate)
    skeleton = UsdSkel.Skeleton(stage.GetPrimAtPath("/Character/Skeleton"))
    query = cache.GetSkinningQuery(mesh.GetPrim())
    points = mesh.GetPointsAttr().Get()
    transforms = cache.GetSkelQuery(skeleton).ComputeSkinningTransforms(code)
    assert query.ComputeSkinnedPoints(transforms, points, code)
    return np.array(points)


@every_skeleton
def test_openusd_skins_the_mesh_as_the_segments_move(
    make_clip: MakeClip, tmp_path: Path, skeleton: Skeleton
) -> None:
    clip = make_clip(5, skeleton)
    write_clip(clip, tmp_path / "clip.usdc")
    stage = Usd.Stage.Open(str(tmp_path / "clip.usdc"))
    skin, rest = skin_of(clip.body), clip.body.rest_positions
    starts = np.array([j if p < 0 else p for j, p in enumerate(skeleton.parents)])
    for k in range(len(clip)):
        moved = np.zeros_like(skin.points)
        for segments, weights in zip(skin.segments.T, skin.weights.T, strict=True):
            arms = skin.points - rest[starts[segments]]
            turned = rotate(clip.rotations[k, segments], arms)
            places = clip.positions[k, starts[segments]]
            moved += weights[:, None] * (places + turned)
        np.testing.assert_allclose(
            skinned(stage, k), moved, rtol=0, atol=TENTH_OF_A_MILLIMETER
        )


def test_the_skin_is_one_mesh_bound_to_the_skeleton(
    make_clip: MakeClip, tmp_path: Path
) -> None:
    write_clip(make_clip(2), tmp_path / "clip.usda")
    stage = Usd.Stage.Open(str(tmp_path / "clip.usda"))
    meshes = [prim for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh)]
    assert [str(mesh.GetPath()) for mesh in meshes] == ["/Character/Skin"]
    binding = UsdSkel.BindingAPI(meshes[0])
    assert meshes[0].HasAPI(UsdSkel.BindingAPI)
    assert binding.GetSkeleton().GetPrim() == stage.GetPrimAtPath("/Character/Skeleton")
    indices = binding.GetJointIndicesPrimvar()
    weights = binding.GetJointWeightsPrimvar()
    assert indices.GetElementSize() == weights.GetElementSize() == INFLUENCES
    shares = np.array(weights.Get()).reshape(-1, INFLUENCES)
    np.testing.assert_allclose(shares.sum(axis=1), 1.0, atol=1e-6)
    joints = binding.GetSkeleton().GetJointsAttr().Get()
    assert 0 <= min(indices.Get()) <= max(indices.Get()) < len(joints)


@pytest.mark.parametrize("export", [Export(), Export(up="z", units="cm")])
def test_extents_hold_joints_skin_and_props_in_every_frame(
    make_clip: MakeClip, furnish: Furnish, tmp_path: Path, export: Export
) -> None:
    clip = furnish(make_clip(8, KINECT_V2, wild=True))
    write_clip(clip, tmp_path / "clip.usdc", export)
    stage = Usd.Stage.Open(str(tmp_path / "clip.usdc"))

    def box(path: str, code: Usd.TimeCode | float) -> NDArray[np.float64]:
        return np.array(UsdGeom.Boundable.Get(stage, path).GetExtentAttr().Get(code))

    character, tiny = "/Character", 1e-6 / export.meters_per_unit
    for k in range(len(clip)):
        joints, points = export.points(clip.positions[k]), skinned(stage, k)
        low, high = box("/Character/Skeleton", k)
        np.testing.assert_allclose(low, joints.min(axis=0), rtol=1e-6, atol=tiny)
        np.testing.assert_allclose(high, joints.max(axis=0), rtol=1e-6, atol=tiny)
        low, high = box("/Character/Skin", k)
        assert (low < points.min(axis=0)).all()
        assert (high > points.max(axis=0)).all()
        outer = box(character, k)
        assert (outer[0] <= low).all()
        assert (outer[1] >= high).all()
        cache = UsdGeom.BBoxCache(k, ["default"])
        props = cache.ComputeWorldBound(stage.GetPrimAtPath("/Character/Props"))
        bounds = props.ComputeAlignedBox()
        assert (outer[0] <= np.array(bounds.GetMin()) + tiny).all()
        assert (outer[1] >= np.array(bounds.GetMax()) - tiny).all()
        whole = box(character, Usd.TimeCode.Default())
        assert (whole[0] <= outer[0]).all()
        assert (whole[1] >= outer[1]).all()


# Where the motion came from


def test_reliability_and_provenance_are_there_for_every_joint_and_frame(
    make_clip: MakeClip, tmp_path: Path
) -> None:
    clip = make_clip(5)
    write_clip(clip, tmp_path / "clip.usdc", Export(units="cm"))
    stage = Usd.Stage.Open(str(tmp_path / "clip.usdc"))

    def attribute(name: str) -> Usd.Attribute:
        return stage.GetDefaultPrim().GetAttribute(f"kinefilter:{name}")

    assert tuple(attribute("joints").Get()) == clip.skeleton.joints
    assert list(attribute("originNames").Get()) == [o.name.lower() for o in Origin]
    assert list(attribute("decidingTermNames").Get()) == [t.name.lower() for t in Term]
    for name, expected in (
        ("reliability", clip.reliability),
        ("decidingTerm", clip.deciding_term),
        ("origin", clip.origin),
        ("movedByCorrection", np.nan_to_num(clip.moved_by_correction, nan=-1.0)),
        ("movedByPhysics", clip.moved_by_physics),
        ("uncertainty", np.nan_to_num(clip.uncertainty, nan=-1.0)),
    ):
        assert attribute(name).IsCustom()
        samples = attribute(name).GetTimeSamples()
        found = np.array([attribute(name).Get(code) for code in samples], dtype=float)
        np.testing.assert_allclose(found, expected, atol=1e-3)


def test_usd_says_what_was_done_to_the_take_where_that_is_known(
    make_clip: MakeClip, tmp_path: Path
) -> None:
    clip = make_clip(3)
    known = replace(clip, tilt=-0.1, floor=0.7)
    for motion, expected in ((known, (-0.1, 0.7)), (clip, (None, None))):
        path = tmp_path / f"{'known' if motion is known else 'unknown'}.usdc"
        write_clip(motion, path, Export(units="cm"))
        stage = Usd.Stage.Open(str(path))
        character = stage.GetDefaultPrim()
        found = [
            character.GetAttribute(f"kinefilter:{name}").Get()
            if character.HasAttribute(f"kinefilter:{name}")
            else None
            for name in ("sensorTilt", "floorHeight")
        ]
        assert tuple(found) == expected


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
        read_clip(tmp_path / "none.usda")
    (tmp_path / "text.usda").write_text("text")
    with pytest.raises(InputError, match="cannot be read as USD"):
        read_clip(tmp_path / "text.usda")
    (tmp_path / "empty.usda").write_text("#usda 1.0\n")
    with pytest.raises(InputError, match="no animated skeleton"):
        read_clip(tmp_path / "empty.usda")


def test_a_package_for_which_there_is_no_room_is_refused_and_not_left(
    make_clip: MakeClip, tmp_path: Path
) -> None:
    resource = pytest.importorskip("resource")
    clip = make_clip(5)
    write_clip(clip, tmp_path / "clip.usdc")
    room = (tmp_path / "clip.usdc").stat().st_size + 10  # what a package adds is more
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, before[1]))
    try:
        with pytest.raises(InputError, match=r"clip\.usdz: cannot be written"):
            write_clip(clip, tmp_path / "clip.usdz")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert [path.name for path in tmp_path.iterdir()] == ["clip.usdc"]


def test_a_package_that_is_interrupted_leaves_nothing(
    make_clip: MakeClip, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def ended(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Sdf.ZipFileWriter, "AddFile", ended)
    with suppress(KeyboardInterrupt):  # whose traceback has to be gone, too
        write_clip(make_clip(3), tmp_path / "clip.usdz")
    assert list(tmp_path.iterdir()) == []
