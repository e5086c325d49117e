"""Knees and elbows that a sensor guesses although it sees the rest of the limb."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from known_motions import performed
from real_data import DATA, recorded

from kinefilter import CleanConfig, Cleaner, clean, read_take
from kinefilter.characters import KINECT_V2, State
from kinefilter.pipeline.failures.limb_failures import guessed_knees
from kinefilter.pipeline.lab.simulation import simulate, truth_of
from kinefilter.pipeline.reconstruct.stage import hidden_joints

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


def test_ankles_that_are_seen_behind_a_desk_stay_as_they_are() -> None:
    take = simulate("office", "office", sensor="v2", seed=4).take
    ankles = take.skeleton.sides("Ankle")
    found = Cleaner().until("failures").whole(take)
    seen = take.state[:, ankles] == State.TRACKED
    assert seen.mean() > 0.5
    np.testing.assert_array_equal(
        found.measured[:, ankles][seen], take.positions[:, ankles][seen]
    )


def test_a_guessed_elbow_is_where_shoulder_and_wrist_say() -> None:
    """The arm moves only while its elbow is hidden, which nothing else shows."""
    take = truth_of(simulate("basic", "wave", seed=3))
    elbow, wrist = (take.skeleton.index(f"{part}Right") for part in ("Elbow", "Wrist"))
    moving = np.linalg.norm(np.diff(take.positions[:, wrist], axis=0), axis=1) > 0.01
    first, *_, last = np.flatnonzero(moving)
    positions, state = take.positions.copy(), take.state.copy()
    positions[first:last, elbow] += [0.3, -0.3, 0.0]
    state[first:last, elbow] = State.INFERRED
    cleaner = Cleaner(CleanConfig(tilt=0.0)).until("reconstruct")
    found = cleaner.whole(replace(take, positions=positions, state=state)).filled
    away = np.linalg.norm(found - take.positions, axis=2)[first:last]
    assert away[:, wrist].max() < 1e-9
    assert away[:, elbow].mean() < 0.05


@pytest.mark.parametrize("part", ["Elbow", "Wrist", "Knee", "Ankle"])
def test_what_is_hardly_ever_tracked_is_hidden_in_arms_alone(part: str) -> None:
    take = performed("stand_idle")
    joint, state = take.skeleton.index(f"{part}Left"), take.state.copy()
    state[10:, joint] = State.INFERRED
    found = hidden_joints(take.positions, state, take.skeleton)[:, joint]
    assert found[10:].all() == found.any() == (part in ("Elbow", "Wrist"))
    state[:, joint] = State.INFERRED
    assert not hidden_joints(take.positions, state, take.skeleton).any()


@recorded
def test_no_recorded_knee_is_only_guessed() -> None:
    for file in sorted((DATA / "takes" / "labanotation").glob("*.csv")):
        assert not guessed_knees(read_take(file)).any(), file.name
