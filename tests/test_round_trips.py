"""What USD and BVH hold is the clip, whatever the axes, unit, rate and rest pose."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from pxr import Usd, UsdGeom, UsdSkel
from usd_positions import read_usd_positions

from kinefilter.characters import (
    KINECT_V1,
    KINECT_V2,
    Body,
    Clip,
    InputError,
    positions_from_rotations,
    standard_body,
)
from kinefilter.characters.rotations import (
    inverse,
    multiply,
    rotate,
    rotation_vector,
    wxyz_from_euler,
)
from kinefilter.pipeline.formats import (
    Export,
    read_bvh,
    read_clip,
    read_take,
    write_clip,
)
from kinefilter.pipeline.formats.bvh import continuous_euler
from kinefilter.pipeline.formats.export import RotationOrder, in_strict_t, resampled
from kinefilter.pipeline.formats.rig import rig_of
from kinefilter.scenes.library import random_body

Array = NDArray[np.float64]
MakeClip = Callable[..., Clip]
TENTH_OF_A_MILLIMETER = 1e-4
RADIANS = 1e-4


@st.composite
def bodies(draw: st.DrawFn) -> Body:
    """Draw a body of random size, build and rest directions."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    body = random_body(draw(st.sampled_from([KINECT_V1, KINECT_V2])), rng)
    tilted = body.directions + draw(st.floats(0.0, 0.5)) * rng.normal(
        size=body.directions.shape
    )
    tilted[body.skeleton.root] = 0.0
    tilted /= np.maximum(np.linalg.norm(tilted, axis=1, keepdims=True), 1e-9)
    lengths = body.lengths * rng.uniform(0.5, 1.5, body.lengths.shape)
    return replace(body, directions=tilted, lengths=lengths)


exports = st.builds(
    Export,
    up=st.sampled_from(["y", "z"]),
    units=st.sampled_from(["m", "cm"]),
    rest=st.sampled_from(["own", "t"]),
    fps=st.sampled_from([None, 24.0, 29.97, 30.0, 60.0]),
)
motions = {
    "body": bodies(),
    "seed": st.integers(0, 2**32 - 1),
    "wild": st.booleans(),
    "start": st.floats(0.0, 1e4),
    "steps": st.lists(st.sampled_from([1 / 30, 0.0334, 0.5]), min_size=1, max_size=6),
}
round_trip = settings(
    max_examples=25,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)


def made(make_clip: MakeClip, options: dict[str, object]) -> Clip:
    body, steps = options["body"], options["steps"]
    assert isinstance(body, Body)
    assert isinstance(steps, list)
    return make_clip(
        skeleton=body.skeleton,
        body=body,
        seed=options["seed"],
        wild=options["wild"],
        time=options["start"] + np.cumsum([0.0, *steps]),
    )


def as_written(clip: Clip, export: Export) -> Clip:
    """Return a clip in the rest pose and at the rate that it is written in."""
    clip = resampled(clip, export.fps) if export.fps else clip
    return in_strict_t(clip) if export.rest == "t" else clip


def turned_by(a: Array, b: Array) -> float:
    """Return the largest angle between rotations [rad]."""
    apart = rotation_vector(multiply(inverse(a), b))
    return float(np.linalg.norm(apart, axis=-1).max())


@round_trip
@given(
    options=st.fixed_dictionaries(motions),
    export=exports,
    order=st.sampled_from(get_args(RotationOrder)),
)
def test_bvh_keeps_places_rotations_names_and_frame_time(
    make_clip: MakeClip,
    tmp_path: Path,
    options: dict[str, object],
    export: Export,
    order: RotationOrder,
) -> None:
    clip, export = made(make_clip, options), replace(export, rotation_order=order)
    write_clip(clip, tmp_path / "clip.bvh", export)
    clip, bvh = as_written(clip, export), read_bvh(tmp_path / "clip.bvh")
    assert len(bvh) == len(clip)
    rig = rig_of(clip.body)
    nodes = [n for n, name in enumerate(bvh.names) if not name.endswith("End")]
    assert [bvh.names[n] for n in nodes] == list(rig.names)
    turns = [c[0].lower() for c in bvh.channels[0] if c.endswith("rotation")]
    assert "".join(turns) == order
    if export.fps:
        assert bvh.frame_time == 1.0 / export.fps
    else:
        duration = float(clip.time[-1] - clip.time[0])
        assert bvh.frame_time == duration / (len(clip) - 1)
    joints = [bvh.names.index(joint) for joint in clip.skeleton.joints]
    meters = bvh.positions[:, joints] * export.meters_per_unit
    np.testing.assert_allclose(
        meters, export.axes(clip.positions), rtol=0, atol=TENTH_OF_A_MILLIMETER
    )
    expected = export.axes(clip.rotations[:, rig.segments])
    assert turned_by(bvh.rotations[:, nodes], expected) < RADIANS


