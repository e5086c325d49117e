"""Clips cut to a part, and what is left of their way over the floor."""

from __future__ import annotations

import json
from collections.abc import Callable
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from pxr import Usd, UsdSkel
from rig_motions import performed
from usd_positions import read_usd_positions

from kinefilter.characters import Clip, InputError
from kinefilter.characters.rotations import (
    about_x,
    inverse,
    multiply,
    rotate,
    rotation_vector,
)
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.contents import contents_of
from kinefilter.pipeline.formats import Export, read_bvh, read_clip, write_clip
from kinefilter.pipeline.formats.export import shaped, with_root_motion
from kinefilter.pipeline.formats.rig import RootMotion
from kinefilter.retarget.standardize import floor_frame

Array = NDArray[np.float64]
MakeClip = Callable[..., Clip]
SAMPLE = Path(__file__).parents[1] / "scenes" / "takes" / "wave_punch_bend.csv"
MILLIMETER, DEGREE = 1e-3, np.pi / 180
FORMATS = [".npz", ".usda", ".usdc", ".usdz", ".glb", ".bvh"]
LEFT = np.array([1.0, 0.0, 0.0])

every_format = pytest.mark.parametrize("suffix", FORMATS)
every_travel = pytest.mark.parametrize("root", ["travel", "in-place", "none"])


@pytest.fixture(scope="module")
def walk() -> Clip:
    """Return somebody who walks, turns and walks back, at minutes of their own."""
    clip = performed("walk")
    object.__setattr__(clip, "time", clip.time + 100.0)
    return clip.at(slice(150))


def yaw_of(clip: Clip) -> Array:
    return floor_frame(clip.root, clip.rotations[:, clip.skeleton.root], LEFT).yaw


def same(clip: Clip, other: Clip) -> bool:
    """Tell whether joints are within a millimeter, segments within half a degree."""
    turned = rotation_vector(multiply(inverse(clip.rotations), other.rotations))
    away = np.linalg.norm(clip.positions - other.positions, axis=-1)
    angle = np.linalg.norm(turned, axis=-1)
    return bool(away.max() < MILLIMETER and angle.max() < 0.5 * DEGREE)


# The part


@pytest.mark.usefixtures("usd_here")
@every_format
def test_a_part_has_its_frames_and_what_is_known_of_them(
    make_clip: MakeClip, tmp_path: Path, suffix: str
) -> None:
    clip = make_clip(60, time=7.0 + np.arange(60) / 30.0)
    path = tmp_path / f"clip{suffix}"
    write_clip(clip, path, Export(begin=0.5, end=1.2))
    found, part = read_clip(path), clip.at(slice(15, 37))
    assert same(part, found)
    since = found.time - found.time[0]
    np.testing.assert_allclose(since, part.time - part.time[0], atol=1e-5)
    if suffix != ".bvh":
        np.testing.assert_array_equal(found.origin, part.origin)
        np.testing.assert_array_equal(found.contacts, part.contacts)
    if suffix == ".npz":
        np.testing.assert_array_equal(found.time, part.time)


def test_a_part_is_cut_of_the_whole_cleaned_take(tmp_path: Path) -> None:
    words = ["clean", str(SAMPLE), "--no-physics", "-o"]
    assert main([*words, str(tmp_path / "whole.npz")]) == 0
    assert main([*words, str(tmp_path / "part.npz"), "--begin", "2", "--end", "3"]) == 0
    whole, part = (read_clip(tmp_path / f"{name}.npz") for name in ("whole", "part"))
    since = whole.time - whole.time[0]
    inside = (since >= 2.0 - 1e-6) & (since <= 3.0 + 1e-6)
    np.testing.assert_array_equal(part.positions, whole.positions[inside])


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--begin", "30"], "--begin 30 is after that"),
        (["--begin", "11", "--end", "12"], "end at 10 s; --begin 11 is after"),
        (["--begin", "3", "--end", "2"], "--begin 3 --end 2: expected seconds"),
        (["--begin", "-1"], "--begin -1: expected seconds"),
        (["--end", "0"], "--end 0: expected seconds"),
    ],
)
def test_spans_outside_of_the_take_are_refused_before_it_is_cleaned(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    options: list[str],
    words: str,
) -> None:
    monkeypatch.setattr("kinefilter.pipeline.cleaner.clean", None)
    out = tmp_path / "clip.npz"
    assert main(["clean", str(SAMPLE), "-o", str(out), *options]) == 2
    assert words in capsys.readouterr().err
    assert not out.exists()


def test_a_part_ends_with_the_clip_at_the_latest(make_clip: MakeClip) -> None:
    clip = make_clip(60)
    part = shaped(clip, Export(begin=0.5, end=100.0))
    np.testing.assert_array_equal(part.time, clip.time[15:])


def test_the_same_part_at_another_rate_begins_where_it_does(
    make_clip: MakeClip,
) -> None:
    clip = make_clip(60)
    part = shaped(clip, Export(begin=0.5, end=1.5, fps=10.0))
    np.testing.assert_allclose(part.time, 0.5 + np.arange(11) / 10.0)
    np.testing.assert_allclose(part.positions[0], clip.positions[15], atol=1e-12)


