"""The motion that the character is pulled through: feet, floor, bones."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from known_motions import noisy, plant
from numpy.typing import NDArray
from skeletons import every_skeleton

from kinefilter import CleanConfig, CleanResult, clean
from kinefilter.characters import (
    CONTACTS,
    KINECT_V1,
    Body,
    Motion,
    State,
    Take,
    standard_body,
)
from kinefilter.characters.rotations import wrapped
from kinefilter.characters.skeleton import SIDES
from kinefilter.pipeline.draft import Draft
from kinefilter.pipeline.metrics import bone_length_cv, jitter, lowest_point
from kinefilter.pipeline.progress import silent
from kinefilter.pipeline.stages import Stage
from kinefilter.pipeline.target.aim_stages import Orient
from kinefilter.pipeline.target.feet import (
    ankles_and_toes,
    find_stance,
    flat_height,
    planted_feet,
)
from kinefilter.pipeline.target.frame_stages import Floor, Level
from kinefilter.pipeline.target.target_stages import Bones, Feet, Smooth
from kinefilter.retarget import BoneLengths
from kinefilter.scenes.library import perform

Array = NDArray[np.float64]

BODY = standard_body(KINECT_V1)
ANKLES, TOES = ankles_and_toes(KINECT_V1)


def placed(
    time: Array,
    positions: Array,
    body: Body = BODY,
    confidence: Array | None = None,
    contacts: NDArray[np.bool_] | None = None,
    **options: Any,
) -> Draft:
    """Pass corrected positions through the stages from the floor to the rotations."""
    shape = positions.shape[:2]
    state = np.full(shape, State.TRACKED, dtype=np.uint8)
    draft = Draft(body.skeleton, time, positions, state)
    draft.positions, draft.body = positions, body
    draft.confidence = np.ones(shape) if confidence is None else confidence
    config = CleanConfig(**options)
    level, feet = Level(config), Feet(config, contacts)
    stages: list[Stage] = [level, Smooth(config), Floor(config), feet]
    for stage in [*stages, Bones(), Orient()]:
        stage.whole(draft, silent)
    return draft


def target_of(act: Motion, **options: Any) -> Draft:
    return placed(act.time, noisy(act), **options)


@pytest.fixture(scope="module")
def walk() -> Motion:
    return perform("walk", BODY, seed=1)


@pytest.fixture(scope="module")
def kick() -> Motion:
    return perform("kick", BODY, seed=1)


# Feet


@pytest.mark.parametrize("motion", ["walk", "kick", "march", "squat", "sit"])
def test_the_soles_of_standing_feet_hardly_move_once_bones_are_in_place(
    motion: str,
) -> None:
    act = perform(motion, BODY, seed=1)
    target = target_of(act)
    posed = target.posed
    assert target.stands.any()
    for foot, toe in enumerate(TOES):
        stands = target.stands[1:, foot] & target.stands[:-1, foot]
        steps = np.linalg.norm(np.diff(posed[:, toe], axis=0), axis=1)[stands]
        assert steps.mean() < 1e-3
        soles = posed[target.stands[:, foot], toe, 1] - BODY.radii[toe]
        assert np.abs(soles).mean() < 2e-3


@pytest.mark.parametrize("seed", range(3))
def test_heels_do_not_drag_while_legs_get_longer(seed: int) -> None:
    """A sensor that sees no steps, and hips 12 cm too low, shows legs too short."""
    act = perform("walk", BODY, seed=seed)
    path, skeleton = noisy(act), BODY.skeleton
    legs = [j for hip in skeleton.hips for j in skeleton.descendants(hip)]
    path[:, np.setdiff1d(np.arange(len(skeleton)), legs), 1] -= 0.12
    path[:, ANKLES + TOES, 1] = [0.08, 0.08, 0.03, 0.03]
    target = placed(act.time, path)
    heels = target.posed[1:, ANKLES]
    speed = np.linalg.norm(
        np.diff(target.posed[:, ANKLES][..., [0, 2]], axis=0), axis=2
    )
    down = heels[..., 1] < flat_height(BODY, TOES[0]) + 0.01
    assert np.mean(down & (speed > 0.01)) < 0.01


@pytest.mark.parametrize("seed", range(1, 5))
def test_hips_of_a_walker_do_not_drop_at_each_step(seed: int) -> None:
    """Legs that are 3 % too short cannot reach where the feet land."""
    act, lengths, hips = perform("walk", BODY, seed=seed), BODY.lengths.copy(), []
    lengths[KINECT_V1.legs] *= 0.97
    target = placed(act.time, noisy(act), replace(BODY, lengths=lengths))
    for positions in (target.positions, act.positions):
        hips.append(positions[:, KINECT_V1.hips].mean(axis=1))
    speed = np.diff(hips[0] - hips[1], axis=0) / np.diff(act.time)[:, None]
    assert np.linalg.norm(speed, axis=1).mean() < 0.08


def test_contacts_say_heel_and_toes_of_both_feet(kick: Motion) -> None:
    target = target_of(kick)
    assert target.contacts.shape == (len(kick), len(CONTACTS))
    assert target.contacts.dtype == np.bool_
    np.testing.assert_array_equal(target.stands, planted_feet(target.contacts))
    np.testing.assert_array_equal(target.contacts[:, 1::2], target.stands)
    # A heel is down only where its foot stands.
    assert not (target.contacts[:, ::2] & ~target.stands).any()
    found = find_stance(
        kick.time, noisy(kick), np.ones(kick.positions.shape[:2]), KINECT_V1
    )
    np.testing.assert_array_equal(target.stands, found)


@pytest.mark.parametrize("feet", ["never", "always"])
def test_feet_stand_never_or_always_where_they_are_told_to(
    walk: Motion, feet: str
) -> None:
    target = target_of(walk, feet=feet)
    assert (target.stands == (feet == "always")).all()
    auto = target_of(walk)
    assert target.floor == auto.floor
    ways = [np.ptp(t.positions[:, TOES[0], 2]) for t in (target, auto)]
    assert ways[0] > 0.9 * ways[1] if feet == "never" else ways[0] < 0.5 * ways[1]


@pytest.mark.parametrize("feet", ["auto", "never", "always"])
def test_given_contacts_have_the_last_word(kick: Motion, feet: str) -> None:
    contacts = np.zeros((len(kick), 4), dtype=np.bool_)
    contacts[40:80, :2] = True
    contacts[60:, 2:] = True
    target = target_of(kick, feet=feet, contacts=contacts)
    np.testing.assert_array_equal(target.contacts, contacts)
    still = target.positions[60:, TOES[1]]
    assert np.ptp(still, axis=0).max() < 0.02


def test_contacts_that_a_target_says_give_the_same_target(kick: Motion) -> None:
    once = target_of(kick)
    again = target_of(kick, contacts=once.contacts)
    np.testing.assert_array_equal(again.contacts, once.contacts)
    np.testing.assert_allclose(again.positions, once.positions, atol=0.012)


def test_edited_contacts_change_the_motion_where_they_were_edited(
    kick: Motion,
) -> None:
    once = target_of(kick)
    contacts = once.contacts.copy()
    standing_on = int(np.flatnonzero(once.stands.all(axis=1))[10])
    contacts[standing_on : standing_on + 12, :2] = False
    edited = target_of(kick, contacts=contacts)
    away = np.linalg.norm(edited.positions - once.positions, axis=2)
    near = np.zeros(len(kick), dtype=np.bool_)
    near[max(standing_on - 30, 0) : standing_on + 42] = True
    assert away[~near].max() < 0.012
    np.testing.assert_array_equal(edited.stands[:, 1], once.stands[:, 1])


# The floor


@pytest.mark.parametrize("lift", [-0.9, 0.4])
def test_the_target_does_not_depend_on_how_high_the_sensor_is(
    kick: Motion, lift: float
) -> None:
    low = target_of(kick)
    high = placed(kick.time, noisy(kick) + np.array([0.0, lift, 0.0]))
    assert high.floor == pytest.approx(low.floor + lift, abs=1e-6)
    np.testing.assert_array_equal(high.contacts, low.contacts)
    np.testing.assert_allclose(high.positions, low.positions, atol=1e-4)


def test_a_floor_that_is_given_is_the_floor(kick: Motion) -> None:
    target = target_of(kick, floor=-0.5, feet="never")
    assert target.floor == -0.5
    found = target_of(kick, feet="never")
    over = target.positions[:, :, 1] - found.positions[:, :, 1]
    np.testing.assert_allclose(over.mean(), 0.5 + found.floor, atol=0.01)


def test_who_hangs_in_the_air_over_a_given_floor_stays_there() -> None:
    path = np.tile(BODY.rest_positions, (60, 1, 1)) + np.array([0.0, 0.6, 0.0])
    target = placed(np.arange(60) / 30.0, path, feet="never", floor=0.0, tilt=0.0)
    np.testing.assert_allclose(target.positions, path, atol=1e-6)


# Bones, and what stays as it was


@pytest.mark.parametrize("feet", ["auto", "always", "never"])
def test_bones_keep_their_length_and_nothing_is_under_the_floor(
    walk: Motion, feet: str
) -> None:
    posed = target_of(walk, feet=feet).posed
    assert bone_length_cv(posed, BODY) < 1e-9
    # Feet that are kept where the body is not can pull the toes down.
    least = -0.03 if feet == "always" else -0.005
    assert lowest_point(posed, BODY).min() > least


def test_without_a_cutoff_a_perfect_take_without_feet_is_left_alone(
    walk: Motion,
) -> None:
    target = placed(walk.time, walk.positions, cutoff=0.0, feet="never", floor=0.0)
    np.testing.assert_allclose(target.posed, walk.positions, atol=2e-3)


def test_arguments_are_not_modified(kick: Motion) -> None:
    positions, confidence = noisy(kick), np.full(kick.positions.shape[:2], 0.9)
    contacts = np.ones((len(kick), 4), dtype=np.bool_)
    before = [np.copy(a) for a in (kick.time, positions, confidence, contacts)]
    placed(kick.time, positions, confidence=confidence, contacts=contacts)
    after = (kick.time, positions, confidence, contacts)
    for array, copy in zip(after, before, strict=True):
        np.testing.assert_array_equal(array, copy)


def test_live_bones_do_not_tremble_with_the_confidence_in_joints() -> None:
    """Which joints have to move for the lengths changes from frame to frame."""
    rng, bones, count = np.random.default_rng(0), Bones(), 60
    seen, time = 1.05 * BODY.rest_positions, np.arange(count) / 30.0
    weights = rng.uniform(0.0, 1.0, (count, len(KINECT_V1)))
    alone = BoneLengths(BODY).project(np.tile(seen, (count, 1, 1)), weights)
    bones.start(BODY)
    found = []
    for now, firmness in zip(time, weights, strict=True):
        state = np.full(len(KINECT_V1), State.TRACKED, dtype=np.uint8)
        draft = Draft(KINECT_V1, now, seen, state)
        draft.positions, draft.body, draft.bone_weights = seen, BODY, firmness
        bones.step(draft)
        found.append(draft.positions)
    assert bone_length_cv(np.array(found), BODY) < 1e-5
    assert jitter(time, np.array(found)) < 0.8 * jitter(time, alone)


@pytest.mark.parametrize("seed", [2, 4])
def test_feet_step_where_somebody_turns_on_the_spot(seed: int) -> None:
    """The ankles hardly move then, but the toes do."""
    act = perform("turn", BODY, seed=seed)
    confidence = np.ones(act.positions.shape[:2])
    stands = find_stance(act.time, act.positions, confidence, KINECT_V1)
    seen = act.time, act.positions, confidence, stands
    planted, _ = plant(*seen, BODY)
    yaws = []
    for positions in (planted, act.positions):
        across, _, ahead = np.moveaxis(positions[:, TOES] - positions[:, ANKLES], 2, 0)
        yaws.append(np.arctan2(across, ahead))
    assert np.degrees(np.abs(wrapped(yaws[0] - yaws[1]))).mean() < 22.0


# Takes as they come, from the take to the clip, where every warning is an error


def _cleaned(time: Array, positions: Array, **options: Any) -> CleanResult:
    missing = np.isnan(positions[..., 0])
    state = np.where(missing, State.NOT_TRACKED, State.TRACKED).astype(np.uint8)
    config = CleanConfig(method="none", physics=False, **options)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        result = clean(Take(time, positions, state, KINECT_V1), config)
    assert np.isfinite(result.clip.positions).all()
    assert len(result.clip.contacts) == len(result.clip.external_force) == len(time)
    assert np.isnan(result.clip.external_force).all()
    return result


def _standing_toes_move(result: CleanResult) -> float:
    """Return how far standing toes move between frames at most [m]."""
    clip = result.clip
    moves = [0.0]
    for foot, toe in enumerate(TOES):
        stands = clip.contacts[:, 2 * foot + 1]
        steps = np.linalg.norm(np.diff(clip.positions[:, toe], axis=0), axis=1)
        moves += steps[stands[1:] & stands[:-1]].tolist()
    return max(moves)


@pytest.mark.parametrize("fps", [5.0, 15.0, 60.0, 120.0])
def test_other_frame_rates_stand_as_still(fps: float) -> None:
    act = perform("walk", BODY, seed=1, fps=fps)
    result = _cleaned(act.time, act.positions)
    assert result.clip.contacts.any()
    assert _standing_toes_move(result) < 2e-3


@pytest.mark.parametrize("frames", [2, 3, 5])
def test_a_few_frames_have_contacts_too(frames: int) -> None:
    path = np.tile(BODY.rest_positions, (frames, 1, 1))
    result = _cleaned(np.arange(frames) / 30.0, path)
    assert result.clip.contacts.all()


def test_a_second_without_the_person_is_bridged(walk: Motion) -> None:
    path = walk.positions.copy()
    path[60:90] = np.nan
    assert _standing_toes_move(_cleaned(walk.time, path)) < 2e-3


@pytest.mark.parametrize("part", ["Ankle", "Foot", "Ankle Foot", "Knee Ankle Foot"])
@pytest.mark.parametrize("sides", [SIDES, SIDES[:1]])
def test_feet_that_nobody_ever_saw_are_invented(
    walk: Motion, part: str, sides: tuple[str, ...]
) -> None:
    path = walk.positions.copy()
    path[:, [KINECT_V1.index(p + s) for p in part.split() for s in sides]] = np.nan
    result = _cleaned(walk.time, path)
    assert result.stages["corrected"].bone_length_cv < 1e-9


def test_repeated_stamps_repeat_the_contacts(walk: Motion) -> None:
    once = _cleaned(walk.time, walk.positions)
    twice = _cleaned(np.repeat(walk.time, 2), np.repeat(walk.positions, 2, axis=0))
    np.testing.assert_array_equal(
        twice.clip.contacts, np.repeat(once.clip.contacts, 2, axis=0)
    )


def test_dropped_frames_stand_as_still(walk: Motion) -> None:
    rng = np.random.default_rng(0)
    kept = np.sort(rng.permutation(len(walk))[: 2 * len(walk) // 3])
    result = _cleaned(walk.time[kept], walk.positions[kept])
    assert result.clip.contacts.any()
    assert _standing_toes_move(result) < 5e-3


def test_who_sits_keeps_the_feet_still() -> None:
    act = perform("sit", BODY, seed=1)
    result = _cleaned(act.time, noisy(act))
    assert result.clip.contacts[:, 1::2].mean() > 0.95
    assert _standing_toes_move(result) < 2e-3


@every_skeleton
def test_both_skeletons_have_feet(skeleton: Any) -> None:
    body = standard_body(skeleton)
    act = perform("step_over", body, seed=0)
    target = placed(act.time, act.positions, body)
    assert 0.3 < target.stands.mean() < 1.0
