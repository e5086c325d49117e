"""Knees that a sensor guesses although it sees hips and ankles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from known_motions import performed
from real_data import DATA, recorded

from kinefilter import CleanConfig, clean, read_take
from kinefilter.characters import KINECT_V2, State
from kinefilter.pipeline.failures.limb_failures import guessed_knees
from kinefilter.pipeline.lab.simulation import simulate

KNEE, ANKLE = KINECT_V2.index("KneeLeft"), KINECT_V2.index("AnkleLeft")


@pytest.mark.parametrize("seen", [0, 10])
def test_a_guessed_knee_of_a_leg_that_is_seen_is_found(seen: int) -> None:
    take = performed("stand_idle")
    state = take.state.copy()
    state[seen:, KNEE] = State.INFERRED
    found = guessed_knees(replace(take, state=state))
    assert found[seen:, KNEE].all()
    assert found.sum() == len(take) - seen
    state[:, ANKLE] = State.INFERRED  # the whole leg is guessed
    assert not guessed_knees(replace(take, state=state)).any()


def test_a_knee_that_is_mostly_tracked_is_no_guess() -> None:
    take = performed("walk")
    state = take.state.copy()
    state[::2, KNEE] = State.INFERRED
    assert not guessed_knees(replace(take, state=state)).any()


def test_who_sits_behind_a_desk_has_bent_knees() -> None:
    """The sensor guesses thighs that hang."""
    paired = simulate("office", "office", sensor="v2", seed=71001)
    take, truth = paired.take, paired.truth
    found = clean(take, CleanConfig(physics=False)).clip.positions
    knees, hips = take.skeleton.sides("Knee"), list(take.skeleton.hips)
    away = [
        (x[:, knees] - x[:, hips]) - (truth[:, knees] - truth[:, hips])
        for x in (take.positions, found)
    ]
    raw, cleaned = (np.nanmean(np.linalg.norm(x, axis=2)) for x in away)
    assert raw > 0.3
    assert cleaned < 0.6 * raw


@recorded
def test_no_recorded_knee_is_only_guessed() -> None:
    for file in sorted((DATA / "takes" / "labanotation").glob("*.csv")):
        assert not guessed_knees(read_take(file)).any(), file.name
