"""The floor under a take."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from known_motions import standing
from numpy.typing import NDArray
from skeletons import every_skeleton

from kinefilter import CleanConfig, InputError, clean
from kinefilter.characters import (
    KINECT_V1,
    KINECT_V2,
    Body,
    Skeleton,
    positions_from_rotations,
    standard_body,
)
from kinefilter.characters.rotations import about_y, normalize, rotate
from kinefilter.pipeline.metrics import lowest_point
from kinefilter.pipeline.target.feet import find_stance
from kinefilter.pipeline.target.floor import Stood, floor_heights, put_on_floor
from kinefilter.scenes.library import perform
from kinefilter.scenes.sensor import sample_take

Array = NDArray[np.float64]


def no_stance(frames: int) -> NDArray[np.bool_]:
    return np.zeros((frames, 2), dtype=np.bool_)


def planted_feet(skeleton: Skeleton) -> list[int]:
    return [
        skeleton.index(part + side)
        for part in ("Ankle", "Foot")
        for side in ("Left", "Right")
    ]


def floor_height(
    positions: Array, confidence: Array, stands: NDArray[np.bool_], body: Body
) -> float:
    return floor_heights([Stood(positions, confidence, stands, body)])[0]


@given(
    skeleton=st.sampled_from([KINECT_V1, KINECT_V2]),
    lift=st.floats(-3.0, 3.0),
    yaw=st.floats(-3.0, 3.0),
)
def test_the_floor_is_under_a_standing_person_at_any_height(
    skeleton: Skeleton, lift: float, yaw: float
) -> None:
    positions = rotate(about_y(yaw), standing(10, skeleton)) + np.array(
        [1.0, lift, 2.0]
    )
    confidence = np.ones(positions.shape[:2])
    for stands in (no_stance(10), ~no_stance(10)):
        found = floor_height(positions, confidence, stands, standard_body(skeleton))
        assert found == pytest.approx(lift, abs=1e-9)


@pytest.mark.parametrize("name", ["walk", "wave", "squat", "punch"])
def test_the_floor_of_a_performance_is_where_it_is(name: str) -> None:
    act = perform(name, standard_body(KINECT_V1), seed=0)
    confidence = np.ones(act.positions.shape[:2])
    sunken = act.positions - [0.0, 0.9, 0.0]
    stands = find_stance(act.time, sunken, confidence, KINECT_V1)
    for known in (no_stance(len(act)), stands):
        found = floor_height(sunken, confidence, known, act.body)
        assert found == pytest.approx(-0.9, abs=0.02)


def test_one_foot_on_the_floor_is_enough_even_where_only_its_ankle_is_seen() -> None:
    body, feet = standard_body(KINECT_V1), planted_feet(KINECT_V1)
    positions, confidence = standing(10) + np.array([0.0, 0.2, 0.0]), np.ones((10, 20))
    right = [j for j in feet if KINECT_V1.joints[j].endswith("Right")]
    positions[:, right, 1] += 0.3
    assert floor_height(positions, confidence, no_stance(10), body) == pytest.approx(
        0.2
    )
    confidence[:, KINECT_V1.index("FootLeft")] = 0.4
    positions[:, KINECT_V1.index("FootLeft"), 1] -= 9.0
    assert floor_height(positions, confidence, no_stance(10), body) == pytest.approx(
        0.2
    )


def test_jumps_and_sunken_frames_do_not_move_the_floor() -> None:
    body, positions = standard_body(KINECT_V1), standing(100)
    positions[:30] += [0.0, 0.4, 0.0]
    positions[50:58] -= [0.0, 0.2, 0.0]
    assert floor_height(
        positions, np.ones((100, 20)), no_stance(100), body
    ) == pytest.approx(0.0)


def test_invented_and_missing_feet_have_no_say() -> None:
    body, feet = standard_body(KINECT_V1), planted_feet(KINECT_V1)
    positions, confidence = standing(20) + np.array([0.0, -0.5, 0.0]), np.ones((20, 20))
    positions[:12, feet, 1] -= 1.0
    confidence[:12, feet] = 0.0
    assert floor_height(positions, confidence, no_stance(20), body) == pytest.approx(
        -0.5
    )
    positions[:12, feet] = np.nan
    confidence[:12, feet] = 1.0
    assert floor_height(positions, confidence, no_stance(20), body) == pytest.approx(
        -0.5
    )


@every_skeleton
def test_without_any_measured_foot_the_lowest_joint_serves(skeleton: Skeleton) -> None:
    positions, body = (
        standing(20, skeleton) + np.array([0.0, 0.7, 0.0]),
        standard_body(skeleton),
    )
    confidence = np.ones(positions.shape[:2])
    confidence[:, planted_feet(skeleton)] = 0.0
    assert floor_height(positions, confidence, no_stance(20), body) == pytest.approx(
        0.7
    )


def test_the_floor_is_the_median_under_the_ankles_that_stand_and_were_measured() -> (
    None
):
    body, stands = standard_body(KINECT_V1), no_stance(30)
    positions, confidence = standing(30), np.ones((30, 20))
    left, right = (KINECT_V1.index(f"Ankle{side}") for side in ("Left", "Right"))
    stands[:20, 0], stands[10:, 1] = True, True
    positions[:20, left, 1] += np.linspace(0.1, 0.3, 20)
    positions[10:, right, 1] += 0.2
    # What the feet do while they do not stand has no say.
    positions[20:, left, 1] -= 5.0
    positions[:10, right, 1] += 5.0
    assert floor_height(positions, confidence, stands, body) == pytest.approx(0.2)
    confidence[10:, right] = 0.4
    positions[10:, right, 1] += 3.0
    positions[15:, KINECT_V1.index("FootLeft"), 1] -= 3.0
    assert floor_height(positions, confidence, stands, body) == pytest.approx(0.2)


def test_stances_nobody_saw_leave_the_floor_to_the_rest_of_the_feet() -> None:
    body, positions, confidence = (
        standard_body(KINECT_V1),
        standing(20),
        np.ones((20, 20)),
    )
    ankles = [KINECT_V1.index(f"Ankle{side}") for side in ("Left", "Right")]
    confidence[:, ankles] = 0.0
    positions[:, ankles, 1] += 0.5
    everything = ~no_stance(20)
    assert floor_height(positions, confidence, everything, body) == pytest.approx(0.0)
    positions[:, ankles] = np.nan
    confidence[:, ankles] = 1.0
    assert floor_height(positions, confidence, everything, body) == pytest.approx(0.0)


@given(skeleton=st.sampled_from([KINECT_V1, KINECT_V2]), seed=st.integers(0, 2**32 - 1))
def test_no_capsule_is_left_under_the_floor(skeleton: Skeleton, seed: int) -> None:
    rng, body = np.random.default_rng(seed), standard_body(skeleton)
    rotations = normalize(rng.normal(size=(4, len(skeleton), 4)))
    root = rng.normal(size=(4, 3))
    positions = positions_from_rotations(rotations, root, body)
    before = positions.copy()
    lifted = put_on_floor(positions, body)
    np.testing.assert_array_equal(positions, before)
    assert lowest_point(lifted, body).min() >= -1e-12
    np.testing.assert_array_equal(lifted[..., [0, 2]], positions[..., [0, 2]])
    assert (lifted[..., 1] >= positions[..., 1]).all()


def test_who_stands_over_the_floor_stays_and_landing_twice_is_landing_once() -> None:
    body = standard_body(KINECT_V1)
    high = standing(3) + np.array([0.0, 0.5, 0.0])
    np.testing.assert_array_equal(put_on_floor(high, body), high)
    once = put_on_floor(standing(3) - [0.0, 0.4, 0.0], body)
    np.testing.assert_array_equal(put_on_floor(once, body), once)


def test_whose_feet_nobody_saw_stands_on_the_floor_of_the_others() -> None:
    body, positions, confidence = (
        standard_body(KINECT_V1),
        standing(20),
        np.ones((20, 20)),
    )
    hidden = confidence.copy()
    hidden[:, planted_feet(KINECT_V1)] = 0.0
    people = [
        Stood(positions + np.array([0.0, 0.1, 0.0]), confidence, ~no_stance(20), body),
        Stood(positions + np.array([0.0, 0.6, 0.0]), hidden, no_stance(20), body),
        Stood(positions + np.array([0.0, 0.3, 0.0]), confidence, ~no_stance(20), body),
    ]
    assert floor_heights(people) == pytest.approx([0.1, 0.2, 0.3])


def test_a_floor_far_above_the_feet_is_refused() -> None:
    take = sample_take().at(slice(60))
    config = CleanConfig("none", physics=False)
    found = clean(take, config).clip.floor
    assert clean(take, replace(config, floor=found + 0.2)).clip.floor == found + 0.2
    with pytest.raises(InputError, match=f"feet are at {found:.2f} m"):
        clean(take, replace(config, floor=1.0))


def test_feet_of_whoever_hangs_from_a_bar_stay_in_the_air() -> None:
    take = sample_take().at(slice(150))
    lift = 0.6 * np.convolve(np.arange(150) > 60, np.ones(9) / 9, "same")[:, None]
    positions = take.positions.copy()
    positions[..., 1] += np.where(np.arange(150) > 145, 0.6, lift[:, 0])[:, None]
    clip = clean(replace(take, positions=positions), CleanConfig(physics=False)).clip
    hangs = slice(70, 140)
    assert clip.contacts[:50].any(axis=1).all()
    assert not clip.contacts[hangs].any()
    ankles = clip.positions[:, planted_feet(take.skeleton), 1]
    rise = ankles[hangs].mean() - ankles[:50].mean()
    assert rise == pytest.approx(0.6, abs=0.05)