@settings(parent=round_trip, max_examples=10)  # each makes a skin
@given(
    options=st.fixed_dictionaries(motions),
    export=exports,
    extension=st.sampled_from([".usda", ".usdc", ".usdz"]),
)
def test_usd_keeps_places_rotations_names_and_frame_time(
    make_clip: MakeClip,
    tmp_path: Path,
    options: dict[str, object],
    export: Export,
    extension: str,
) -> None:
    clip, path = made(make_clip, options), tmp_path / f"clip{extension}"
    write_clip(clip, path, export)
    clip = as_written(clip, export)
    time, names, meters = read_usd_positions(path)
    # Time codes are rounded to a millionth of a frame.
    rounding = 1e-6 / (export.fps or clip.fps)
    np.testing.assert_allclose(time, clip.time - clip.time[0], rtol=0, atol=rounding)
    stage = Usd.Stage.Open(str(path))
    if export.fps:
        assert stage.GetTimeCodesPerSecond() == export.fps
    rig = rig_of(clip.body)
    assert names == rig.names
    joints = [names.index(joint) for joint in clip.skeleton.joints]
    np.testing.assert_allclose(
        meters[:, joints],
        export.axes(clip.positions),
        rtol=0,
        atol=TENTH_OF_A_MILLIMETER,
    )
    query = UsdSkel.Cache().GetSkelQuery(
        UsdSkel.Skeleton(stage.GetPrimAtPath("/Character/Skeleton"))
    )
    codes = query.GetAnimQuery().GetJointTransformTimeSamples()
    if export.fps:
        assert codes == list(range(len(clip)))
    matrices = np.array([query.ComputeJointSkelTransforms(code) for code in codes])
    # USD's matrices act on rows.
    axes = np.swapaxes(matrices[..., :3, :3], -1, -2)
    expected = export.axes(clip.rotations[:, rig.segments])
    for k, unit in enumerate(np.eye(3)):
        apart = np.linalg.norm(axes[..., k] - rotate(expected, unit), axis=-1)
        assert apart.max() < RADIANS


@settings(max_examples=60, deadline=None)
@given(
    order=st.sampled_from(get_args(RotationOrder)),
    seed=st.integers(0, 2**32 - 1),
    lock=st.sampled_from([-90.0, 90.0, 89.9999999, 30.0]),
)
def test_angles_of_every_order_give_the_rotation_back_and_do_not_jump(
    order: str, seed: int, lock: float
) -> None:
    rng = np.random.default_rng(seed)
    triples = rng.uniform(-np.pi, np.pi, (20, 3))
    triples[5:15, 1] = np.radians(lock)
    rotations = wxyz_from_euler(triples, order.upper())
    angles = continuous_euler(rotations, order.upper())
    again = wxyz_from_euler(angles, order.upper())
    dots = np.abs(np.sum(rotations * again, axis=-1))
    np.testing.assert_allclose(dots, 1.0, atol=1e-12)
    assert np.abs(np.diff(angles, axis=0)).max() <= np.pi + 1e-9


def test_with_z_up_the_person_faces_minus_y_and_left_stays_left() -> None:
    export = Export(up="z", units="cm")
    points = export.points(np.array([[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]]))
    np.testing.assert_allclose(points, [[100.0, 0, 0], [0, 0, 100.0], [0, -100.0, 0]])
    rng = np.random.default_rng(0)
    turn, vector = rng.normal(size=(5, 4)), rng.normal(size=(5, 3))
    turn /= np.linalg.norm(turn, axis=1, keepdims=True)
    np.testing.assert_allclose(
        rotate(export.axes(turn), export.axes(vector)),
        export.axes(rotate(turn, vector)),
    )


# Rest pose


def test_a_strict_t_is_square_and_leaves_every_joint_where_it_was(
    make_clip: MakeClip,
) -> None:
    rng = np.random.default_rng(0)
    body = random_body(KINECT_V2, rng)
    tilted = body.directions + 0.2 * rng.normal(size=body.directions.shape)
    tilted /= np.linalg.norm(tilted, axis=1, keepdims=True)
    clip = make_clip(6, KINECT_V2, body=replace(body, directions=tilted), wild=True)
    strict = in_strict_t(clip)
    np.testing.assert_array_equal(
        strict.body.directions, standard_body(KINECT_V2).directions
    )
    root = strict.positions[:, KINECT_V2.root]
    again = positions_from_rotations(strict.rotations, root, strict.body)
    np.testing.assert_allclose(again, clip.positions, atol=1e-12)


