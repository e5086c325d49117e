"""Hands and feet that a sensor never sees go on from forearms and shins."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from known_motions import pulled_through
from numpy.typing import NDArray

from kinefilter import Avatar, CleanConfig, clean
from kinefilter.characters import KINECT_V1, KINECT_V2, Skeleton, State, Take
from kinefilter.characters import standard_body as body_of
from kinefilter.characters.rotations import cross, unit
from kinefilter.pipeline.correct import Hold
from kinefilter.pipeline.physics.pulled_character import PulledCharacter
from kinefilter.retarget import BoneLengths, rotations_from_positions
from kinefilter.scenes.library import perform
from kinefilter.scenes.sensor import sample_take

Array = NDArray[np.float64]


def without_hands(skeleton: Skeleton) -> Take:
    """Return somebody who waves, seen up to the wrists."""
    act = perform("wave", body_of(skeleton), seed=2).at(slice(0, 90))
    hands = [
        k
        for k, name in enumerate(skeleton.joints)
        if name.startswith(("Hand", "Thumb"))
    ]
    positions = act.positions + np.random.default_rng(0).normal(0.0, 0.003, (90, 1, 1))
    state = np.full(positions.shape[:2], State.TRACKED, dtype=np.uint8)
    positions[:, hands], state[:, hands] = np.nan, State.NOT_TRACKED
    return Take(act.time, positions, state, skeleton, "wave")


def bends(positions: Array, skeleton: Skeleton) -> Array:
    """Return the angles between forearms and hands [degrees], (T, 2)."""
    elbow, wrist, hand = (
        positions[:, skeleton.sides(part)] for part in ("Elbow", "Wrist", "Hand")
    )
    forearm, palm = wrist - elbow, hand - wrist
    lengths = np.linalg.norm(forearm, axis=2) * np.linalg.norm(palm, axis=2)
    return np.degrees(np.arccos(np.clip(np.vecdot(forearm, palm) / lengths, -1.0, 1.0)))


@pytest.mark.parametrize("skeleton", [KINECT_V1, KINECT_V2])
@pytest.mark.parametrize("method", ["default", "none"])
def test_hands_that_nobody_saw_continue_the_forearms(
    skeleton: Skeleton, method: str
) -> None:
    clip = clean(without_hands(skeleton), CleanConfig(method=method)).clip
    assert np.percentile(bends(clip.positions, skeleton), 95) < 25.0


def test_live_too_until_they_are_seen() -> None:
    take = without_hands(KINECT_V1)
    hand, wrist = KINECT_V1.index("HandLeft"), KINECT_V1.index("WristLeft")
    positions, state = take.positions.copy(), take.state.copy()
    elbow, shoulder = KINECT_V1.index("ElbowLeft"), KINECT_V1.index("ShoulderLeft")
    forearm = unit(positions[60:, wrist] - positions[60:, elbow])
    aside = unit(cross(forearm, positions[60:, elbow] - positions[60:, shoulder]))
    positions[60:, hand] = positions[60:, wrist] + 0.08 * unit(forearm + aside)
    state[60:, hand] = State.TRACKED
    take = replace(take, positions=positions, state=state)
    avatar = Avatar(body_of(KINECT_V1))
    poses = np.array(
        [
            avatar.step(*frame).positions
            for frame in zip(take.positions, take.time, take.state, strict=True)
        ]
    )
    assert np.percentile(bends(poses[10:58], KINECT_V1), 95) < 25.0
    palm = unit(poses[80:, hand] - poses[80:, wrist])
    shown = unit(forearm + aside)[20:]
    assert np.degrees(np.arccos(np.vecdot(palm, shown))).max() < 17.0


def test_whole_takes_as_frame_by_frame_before_hands_are_seen() -> None:
    take = without_hands(KINECT_V1)
    hand, wrist = KINECT_V1.index("HandLeft"), KINECT_V1.index("WristLeft")
    positions = take.positions.copy()
    positions[60:, hand] = positions[60:, wrist] + [0.0, 0.0, -0.08]
    whole, hold = Hold(KINECT_V1).fill(positions), Hold(KINECT_V1)
    steps = [hold.follow(p, np.where(np.isnan(p[:, 0]), 0.0, 1.0)) for p in positions]
    np.testing.assert_allclose(whole, steps, atol=1e-12)
    assert bends(whole[:60], KINECT_V1).max() < 1e-3


def test_a_hand_pressed_against_the_thigh_does_not_fold() -> None:
    body = body_of(KINECT_V1)
    positions = np.tile(body.rest_positions, (60, 1, 1))
    hip = positions[:, KINECT_V1.index("HipLeft")]
    chain = [KINECT_V1.index(f"{part}Left") for part in ("Elbow", "Wrist", "Hand")]
    shoulder = positions[:, KINECT_V1.index("ShoulderLeft")]
    down, inward = np.array([0.0, -1.0, 0.0]), np.linspace(0.0, 0.12, 60)[:, None]
    place = shoulder.copy()
    for joint in chain:
        place = place + body.lengths[joint] * down
        positions[:, joint] = place - inward * [1.0, 0.0, 0.0]
    assert np.abs(positions[-1, chain[-1], 0] - hip[-1, 0]).max() < 0.06  # in the thigh
    positions = BoneLengths(body).project(positions, np.ones(positions.shape[:2]))
    rotations = rotations_from_positions(positions, body)
    clip = pulled_through(
        PulledCharacter(body), np.arange(60) / 30.0, positions, rotations
    )
    assert bends(clip.positions, KINECT_V1).max() < 62.0


def test_no_hand_of_the_sample_hangs_bent() -> None:
    clip = clean(sample_take()).clip
    index = clip.skeleton.index
    for side in ("Left", "Right"):
        elbow, wrist, hand = (
            clip.positions[:, index(part + side)] for part in ("Elbow", "Wrist", "Hand")
        )
        forearm, bone = wrist - elbow, hand - wrist
        lengths = np.linalg.norm([forearm, bone], axis=2).prod(axis=0)
        assert np.degrees(np.arccos(np.vecdot(forearm, bone) / lengths)).max() < 45.0
