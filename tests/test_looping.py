"""Clips that can be repeated: where they meet, and that standing feet stay."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from real_data import TAKES, recorded
from rig_motions import performed
from usd_positions import read_usd_positions

from kinefilter import CleanConfig, clean
from kinefilter.characters import KINECT_V1, Clip, InputError
from kinefilter.characters.arrays import runs
from kinefilter.characters.rotations import about_y, multiply, rotate
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.formats import Export, read_clip, read_take, write_clip
from kinefilter.retarget.limbs import shortage
from kinefilter.retarget.looping import _DEEPEST, looped, repeated

Array = NDArray[np.float64]
MakeClip = Callable[..., Clip]
SAMPLE = Path(__file__).parents[1] / "scenes" / "takes" / "wave_punch_bend.csv"
MILLIMETER = 1e-3

# Spans in which the same feet stand at both ends, but elsewhere and otherwise.
SPANS = [
    ("walk", 3, 156, 228),
    ("walk", 4, 62, 133),
    ("squat", 3, 7, 66),
    ("squat", 4, 98, 189),
    ("raise_leg", 3, 166, 240),
    ("step_over", 4, 214, 320),
]
every_span = pytest.mark.parametrize(("name", "seed", "begin", "end"), SPANS)


def part_of(name: str, seed: int, begin: int, end: int) -> Clip:
    return performed(name, seed=seed).at(slice(begin, end))


def slid(clip: Clip, positions: Array, contacts: Array) -> float:
    """Return how far [m] parts of the feet move at most while they stand."""
    ends = np.transpose([clip.skeleton.sides(p) for p in ("Ankle", "Foot")]).ravel()
    paths = [
        positions[stance, joint]
        for part, joint in enumerate(ends)
        for stance in runs(contacts[:-1, part])
    ]
    return max(float(np.linalg.norm(path - path[0], axis=1).max()) for path in paths)


def apart(clip: Clip) -> Array:
    """Return how far joints of first and last frame are apart, from the hips [m]."""
    turn = multiply(
        clip.rotations[-1, clip.skeleton.root],
        clip.rotations[0, clip.skeleton.root] * [1, -1, -1, -1],
    )
    first, last = clip.positions[[0, -1]] - clip.root[[0, -1], None]
    return np.linalg.norm(rotate(turn, first) - last, axis=1)


@every_span
def test_the_last_frame_is_the_first_and_standing_feet_stay(
    name: str, seed: int, begin: int, end: int
) -> None:
    clip = part_of(name, seed, begin, end)
    loop = looped(clip)
    assert apart(clip).max() > 20 * MILLIMETER
    assert apart(loop).max() < 1e-9
    assert loop.root[-1, 1] == pytest.approx(loop.root[0, 1])
    np.testing.assert_array_equal(loop.contacts[-1], loop.contacts[0])
    before = slid(clip, clip.positions, loop.contacts)
    assert slid(clip, loop.positions, loop.contacts) < before + 0.1 * MILLIMETER
    np.testing.assert_array_equal(loop.contacts[:-1], clip.contacts[:-1])
    unchanged = clip.time < clip.time[-1] - 0.41
    hands = clip.skeleton.sides("Hand")
    np.testing.assert_allclose(
        loop.positions[unchanged][:, hands],
        clip.positions[unchanged][:, hands],
        atol=MILLIMETER,  # hips may sink for a foot that comes down elsewhere
    )


@every_span
def test_one_repetition_goes_on_into_the_next_without_a_jerk(
    name: str, seed: int, begin: int, end: int
) -> None:
    loop, own = repeated(looped(part_of(name, seed, begin, end)))
    arms = [loop.skeleton.index(j) for j in ("Head", "WristLeft", "WristRight")]
    pull = np.diff(loop.positions[:, arms], 2, axis=0)
    pull = np.linalg.norm(pull, axis=-1).max(axis=1)
    seams = np.r_[own.start - 3 : own.start + 1, own.stop - 4 : own.stop]
    elsewhere = np.delete(pull, seams)
    assert pull[seams].max() < 1.2 * elsewhere.max() + MILLIMETER


@pytest.mark.parametrize("span", [("lunge", 3, 52, 143), ("step_over", 4, 162, 270)])
def test_feet_that_come_down_elsewhere_go_there_in_their_last_step(
    span: tuple[str, int, int, int],
) -> None:
    clip = part_of(*span)
    loop = looped(clip)
    feet = [*clip.skeleton.sides("Ankle"), *clip.skeleton.sides("Foot")]
    moved = loop.positions[:, feet] - clip.positions[:, feet]
    steps = np.linalg.norm(np.diff(moved, axis=0), axis=-1).max()
    far = np.linalg.norm(moved, axis=-1).max()
    assert far > 0.1
    assert steps < 0.3 * far


def test_who_turned_goes_on_turned(make_clip: MakeClip) -> None:
    """A quarter turn, and two steps ahead, are those of the next repetition, too."""
    clip = make_clip(30, seed=3)
    clip = replace(clip, contacts=np.zeros_like(clip.contacts))
    first = clip.at([0])
    turn = about_y(np.pi / 2)
    rotations, root = clip.rotations.copy(), clip.root.copy()
    rotations[-1] = multiply(turn, first.rotations[0])
    root[-1] = first.root[0] + [2.0, 0.0, 1.0]
    loop = looped(replace(clip, rotations=rotations, root=root))
    np.testing.assert_allclose(loop.root[-1], root[-1], atol=1e-9)
    there = rotate(turn, first.positions[0] - first.root[0]) + root[-1]
    np.testing.assert_allclose(loop.positions[-1], there, atol=1e-9)


def test_feet_that_never_step_stay_where_they_are() -> None:
    clip = performed("squat", seed=4).at(slice(98, 189))
    assert clip.contacts.all()
    loop = looped(clip)
    ends = [*clip.skeleton.sides("Ankle"), *clip.skeleton.sides("Foot")]
    np.testing.assert_allclose(
        loop.positions[:, ends], clip.positions[:, ends], atol=0.1 * MILLIMETER
    )
    np.testing.assert_allclose(loop.positions[-1], loop.positions[0], atol=MILLIMETER)


def test_hips_sink_by_what_legs_are_too_short() -> None:
    """A right triangle: a leg of 0.9 m that ends 0.54 m aside is 0.72 m high."""
    legs = np.array([[0.54, 0.75, 0.0], [0.0, 0.7, 0.54], [0.0, 2.0, 0.0]])
    short = shortage(legs, 0.9, _DEEPEST * 0.9)
    np.testing.assert_allclose(short, [0.03, 0.0, 0.09])


def test_other_feet_at_the_end_are_refused_saying_where_to_end() -> None:
    clip = performed("walk", seed=3).at(slice(156, 228))
    stands = clip.contacts.copy()
    stands[-6:, 2:] = False
    stands[0, 2:] = True
    with pytest.raises(InputError, match=r"right foot is planted only at"):
        looped(replace(clip, contacts=stands))
    try:
        looped(replace(clip, contacts=stands))
    except InputError as error:
        earlier = float(str(error).partition("--end ")[2].partition(" s")[0])
    kept = clip.time <= clip.time[-1] - earlier + 1e-3
    assert kept.sum() == 66
    looped(replace(clip, contacts=stands).at(kept))


@pytest.mark.parametrize("frames", [1, 3])
def test_what_is_too_short_is_refused(make_clip: MakeClip, frames: int) -> None:
    with pytest.raises(InputError, match=r"--begin and --end farther apart"):
        looped(make_clip(frames))


@pytest.mark.parametrize("rig", ["unreal", "mixamo"])
def test_rigs_meet_their_beginning_too(tmp_path: Path, rig: str) -> None:
    clip = part_of(*SPANS[0])
    write_clip(clip, tmp_path / "clip.usdc", Export(rig=rig, loop=True, root="none"))
    _, _, found = read_usd_positions(tmp_path / "clip.usdc")
    assert np.linalg.norm(found[0] - found[-1], axis=1).max() < 0.1 * MILLIMETER


@recorded
@pytest.mark.parametrize(
    "name",
    ["labanotation/Ges03_drawlines.csv", "ui-prmd/m01_s02_e05.csv"],
)
def test_a_recorded_take_repeats(name: str) -> None:
    clip = clean(read_take(TAKES / name), CleanConfig(physics=False)).clip
    loop = looped(clip)
    assert apart(loop).max() < 1e-9
    before = slid(clip, clip.positions, loop.contacts)
    assert slid(clip, loop.positions, loop.contacts) < before + 2 * MILLIMETER


@pytest.mark.parametrize("suffix", [".npz", ".usdc", ".glb", ".bvh"])
def test_files_are_loops_at_any_rate_in_place(tmp_path: Path, suffix: str) -> None:
    clip = part_of(*SPANS[1])
    for export in (Export(loop=True), Export(loop=True, root="none", fps=24.0)):
        write_clip(clip, tmp_path / f"clip{suffix}", export)
        found = read_clip(tmp_path / f"clip{suffix}")
        assert apart(found).max() < 0.1 * MILLIMETER
    away = found.positions[0] - found.positions[-1]
    assert np.linalg.norm(away, axis=1).max() < 0.1 * MILLIMETER


def test_the_command_makes_a_loop_of_a_part(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "clip.npz"
    words = ["clean", str(SAMPLE), "-o", str(out), "--no-physics"]
    assert main([*words, "--begin", "1", "--end", "4", "--loop"]) == 0
    loop = read_clip(out)
    assert loop.skeleton == KINECT_V1
    assert loop.time[-1] - loop.time[0] == pytest.approx(3.0, abs=0.06)
    assert apart(loop).max() < 1e-9
    assert main([*words, "--begin", "1", "--end", "1.05", "--loop"]) == 2
    assert "farther apart" in capsys.readouterr().err
