"""Sensors that were upside down or tilted far, and people who are not upright."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from kinefilter import Avatar, CleanConfig, clean, read_clip, read_take, write_clip
from kinefilter.characters import KINECT_V1, State, Take, standard_body
from kinefilter.pipeline.clean_result import CleanResult
from kinefilter.pipeline.formats import read_recording
from kinefilter.pipeline.look.comparison import in_clip_frame
from kinefilter.pipeline.target.floor import leveled
from kinefilter.scenes.library import perform

Array = NDArray[np.float64]
BODY = standard_body(KINECT_V1)
QUICK = CleanConfig(method="none", physics=False)
HEAD = KINECT_V1.index("Head")
ARMS = {
    "down": (0.0, -1.0, 0.0),
    "front": (0.0, 0.0, 1.0),
    "up": (0.0, 1.0, 0.0),
}


def seen(motion: str) -> Take:
    """Return a take of a sensor 0.9 m high, 2.5 m away from whom it sees from ahead."""
    act = perform(motion, BODY, seed=1)
    positions = act.positions[:150] * [-1.0, 1.0, -1.0] + [0.0, -0.9, 2.5]
    state = np.full(positions.shape[:2], State.TRACKED, dtype=np.uint8)
    return Take(act.time[:150], positions, state, KINECT_V1, motion)


def turned(take: Take, axes: str, degrees: float | list[float]) -> Take:
    matrix = Rotation.from_euler(axes, degrees, degrees=True).as_matrix()
    return replace(take, positions=take.positions @ matrix.T)


def standing(arms: str) -> Take:
    """Return somebody who stands straight, trembles a little and holds the arms so."""
    take = seen("stand_idle")
    positions = np.tile(take.positions[:1], (90, 1, 1)) * 1.0
    for side in ("Left", "Right"):
        shoulder = positions[:, KINECT_V1.index("Shoulder" + side)]
        for joint, far in (("Elbow", 0.28), ("Wrist", 0.53), ("Hand", 0.6)):
            place = shoulder + far * np.array(ARMS[arms]) * [1.0, 1.0, -1.0]
            positions[:, KINECT_V1.index(joint + side)] = place
    # The scripted person leans forward farther than anyone in mocap.
    positions = leveled(positions, np.radians(2.5))
    positions += np.random.default_rng(0).normal(scale=0.005, size=positions.shape)
    return Take(take.time[:90], positions, take.state[:90], KINECT_V1, arms)


def told(result: CleanResult, *words: str) -> bool:
    return any(all(word in note for word in words) for note in result.notes)


@pytest.mark.parametrize("arms", ["down", "front"])
def test_a_take_from_a_sensor_upside_down_is_cleaned_as_one_that_was_not(
    arms: str,
) -> None:
    take = standing(arms)
    level, over = clean(take, QUICK), clean(turned(take, "z", 180.0), QUICK)
    np.testing.assert_allclose(over.clip.positions, level.clip.positions, atol=1e-6)
    assert told(over, "upside down")
    assert not told(level, "sensor")


def test_a_take_with_a_long_gap_is_turned_as_a_whole() -> None:
    take = standing("down")
    take = replace(take, time=take.time + 5.0 * (np.arange(len(take)) >= 45))
    level, over = clean(take, QUICK), clean(turned(take, "z", 180.0), QUICK)
    assert over.clip.roll == pytest.approx(np.pi)
    assert told(over, "upside down")
    moved = (result.stages["corrected"].moved_cm for result in (level, over))
    np.testing.assert_allclose(*moved, atol=1e-3)


@pytest.mark.parametrize(("axes", "degrees"), [("x", 30.0), ("x", -45.0), ("z", 30.0)])
def test_who_stands_before_a_tilted_sensor_stands_upright(
    axes: str, degrees: float
) -> None:
    take = standing("down")
    result, level = clean(turned(take, axes, degrees), QUICK), clean(take, QUICK)
    tilted, upright = (
        np.mean(r.clip.positions[:, HEAD] - r.clip.positions[:, KINECT_V1.root], axis=0)
        for r in (result, level)
    )
    assert np.linalg.norm(tilted - upright) < 0.06  # 5 degrees
    assert told(result, "tilted", "stands")


def test_a_frame_that_the_user_gives_is_left_alone() -> None:
    result = clean(turned(standing("down"), "x", 30.0), replace(QUICK, tilt=0.0))
    assert (result.clip.tilt, result.clip.roll) == (0.0, 0.0)
    assert not told(result, "sensor")


def test_a_tilt_that_the_user_gives_is_undone_before_correction() -> None:
    config = replace(QUICK, method="local-pca", tilt=0.0)
    level = clean(standing("front"), config)
    tilted = clean(turned(standing("front"), "x", -30.0), replace(config, tilt=30.0))
    assert tilted.clip.tilt == pytest.approx(np.radians(30.0))
    for name in ("rotations", "root", "reliability"):
        wanted = getattr(level.clip, name)
        np.testing.assert_allclose(getattr(tilted.clip, name), wanted, atol=1e-5)


@pytest.mark.parametrize(
    ("arms", "lean"),
    [("down", 90.0), ("down", -90.0), ("front", 75.0), ("front", 50.0), ("up", 180.0)],
    ids=["prone", "supine", "push-up", "push-up at a bench", "handstand"],
)
def test_who_is_on_the_floor_or_on_the_hands_stays_there_and_is_told(
    arms: str, lean: float
) -> None:
    # They face -z, so that leaning forward is turning about -x.
    result = clean(turned(standing(arms), "x", -lean), QUICK)
    assert (result.clip.tilt, result.clip.roll) == (0.0, 0.0)
    # The option cannot turn anybody by more than 90 degrees.
    assert told(result, "off the vertical", "rotate the frames")
    assert told(result, "--tilt") == (lean <= 90.0)


@pytest.mark.parametrize("motion", ["bend", "sit", "squat", "lunge", "pick_up", "run"])
def test_whoever_bends_sits_or_runs_before_a_level_sensor_is_left_alone(
    motion: str,
) -> None:
    result = clean(seen(motion), QUICK)
    assert result.clip.roll == 0.0
    assert not told(result, "vertical")
    assert not told(result, "stands")


def test_somebody_who_does_cartwheels_is_left_alone() -> None:
    take = standing("down")
    turns = Rotation.from_euler("z", np.linspace(0.0, 720.0, 90)[:, None], degrees=True)
    positions = np.einsum("tij,tkj->tki", turns.as_matrix(), take.positions)
    assert clean(replace(take, positions=positions), QUICK).clip.roll == 0.0


@pytest.mark.usefixtures("usd_here")
def test_a_clip_says_how_its_take_was_turned(tmp_path: Path) -> None:
    take = turned(standing("down"), "zx", [170.0, 25.0])
    result = clean(take, QUICK)
    assert abs(result.clip.roll) > 2.8
    for name in ("clip.npz", "clip.usda"):
        write_clip(result.clip, tmp_path / name)
        found = read_clip(tmp_path / name)
        assert (found.tilt, found.roll) == (result.clip.tilt, result.clip.roll)
    away = np.linalg.norm(result.target - in_clip_frame(take, result.clip), axis=2)
    np.testing.assert_allclose(away, result.clip.moved_by_correction, atol=1e-9)


def test_y_that_points_down_in_a_file_is_negated(tmp_path: Path) -> None:
    take = standing("down")
    down = replace(take, positions=take.positions * [1.0, -1.0, 1.0])
    for name, positions in (("up", take.positions), ("down", down.positions)):
        rows = np.concatenate([positions, np.full((90, 20, 1), 2)], axis=2)
        table = np.column_stack([take.time, rows.reshape(90, -1)])
        cells = [f"{j}.{c}" for j in KINECT_V1.joints for c in ("x", "y", "z", "state")]
        header = ",".join(["time", *cells])
        np.savetxt(tmp_path / name, table, "%.9g", ",", header=header, comments="")
    one, other = read_take(tmp_path / "up"), read_take(tmp_path / "down")
    np.testing.assert_allclose(one.positions, other.positions)
    assert read_recording(tmp_path / "up").notes == ()
    assert any("negated" in note for note in read_recording(tmp_path / "down").notes)
    assert told(clean(down, QUICK), "toes", "negate")


def heads(take: Take, *, of: slice = slice(None)) -> Array:
    """Return how high an avatar's head is over the floor in each frame [m]."""
    avatar = Avatar(BODY)
    return np.array(
        [
            avatar.step(frame, time).positions[HEAD, 1]
            for frame, time in zip(take.positions[of], take.time[of], strict=True)
        ]
    )


