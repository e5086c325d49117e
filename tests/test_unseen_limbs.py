"""Limbs that the sensor never sees are where people mostly have them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from real_data import PAIRS, paired

from kinefilter import CleanConfig, Cleaner
from kinefilter.characters import KINECT_V1, State, Take, standard_body
from kinefilter.characters.rotations import about_y, rotate
from kinefilter.pipeline.lab.limb_lessons import with_prior
from kinefilter.pipeline.pairs import read_pairs
from kinefilter.pipeline.reconstruct import HiddenLimbTracker, MotionPrior, stage
from kinefilter.pipeline.reconstruct.hidden_limbs import fill_unseen
from kinefilter.pipeline.reconstruct.prior import default_prior
from kinefilter.retarget import Standardizer

Array = NDArray[np.float64]
BODY = standard_body(KINECT_V1)
RATE = 30.0
PLACE = np.array([0.3, 1.0, 2.5])
MOVED = np.array([1.0, 0.1, -0.5])


def joints(*names: str) -> list[int]:
    return [KINECT_V1.index(name) for name in names]


LEGS = joints("KneeLeft", "AnkleLeft", "KneeRight", "AnkleRight")
ARMS = [joints(f"Elbow{s}", f"Wrist{s}", f"Hand{s}") for s in ("Left", "Right")]


def postures(count: int = 30) -> Array:
    """Return a body whose right arm is lifted to the side and forward, (T, J, 3)."""
    frames = np.repeat(BODY.rest_positions[None], count, axis=0) + PLACE
    lift = np.linspace(0.0, 1.0, count)[:, None]
    at = frames[:, KINECT_V1.index("ShoulderRight")]
    for j in ARMS[1]:
        bone = np.array([-0.5, -1.0, 0.0]) + lift * [0.0, 1.2, 0.8]
        bone /= np.linalg.norm(bone, axis=1, keepdims=True)
        at = frames[:, j] = at + BODY.lengths[j] * bone
    return frames


def filled(positions: Array, hidden: list[int]) -> Array:
    """Return positions in which joints that are never seen are filled."""
    blind = positions.copy()
    blind[:, hidden] = np.nan
    unseen = np.isnan(blind[..., 0]).all(axis=0)
    time = np.arange(len(positions)) / RATE
    return fill_unseen(time, blind, unseen, BODY, default_prior())[0]


def test_joints_that_are_never_tracked_are_told() -> None:
    time, places = np.arange(30) / RATE, postures()
    state = np.full(places.shape[:2], State.TRACKED, dtype=np.uint8)
    cleaner = Cleaner(CleanConfig(physics=False))
    word = "never tracked"
    seen = cleaner.clean(Take(time, places, state, KINECT_V1))
    assert not any(word in note for note in seen.notes)
    state[:, LEGS] = State.NOT_TRACKED
    blind = cleaner.clean(Take(time, places, state, KINECT_V1))
    names = "KneeLeft, AnkleLeft, KneeRight, AnkleRight"
    assert f"{word}, so a guess: {names}" in blind.notes


def test_unseen_legs_stand_below_the_hips() -> None:
    found = filled(postures(), LEGS)
    for side in ("Left", "Right"):
        hip, knee, ankle = joints(f"Hip{side}", f"Knee{side}", f"Ankle{side}")
        down = found[:, hip] - found[:, ankle]
        upright = down[:, 1] / np.linalg.norm(down, axis=1)
        assert upright.min() > np.cos(np.deg2rad(20.0))
        for end, start in ((knee, hip), (ankle, knee)):
            lengths = np.linalg.norm(found[:, end] - found[:, start], axis=1)
            np.testing.assert_allclose(lengths, BODY.lengths[end], atol=1e-9)


def test_what_was_seen_stays_and_hands_are_left_to_other_stages() -> None:
    seen = postures()
    found = filled(seen, ARMS[0])
    others = np.setdiff1d(np.arange(len(KINECT_V1)), ARMS[0])
    np.testing.assert_array_equal(found[:, others], seen[:, others])
    assert np.isfinite(found[:, ARMS[0][:2]]).all()
    assert np.isnan(found[:, ARMS[0][2]]).all()


def test_the_left_arm_is_the_mirror_image_of_the_right() -> None:
    seen, flip = postures(), np.array([-1.0, 1.0, 1.0])
    for hidden, other in (ARMS, ARMS[::-1]):
        mirrored = filled((flip * seen)[:, KINECT_V1.mirror], other)
        expected = (flip * mirrored)[:, KINECT_V1.mirror]
        np.testing.assert_allclose(filled(seen, hidden), expected, atol=1e-9)


@pytest.mark.parametrize("yaw", [0.7, -2.5])
def test_limbs_turn_and_move_with_the_person(yaw: float) -> None:
    seen, turn = postures(), about_y(np.array(yaw))
    expected = rotate(turn, filled(seen, ARMS[0])) + MOVED
    found = filled(rotate(turn, seen) + MOVED, ARMS[0])
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_who_crouches_bends_the_knees() -> None:
    low = postures(60)
    low[30:, :, 1] -= 0.4
    found = filled(low, LEGS)
    knee, hip, ankle = joints("KneeLeft", "HipLeft", "AnkleLeft")
    reach = np.linalg.norm(found[:, ankle] - found[:, hip], axis=1)
    assert reach[-5:].mean() < 0.93 * reach[:5].mean()
    assert (found[-5:, knee, 2] > found[-5:, hip, 2]).all()  # they bend forward


def test_without_a_network_nothing_is_filled() -> None:
    blind = postures()
    blind[:, LEGS] = np.nan
    unseen, time = np.isnan(blind[0, :, 0]), np.arange(len(blind)) / RATE
    found, which = fill_unseen(time, blind, unseen, BODY, MotionPrior({}))
    np.testing.assert_array_equal(found, blind)
    assert not which.any()


def test_live_limbs_come_to_where_they_are_in_whole_takes() -> None:
    still = np.repeat(postures(30)[-1:], 60, axis=0)
    expected, blind = filled(still, LEGS)[-1], still.copy()
    blind[:, LEGS] = np.nan
    tracker = HiddenLimbTracker(BODY)
    for k, frame in enumerate(blind):
        found, hidden = tracker.step(frame, np.isnan(frame[:, 0]), k / RATE)
    np.testing.assert_allclose(found[LEGS], expected[LEGS], atol=1e-6)
    assert hidden[LEGS].all()


def test_a_live_limb_that_is_seen_at_last_gets_there_without_a_jump() -> None:
    seen, tracker, places = postures(90), HiddenLimbTracker(BODY), []
    wrist = ARMS[1][1]
    for k, frame in enumerate(seen):
        blind = frame.copy()
        if k < 45:
            blind[ARMS[1]] = np.nan
        found, _ = tracker.step(blind, np.isnan(blind[:, 0]), k / RATE)
        places.append(found[wrist])
    away = np.linalg.norm(np.array(places) - seen[:, wrist], axis=1)
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    assert away[:45].mean() > 0.1
    assert steps.max() < 0.5 * away[44]
    np.testing.assert_allclose(away[53:], 0.0, atol=1e-9)


def error_from_hips(away: Array, joints: list[int]) -> float:
    away = away - away[:, KINECT_V1.hips].mean(axis=1, keepdims=True)
    return float(np.linalg.norm(away[:, joints], axis=2).mean())


@paired
def test_unseen_legs_are_nearer_to_where_they_are_than_without_networks() -> None:
    config = CleanConfig(physics=False)
    cleaners = [Cleaner(config), with_prior(Cleaner(config), config, MotionPrior({}))]
    errors = []
    for pair in read_pairs(PAIRS / "s08.npz")[::40]:
        skeleton, positions = pair.take.skeleton, pair.take.positions.copy()
        ends, state = ("Knee", "Ankle", "Foot"), pair.take.state.copy()
        gone = [j for j, n in enumerate(skeleton.joints) if n.startswith(ends)]
        positions[:, gone], state[:, gone] = np.nan, State.NOT_TRACKED
        blind = replace(pair.take, positions=positions, state=state)
        truth = cleaners[0].clean(pair.take).clip.positions
        away = [cleaner.clean(blind).clip.positions - truth for cleaner in cleaners]
        errors.append([error_from_hips(one, gone) for one in away])
    error, without = np.mean(errors, axis=0)
    assert error < 0.9 * without


def test_frames_before_the_person_is_seen_face_as_the_first_seen_one() -> None:
    body = standard_body(KINECT_V1)
    positions = np.tile(rotate(about_y(2.0), body.rest_positions), (5, 1, 1))
    weights = np.ones(positions.shape[:2])
    weights[:3] = 0.0  # places that were filled in, with no reliability
    _, view = Standardizer(body).steps(positions, weights)
    np.testing.assert_allclose(view.yaw, 2.0)


def test_a_live_frame_learns_of_one_limb_at_most(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    seen, tracker, learned = postures(90), HiddenLimbTracker(BODY), list[int]()

    def counted(*_: Any, **__: Any) -> None:
        learned.append(k)

    monkeypatch.setattr(stage, "learn", counted)
    seen[60:, [*ARMS[0], *ARMS[1], *LEGS]] = np.nan
    for k, frame in enumerate(seen):
        tracker.step(frame, np.isnan(frame[:, 0]), k / RATE)
    assert learned == [63, 64, 65, 66]