# Frame rate


def test_at_its_own_rate_a_clip_is_the_same(make_clip: MakeClip) -> None:
    clip = make_clip(40)
    again = resampled(clip, 30.0)
    np.testing.assert_allclose(again.time, clip.time, atol=1e-12)
    np.testing.assert_allclose(again.positions, clip.positions, atol=1e-9)
    np.testing.assert_allclose(again.reliability, clip.reliability, atol=1e-9)
    np.testing.assert_array_equal(again.origin, clip.origin)
    np.testing.assert_array_equal(again.contacts, clip.contacts)


@given(fps=st.floats(1.0, 240.0), seed=st.integers(0, 2**32 - 1))
@settings(max_examples=20, deadline=None)
def test_resampled_frames_are_even_whole_and_between_their_neighbors(
    make_clip: MakeClip, fps: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    time = 5.0 + np.cumsum(rng.choice([0.0, 1 / 30, 0.2], 12))
    clip = make_clip(seed=seed, time=time)
    again = resampled(clip, fps)
    assert again.time[0] == time[0]
    assert time[-1] - 1.0 / fps < again.time[-1] <= time[-1] + 1e-5 / fps
    np.testing.assert_allclose(np.diff(again.time), 1.0 / fps, rtol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(again.rotations, axis=-1), 1.0)
    lengths = np.linalg.norm(
        again.positions[:, KINECT_V1.segments]
        - again.positions[:, KINECT_V1.segment_parents],
        axis=-1,
    )
    np.testing.assert_allclose(
        lengths, np.broadcast_to(clip.body.lengths[KINECT_V1.segments], lengths.shape)
    )
    root = KINECT_V1.root
    for axis in range(3):
        last = np.append(np.diff(time) > 0, True)
        line = np.interp(again.time, time[last], clip.positions[last, root, axis])
        np.testing.assert_allclose(again.positions[:, root, axis], line, atol=1e-9)


def test_csv_and_npz_are_resampled_too(make_clip: MakeClip, tmp_path: Path) -> None:
    clip, export = make_clip(31), Export(fps=60.0)
    for name, read in (("clip.csv", read_take), ("clip.npz", read_clip)):
        write_clip(clip, tmp_path / name, export)
        np.testing.assert_allclose(
            read(tmp_path / name).time, np.arange(61) / 60.0, atol=1e-12
        )


# What goes with what


@pytest.mark.parametrize(
    ("name", "export", "words"),
    [
        ("clip.csv", Export(up="z"), "--up .*\\.csv.*\\.bvh"),
        ("clip.npz", Export(units="cm"), "--units .*\\.npz"),
        ("clip.usda", Export(rotation_order="zxy"), "--rotation-order .*\\.usda"),
        ("clip.bvh", Export(character=Path("c.usda")), "--character .*\\.bvh"),
        ("clip.usdz", Export(character=Path("c.usda")), "--character .*\\.usdz"),
        ("clip.usda", Export(character=Path("c.bvh")), "--character .*expected"),
    ],
)
def test_what_a_kind_of_file_cannot_follow_is_refused(
    make_clip: MakeClip, tmp_path: Path, name: str, export: Export, words: str
) -> None:
    with pytest.raises(InputError, match=words):
        write_clip(make_clip(2), tmp_path / name, export)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("fps", [0.0, -1.0, 1e6, float("nan"), float("inf")])
def test_a_frame_rate_of_no_camera_is_refused(fps: float) -> None:
    with pytest.raises(InputError, match="--fps"):
        Export(fps=fps)


def test_stage_and_skeleton_agree_on_axes_and_unit(
    make_clip: MakeClip, tmp_path: Path
) -> None:
    write_clip(make_clip(3), tmp_path / "clip.usda", Export(up="z", units="cm"))
    stage = Usd.Stage.Open(str(tmp_path / "clip.usda"))
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    assert UsdGeom.GetStageMetersPerUnit(stage) == 0.01
    points = np.array(stage.GetAttributeAtPath("/Character/Skin.points").Get())
    assert points[:, 2].min() == pytest.approx(0.0, abs=0.4)
    assert 165.0 < points[:, 2].max() < 180.0
