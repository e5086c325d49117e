"""Where people are whose hips the sensor does not see, as they come near or sit."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from kinefilter import CleanConfig, Cleaner
from kinefilter.characters import KINECT_V1, KINECT_V2, Skeleton, State, Take
from kinefilter.pipeline.lab.evaluate import followed
from kinefilter.pipeline.lab.simulation import simulate, truth_of
from kinefilter.scenes.library import perform, random_body

Array = NDArray[np.float64]
CLEANER = Cleaner(CleanConfig(physics=False, tilt=0.0))


@cache
def walk(skeleton: Skeleton) -> Take:
    """Return somebody who walks in view of a sensor, seen without errors."""
    pair = simulate("basic", "walk", skeleton=skeleton.name, seed=3, stay_in_view=True)
    return truth_of(pair).at(slice(150))


def without(take: Take, joints: list[int], frames: slice) -> Take:
    positions, state = take.positions.copy(), take.state.copy()
    positions[frames, joints], state[frames, joints] = np.nan, State.NOT_TRACKED
    return replace(take, positions=positions, state=state)


def lower_body(skeleton: Skeleton) -> list[int]:
    legs = (j for hip in skeleton.hips for j in (hip, *skeleton.descendants(hip)))
    return [skeleton.root, *(int(j) for j in legs)]


def trunk(skeleton: Skeleton) -> list[int]:
    ends = [*skeleton.sides("Hip"), *skeleton.sides("Shoulder"), skeleton.index("Head")]
    return [skeleton.root, *skeleton.ancestors(skeleton.girdle), *ends]


def live(take: Take) -> Array:
    """Return the joints of live motion [m]; the first second measures the person."""
    return followed(CLEANER, take, take.at(slice(30)))


@pytest.mark.parametrize("skeleton", [KINECT_V1, KINECT_V2])
@pytest.mark.parametrize(
    ("parts", "most"), [("root", 0.03), ("lower body", 0.06), ("trunk", 0.12)]
)
def test_people_walk_on_while_their_hips_are_hidden(
    skeleton: Skeleton, parts: str, most: float
) -> None:
    """Live, they used to stay behind by over half a meter, and to leap after it."""
    hidden = {"root": [skeleton.root, *skeleton.sides("Hip")]}
    hidden |= {"lower body": lower_body(skeleton), "trunk": trunk(skeleton)}
    take, gap = walk(skeleton), slice(60, 100)
    blind, hips = without(take, hidden[parts], gap), list(skeleton.hips)
    for of in (
        lambda take: CLEANER.clean(take).clip.positions,
        live,
    ):
        found, usual = of(blind), of(take)
        off = np.linalg.norm(found[:, hips].mean(1) - usual[:, hips].mean(1), axis=1)
        way = np.linalg.norm(np.ptp(usual[gap, hips].mean(axis=1), axis=0))
        assert way > 0.6
        assert off[gap].mean() < most
        steps = np.linalg.norm(np.diff(found[55:110], axis=0), axis=2)
        fastest = np.linalg.norm(np.diff(usual[55:110], axis=0), axis=2).max()
        assert steps.max() < fastest + 0.08


@pytest.mark.parametrize("share", [0.1, 0.3, 0.6])
def test_people_of_whom_any_joint_may_be_missing_are_followed(share: float) -> None:
    """A root that was missing now and then left directions of its bones unknown."""
    take = walk(KINECT_V2)
    flags = np.random.default_rng(0).random(take.state.shape) < share
    flags[:30] = False
    positions = np.where(flags[..., None], np.nan, take.positions)
    state = np.where(flags, State.NOT_TRACKED, take.state).astype(np.uint8)
    blind = replace(take, positions=positions, state=state)
    found, usual = (live(some) for some in (blind, take))
    away = np.linalg.norm(found - usual, axis=2)
    assert away.mean() < 0.25 * share


@pytest.mark.parametrize("legs", [False, True])
def test_a_root_that_is_never_seen_is_below_the_trunk(legs: bool) -> None:
    """Behind a desk, for one: it used to end in a traceback, or meters away."""
    body = random_body(KINECT_V1, np.random.default_rng(0))
    act = perform("wave", body, seed=0)
    state = np.full(act.positions.shape[:2], State.TRACKED, dtype=np.uint8)
    full = act.positions + np.array([0.0, 0.0, 2.5])
    take = Take(act.time, full, state, KINECT_V1).at(slice(60))
    lost = lower_body(KINECT_V1) if legs else [KINECT_V1.root]
    blind = without(take, lost, slice(None))
    cleaner = CLEANER.until("correct")
    found, usual = (cleaner.whole(some).positions for some in (blind, take))
    upper = [KINECT_V1.index(name) for name in ("HipCenter", "Head", "WristLeft")]
    assert np.abs(found - usual)[:, upper].max() < 0.1
    stepped = followed(cleaner, blind, take)
    assert np.abs(stepped - usual)[-1, upper].max() < 0.15
