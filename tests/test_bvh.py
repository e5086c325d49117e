from __future__ import annotations

import gzip
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from real_data import CMU, captured
from scipy.spatial.transform import Rotation
from text_files import write_text

from kinefilter.characters import KINECT_V1, KINECT_V2, Clip, InputError, Skeleton
from kinefilter.characters.rotations import wxyz_from_euler
from kinefilter.pipeline.formats import Bvh, read_bvh, write_clip
from kinefilter.pipeline.formats.bvh import continuous_euler

MakeClip = Callable[..., Clip]
SMALL = """HIERARCHY
ROOT Hips
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Yrotation Xrotation Zrotation
  JOINT Left Leg {
    OFFSET 1 0 0
    CHANNELS 4 Xrotation Yposition Zrotation Yrotation
    End Site
    {
      OFFSET 0 -2 0
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.04
1 2 3 0 0 0 0 5 0 0
0 0 0 90 0 0 0 5 90 0
"""


def round_trip(clip: Clip, folder: Path) -> Bvh:
    write_clip(clip, folder / "clip.bvh")
    return read_bvh(folder / "clip.bvh")


# Round trips


@settings(
    max_examples=25,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(
    skeleton=st.sampled_from([KINECT_V1, KINECT_V2]),
    seed=st.integers(0, 2**32 - 1),
    wild=st.booleans(),
    start=st.floats(0.0, 1e4),
    steps=st.lists(st.sampled_from([0.0, 1 / 30, 0.5]), min_size=1, max_size=8),
)
def test_bvh_puts_every_joint_where_the_clip_has_it(
    make_clip: MakeClip,
    tmp_path: Path,
    skeleton: Skeleton,
    seed: int,
    wild: bool,
    start: float,
    steps: list[float],
) -> None:
    time = start + np.cumsum([0.0, *steps])
    clip = make_clip(skeleton=skeleton, seed=seed, wild=wild, time=time)
    bvh = round_trip(clip, tmp_path)
    columns = [bvh.names.index(joint) for joint in skeleton.joints]
    np.testing.assert_allclose(
        bvh.positions[:, columns], clip.positions, rtol=0, atol=2e-6
    )
    if time[-1] > time[0]:
        assert bvh.time[-1] == pytest.approx(time[-1] - time[0])
    assert np.abs(np.diff(bvh.motion[:, 3:], axis=0)).max() <= 180.0 + 1e-4


def test_every_leaf_has_an_end_site_that_goes_on_along_its_bone(
    make_clip: MakeClip, tmp_path: Path
) -> None:
    bvh = round_trip(make_clip(2, KINECT_V2), tmp_path)
    ends = [n for n, name in enumerate(bvh.names) if name.endswith("End")]
    leaves = [j for j, c in enumerate(KINECT_V2.children) if not c]
    assert {bvh.names[n] for n in ends} == {f"{KINECT_V2.joints[j]}End" for j in leaves}
    for n in ends:
        bone, end = bvh.offsets[bvh.parents[n]], bvh.offsets[n]
        assert np.linalg.norm(end) > 0.0
        np.testing.assert_allclose(end, 0.3 * bone, atol=1e-8)


# Angles


def test_angles_that_swing_through_the_lock_take_steps_as_small_as_they_did() -> None:
    time = np.linspace(0.0, 6.0, 2000)[:, None]
    swung = 2.5 * np.sin(time * [0.7, 1.1, 1.7] + [0.3, 0.1, 0.7])
    angles = continuous_euler(wxyz_from_euler(swung, "ZYX"), "ZYX")
    steps, found = (np.abs(np.diff(path, axis=0)) for path in (swung, angles))
    np.testing.assert_allclose(found, steps, atol=1e-6)


@pytest.mark.parametrize("axis", ["X", "Y", "Z"])
@pytest.mark.parametrize("step", [1.0, 7.0, -90.0])
def test_two_full_turns_about_an_axis_are_720_degrees_without_a_jump(
    axis: str, step: float
) -> None:
    turns = np.radians(np.arange(0.0, np.copysign(721.0, step), step))[:, None]
    angles = continuous_euler(wxyz_from_euler(turns, axis), "ZYX")
    expected = np.zeros((len(turns), 3))
    expected[:, "ZYX".index(axis)] = turns[:, 0]
    np.testing.assert_allclose(angles, expected, atol=1e-7)


def test_each_frame_has_the_nearest_of_the_equivalent_angles(
    make_clip: MakeClip,
) -> None:
    angles = continuous_euler(make_clip(400).rotations[:, 3], "ZYX")
    steps = np.abs(np.diff(angles, axis=0))
    other = angles[1:] * [1, -1, 1] + np.pi - angles[:-1]
    turned = np.abs((other + np.pi) % (2 * np.pi) - np.pi)
    assert (steps <= np.pi + 1e-9).all()
    assert ((steps**2).sum(axis=-1) <= (turned**2).sum(axis=-1) + 1e-9).all()


@settings(deadline=None)
@given(
    axes=st.sampled_from(["ZYX", "ZXY", "YXZ", "XYZ", "YZX", "XZY", "X", "ZY"]),
    seed=st.integers(0, 2**32 - 1),
)
def test_euler_angles_mean_what_scipy_takes_them_for(axes: str, seed: int) -> None:
    angles = np.random.default_rng(seed).uniform(-7.0, 7.0, (5, len(axes)))
    theirs = Rotation.from_euler(axes, angles).as_quat(scalar_first=True)
    ours = wxyz_from_euler(angles, axes)
    np.testing.assert_allclose(np.abs(np.sum(ours * theirs, axis=-1)), 1.0, atol=1e-12)


# Reading


def test_any_channel_order_and_position_channels_on_a_joint_are_read(
    tmp_path: Path,
) -> None:
    bvh = read_bvh(write_text(tmp_path / "small.bvh", SMALL))
    assert bvh.names == ("Hips", "Left Leg", "Left LegEnd")
    assert bvh.parents == (-1, 0, 1)
    assert bvh.frame_time == 0.04
    expected = [
        [[1, 2, 3], [2, 7, 3], [2, 5, 3]],
        [[0, 0, 0], [0, 5, -1], [0, 5, -3]],
    ]
    np.testing.assert_allclose(bvh.positions, expected, atol=1e-12)
    np.testing.assert_allclose(bvh.rotations[0], [[1, 0, 0, 0]] * 3, atol=1e-12)


def test_a_zipped_bvh_is_the_same_bvh(tmp_path: Path) -> None:
    plain = read_bvh(write_text(tmp_path / "a.bvh", SMALL))
    (tmp_path / "b.bvh.gz").write_bytes(gzip.compress(SMALL.encode()))
    zipped = read_bvh(tmp_path / "b.bvh.gz")
    assert zipped.names == plain.names
    np.testing.assert_array_equal(zipped.motion, plain.motion)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (SMALL, "", "ends the file before the line MOTION"),
        ("HIERARCHY", "hello there", "line 1 is 'hello there'"),
        ("OFFSET 1 0 0", "OFFSET 1 0", "line 7 has offset '1 0'"),
        ("OFFSET 1 0 0", "OFFSET 1 0 x", "line 7 has offset '1 0 x'"),
        ("CHANNELS 4", "CHANNELS 3", "line 8 has channels '3 Xrotation"),
        ("Zrotation Yrotation", "Zrotation Wrotation", "line 8 has channels"),
        ("  }\n}\n", "  }\n", "line 14 begins the motion inside the hierarchy"),
        ("Frames: 2", "Frames: two", "line 16 is 'Frames: two'"),
        ("Frame Time: 0.04", "Frame Time: 0", "line 17 is 'Frame Time: 0'"),
        ("Frames: 2", "Frames: 3", "line 19 ends the motion after 2 frames"),
        ("1 2 3 0", "1 2 3", "row 18 has 9 columns, expected 10"),
        ("1 2 3", "1 b 3", "row 18, column Hips.Yposition is 'b'"),
        ("1 2 3", "1 nan 3", "row 18, column Hips.Yposition is not a number"),
        ("Frames: 2", "Frames: 1", "line 19 ends the motion after 2 frames"),
        ("Frames: 2", "Frames: 1e18", "1e+18 frames of 3 joints are more"),
        ("OFFSET 1 0 0", f"OFFSET {'1' * 2_000_000}", "row 7 does not end"),
        ("JOINT Left Leg {", "JOINT a {\n" * 20_000, "line 1005 is joint number 1001"),
    ],
)
def test_bad_bvh_is_refused_naming_file_and_line(
    tmp_path: Path, old: str, new: str, words: str
) -> None:
    assert old in SMALL
    path = write_text(tmp_path / "bad.bvh", SMALL.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        read_bvh(path)
    assert str(path) in str(caught.value)
    assert words in str(caught.value)


@settings(
    max_examples=150,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(
    edits=st.lists(
        st.tuples(
            st.integers(0, len(SMALL)),
            st.integers(0, 12),
            st.binary(max_size=6)
            | st.sampled_from([b"{", b"}", b"\n", b"1e400", b"nan", b"-1", b"JOINT "]),
        ),
        min_size=1,
        max_size=4,
    )
)
def test_a_damaged_bvh_is_read_or_refused(
    tmp_path: Path, edits: list[tuple[int, int, bytes]]
) -> None:
    data = SMALL.encode()
    for start, length, piece in edits:
        data = data[:start] + piece + data[start + length :]
    (tmp_path / "damaged.bvh").write_bytes(data)
    try:
        bvh = read_bvh(tmp_path / "damaged.bvh")
    except InputError:
        return
    assert np.isfinite(bvh.motion).all()
    assert bvh.positions.shape == (len(bvh), len(bvh.names), 3)


def test_a_gzip_bomb_ends_at_its_first_wrong_frame(tmp_path: Path) -> None:
    with gzip.open(tmp_path / "bomb.bvh.gz", "wt", compresslevel=1) as file:
        file.write(SMALL)
        for _ in range(200):
            file.write("0 0 0 0 0 0 0 0 0 0\n" * 5_000)
    with pytest.raises(InputError, match="ends the motion after"):
        read_bvh(tmp_path / "bomb.bvh.gz")


@captured
def test_motion_capture_stands_in_a_t_pose_in_its_first_frame() -> None:
    paths = sorted(CMU.glob("*.bvh.gz"))[::20]
    assert paths
    for path in paths:
        bvh = read_bvh(path)
        assert bvh.frame_time == pytest.approx(1 / 120, rel=1e-4)
        meters = 0.056444 * bvh.positions[0]
        joint = {name: meters[n] for n, name in enumerate(bvh.names)}
        arms = joint["LeftHand"] - joint["RightHand"]
        assert arms[0] > 1.0
        assert np.abs(arms[1:]).max() < 0.1
        assert joint["Head"][1] - joint["LeftFoot"][1] > 1.2


@captured
def test_motion_capture_keeps_its_bone_lengths() -> None:
    bvh = read_bvh(min(CMU.glob("*.bvh.gz")))
    parents = np.array(bvh.parents)
    bones = bvh.positions[:, 1:] - bvh.positions[:, parents[1:]]
    lengths = np.linalg.norm(bones, axis=-1)
    np.testing.assert_allclose(
        lengths,
        np.broadcast_to(np.linalg.norm(bvh.offsets[1:], axis=-1), lengths.shape),
        atol=1e-9,
    )
