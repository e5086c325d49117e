"""Sensors that do not stand level."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from real_data import TAKES, recorded

from kinefilter import CleanConfig, Cleaner, clean, read_take
from kinefilter.characters import KINECT_V1, State, Take, standard_body
from kinefilter.pipeline.draft import Draft
from kinefilter.pipeline.look.comparison import laid_onto_clip
from kinefilter.pipeline.target.floor import in_world, leveled
from kinefilter.pipeline.target.frame_stages import Level
from kinefilter.pipeline.target.tilt import TiltEvidence, sensor_tilt
from kinefilter.retarget import HeadingFrame
from kinefilter.scenes.library import perform

Array = NDArray[np.float64]
BODY = standard_body(KINECT_V1)
EMPTY = np.zeros(len(KINECT_V1))
RIGHT_LEG = np.array([joint != "AnkleLeft" for joint in KINECT_V1.joints], dtype=float)


def walking(tilt: float, noise: float) -> tuple[Array, Array]:
    """Return someone who walks in front of a sensor that is 0.9 m high."""
    act = perform("walk", BODY, seed=2)
    there = act.positions[:120] - np.array([0.0, 0.9, 2.0])
    there = there + np.random.default_rng(0).normal(scale=noise, size=there.shape)
    return act.time[:120], leveled(there, -np.radians(tilt))


def tilt_of(
    *people: Array, confidence: float | Array = 1.0, by_kinect: bool = True
) -> float:
    """Return the tilt [degrees] that people show in frames of 1/30 s."""
    found = []
    for positions in people:
        person = TiltEvidence(KINECT_V1)
        known = np.full(positions.shape[:2], confidence)
        person.add(positions, known, np.full(len(positions), 1.0 / 30.0))
        found.append(person)
    return float(np.degrees(sensor_tilt(found, by_kinect=by_kinect)[0]))


@pytest.mark.parametrize("by_kinect", [True, False])
@pytest.mark.parametrize("tilt", [-12.0, -5.0, 8.0])
def test_the_tilt_is_found_under_someone_who_walks(
    tilt: float, *, by_kinect: bool
) -> None:
    _, positions = walking(tilt, 0.01)
    assert tilt_of(positions, by_kinect=by_kinect) == pytest.approx(tilt, abs=1.0)


def test_one_foot_shows_the_tilt_where_it_bears() -> None:
    _, positions = walking(-8.0, 0.01)
    assert tilt_of(positions, confidence=RIGHT_LEG) == pytest.approx(-8.0, abs=1.5)


def test_a_foot_that_kicks_shows_no_tilt() -> None:
    kicks = standing()
    leg = [KINECT_V1.index(f"{part}Right") for part in ("Hip", "Knee", "Ankle")]
    swing = 0.5 * np.pi * np.sin(np.linspace(0.0, 6.0 * np.pi, len(kicks))) ** 2
    forward = np.stack([np.zeros_like(swing), -np.cos(swing), -np.sin(swing)], axis=1)
    hip = kicks[:, leg[0]].copy()
    for j in leg[1:]:
        length = np.linalg.norm(kicks[:, j] - hip, axis=1)
        kicks[:, j] = hip + length[:, None] * forward
    assert np.ptp(kicks[:, leg[2], 1]) > 0.5
    assert abs(tilt_of(kicks, confidence=RIGHT_LEG)) < 0.5


@pytest.mark.parametrize("roll", [-6.0, 2.0])
def test_the_roll_is_found_under_someone_who_walks_across(roll: float) -> None:
    time, away = walking(0.0, 0.005)
    across = away[..., [2, 1, 0]] * [1.0, 1.0, -1.0] + [2.5, 0.0, -2.5]
    rolled = leveled(across, 0.0, -np.radians(roll))
    state = np.full(rolled.shape[:2], State.TRACKED, dtype=np.uint8)
    take = Take(time, rolled, state, KINECT_V1, "sensor.csv")
    result = clean(take, CleanConfig(method="none", physics=False))
    found = np.degrees(result.clip.roll)
    assert found == pytest.approx(roll, abs=1.0)
    assert f"rolled by {found:+.1f} degrees" in " ".join(result.notes)
    laid = laid_onto_clip(take, result.clip)
    assert np.abs(laid - in_world(take, result.clip)).max() < 0.05
    hips = result.clip.positions[:, KINECT_V1.root]
    slope = np.polyfit(hips[:, 0], hips[:, 1], 1)[0]
    assert abs(np.degrees(slope)) < 1.0


def test_a_foot_that_seems_higher_is_no_roll() -> None:
    steps = standing()
    left, right = KINECT_V1.sides("Ankle")
    steps[:, left, 1] += 0.02
    steps[::2, left, 1] += 0.05
    steps[1::2, right, 1] += 0.05
    person = TiltEvidence(KINECT_V1)
    person.add(steps, np.ones(steps.shape[:2]), np.full(len(steps), 0.5))
    assert abs(np.degrees(sensor_tilt([person])[1])) < 0.1


def test_a_level_sensor_stays_as_it_is() -> None:
    assert abs(tilt_of(walking(0.0, 0.01)[1])) < 0.5


def test_one_frame_after_another_shows_what_all_of_them_do() -> None:
    _, positions = walking(-5.0, 0.01)
    person, known = TiltEvidence(KINECT_V1), np.ones((1, len(KINECT_V1)))
    for frame in positions:
        person.add(frame[None], known, np.array([1.0 / 30.0]))
    found = np.degrees(sensor_tilt([person])[0])
    assert found == pytest.approx(tilt_of(positions), abs=1e-9)


@pytest.mark.parametrize("raised", [0.0, 0.15])
def test_people_of_a_recording_share_the_tilt(raised: float) -> None:
    """The sensor may have misplaced the feet of one by a height of their own."""
    _, walker = walking(-5.0, 0.01)
    still = np.repeat(walker[20:21] + np.array([0.5, raised, 0.0]), len(walker), axis=0)
    assert tilt_of(still) == 0.0
    for people in ([walker, still], [still, walker]):
        assert tilt_of(*people) == pytest.approx(-5.0, abs=1.0)


def standing(lean: float = 3.0, turned: float = 0.0) -> Array:
    """Return someone who stands before the sensor and leans forward [degrees]."""
    posture = BODY.rest_positions.copy()
    for shoulder in KINECT_V1.sides("Shoulder"):
        for j in KINECT_V1.descendants(shoulder):  # the arms hang
            posture[j] = posture[KINECT_V1.parents[j]] - [0.0, BODY.lengths[j], 0.0]
    posture -= posture[list(KINECT_V1.sides("Ankle"))].mean(axis=0)
    posture = leveled(posture, np.radians(lean))
    facing = HeadingFrame(np.array([0.2, -0.8, -2.5]), np.radians(turned))
    return np.tile(facing.restore(posture), (60, 1, 1))


@pytest.mark.parametrize("tilt", [-12.0, -6.0, -3.0, 5.0, 9.0])
@pytest.mark.parametrize("turned", [-20.0, 0.0, 15.0])
def test_the_tilt_is_found_by_someone_who_stands(tilt: float, turned: float) -> None:
    positions = leveled(standing(turned=turned), -np.radians(tilt))
    assert tilt_of(positions) == pytest.approx(tilt, abs=1.5)


def test_who_leans_a_little_or_stands_otherwise_shows_no_tilt() -> None:
    assert tilt_of(standing()) == 0.0
    assert tilt_of(standing(lean=0.0)) == pytest.approx(0.0, abs=0.1)
    assert -0.7 < tilt_of(standing(lean=4.6)) < 0.0  # as far as anyone in mocap
    tilted = leveled(standing(), np.radians(8.0))
    assert tilt_of(tilted) == pytest.approx(-8.0, abs=1.5)
    assert tilt_of(tilted, confidence=0.0) == 0.0  # feet that were never seen
    assert tilt_of(tilted, by_kinect=False) == 0.0
    assert tilt_of(tilted[:3]) == 0.0


@recorded
@pytest.mark.parametrize("tilt", [-8.0, -4.0])
def test_a_recorded_gesture_before_a_tilted_sensor_stands_upright(tilt: float) -> None:
    take = read_take(TAKES / "labanotation" / "Ges05_demopoint.csv")
    turned = replace(take, positions=leveled(take.positions, np.radians(tilt)))
    level, tilted = (
        np.degrees(clean(one, CleanConfig(physics=False)).clip.tilt)
        for one in (take, turned)
    )
    assert level == pytest.approx(4.5, abs=1.0)
    assert tilted == pytest.approx(level - tilt, abs=2.5)


def test_leveling_turns_and_keeps_lengths_and_the_array() -> None:
    positions = np.random.default_rng(1).normal(size=(5, 20, 3))
    before = positions.copy()
    turned = leveled(positions, 0.3)
    np.testing.assert_array_equal(positions, before)
    np.testing.assert_allclose(
        np.linalg.norm(turned, axis=-1), np.linalg.norm(positions, axis=-1)
    )
    np.testing.assert_allclose(leveled(turned, -0.3), positions, atol=1e-12)


def live(time: Array, positions: Array) -> list[Draft]:
    """Pass frames through the stages up to the leveled floor, one by one."""
    cleaner = Cleaner(CleanConfig(method="none")).until("level")
    cleaner.start(BODY)
    frames = zip(positions, time, strict=True)
    return [cleaner.step(joints, float(now)) for joints, now in frames]


def test_live_motion_is_leveled_as_soon_as_somebody_walks() -> None:
    time, positions = walking(-8.0, 0.005)
    drafts = live(time, positions)
    tilts = np.degrees([draft.tilt for draft in drafts])
    assert tilts[0] == 0.0
    assert tilts[-1] == pytest.approx(-8.0, abs=2.0)
    assert np.abs(np.diff(tilts)).max() < 1.0  # it does not jump


def test_feet_that_stand_stay_in_place_while_the_tilt_is_found() -> None:
    time, tilted = np.arange(60) / 30.0, leveled(standing(), -np.radians(-8.0))
    drafts = live(time, tilted)
    assert np.degrees(drafts[-1].tilt) < -5.0
    ankles = list(KINECT_V1.sides("Ankle"))
    places = np.array([draft.positions[ankles].mean(axis=0) for draft in drafts])
    np.testing.assert_allclose(places, places[:1].repeat(len(places), 0), atol=1e-3)


def test_a_live_face_is_turned_with_the_joints() -> None:
    level, draft = Level(CleanConfig(tilt=10.0)), Draft(KINECT_V1, 0.0, *[EMPTY] * 2)
    level.start(BODY)
    draft.body, draft.positions = BODY, BODY.rest_positions
    draft.face = np.array([0.0, 0.0, -1.0])
    level.step(draft)
    np.testing.assert_allclose(
        draft.face, leveled(np.array([0.0, 0.0, -1.0]), np.radians(10.0))
    )


def test_a_clip_from_a_tilted_sensor_stands_on_a_level_floor() -> None:
    time, positions = walking(-8.0, 0.005)
    state = np.full(positions.shape[:2], State.TRACKED, dtype=np.uint8)
    take = Take(time, positions, state, KINECT_V1)
    found = clean(take, CleanConfig(method="none", physics=False))
    assert any("tilted by -" in note for note in found.notes)
    kept = clean(take, CleanConfig(method="none", physics=False, tilt=0.0))
    assert not any("tilted" in note for note in kept.notes)

    def slope(root: Array) -> float:
        return float(np.polyfit(root[:, 2], root[:, 1], 1)[0])

    root = KINECT_V1.root
    assert abs(slope(found.clip.positions[:, root])) < 0.02
    assert abs(slope(kept.clip.positions[:, root])) > 0.05
