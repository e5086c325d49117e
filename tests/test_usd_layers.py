"""Clips over a character's layer, and the props of a scene."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mutations import mutated
from pxr import Usd, UsdGeom
from usd_positions import read_usd_positions

from kinefilter.characters import KINECT_V2, Clip, InputError, standard_body
from kinefilter.characters.rotations import rotate
from kinefilter.pipeline.contents import contents_of
from kinefilter.pipeline.formats import Export, read_clip, write_clip

MakeClip = Callable[..., Clip]
Furnish = Callable[[Clip], Clip]

TENTH_OF_A_MILLIMETER = 1e-4

# Layers


def of_height(clip: Clip, height: float) -> Clip:
    return replace(clip, body=standard_body(clip.skeleton, height=height))


def test_a_character_without_a_motion_is_told(
    make_clip: MakeClip, tmp_path: Path
) -> None:
    export = Export(character=tmp_path / "sam.usda")
    write_clip(make_clip(6), tmp_path / "clip.usda", export)
    with pytest.raises(InputError, match=r"only one at rest.*give a clip that refers"):
        contents_of(tmp_path / "sam.usda")


def test_many_clips_refer_to_one_character(make_clip: MakeClip, tmp_path: Path) -> None:
    (tmp_path / "shots").mkdir()
    character = tmp_path / "sam.usdc"
    export = Export(character=character)
    for seed in (1, 2):
        path, clip = tmp_path / "shots" / f"{seed}.usda", make_clip(6, seed=seed)
        clip = of_height(clip, clip.body.height * (0.98 + 0.02 * seed))
        write_clip(clip, path, export)
        if seed == 1:
            before = character.read_bytes()
        _, names, positions = read_usd_positions(path)
        columns = [names.index(joint) for joint in clip.skeleton.joints]
        np.testing.assert_allclose(
            positions[:, columns], clip.positions, rtol=0, atol=TENTH_OF_A_MILLIMETER
        )
        np.testing.assert_allclose(
            read_clip(path).positions, clip.positions, rtol=0, atol=1e-3
        )
        text = path.read_text(encoding="utf-8")
        assert "@./../sam.usdc@" in text
        assert str(tmp_path) not in text
        assert "points" not in text
        assert "restTransforms" not in text
    assert character.read_bytes() == before
    moved = (tmp_path / "shots").rename(tmp_path / "elsewhere")
    stage = Usd.Stage.Open(str(moved / "2.usda"))
    assert len(stage.GetAttributeAtPath("/Character/Skin.points").Get()) > 1000
    _, _, again = read_usd_positions(moved / "2.usda")
    np.testing.assert_array_equal(again, positions)


def test_a_character_that_does_not_fit_is_refused_and_left(
    make_clip: MakeClip, tmp_path: Path
) -> None:
    sam = tmp_path / "sam.usda"
    write_clip(make_clip(2), tmp_path / "a.usda", Export(character=sam))
    before = sam.read_bytes()
    for clip, export, words in (
        (make_clip(2, KINECT_V2), Export(character=sam), "joints"),
        (make_clip(2), Export(character=sam, up="z"), "y up"),
        (make_clip(2), Export(character=sam, units="cm"), "--units"),
        (of_height(make_clip(2), 2.1), Export(character=sam), "another size"),
    ):
        with pytest.raises(InputError, match=rf"sam\.usda: .*{words}"):
            write_clip(clip, tmp_path / "b.usda", export)
    stage = Usd.Stage.Open(str(sam))
    stage.RemovePrim("/Character/Skin")
    stage.GetPrimAtPath("/Character/Skeleton").RemoveProperty("bindTransforms")
    stage.Export(str(tmp_path / "bare.usda"))
    bare = Export(character=tmp_path / "bare.usda")
    with pytest.raises(InputError, match=r"bare\.usda: .*joints"):
        write_clip(make_clip(2), tmp_path / "b.usda", bare)
    (tmp_path / "text.usda").write_text("text")
    text = Export(character=tmp_path / "text.usda")
    with pytest.raises(InputError, match="cannot be read as USD"):
        write_clip(make_clip(2), tmp_path / "b.usda", text)
    assert not (tmp_path / "b.usda").exists()
    assert sam.read_bytes() == before


@pytest.mark.parametrize("seed", [37, 161])
def test_a_damaged_character_is_refused_by_its_name(
    make_clip: MakeClip, tmp_path: Path, seed: int
) -> None:
    sam = tmp_path / "sam.usdc"
    write_clip(make_clip(2), tmp_path / "a.usda", Export(character=sam))
    sam.write_bytes(mutated(sam.read_bytes(), random.Random(seed)))
    with pytest.raises(InputError, match=r"sam\.usdc: (cannot be read|.*joints)"):
        write_clip(make_clip(2), tmp_path / "b.usda", Export(character=sam))


# Props


@pytest.mark.parametrize("export", [Export(), Export(up="z", units="cm")])
def test_props_have_their_shape_place_and_motion(
    make_clip: MakeClip, furnish: Furnish, tmp_path: Path, export: Export
) -> None:
    clip = furnish(make_clip(4))
    write_clip(clip, tmp_path / "clip.usda", export)
    stage = Usd.Stage.Open(str(tmp_path / "clip.usda"))
    folder = stage.GetPrimAtPath("/Character/Props")
    kinds = [child.GetChild("Shape0").GetTypeName() for child in folder.GetChildren()]
    tolerance = TENTH_OF_A_MILLIMETER / export.meters_per_unit
    assert kinds == ["Cube", "Sphere", "Cylinder", "Capsule", "Mesh"]
    for k in range(len(clip)):
        cache = UsdGeom.BBoxCache(k, ["default"])
        for prim, prop in zip(folder.GetChildren(), clip.props, strict=True):
            frame = k if prop.moves else 0
            assert prim.GetName() == prop.name.replace(" ", "_")
            shape = prop.shapes[1]
            place = prop.positions[frame] + rotate(
                prop.rotations[frame], shape.position
            )
            # A mesh is not the same on both sides of its origin.
            if shape.kind == "mesh":
                continue
            bound = cache.ComputeWorldBound(prim.GetChild("Shape1"))
            center = np.array(bound.ComputeCentroid())
            np.testing.assert_allclose(
                center, export.points(place), rtol=1e-6, atol=tolerance
            )
            size = np.abs(export.points(shape.half_extents))
            matrix = np.array(bound.GetMatrix())[:3, :3]
            own = np.array(bound.GetBox().GetSize()) * np.linalg.norm(matrix, axis=1)
            np.testing.assert_allclose(own, 2.0 * size, rtol=1e-5)


def test_a_mesh_prop_has_its_points_and_triangles(
    make_clip: MakeClip, furnish: Furnish, tmp_path: Path
) -> None:
    clip = furnish(make_clip(4))
    write_clip(clip, tmp_path / "clip.usda")
    stage = Usd.Stage.Open(str(tmp_path / "clip.usda"))
    prims = stage.GetPrimAtPath("/Character/Props").GetChildren()
    found = [
        (UsdGeom.Mesh(prim.GetChild(f"Shape{n}")), shape)
        for prim, prop in zip(prims, clip.props, strict=True)
        for n, shape in enumerate(prop.shapes)
        if shape.kind == "mesh"
    ]
    assert found
    for mesh, shape in found:
        points = np.array(mesh.GetPointsAttr().Get())
        np.testing.assert_allclose(points, shape.points, atol=TENTH_OF_A_MILLIMETER)
        corners = np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
        np.testing.assert_array_equal(corners, shape.triangles)
        assert set(mesh.GetFaceVertexCountsAttr().Get()) == {3}
