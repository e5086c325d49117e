"""Legs that are never seen step where the person goes, and otherwise stand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from real_data import CMU, captured

from kinefilter import CleanConfig, Cleaner, read_take
from kinefilter.characters import KINECT_V1, Clip, State, Take, standard_body
from kinefilter.characters.motion import values_at
from kinefilter.characters.rotations import about_y, rotate
from kinefilter.pipeline.lab.evaluate import followed
from kinefilter.pipeline.reconstruct import MotionPrior, hidden_limbs, stage
from kinefilter.pipeline.reconstruct.hidden_limbs import fill_unseen
from kinefilter.pipeline.reconstruct.prior import default_prior
from kinefilter.pipeline.reconstruct.unseen_steps import (
    Steps,
    gait_inputs,
)

Array = NDArray[np.float64]
BODY, RATE = standard_body(KINECT_V1), 30.0
LEGS = [j for n in ("Knee", "Ankle", "Foot") for j in KINECT_V1.sides(n)]
HIPS = [KINECT_V1.root, KINECT_V1.index("Spine"), *KINECT_V1.hips.tolist()]
ANKLES, FLIP = KINECT_V1.sides("Ankle"), np.array([-1.0, 1.0, 1.0])


def unseen(places: Array, prior: MotionPrior | None = None) -> Array:
    """Return the ankles of a person whose legs are never seen, (T, 2, 3)."""
    blind = np.where(np.isin(np.arange(len(KINECT_V1)), LEGS)[:, None], np.nan, places)
    time, gone = np.arange(len(places)) / RATE, np.isnan(blind[0, :, 0])
    found = fill_unseen(time, blind, gone, BODY, prior or default_prior())[0]
    return np.asarray(found[:, ANKLES])


def going(way: Array) -> Array:
    """Return a standing body that goes along a way (x and z), (T, J, 3)."""
    return np.asarray(BODY.rest_positions + np.insert(way, 1, 0.0, axis=1)[:, None])


def speeds(ankles: Array) -> Array:
    return RATE * np.linalg.norm(np.diff(ankles[..., [0, 2]], axis=0), axis=2)


def test_who_sways_stands_and_who_goes_sideways_steps_foot_by_foot() -> None:
    phase = np.linspace(0.0, 20.0, 300)[:, None]
    assert speeds(unseen(going(0.05 * np.sin(phase * [1.0, 0.7])))).max() < 1e-9
    ankles = unseen(going(np.linspace(0.0, 1.0, 120)[:, None] * [2.0, 0.0]))
    moves = speeds(ankles) > 1e-9
    assert moves.all(axis=1).mean() < 0.1  # a foot lands while the other leaves
    assert (np.diff(moves.astype(int), axis=0) == 1).sum(axis=0).min() >= 5
    hips = going(np.linspace(0.0, 1.0, 120)[:, None] * [2.0, 0.0])[:, KINECT_V1.hips]
    assert np.abs(ankles - hips)[..., 0].max() < 0.45


def test_steps_turn_with_the_person_and_mirror() -> None:
    way = np.linspace(0.0, 1.0, 90)[:, None] * [1.0, 1.5]
    places, turn = going(way), about_y(np.array(2.0))
    turned = unseen(rotate(turn, places))
    np.testing.assert_allclose(turned, rotate(turn, unseen(places)), atol=1e-9)
    motion = values_at(np.arange(90) / RATE, places, np.full((1, 17), 1.0))
    motion = motion + np.random.default_rng(0).normal(0.0, 0.03, motion.shape)
    inputs, ahead, way_there = gait_inputs(motion, KINECT_V1)
    other = gait_inputs((FLIP * motion)[:, :, KINECT_V1.mirror], KINECT_V1)
    np.testing.assert_allclose(other[0], -inputs, atol=1e-9)
    np.testing.assert_allclose(other[1], ahead * [-1.0, 1.0], atol=1e-9)
    np.testing.assert_allclose(other[2], way_there, atol=1e-9)


def test_feet_swing_as_the_cycle_says() -> None:
    steps, ankles = Steps(np.zeros((2, 3))), []
    cycle = (np.arange(120) / 36.0 + 1.0) % 2.0 - 1.0
    for k, part in enumerate(cycle):
        goals = np.array([[0.1, 0.0, k / RATE], [-0.1, 0.0, k / RATE]])
        ankles.append(steps.step(1.0 / RATE, goals, float(part))[0])
    moves = speeds(np.array(ankles))[40:] > 1e-9
    swings = np.stack([cycle < 0.0, cycle >= 0.0], axis=1)[40:-1]
    assert not (moves & ~swings).any()
    assert moves.mean(axis=0).min() > 0.35


def walk(frames: slice, gone: list[int]) -> tuple[Take, Take]:
    """Return a recorded walk, and the same without joints in some frames."""
    take = read_take(CMU / "08_01.bvh.gz").at(slice(0, None, 4))
    assert take.skeleton == KINECT_V1
    positions, state = take.positions.copy(), take.state.copy()
    positions[frames, gone], state[frames, gone] = np.nan, State.NOT_TRACKED
    return take, replace(take, positions=positions, state=state)


@captured
@pytest.mark.parametrize(
    ("frames", "gone", "most", "more"),
    [
        (slice(None), LEGS, 0.8, 0.3),
        (slice(None), LEGS + HIPS, 0.8, 0.3),
        (slice(15, -15), LEGS, 0.9, 0.0),
    ],
    ids=["never seen", "nor hips", "for a while"],
)
def test_legs_of_walkers_step_as_they_do(
    frames: slice,
    gone: list[int],
    most: float,
    more: float,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    take, blind = walk(frames, gone)
    cleaner = Cleaner(CleanConfig(physics=False, tilt=0.0))
    truth, found = (cleaner.clean(one).clip for one in (take, blind))
    monkeypatch.setattr(hidden_limbs, "step_unseen", lambda *_: None)
    monkeypatch.setattr(stage, "fill_walking", lambda _, filled, *__: filled)
    gliding = cleaner.clean(blind).clip

    def error(clip: Clip) -> float:
        ends = [*KINECT_V1.sides("Knee"), *ANKLES]
        away = (clip.positions - truth.positions)[20:-20]
        away = away - away[:, KINECT_V1.hips].mean(axis=1, keepdims=True)
        return float(np.linalg.norm(away[:, ends], axis=2).mean())

    assert error(found) < most * error(gliding)
    stands = (clip.contacts.any(axis=1).mean() for clip in (found, gliding))
    assert next(stands) > next(stands) + more


@captured
def test_live_feet_stand_while_walkers_go() -> None:
    take, blind = walk(slice(None), LEGS + HIPS)
    motion = followed(Cleaner(CleanConfig(physics=False, tilt=0.0)), blind, take)
    still = (speeds(motion[20:, ANKLES]) < 0.2).any(axis=1)
    assert still.mean() > 0.4
