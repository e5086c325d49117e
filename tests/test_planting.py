"""Feet that stand still and step: where they are, and what stays as it was."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from known_motions import noisy, plant, stamps, standing
from numpy.typing import NDArray
from skeletons import every_skeleton

from kinefilter.characters import KINECT_V1, Skeleton, standard_body
from kinefilter.characters.arrays import runs
from kinefilter.characters.rotations import about_y, rotate, unit
from kinefilter.characters.skeleton import SIDES
from kinefilter.pipeline.target import feet, foot_pitch, planting
from kinefilter.pipeline.target.feet import (
    ankles_and_toes,
    find_stance,
    flat_height,
)
from kinefilter.pipeline.target.foot_pitch import pitch_of
from kinefilter.pipeline.target.planting import plant_feet
from kinefilter.scenes.library import perform

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

BODY = standard_body(KINECT_V1)
ANKLES, TOES = ankles_and_toes(KINECT_V1)
FEET = [*ANKLES, *TOES]
STILL = 1e-3  # m: nobody sees a foot move by this
MOTIONS = ["walk", "kick", "march", "dance", "squat"]


def ones(path: Array) -> Array:
    return np.ones(path.shape[:2])


def found(motion: str, seed: int = 0, fps: float = 30.0) -> tuple[Array, Array, Flags]:
    """Return time, a trembling performance and when its feet stand."""
    act = perform(motion, BODY, seed=seed, fps=fps)
    path = noisy(act)
    return act.time, path, find_stance(act.time, path, ones(path), KINECT_V1)


# Feet that stand


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("fps", [15.0, 30.0, 120.0])
def test_feet_that_stand_do_not_move_and_their_soles_are_on_the_floor(
    motion: str, fps: float
) -> None:
    time, path, stands = found(motion, fps=fps)
    planted, heels = plant(time, path, ones(path), stands, BODY)
    assert stands.any()
    for foot, (ankle, toe) in enumerate(zip(ANKLES, TOES, strict=True)):
        for stance in runs(stands[:, foot]):
            toes = planted[stance, toe]
            assert np.ptp(toes, axis=0).max() < STILL
            np.testing.assert_allclose(toes[:, 1], BODY.radii[toe], atol=STILL)
            if heels[stance, foot].all():  # may still rise by less than a centimeter
                assert np.ptp(planted[stance, ankle], axis=0).max() < 0.012


@pytest.mark.parametrize("motion", MOTIONS)
def test_standing_feet_are_as_long_as_they_are(motion: str) -> None:
    time, path, stands = found(motion, seed=1)
    planted, _ = plant(time, path, ones(path), stands, BODY)
    for foot, (ankle, toe) in enumerate(zip(ANKLES, TOES, strict=True)):
        feet = planted[stands[:, foot]]
        lengths = np.linalg.norm(feet[:, toe] - feet[:, ankle], axis=1)
        np.testing.assert_allclose(lengths, BODY.lengths[toe], atol=5 * STILL)


@every_skeleton
def test_who_stands_at_ease_is_left_where_they_are(skeleton: Skeleton) -> None:
    path, stands = standing(40, skeleton), np.ones((40, 2), dtype=np.bool_)
    body = standard_body(skeleton)
    planted, heels = plant(stamps(40), path, ones(path), stands, body)
    np.testing.assert_allclose(planted, path, atol=1e-6)
    assert heels.all()


def test_a_foot_stands_at_the_weighted_median_of_its_ankle() -> None:
    path, confidence = standing(60), np.ones((60, 20))
    place = path[0, ANKLES[0], [0, 2]].copy()
    path[:, [ANKLES[0], TOES[0]], 0] += np.random.default_rng(0).normal(
        0.0, 0.01, (60, 1)
    )
    median = np.median(path[:, ANKLES[0], 0])
    path[30:55, [ANKLES[0], TOES[0]], 0] += 5.0  # in a place nobody measured
    confidence[30:55] = 0.0
    stands = np.ones((60, 2), dtype=np.bool_)
    planted, _ = plant(stamps(60), path, confidence, stands, BODY)
    assert planted[0, ANKLES[0], 0] == pytest.approx(median, abs=0.006)
    assert planted[0, ANKLES[0], 2] == pytest.approx(place[1], abs=1e-6)


@pytest.mark.parametrize("up", [np.radians(40.0), np.radians(-40.0)])
def test_a_pitched_foot_stands_on_its_heel_or_on_its_toes(up: float) -> None:
    path, stands = standing(90), np.ones((90, 2), dtype=np.bool_)
    pitch = np.zeros((90, 2))
    pitch[:, 0] = up * np.sin(np.linspace(0.0, np.pi, 90)) ** 2
    planted, contacts = plant_feet(stamps(90), path, ones(path), stands, pitch, BODY)
    np.testing.assert_allclose(pitch_of(planted, BODY), pitch, atol=2e-3)
    heels, toes = contacts[:, 0], contacts[:, 1]
    rests, turns = (ANKLES[0], TOES[0]) if up > 0.0 else (TOES[0], ANKLES[0])
    assert np.ptp(planted[:, rests], axis=0).max() < STILL
    assert np.ptp(planted[:, turns, 1]) > 0.05
    assert (heels if up > 0.0 else toes).all()
    assert not (toes if up > 0.0 else heels)[30:60].any()
    assert contacts[:, 2:].all()
    lengths = np.linalg.norm(planted[:, ANKLES[0]] - planted[:, TOES[0]], axis=1)
    np.testing.assert_allclose(lengths, BODY.lengths[TOES[0]], atol=STILL)


def test_toes_stay_where_they_stood_however_long_the_heel_is_up() -> None:
    """Where the ankle is most of the time is ahead of where it is in a flat foot."""
    path, stands = standing(60), np.ones((60, 2), dtype=np.bool_)
    pitch = np.zeros((60, 2))
    pitch[20:, 0] = np.radians(-50.0)
    foot = path[:, [ANKLES[0], TOES[0]]]
    ahead = unit(foot[0, 1, [0, 2]] - foot[0, 0, [0, 2]])
    below = foot_pitch.flat_angle(BODY) - pitch[:, 0]
    raised = planting.standing_feet(foot[0, 0, [0, 2]], ahead, below, BODY, TOES[0])
    np.testing.assert_allclose(raised[:20], foot[:20], atol=1e-6)
    assert raised[-1, 0, 1] - foot[-1, 0, 1] > 0.05
    path[:, [ANKLES[0], TOES[0]]] = raised
    planted, _ = plant_feet(stamps(60), path, ones(path), stands, pitch, BODY)
    assert np.linalg.norm(planted[:, TOES[0]] - foot[:, 1], axis=1).max() < STILL


# Feet that step


@pytest.mark.parametrize("motion", ["walk", "march", "kick", "step_over"])
def test_steps_start_and_end_where_the_foot_stands(motion: str) -> None:
    time, path, stands = found(motion, seed=2)
    planted, _ = plant(time, path, ones(path), stands, BODY)
    for foot, toe in enumerate(TOES):
        for stance in runs(stands[:, foot]):
            for inside, outside in (
                (stance.start, stance.start - 1),
                (stance.stop - 1, stance.stop),
            ):
                if 0 <= outside < len(time):
                    apart = planted[outside, toe] - planted[inside, toe]
                    assert np.linalg.norm(apart) < 0.025


@pytest.mark.parametrize("motion", ["walk", "march", "kick"])
def test_steps_are_no_quicker_than_the_measured_ones_by_much(motion: str) -> None:
    time, path, stands = found(motion, seed=3)
    planted, _ = plant(time, path, ones(path), stands, BODY)
    raw, quick = (
        np.linalg.norm(np.diff(p[:, TOES], axis=0), axis=2).max()
        for p in (path, planted)
    )
    assert quick < 1.4 * raw


def test_a_foot_that_is_lifted_or_set_down_stays_behind_by_little() -> None:
    time = np.arange(100) / 100.0
    path = np.zeros((100, 2, 3))
    path[:, :, 2] = np.linspace(0.0, 1.0, 100)[:, None]
    stances = [slice(0, 30), slice(70, 100)]
    resting = path.copy()
    resting[:30], resting[70:] = 0.0, 1.0
    joined = planting._joined(time, path, resting, stances)[:, 0, 2]
    np.testing.assert_allclose(joined[30:33], 0.0, atol=1e-9)
    np.testing.assert_allclose(joined[68:70], 1.0, atol=1e-9)
    share = (time[30:70] - time[29]) / (time[70] - time[29])
    measured = path[30:70, 0, 2] - 0.29 + 0.58 * share**2 * (3.0 - 2.0 * share)
    assert np.abs(joined[30:70] - measured).max() < 0.051


def test_a_lift_rises_and_sinks_at_an_even_speed() -> None:
    time, toe = np.arange(100) / 100.0, np.zeros((100, 3))
    stands = np.ones(100, dtype=np.bool_)
    stands[20:80] = False
    toe[20:80, 2] = np.linspace(0.0, 0.6, 60)
    lift = planting._lift(time, toe, 0.0, stands)
    assert not lift[stands].any()
    assert lift.max() == pytest.approx(feet.CLEARANCE)
    steepest = feet.CLEARANCE / feet.LIFT_TIME
    assert np.abs(np.diff(lift)).max() * 100.0 == pytest.approx(steepest)


@pytest.mark.parametrize("raised", [0.0, 0.08])
def test_a_foot_that_was_dragged_is_lifted_on_its_way_and_only_there(
    raised: float,
) -> None:
    """The heel too, where only the toes are up."""
    time, path = stamps(120), standing(120)
    way = 0.5 * np.clip((time - 1.5) / 1.0, 0.0, 1.0)
    path[:, [ANKLES[0], TOES[0]], 2] += way[:, None]
    path[50:71, TOES[0], 1] += raised
    stands = np.ones((120, 2), dtype=np.bool_)
    stands[45:75, 0] = False
    planted, _ = plant(time, path, ones(path), stands, BODY)
    soles = planted[:, TOES, 1] - BODY.radii[TOES]
    heels = planted[:, ANKLES[0], 1] - flat_height(BODY, TOES[0])
    assert min(soles[55:66, 0].min(), heels[55:66].min()) > 0.06
    assert soles.min() > -STILL
    np.testing.assert_allclose(soles[stands], 0.0, atol=STILL)
    np.testing.assert_allclose(planted[-1, TOES[0]], path[-1, TOES[0]], atol=STILL)


def test_a_foot_that_is_high_enough_is_not_lifted_further() -> None:
    time, path = stamps(120), standing(120)
    share = np.clip((time - 1.5) / 1.0, 0.0, 1.0)
    path[:, [ANKLES[0], TOES[0]], 1] += (0.2 * np.sin(np.pi * share))[:, None]
    stands = np.ones((120, 2), dtype=np.bool_)
    stands[44:77, 0] = False
    planted, _ = plant(time, path, ones(path), stands, BODY)
    np.testing.assert_allclose(planted[55:66, FEET], path[55:66, FEET], atol=0.01)


def test_a_step_over_dropped_frames_is_where_the_whole_one_is() -> None:
    time, path = stamps(120), standing(120)
    share = np.clip((time - 1.4) / 1.2, 0.0, 1.0)
    path[:, [ANKLES[0], TOES[0]], 2] += 0.4 * share[:, None] ** 2
    path[:, [ANKLES[0], TOES[0]], 0] += 0.1 * share[:, None]
    path[78:, [ANKLES[0], TOES[0]], 0] += 0.06  # the foot drifts where it stands
    stands = np.ones((120, 2), dtype=np.bool_)
    stands[42:78, 0] = False
    whole, _ = plant(time, path, ones(path), stands, BODY)
    kept = np.setdiff1d(np.arange(120), [46, 47, 48, 49, 50, 51])
    short, _ = plant(time[kept], path[kept], ones(path[kept]), stands[kept], BODY)
    np.testing.assert_allclose(
        short[:, TOES[0], [0, 2]], whole[kept][:, TOES[0]][:, [0, 2]], atol=8e-3
    )


# What stays as it was


@pytest.mark.parametrize("motion", MOTIONS)
def test_feet_that_never_stand_follow_the_measurement(motion: str) -> None:
    time, path, stands = found(motion)
    nowhere = np.zeros_like(stands)
    planted, heels = plant(time, path, ones(path), nowhere, BODY)
    np.testing.assert_array_equal(planted, path)
    assert not heels.any()


@pytest.mark.parametrize("motion", MOTIONS)
def test_feet_that_always_stand_never_move(motion: str) -> None:
    time, path, stands = found(motion)
    planted, _ = plant(time, path, ones(path), np.ones_like(stands), BODY)
    assert np.ptp(planted[:, FEET], axis=0).max() < STILL


@pytest.mark.parametrize("motion", MOTIONS)
def test_only_feet_are_moved_and_each_by_itself(motion: str) -> None:
    time, path, stands = found(motion)
    stands[:, 1] = False
    planted, heels = plant(time, path, ones(path), stands, BODY)
    others = np.setdiff1d(np.arange(20), [ANKLES[0], TOES[0]])
    np.testing.assert_array_equal(planted[:, others], path[:, others])
    assert not np.array_equal(planted, path)
    assert not heels[:, 1].any()
    assert not heels[~stands[:, 0], 0].any()


def test_arguments_are_not_modified() -> None:
    time, path, stands = found("walk")
    arrays = time, path, ones(path), stands, pitch_of(path, BODY)
    before = [np.copy(array) for array in arrays]
    plant_feet(*arrays, BODY)
    for array, copy in zip(arrays, before, strict=True):
        np.testing.assert_array_equal(array, copy)


# Symmetries


@settings(max_examples=8, deadline=None)
@given(
    motion=st.sampled_from(MOTIONS),
    x=st.floats(-4.0, 4.0),
    z=st.floats(-4.0, 4.0),
    hours=st.floats(0.0, 2.0),
)
def test_planting_follows_the_body_wherever_and_whenever_it_is(
    motion: str, x: float, z: float, hours: float
) -> None:
    time, path, stands = found(motion)
    planted, heels = plant(time, path, ones(path), stands, BODY)
    away, later = np.array([x, 0.0, z]), time + 3600.0 * hours
    moved, same = plant(later, path + away, ones(path), stands, BODY)
    np.testing.assert_allclose(moved, planted + away, atol=1e-6)
    np.testing.assert_array_equal(same, heels)


@pytest.mark.parametrize("motion", MOTIONS)
def test_left_and_right_are_treated_alike(motion: str) -> None:
    time, path, stands = found(motion)
    planted, heels = plant(time, path, ones(path), stands, BODY)
    mirror = KINECT_V1.mirror
    mirrored, same = plant(
        time,
        path[:, mirror] * [-1.0, 1.0, 1.0],
        ones(path),
        stands[:, ::-1],
        BODY,
    )
    np.testing.assert_allclose(
        mirrored, planted[:, mirror] * [-1.0, 1.0, 1.0], atol=1e-9
    )
    np.testing.assert_array_equal(same, heels[:, ::-1])


@pytest.mark.parametrize("yaw", [0.4, 1.9, -2.6])
@pytest.mark.parametrize("motion", MOTIONS)
def test_planting_turns_with_the_body(motion: str, yaw: float) -> None:
    time, path, stands = found(motion)
    planted, _ = plant(time, path, ones(path), stands, BODY)
    turned, _ = plant(time, rotate(about_y(yaw), path), ones(path), stands, BODY)
    # The median of a cloud of noise, axis by axis, does not turn exactly, and what is
    # only just quick enough to be lifted may not be then.
    away = turned - rotate(about_y(yaw), planted)
    assert np.linalg.norm(away[..., [0, 2]], axis=2).max() < 0.02
    standing_feet = np.concatenate([stands, stands], axis=1)
    assert np.linalg.norm(away[:, FEET], axis=2)[standing_feet].max() < 0.012
    quarter, _ = plant(
        time, path[..., [2, 1, 0]] * [1.0, 1.0, -1.0], ones(path), stands, BODY
    )
    np.testing.assert_allclose(
        quarter, planted[..., [2, 1, 0]] * [1.0, 1.0, -1.0], atol=1e-9
    )


# Takes as they come


@pytest.mark.parametrize("frames", [1, 2, 3])
@pytest.mark.parametrize("stands", [True, False])
def test_a_few_frames_are_planted_without_a_warning(frames: int, stands: bool) -> None:
    path, flags = standing(frames), np.full((frames, 2), stands)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        planted, heels = plant(stamps(frames), path, ones(path), flags, BODY)
    np.testing.assert_allclose(planted, path, atol=1e-9)
    assert (heels == stands).all()


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), frames=st.integers(1, 40))
def test_any_stances_of_any_motion_give_numbers(seed: int, frames: int) -> None:
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.choice([1 / 30, 1 / 15, 0.5], frames))
    path = standing(frames) + rng.normal(0.0, 0.3, (frames, 20, 3))
    stands = rng.random((frames, 2)) < rng.random()
    confidence = (rng.random((frames, 20)) < 0.7).astype(float)
    planted, heels = plant(time, path, confidence, stands, BODY)
    assert np.isfinite(planted).all()
    assert not (heels & ~stands).any()


def test_toes_right_under_the_ankle_still_stand() -> None:
    path = standing(20)
    path[:, TOES[0], [0, 2]] = path[:, ANKLES[0], [0, 2]]
    stands = np.ones((20, 2), dtype=np.bool_)
    planted, _ = plant(stamps(20), path, ones(path), stands, BODY)
    assert np.isfinite(planted).all()
    np.testing.assert_allclose(planted[:, TOES[0], 1], BODY.radii[TOES[0]], atol=STILL)


def test_sides_are_in_the_order_of_the_flags() -> None:
    assert SIDES == ("Left", "Right")
    path, stands = standing(30), np.zeros((30, 2), dtype=np.bool_)
    path[:, FEET, 0] += np.random.default_rng(0).normal(0.0, 0.01, (30, 1))
    stands[:, 1] = True
    planted, _ = plant(stamps(30), path, ones(path), stands, BODY)
    right = KINECT_V1.index("AnkleRight")
    assert np.ptp(planted[:, right, 0]) < STILL
    assert np.ptp(planted[:, KINECT_V1.index("AnkleLeft"), 0]) > 0.02
