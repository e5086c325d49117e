"""Left and right of people whom the sensor takes for others who face it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from known_motions import performed, yaw_of
from numpy.typing import NDArray
from real_data import DATA, recorded
from sides_figures import figures_of, swapped_live
from skeletons import every_skeleton

from kinefilter import CleanConfig, Cleaner
from kinefilter.characters import KINECT_V2, Skeleton, State, standard_body
from kinefilter.pipeline.failures.sides import Sides, swapped_back, swapped_frames
from kinefilter.pipeline.lab.limb_guesses import HIDDEN
from kinefilter.pipeline.lab.view_sessions import find_sessions

Array = NDArray[np.float64]


@every_skeleton
def test_who_walks_forward_with_sides_swapped_is_found(skeleton: Skeleton) -> None:
    take = performed("walk", skeleton)
    assert not swapped_frames(take).any()
    assert swapped_frames(take.swapped()).all()
    part = slice(40, 90)
    found = swapped_frames(take.swapped(part))
    for swapped in found.T:  # trunk and arms, legs
        np.testing.assert_array_equal(np.flatnonzero(swapped), np.arange(40, 90))


@every_skeleton
@pytest.mark.parametrize("early", [False, True])
def test_legs_change_sides_before_or_after_the_arms(
    skeleton: Skeleton, early: bool
) -> None:
    take = performed("walk", skeleton, seed=2)
    legs = [j for hip in skeleton.hips for j in skeleton.descendants(hip) if j != hip]
    swapped = np.zeros((len(take), 2), dtype=bool)
    swapped[60:, 0] = True
    swapped[52 if early else 68 :, 1] = True
    seen = take.swapped(swapped[:, 0]).positions.copy()
    seen[:, legs] = take.swapped(swapped[:, 1]).positions[:, legs]
    seen = replace(take, positions=seen)
    np.testing.assert_array_equal(swapped_frames(seen), swapped)
    feet = list(skeleton.sides("Foot"))  # their toes are turned
    others = np.setdiff1d(np.arange(len(skeleton)), feet)
    mended = swapped_back(seen, swapped).positions
    np.testing.assert_allclose(mended[:, others], take.positions[:, others], atol=1e-9)


@every_skeleton
@pytest.mark.parametrize("motion", ["wave", "punch", "stand_idle"])
def test_who_is_seen_from_the_chest_up_keeps_the_sides(
    skeleton: Skeleton, motion: str
) -> None:
    take = performed(motion, skeleton)
    positions = take.positions.copy()
    below = [j for hip in skeleton.hips for j in (hip, *skeleton.descendants(hip))]
    positions[:, [skeleton.root, *below]] = np.nan
    seated = replace(take, positions=positions)
    assert not swapped_frames(seated).any()
    assert not swapped_live(seated).any()


def test_knees_that_the_sensor_guesses_do_not_tell_the_sides() -> None:
    take = performed("stand_idle")
    knees = take.skeleton.sides("Knee")
    ahead = np.array([np.sin(yaw_of(take)), 0.0 * take.time, np.cos(yaw_of(take))]).T
    positions, state = take.positions.copy(), take.state.copy()
    positions[:, knees] -= 0.5 * ahead[:, None]
    assert swapped_frames(replace(take, positions=positions)).any()
    state[:, knees] = State.INFERRED
    assert not swapped_frames(replace(take, positions=positions, state=state)).any()


@every_skeleton
@pytest.mark.parametrize("motion", ["walk", "run"])
def test_live_sides_follow_within_half_a_second(
    skeleton: Skeleton, motion: str
) -> None:
    take = performed(motion, skeleton)
    assert not swapped_live(take).any()
    part = slice(40, 80)
    found = swapped_live(take.swapped(part))
    assert not found[:40].any()
    assert found[55:80].all()
    assert not found[95:].any()


def test_live_motion_faces_where_somebody_walks() -> None:
    take = performed("walk").swapped()
    cleaner = Cleaner(CleanConfig(method="none")).until("failures")
    cleaner.start(standard_body(KINECT_V2))
    frames = zip(take.positions, take.time, take.state, strict=True)
    drafts = [cleaner.step(p, float(s), state) for p, s, state in frames]
    late = np.array([draft.measured for draft in drafts[20:]])
    other = [j for j in range(len(KINECT_V2)) if j not in KINECT_V2.sides("Foot")]
    np.testing.assert_array_equal(late[:, other], take.swapped().positions[20:, other])


@pytest.mark.parametrize("motion", ["walk", "run"])
@pytest.mark.parametrize("seed", range(3))
def test_who_walks_backward_is_left_alone(motion: str, seed: int) -> None:
    take = performed(motion, seed=seed)
    back = replace(take, positions=take.positions[::-1])
    assert not swapped_frames(back).any()
    assert not swapped_live(back).any()


@pytest.mark.parametrize("limb", ["left-arm", "arms", "right-leg", "legs"])
@pytest.mark.parametrize("begin", [0, 60])
def test_hidden_limbs_leave_enough_to_see(limb: str, begin: int) -> None:
    take = performed("walk")
    joints = [
        KINECT_V2.index(name) for name in HIDDEN[limb] if name in KINECT_V2.joints
    ]
    positions = take.positions.copy()
    positions[begin:, joints] = np.nan
    hidden = replace(take, positions=positions)
    assert not swapped_frames(hidden).any()
    assert swapped_frames(hidden.swapped()).all()


@pytest.mark.parametrize("legs", [True, False])
def test_toes_that_point_at_the_sensor_are_turned_forward(*, legs: bool) -> None:
    """Also while the sensor has swapped trunk and arms alone."""
    take = performed("walk")
    feet = list(KINECT_V2.sides("Foot"))
    ankles = take.positions[:, [KINECT_V2.parents[foot] for foot in feet]]
    yaw = yaw_of(take)
    forward = np.stack([np.sin(yaw), np.zeros(len(yaw)), np.cos(yaw)], axis=1)
    true, seen = take.positions.copy(), take.positions.copy()
    true[:, feet] = ankles + 0.1 * forward[:, None] + [0.02, -0.06, 0.0]
    seen[:, feet] = (
        true[:, feet]
        - 2.0
        * np.vecdot(true[:, feet] - ankles, forward[:, None])[..., None]
        * forward[:, None]
    )
    swapped = np.array([[True, legs]]).repeat(len(take), axis=0)
    below = np.concatenate([KINECT_V2.descendants(hip) for hip in KINECT_V2.hips])
    for toes in (seen, true):
        shown = replace(take, positions=toes).swapped().positions.copy()
        if not legs:
            shown[:, below] = toes[:, below]
        mended = swapped_back(replace(take, positions=shown), swapped)
        np.testing.assert_allclose(mended.positions, true, atol=1e-9)


@recorded
def test_recorded_walkers_have_limbs_where_another_sensor_has_them() -> None:
    """They walk away from a sensor, which has them walk backward, and stand beside."""
    names = ("p10_90deg_walk", "p14_90deg_walk", "p16_45deg_walk")
    paths = [DATA / "two-kinects" / f"{name}.sync.csv" for name in names]
    sessions = find_sessions(paths, None)
    figures = np.mean([figures_of(session) for session in sessions], axis=0)
    (backward, less, live), (wrong, still_wrong, wrong_live) = figures.reshape(3, 3)[:2]
    assert backward > 20.0
    assert less < 0.4 * backward
    assert live < 0.6 * backward
    assert still_wrong < wrong + 0.5
    assert wrong_live < wrong + 4.0


def test_the_best_choice_so_far_ends_the_cheapest_path_so_far() -> None:
    rng, count = np.random.default_rng(0), 300
    seen = np.tile(standard_body(KINECT_V2).rest_positions, (count, 3, 1, 1))
    seen += rng.normal(scale=0.2, size=seen.shape)
    some = rng.random((count, 3)) < 0.5
    seen[some] = seen[some][:, KINECT_V2.mirror]
    seen[:20, 1] = seen[100:130] = seen[200:270, 2] = np.nan  # not seen at all
    seen[rng.random(seen.shape[:3]) < 0.1] = np.nan
    weights, sides = rng.random(seen.shape[:3]), Sides(KINECT_V2, 3)
    steps = [sides.step(*frame) for frame in zip(seen, weights, strict=True)]
    assert len({tuple(step) for step in steps}) > 4
    for k in range(1, count + 1, 5):
        path = sides.whole(seen[:k], weights[:k])
        np.testing.assert_array_equal(path[-1], steps[k - 1])