# The way over the floor


@every_travel
def test_csv_keeps_the_places_that_are_left(
    walk: Clip, tmp_path: Path, root: RootMotion
) -> None:
    write_clip(walk, tmp_path / "clip.csv", Export(root=root))
    away = (
        with_root_motion(walk, root).positions
        - read_clip(tmp_path / "clip.csv").positions
    )
    assert np.linalg.norm(away, axis=-1).max() < MILLIMETER


@pytest.mark.usefixtures("usd_here")
@every_format
@every_travel
def test_every_format_keeps_what_is_left(
    walk: Clip, tmp_path: Path, suffix: str, root: RootMotion
) -> None:
    write_clip(walk, tmp_path / f"clip{suffix}", Export(root=root))
    assert same(with_root_motion(walk, root), read_clip(tmp_path / f"clip{suffix}"))


def test_in_place_only_the_way_is_gone(walk: Clip) -> None:
    there = with_root_motion(walk, "in-place")
    np.testing.assert_allclose(there.root[:, [0, 2]], 0.0, atol=1e-12)
    from_root = walk.positions - walk.root[:, None] * [1.0, 0.0, 1.0]
    np.testing.assert_allclose(there.positions, from_root, atol=1e-12)
    np.testing.assert_allclose(yaw_of(there), yaw_of(walk))


def test_without_a_way_they_face_ahead_in_the_same_postures(walk: Clip) -> None:
    assert np.ptp(yaw_of(walk)) > 0.3
    there = with_root_motion(walk, "none")
    np.testing.assert_allclose(yaw_of(there), 0.0, atol=1e-9)
    np.testing.assert_allclose(there.root[:, [0, 2]], 0.0, atol=1e-12)
    np.testing.assert_allclose(there.positions[..., 1], walk.positions[..., 1])
    for clip in (walk, there):
        hands = clip.positions[:, clip.skeleton.sides("Hand")]
        reach = np.linalg.norm(hands - clip.root[:, None], axis=2)
        np.testing.assert_allclose(
            reach,
            np.linalg.norm(
                walk.positions[:, walk.skeleton.sides("Hand")] - walk.root[:, None],
                axis=2,
            ),
        )


@every_travel
def test_props_stay_where_the_person_has_them(
    walk: Clip, furnish: Callable[[Clip], Clip], root: RootMotion
) -> None:
    furnished = furnish(walk)
    there = with_root_motion(furnished, root)
    for before, after in zip(furnished.props, there.props, strict=True):
        seen = [
            rotate(
                inverse(clip.rotations[:, clip.skeleton.root]),
                prop.positions - clip.root,
            )
            for clip, prop in ((furnished, before), (there, after))
        ]
        np.testing.assert_allclose(*seen, atol=1e-9)


# Rigs


def places(path: Path, bone: str) -> tuple[Array, Array]:
    """Return a bone's places in its parent (T, 3), and rotations wxyz (T, 4)."""
    stage = Usd.Stage.Open(str(path))
    animation = UsdSkel.Animation(stage.GetPrimAtPath("/Character/Animation"))
    joints = [j.rpartition("/")[2] for j in animation.GetJointsAttr().Get()]
    column = joints.index(bone)
    moves, turns = animation.GetTranslationsAttr(), animation.GetRotationsAttr()
    codes = moves.GetTimeSamples()
    where = np.array([moves.Get(code)[column] for code in codes], dtype=float)
    real = [turns.Get(code)[column] for code in codes]
    return where, np.array([[q.GetReal(), *q.GetImaginary()] for q in real])


def test_the_root_of_a_rig_goes_below_its_pelvis_and_turns(
    walk: Clip, tmp_path: Path
) -> None:
    path = tmp_path / "clip.usdc"
    write_clip(walk, path, Export(rig="unreal"))
    root, turns = places(path, "root")
    pelvis, _ = places(path, "pelvis")
    np.testing.assert_allclose(root[:, 1], 0.0, atol=1e-6)
    np.testing.assert_allclose(pelvis[:, :2], 0.0, atol=1e-6)  # z is up, as in Unreal
    turns = multiply(turns, inverse(ROOTS_AXES))
    np.testing.assert_allclose(turns[:, [1, 3]], 0.0, atol=1e-6)
    yaw = 2.0 * np.arctan2(turns[:, 2], turns[:, 0])
    away = np.angle(np.exp(1j * (yaw - yaw_of(walk))))
    assert np.abs(away).max() < 1e-5
    hips = walk.positions[:, walk.skeleton.hips].mean(axis=1)
    assert np.ptp(root[:, 2]) == pytest.approx(np.ptp(hips[:, 2]), rel=0.1)


