"""Keys that are left out of GLB, and how near the curves through the others come."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline, CubicSpline
from skeletons import every_skeleton

from kinefilter import CleanConfig, clean
from kinefilter.characters import KINECT_V2, Clip, InputError, Skeleton
from kinefilter.characters.rotations import IDENTITY, inverse, multiply, rotation_vector
from kinefilter.pipeline.contents import contents_of
from kinefilter.pipeline.formats import Export, read_clip, read_take, write_clip
from kinefilter.pipeline.formats.keys import sparse_curves
from kinefilter.pipeline.formats.rig import rig_of
from kinefilter.pipeline.look.comparison import compare
from kinefilter.scenes import SAMPLE

Array = NDArray[np.float64]
MakeClip = Callable[..., Clip]
ROUNDING = 2e-6  # m


def samplers(path: Path) -> list[tuple[str, Array, Array]]:
    """Return how the samplers of a file go on between keys, their times, and values."""
    data = path.read_bytes()
    (size,) = struct.unpack_from("<I", data, 12)
    document = json.loads(data[20 : 20 + size])
    binary = data[28 + size :]

    def rows(index: int) -> Array:
        accessor = document["accessors"][index]
        begin = document["bufferViews"][accessor["bufferView"]]["byteOffset"]
        width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor["type"]]
        found = np.frombuffer(binary, "<f4", accessor["count"] * width, begin)
        return found.astype(float).reshape(accessor["count"], width)

    return [
        (s.get("interpolation", "LINEAR"), rows(s["input"]).ravel(), rows(s["output"]))
        for s in document["animations"][0]["samplers"]
    ]


def apart(clip: Clip, other: Clip) -> tuple[float, float]:
    """Return how far [m] joints, and how far [degrees] segments, are at most apart."""
    turned = rotation_vector(multiply(inverse(clip.rotations), other.rotations))
    away = np.linalg.norm(clip.positions - other.positions, axis=-1)
    angle = np.degrees(np.linalg.norm(turned, axis=-1))
    return float(away.max()), float(angle.max())


@settings(
    max_examples=25,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(
    error=st.sampled_from([0.1, 1.0, 5.0]),
    wild=st.booleans(),
    seed=st.integers(0, 999),
    steps=st.lists(
        st.sampled_from([0.0, 1 / 30, 0.0334, 0.5, 3.0]), min_size=1, max_size=30
    ),
)
def test_no_joint_is_farther_off_than_the_error_and_every_frame_comes_back(
    make_clip: MakeClip,
    tmp_path: Path,
    error: float,
    wild: bool,
    seed: int,
    steps: list[float],
) -> None:
    time = 5.0 + np.cumsum([0.0, *steps])
    clip = make_clip(seed=seed, wild=wild, time=time)
    write_clip(clip, tmp_path / "clip.glb")
    whole = read_clip(tmp_path / "clip.glb")
    write_clip(clip, tmp_path / "clip.glb", Export(keys=error))
    found = read_clip(tmp_path / "clip.glb")
    np.testing.assert_array_equal(found.time, whole.time)
    np.testing.assert_array_equal(found.reliability, whole.reliability)
    away, angle = apart(whole, found)
    assert away < error / 1000.0 + ROUNDING
    assert angle < 0.5 * error + 1e-3


def test_what_does_not_move_keeps_two_keys(make_clip: MakeClip, tmp_path: Path) -> None:
    clip = make_clip(1).at([0] * 90)
    object.__setattr__(clip, "time", np.arange(90) / 30.0)
    write_clip(clip, tmp_path / "clip.glb", Export(keys=0.01))
    ways, times, _ = zip(*samplers(tmp_path / "clip.glb"), strict=True)
    assert set(ways) == {"CUBICSPLINE"}
    assert {len(keys) for keys in times} == {2}
    assert {float(keys[-1]) for keys in times} == {float(np.float32(89 / 30))}


def test_an_ordinary_take_keeps_a_fifth_of_its_keys(tmp_path: Path) -> None:
    clip = clean(read_take(SAMPLE)).clip
    write_clip(clip, tmp_path / "whole.glb")
    write_clip(clip, tmp_path / "clip.glb", Export(keys=1.0))
    whole, few = (
        sum(len(times) for _, times, _ in samplers(tmp_path / name))
        for name in ("whole.glb", "clip.glb")
    )
    assert few < 0.2 * whole
    away, angle = apart(clip, read_clip(tmp_path / "clip.glb"))
    assert 0.9e-3 < away < 1e-3
    assert angle < 0.5
    shown = compare(read_clip(tmp_path / "clip.glb"), read_take(SAMPLE))
    np.testing.assert_allclose(shown.clip.positions, clip.positions, atol=1e-3)
    write_clip(clip.at(slice(1)), tmp_path / "still.glb", Export(keys=1.0))
    once, ten_seconds = (
        (tmp_path / name).stat().st_size for name in ("still.glb", "clip.glb")
    )
    assert once + 6 * (ten_seconds - once) < 1.2e6  # in a minute


@every_skeleton
def test_blender_makes_the_same_curves_of_the_keys_alone(
    make_clip: MakeClip, tmp_path: Path, skeleton: Skeleton
) -> None:
    """Its automatic handles: the acceleration continuous, both ends level."""
    write_clip(make_clip(60, skeleton, seed=2), tmp_path / "clip.glb", Export(keys=2.0))
    for way, times, rows in samplers(tmp_path / "clip.glb"):
        assert way == "CUBICSPLINE"
        before, values, after = np.moveaxis(rows.reshape(len(times), 3, -1), 1, 0)
        np.testing.assert_array_equal(before, after)
        spline = CubicSpline(times, values, bc_type="clamped")
        np.testing.assert_allclose(after, spline(times, 1), atol=2e-4)


def test_curves_do_not_swing_where_frames_are_missing() -> None:
    """Ahead at full speed, then nothing for four seconds, then ahead again."""
    rig = rig_of(clean(read_take(SAMPLE).at(slice(40))).clip.body)
    stamps = np.r_[np.arange(10), 130 + np.arange(10)] / 30.0
    path = np.zeros((20, 3))
    path[:, 2] = np.r_[np.arange(10), 9, 10 + np.arange(9)] * 0.05
    still = np.tile(IDENTITY, (20, len(rig), 1))
    curve = next(sparse_curves(rig, stamps, 1 / 30, {0: path}, still, 0.001))
    known = CubicHermiteSpline(curve.times, curve.values, curve.slopes)
    between = np.arange(9, 131) / 30.0
    assert np.abs(known(between)[:, 2] - 9 * 0.05).max() < 1e-3


def test_clips_of_rigs_are_told_as_whole(make_clip: MakeClip, tmp_path: Path) -> None:
    write_clip(make_clip(50), tmp_path / "rig.glb", Export(keys=20.0, rig="mixamo"))
    found: dict[str, Any] = contents_of(tmp_path / "rig.glb")
    assert (found["frames"], found["joints"]) == (50, 22)
    assert found["fps"] == pytest.approx(30.0)


def test_a_frame_alone_is_written_and_so_are_two(
    make_clip: MakeClip, tmp_path: Path
) -> None:
    for frames in (1, 2):
        write_clip(make_clip(frames), tmp_path / "clip.glb", Export(keys=1.0))
        assert len(read_clip(tmp_path / "clip.glb")) == frames


@pytest.mark.parametrize("keys", [0.0, -1.0, 1e4, float("nan")])
def test_errors_that_nobody_means_are_refused(keys: float) -> None:
    with pytest.raises(InputError, match=r"--keys .*expected 0\.01 to 100 mm"):
        Export(keys=keys)


def test_formats_with_a_key_in_every_frame_say_what_has_fewer(
    make_clip: MakeClip, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=r"--keys does not apply to \.usda.*\.glb"):
        write_clip(make_clip(3, KINECT_V2), tmp_path / "clip.usda", Export(keys=1.0))


def test_keys_are_left_out_of_what_is_cleaned_without_physics(tmp_path: Path) -> None:
    take = read_take(SAMPLE)
    clip = clean(take, CleanConfig(physics=False)).clip
    write_clip(clip, tmp_path / "clip.glb", Export(keys=5.0, fps=24.0))
    ways, times, _ = zip(*samplers(tmp_path / "clip.glb"), strict=True)
    assert set(ways) == {"CUBICSPLINE"}
    assert sum(map(len, times)) < 0.15 * len(times) * 24 * 10
