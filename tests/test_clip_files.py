"""Clips read back from every file that they are written to."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from skeletons import every_skeleton

from kinefilter.characters import KINECT_V2, Body, Clip, InputError, Skeleton, State
from kinefilter.characters.rotations import inverse, multiply, rotation_vector
from kinefilter.pipeline.formats import Export, read_clip, write_clip
from kinefilter.pipeline.formats.export import in_strict_t, resampled
from kinefilter.scenes.library import random_body

MakeClip = Callable[..., Clip]
Furnish = Callable[[Clip], Clip]

USD = (".usda", ".usdc", ".usd", ".usdz")
EXPORTS = (
    Export(),
    Export(up="z", units="cm"),
    Export(up="z"),
    Export(units="cm", rest="t"),
    Export(fps=24.0),
)


def turned_by(a: Clip, b: Clip) -> float:
    """Return the largest angle between the rotations of two clips [rad]."""
    apart = rotation_vector(multiply(inverse(a.rotations), b.rotations))
    return float(np.linalg.norm(apart, axis=-1).max())


def as_written(clip: Clip, export: Export) -> Clip:
    clip = resampled(clip, export.fps) if export.fps else clip
    return in_strict_t(clip) if export.rest == "t" else clip


@every_skeleton
@pytest.mark.parametrize("suffix", [*USD, ".glb", ".bvh", ".npz", ".csv"])
def test_every_file_gives_the_motion_back(
    make_clip: MakeClip, tmp_path: Path, suffix: str, skeleton: Skeleton
) -> None:
    clip = make_clip(12, skeleton)
    write_clip(clip, tmp_path / f"clip{suffix}")
    found = read_clip(tmp_path / f"clip{suffix}")
    assert found.skeleton is skeleton
    np.testing.assert_allclose(found.positions, clip.positions, rtol=0, atol=1e-4)
    np.testing.assert_allclose(found.time, clip.time, rtol=0, atol=1e-7)
    np.testing.assert_allclose(found.body.lengths, clip.body.lengths, atol=1e-6)
    if suffix != ".csv":  # which leaves open how bones are turned about themselves
        assert turned_by(found, clip) < 1e-4


@pytest.fixture(scope="module")
def tilted_body() -> Body:
    """Return a body at rest in no T-pose; one for all tests, which share its skin."""
    rng = np.random.default_rng(0)
    body = random_body(KINECT_V2, rng)
    tilted = body.directions + 0.2 * rng.normal(size=body.directions.shape)
    tilted[KINECT_V2.root] = 0.0
    tilted /= np.maximum(np.linalg.norm(tilted, axis=1, keepdims=True), 1e-9)
    return replace(body, directions=tilted)


@pytest.mark.usefixtures("usd_here")
@pytest.mark.parametrize("suffix", [".usda", ".usdc", ".usdz", ".bvh"])
@pytest.mark.parametrize("export", EXPORTS)
def test_axes_and_unit_are_undone(
    make_clip: MakeClip,
    tilted_body: Body,
    tmp_path: Path,
    suffix: str,
    export: Export,
) -> None:
    clip = make_clip(12, KINECT_V2, body=tilted_body, wild=export.fps is None)
    write_clip(clip, tmp_path / f"clip{suffix}", export)
    found, clip = read_clip(tmp_path / f"clip{suffix}"), as_written(clip, export)
    np.testing.assert_allclose(found.positions, clip.positions, rtol=0, atol=1e-4)
    np.testing.assert_allclose(
        found.body.rest_offsets, clip.body.rest_offsets, atol=1e-6
    )
    np.testing.assert_allclose(found.time, clip.time, atol=1e-6)
    assert turned_by(found, clip) < 1e-4


@pytest.mark.usefixtures("usd_here")
@pytest.mark.parametrize("suffix", USD)
@pytest.mark.parametrize("export", EXPORTS[:2])
def test_usd_gives_back_where_every_joint_came_from(
    make_clip: MakeClip,
    furnish: Furnish,
    tmp_path: Path,
    suffix: str,
    export: Export,
) -> None:
    clip = furnish(make_clip(8, KINECT_V2))
    force = clip.external_force.copy()
    force[3:5] = np.nan
    clip = replace(clip, external_force=force, tilt=-0.1, floor=0.7)
    write_clip(clip, tmp_path / f"clip{suffix}", export)
    found = read_clip(tmp_path / f"clip{suffix}")
    for name in ("origin", "deciding_term", "contacts"):
        np.testing.assert_array_equal(getattr(found, name), getattr(clip, name))
    for name in ("reliability", "moved_by_correction", "uncertainty"):
        np.testing.assert_allclose(
            getattr(found, name), getattr(clip, name), rtol=1e-3, atol=1e-7
        )
    np.testing.assert_allclose(found.external_force, force, rtol=1e-6)
    assert (found.tilt, found.floor) == (clip.tilt, clip.floor)
    assert (found.state == State.TRACKED).all()  # as long as nobody writes it
    assert [prop.name for prop in found.props] == [
        prop.name.replace(" ", "_") for prop in clip.props
    ]
    for prop, other in zip(clip.props, found.props, strict=True):
        np.testing.assert_allclose(other.positions, prop.positions, atol=1e-6)
        np.testing.assert_allclose(other.rotations, prop.rotations, atol=1e-6)
        for shape, read in zip(prop.shapes, other.shapes, strict=True):
            assert read.kind == shape.kind
            np.testing.assert_allclose(read.half_extents, shape.half_extents, atol=1e-6)
            np.testing.assert_allclose(read.position, shape.position, atol=1e-6)
            np.testing.assert_allclose(read.rotation, shape.rotation, atol=1e-6)
            np.testing.assert_allclose(read.color, shape.color, atol=1e-6)
            np.testing.assert_allclose(read.points, shape.points, atol=1e-6)
            np.testing.assert_array_equal(read.triangles, shape.triangles)


@pytest.mark.usefixtures("usd_here")
def test_what_usd_does_not_say_is_unknown(make_clip: MakeClip, tmp_path: Path) -> None:
    clip = make_clip(4)
    clip = replace(clip, external_force=np.full(4, np.nan))
    write_clip(clip, tmp_path / "clip.usda")
    found = read_clip(tmp_path / "clip.usda")
    assert np.isnan(found.external_force).all()
    assert np.isnan([found.tilt, found.floor]).all()
    assert found.props == ()


@pytest.mark.usefixtures("usd_here")
def test_a_clip_that_refers_to_its_character_is_read(
    make_clip: MakeClip, tmp_path: Path
) -> None:
    clip = make_clip(4)
    export = Export(character=tmp_path / "sam.usda", units="cm")
    write_clip(clip, tmp_path / "clip.usdc", export)
    found = read_clip(tmp_path / "clip.usdc")
    np.testing.assert_allclose(found.positions, clip.positions, rtol=0, atol=1e-4)


@pytest.mark.parametrize("suffix", [".usda", ".usdz"])
def test_usd_on_the_rig_of_others_is_refused_with_what_to_do(
    make_clip: MakeClip, tmp_path: Path, suffix: str
) -> None:
    path = tmp_path / f"clip{suffix}"
    write_clip(make_clip(4), path, Export(rig="mixamo"))
    with pytest.raises(InputError, match=rf"clip\{suffix}: .*mixamorig.*without --rig"):
        read_clip(path)


@pytest.mark.usefixtures("usd_here")
def test_a_damaged_usd_clip_is_refused(make_clip: MakeClip, tmp_path: Path) -> None:
    write_clip(make_clip(4), tmp_path / "clip.usda")
    text = (tmp_path / "clip.usda").read_text()
    for old, new, words in (
        ('"measured", "corrected"', '"invented", "corrected"', "originNames"),
        ('"HipCenter", "Spine"', '"Spine", "HipCenter"', "kinefilter:joints"),
        ("quatf[] rotations.timeSamples", "quatf[] turns.timeSamples", "not match"),
    ):
        assert old in text
        (tmp_path / "odd.usda").write_text(text.replace(old, new))
        with pytest.raises(InputError, match=rf"odd\.usda: .*{words}"):
            read_clip(tmp_path / "odd.usda")


def test_what_is_no_clip_is_refused(tmp_path: Path) -> None:
    for name, words in (
        ("none.usda", "no such file"),
        ("clip.fbx", r"VRMA and FBX .* cannot be read back; give \.usda"),
        ("clip.VRMA", "cannot be read back"),
        ("clip.foo", r"unknown extension for a clip; give \.usda"),
        ("clip.usda", "cannot be read as USD"),
    ):
        if not name.startswith("none"):
            (tmp_path / name).write_text("text")
        with pytest.raises(InputError, match=words):
            read_clip(tmp_path / name)