@pytest.mark.parametrize("rig", ["unreal", "mixamo"])
def test_on_rigs_the_way_is_taken_off_after_feet_were_planted(
    walk: Clip, tmp_path: Path, rig: str
) -> None:
    found: dict[str, Array] = {}
    for root in ("travel", "in-place", "none"):
        write_clip(walk, tmp_path / "clip.usdc", Export(rig=rig, root=root))
        _, names, found[root] = read_usd_positions(tmp_path / "clip.usdc")
    pelvis = names.index("pelvis" if rig == "unreal" else "mixamorig_Hips")
    level = np.array([1.0, 0.0, 1.0])
    way = found["travel"][:, pelvis : pelvis + 1] * level
    np.testing.assert_allclose(found["in-place"], found["travel"] - way, atol=1e-5)
    still = found["none"][:, pelvis] * level
    np.testing.assert_allclose(still, 0.0, atol=1e-5)
    thighs = [n for n, name in enumerate(names) if name in THIGHS[rig]]
    across = found["none"][:, thighs[0]] - found["none"][:, thighs[1]]
    np.testing.assert_allclose(across[:, 2], across[:, 2].mean(), atol=1e-5)
    if rig == "unreal":
        path = tmp_path / "clip.usdc"
        place, turn = places(path, "root")
        np.testing.assert_allclose(place, 0.0, atol=1e-6)
        turn = multiply(turn, inverse(ROOTS_AXES))
        np.testing.assert_allclose(np.abs(turn[:, 0]), 1.0, atol=1e-6)


ROOTS_AXES = about_x(-np.pi / 2.0)
"""Of unreal's root at rest: x to the left, z up."""
THIGHS = {
    "unreal": ("thigh_l", "thigh_r"),
    "mixamo": ("mixamorig_LeftUpLeg", "mixamorig_RightUpLeg"),
}


@every_travel
def test_bvh_and_usd_have_a_rig_in_the_same_places(
    walk: Clip, tmp_path: Path, root: RootMotion
) -> None:
    for suffix in ("bvh", "usda"):
        write_clip(walk, tmp_path / f"clip.{suffix}", Export(rig="unreal", root=root))
    bvh = read_bvh(tmp_path / "clip.bvh")
    _, names, positions = read_usd_positions(tmp_path / "clip.usda")
    columns = [bvh.names.index(name) for name in names]
    np.testing.assert_allclose(bvh.positions[:, columns], positions, atol=1e-4)


def test_vrm_avatars_stay_where_they_are(walk: Clip, tmp_path: Path) -> None:
    write_clip(walk, tmp_path / "clip.vrma", Export(root="in-place"))
    data = (tmp_path / "clip.vrma").read_bytes()
    document = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])
    (place,) = (
        document["animations"][0]["samplers"][channel["sampler"]]["output"]
        for channel in document["animations"][0]["channels"]
        if channel["target"]["path"] == "translation"
    )
    accessor = document["accessors"][place]
    begin = document["bufferViews"][accessor["bufferView"]]["byteOffset"]
    start = 28 + int.from_bytes(data[12:16], "little") + begin
    rows = np.frombuffer(data, "<f4", 3 * accessor["count"], start).reshape(-1, 3)
    np.testing.assert_allclose(rows[:, [0, 2]], 0.0, atol=1e-6)


# What is told of it


def test_files_and_info_say_that_feet_slide(walk: Clip, tmp_path: Path) -> None:
    for root, rig in product(("travel", "in-place"), (None, "unreal")):
        for suffix in (".glb", ".usdc", *[".npz"] * (rig is None)):
            write_clip(walk, tmp_path / f"clip{suffix}", Export(root=root, rig=rig))
            told = contents_of(tmp_path / f"clip{suffix}")
            assert told["in_place"] is (root == "in-place")
    data = (tmp_path / "clip.glb").read_bytes()
    assert b'"root":"in-place"' in data
    write_clip(walk, tmp_path / "clip.usdc", Export(root="none", rig="unreal"))
    stage = Usd.Stage.Open(str(tmp_path / "clip.usdc"))
    known = stage.GetPrimAtPath("/Character").GetAttribute("kinefilter:root")
    assert known.Get() == "none"


def test_a_folders_file_may_hold_these_options(tmp_path: Path) -> None:
    takes = tmp_path / "takes"
    takes.mkdir()
    (takes / "wave.csv").write_bytes(SAMPLE.read_bytes())
    (takes / "kinefilter.toml").write_text(
        'begin = 1\nend = 3.5\nloop = true\nroot = "none"\nkeys = 1.0\n'
        "physics = false\n"
    )
    words = ["batch", str(takes), "-o", str(tmp_path), "--to", "glb", "--jobs", "1"]
    assert main(words) == 0
    (path,) = tmp_path.rglob("wave.glb")
    clip = read_clip(path)
    assert clip.time[-1] - clip.time[0] == pytest.approx(2.5, abs=0.1)
    np.testing.assert_allclose(clip.root[:, [0, 2]], 0.0, atol=MILLIMETER)
    away = clip.positions[0] - clip.positions[-1]
    assert np.linalg.norm(away, axis=1).max() < 2 * MILLIMETER


@pytest.mark.parametrize("wrong", [float("nan"), -0.1])
def test_times_that_are_none_are_refused(wrong: float) -> None:
    with pytest.raises(InputError, match=r"--begin"):
        Export(begin=wrong)
