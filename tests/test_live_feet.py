"""Feet of live motion, which does not look ahead."""

from __future__ import annotations

import numpy as np
import pytest
from known_motions import BODY, Array, noisy, stamps, standing, toes_rest
from numpy.typing import NDArray

from kinefilter.characters import KINECT_V1, State
from kinefilter.characters.arrays import runs
from kinefilter.characters.rotations import about_y, rotate
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.draft import Draft
from kinefilter.pipeline.target import feet
from kinefilter.pipeline.target.stance_odds import legs_of
from kinefilter.pipeline.target.target_stages import Bones, Feet
from kinefilter.scenes.library import perform

Flags = NDArray[np.bool_]
LEGS = legs_of(KINECT_V1)


def standing_legs(frames: int) -> Array:
    return standing(frames)[:, LEGS]


def live_stances(time: Array, legs: Array) -> Flags:
    tracker = feet.StanceTracker()
    frames = zip(time.tolist(), legs, strict=True)
    return np.array([tracker.step(*frame) for frame in frames])


def test_no_foot_stands_where_it_no_longer_is() -> None:
    """A foot that creeps too slowly for a step is planted again and again."""
    legs = standing_legs(120)
    legs[:, 2, 0] += np.linspace(0.0, 1.0, 120)
    stands = live_stances(stamps(120), legs)
    stances = runs(stands[:, 0])
    assert len(stances) > 3
    for stance in stances:
        assert np.ptp(legs[stance, 2, 0]) < feet._DRIFT + 0.05
    assert stands[:, 1].all()


def test_a_foot_is_lifted_while_it_steps_and_only_then() -> None:
    tracker, legs = feet.StanceTracker(), standing_legs(90)
    ahead = np.interp(np.arange(90), [30, 50], [0.0, 1.0])
    legs[:, 2, 2] += ahead
    toes = np.tile([0.0, 0.03, 2.0], (90, 2, 1))
    toes[:, 0, 2] += ahead
    up = []
    for now, frame, tips in zip(stamps(90).tolist(), legs, toes, strict=True):
        tracker.step(now, frame)
        up.append(tracker.lift(tips, np.zeros(2), 1.0 / 30.0))
    lifted = np.array(up)
    assert not lifted[:30].any()
    assert lifted[:, 0].max() == pytest.approx(feet.CLEARANCE)
    assert not lifted[70:].any()
    assert not lifted[:, 1].any()


@pytest.mark.parametrize("foot", [0, 1])
def test_a_foot_that_is_lifted_is_told_within_a_few_frames(foot: int) -> None:
    legs = standing_legs(60)
    lifted = np.interp(np.arange(60), [20, 26, 34, 40], [0.0, 0.3, 0.3, 0.0])
    legs[:, 2 + foot, 1] += lifted
    stands = live_stances(stamps(60), legs)
    assert stands[:20].all()
    assert not stands[24:38, foot].any()
    assert stands[-10:].all()
    assert stands[:, 1 - foot].all()


@pytest.mark.parametrize("foot", [0, 1])
@pytest.mark.parametrize("error", [[0.0, 0.3, 0.0], [0.3, 0.0, 0.0], [0.2, 0.2, 0.2]])
def test_one_wrong_frame_lifts_no_foot(foot: int, error: list[float]) -> None:
    legs = standing_legs(60)
    legs[30, 2 + foot] += error
    assert live_stances(stamps(60), legs).all()


@pytest.mark.parametrize("fps", [15.0, 30.0, 60.0, 120.0])
def test_feet_at_rest_stand_however_they_tremble(fps: float) -> None:
    time = stamps(int(6 * fps), fps)
    legs = standing_legs(len(time))
    legs += np.random.default_rng(1).normal(0.0, 0.008, legs.shape)
    assert live_stances(time, legs).all()


@pytest.mark.parametrize(
    ("motion", "agreement"),
    [
        ("walk", 0.85),
        ("march", 0.88),
        ("jump", 0.9),
        ("kick", 0.9),
        ("step_over", 0.9),
        ("leg_raise", 0.9),
        ("squat", 1.0),
    ],
)
def test_live_feet_of_a_performance_stand_where_their_toes_rest(
    motion: str, agreement: float
) -> None:
    for seed in range(2):
        act = perform(motion, BODY, seed=seed)
        truth = toes_rest(act.time, act.positions)
        stands = live_stances(act.time, noisy(act, 0.005)[:, LEGS])
        assert np.mean(stands == truth) >= agreement
        for foot in range(2):
            lifts = runs(~truth[:, foot], shortest=9)
            assert not any(stands[lift, foot].all() for lift in lifts)


def test_live_stances_do_not_depend_on_place_heading_or_side() -> None:
    act = perform("walk", BODY, seed=1)
    legs = noisy(act, 0.005)[:, LEGS]
    stands = live_stances(act.time, legs)
    assert 0.3 < stands.mean() < 0.95
    turned = rotate(about_y(0.7), legs) + np.array([3.0, 0.0, -2.0])
    assert np.mean(live_stances(act.time + 1e4, turned) == stands) > 0.99
    mirrored = legs[:, [1, 0, 3, 2]] * [-1.0, 1.0, 1.0]
    assert np.mean(live_stances(act.time, mirrored)[:, ::-1] == stands) > 0.99


@pytest.mark.parametrize("motion", ["walk", "dance"])
def test_live_feet_do_not_drag_the_hips_along(motion: str) -> None:
    """Without looking ahead, a foot is let go of after it has begun to step."""
    act, skeleton = perform(motion, BODY, seed=1), KINECT_V1
    stages, found = (Feet(CleanConfig()), Bones()), []
    for stage in stages:
        stage.start(act.body)
    state = np.full(len(skeleton), State.TRACKED, dtype=np.uint8)
    for now, seen in zip(act.time, act.positions, strict=True):
        draft = Draft(skeleton, float(now), seen, state)
        draft.positions, draft.body = seen, act.body
        draft.confidence, draft.elapsed = np.ones(len(skeleton)), 1.0 / 30.0
        for stage in stages:
            stage.step(draft)
        found.append(draft.positions)
    off = np.linalg.norm(np.array(found) - act.positions, axis=2)
    assert off.mean() < 0.015
    leaps = [
        np.linalg.norm(np.diff(positions[:, skeleton.root], 2, axis=0), axis=1).max()
        for positions in (np.array(found), act.positions)
    ]
    assert leaps[0] < 3.0 * leaps[1]