def test_an_avatar_stands_upright_before_a_sensor_upside_down() -> None:
    assert heads(turned(standing("down"), "z", 180.0), of=slice(15)).min() > 1.4


def test_an_avatar_stands_upright_after_two_seconds_before_a_tilted_sensor() -> None:
    found = heads(turned(standing("down"), "z", 40.0), of=slice(90))
    assert abs(found[80:] - 1.6).max() < 0.1


def test_an_avatar_tells_how_the_sensor_was_turned() -> None:
    for degrees, frames, words in (
        (180.0, 3, "upside down"),
        (40.0, 70, "tilted"),
        (0.0, 70, ""),
    ):
        avatar, take = Avatar(BODY), turned(standing("down"), "z", degrees)
        assert avatar.notes == ()
        for frame, time in zip(take.positions[:frames], take.time, strict=False):
            avatar.step(frame, time)
        assert [words in note for note in avatar.notes] == [True] * bool(words)


@pytest.mark.parametrize("mirrored", [True, False])
def test_toes_of_who_is_seen_from_behind_do_not_point_backwards(mirrored: bool) -> None:
    take = seen("stand_idle")
    # Seen from behind, they turn around, but the tracker swaps their sides.
    behind = take.positions * [1.0, 1.0, -1.0] + [0.0, 0.0, 5.0]
    positions = take.positions * [-1.0, 1.0, 1.0] if mirrored else behind
    avatar = Avatar(BODY)
    for frame, time in zip(positions[:70], take.time, strict=False):
        avatar.step(frame, time)
    assert ["toes" in note for note in avatar.notes] == [True] * mirrored


def test_who_no_longer_stands_before_a_tilted_sensor_stays_turned() -> None:
    stands, squats = standing("down"), standing("front")
    positions = np.concatenate([stands.positions, squats.positions])
    time = np.arange(len(positions)) / 30.0
    state = np.full(positions.shape[:2], State.TRACKED, dtype=np.uint8)
    take = turned(Take(time, positions, state, KINECT_V1), "x", 40.0)
    assert abs(heads(take)[80:] - 1.6).max() < 0.2


@pytest.fixture(scope="module")
def usual() -> Array:
    """Return how high the head of somebody is who stands idly in each frame [m]."""
    return heads(seen("stand_idle"), of=slice(60))


@pytest.mark.parametrize(("first", "last"), [(0, 0), (15, 15), (15, 30)])
def test_absurd_frames_do_not_move_the_floor_of_an_avatar(
    usual: Array, first: int, last: int
) -> None:
    take = seen("stand_idle")
    positions = take.positions.copy()
    positions[first : last + 1, :, 1] -= 99.0
    found = heads(replace(take, positions=positions), of=slice(last + 30))
    assert abs(found - usual[: last + 30])[last + 10 :].max() < 0.15


def test_an_avatar_follows_a_floor_that_is_another_within_a_second_or_so() -> None:
    take = seen("stand_idle")
    positions = take.positions.copy()
    positions[20:, :, 1] += 0.8
    found = heads(replace(take, positions=positions), of=slice(70))
    assert abs(found[60:] - 1.6).max() < 0.1
