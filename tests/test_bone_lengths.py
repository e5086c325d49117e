"""The projection of postures onto the lengths of a body."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.optimize import NonlinearConstraint, minimize
from skeletons import every_skeleton

from kinefilter.characters import (
    KINECT_V1,
    KINECT_V2,
    InputError,
    Skeleton,
    positions_from_rotations,
    standard_body,
)
from kinefilter.characters.rotations import normalize
from kinefilter.retarget import BoneLengths, bone_lengths

Array = NDArray[np.float64]


def postures(skeleton: Skeleton, count: int, seed: int = 0) -> Array:
    rng = np.random.default_rng(seed)
    swing = rng.normal(0.0, 0.3, (count, len(skeleton), 4)) + np.array(
        [1.0, 0.0, 0.0, 0.0]
    )
    return positions_from_rotations(
        normalize(swing), rng.normal(size=(count, 3)), standard_body(skeleton)
    )


def noisy(skeleton: Skeleton, count: int, size: float, seed: int = 0) -> Array:
    rng = np.random.default_rng(seed + 1)
    right = postures(skeleton, count, seed)
    return np.asarray(right + rng.normal(0.0, size, right.shape))


def lengths_of(positions: Array, skeleton: Skeleton) -> Array:
    bones = positions[:, skeleton.segments] - positions[:, skeleton.segment_parents]
    return np.asarray(np.linalg.norm(bones, axis=-1))


def resistance(confidence: Array) -> Array:
    """Return what moves of KINECT_V1's joints cost, shape (20, 20)."""
    # Hips, shoulders and their middles are thirty times as firm.
    trunk = [j[:3] in ("Hip", "Sho") for j in KINECT_V1.joints]
    firm = confidence * np.where(trunk, 30.0, 1.0) + 0.02
    resists = np.diag(firm)
    # Turning a bone between measured joints costs twice as much.
    for a, b in zip(KINECT_V1.segments, KINECT_V1.segment_parents, strict=True):
        ends = np.eye(20)[a] - np.eye(20)[b]
        resists += 2.0 * min(1.0, firm[a], firm[b]) * np.outer(ends, ends)
    # All above the knees moves as one with ease.
    above = [j[:4] not in ("Knee", "Ankl", "Foot") for j in KINECT_V1.joints]
    return np.linalg.inv(np.linalg.inv(resists) + 0.1 * np.outer(above, above))


@settings(max_examples=30, deadline=None)
@given(
    skeleton=st.sampled_from([KINECT_V1, KINECT_V2]),
    seed=st.integers(0, 2**32 - 1),
    size=st.floats(0.0, 0.015),
)
def test_bone_lengths_are_exact_after_projection(
    skeleton: Skeleton, seed: int, size: float
) -> None:
    body = standard_body(skeleton)
    positions = noisy(skeleton, 10, size, seed)
    confidence = np.random.default_rng(seed).uniform(0.2, 1.0, positions.shape[:2])
    projected = BoneLengths(body).project(positions, confidence)
    expected = np.broadcast_to(body.lengths[skeleton.segments], (10, len(skeleton) - 1))
    np.testing.assert_allclose(lengths_of(projected, skeleton), expected, atol=1e-6)


@every_skeleton
def test_a_long_segment_is_shortened_wherever_it_is(skeleton: Skeleton) -> None:
    body = standard_body(skeleton)
    right = postures(skeleton, len(skeleton), 3)
    wrong = right.copy()
    for frame, joint in enumerate(skeleton.segments):
        parent = skeleton.parents[joint]
        wrong[frame, joint] += 0.4 * (right[frame, joint] - right[frame, parent])
    projected = BoneLengths(body).project(wrong, np.ones(wrong.shape[:2]))
    expected = np.broadcast_to(
        body.lengths[skeleton.segments], (len(skeleton), len(skeleton) - 1)
    )
    np.testing.assert_allclose(lengths_of(projected, skeleton), expected, atol=1e-6)


@every_skeleton
def test_postures_that_are_right_already_stay(skeleton: Skeleton) -> None:
    positions = postures(skeleton, 20)
    confidence = np.random.default_rng(0).random(positions.shape[:2])
    projected = BoneLengths(standard_body(skeleton)).project(positions, confidence)
    np.testing.assert_array_equal(projected, positions)


def test_projecting_twice_is_projecting_once() -> None:
    positions = noisy(KINECT_V1, 20, 0.01)
    projector = BoneLengths(standard_body(KINECT_V1))
    confidence = np.ones(positions.shape[:2])
    once = projector.project(positions, confidence)
    np.testing.assert_allclose(projector.project(once, confidence), once, atol=1e-6)


def test_what_does_not_converge_is_laid_bone_by_bone_from_the_root(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    body, positions = standard_body(KINECT_V1), noisy(KINECT_V1, 5, 0.05)
    monkeypatch.setattr(bone_lengths, "_MOST_STEPS", 0)
    laid = BoneLengths(body).project(positions, np.ones(positions.shape[:2]))
    ends = KINECT_V1.segments
    expected = np.broadcast_to(body.lengths[ends], (5, 19))
    np.testing.assert_allclose(lengths_of(laid, KINECT_V1), expected, atol=1e-9)
    np.testing.assert_array_equal(laid[:, KINECT_V1.root], positions[:, KINECT_V1.root])
    bones = positions[:, ends] - positions[:, KINECT_V1.segment_parents]
    bones *= (expected / lengths_of(positions, KINECT_V1))[..., None]
    found = laid[:, ends] - laid[:, KINECT_V1.segment_parents]
    np.testing.assert_allclose(found, bones, atol=1e-9)


@pytest.mark.parametrize("wrong", [np.nan, np.inf])
def test_a_joint_that_is_nowhere_is_refused(wrong: float) -> None:
    positions = postures(KINECT_V1, 2)
    positions[1, KINECT_V1.index("WristLeft"), 0] = wrong
    with pytest.raises(InputError, match="missing joints"):
        BoneLengths(standard_body(KINECT_V1)).project(positions, np.ones((2, 20)))


def test_arguments_are_not_modified() -> None:
    positions, confidence = noisy(KINECT_V1, 4, 0.01), np.full((4, 20), 0.5)
    before = positions.copy(), confidence.copy()
    BoneLengths(standard_body(KINECT_V1)).project(positions, confidence)
    np.testing.assert_array_equal(positions, before[0])
    np.testing.assert_array_equal(confidence, before[1])


def test_a_joint_moves_more_if_it_is_not_trusted() -> None:
    positions = noisy(KINECT_V1, 100, 0.01)
    projector, everyone = BoneLengths(standard_body(KINECT_V1)), np.ones((100, 20))
    before = projector.project(positions, everyone) - positions
    for joint in range(20):
        doubted = everyone.copy()
        doubted[:, joint] = 0.0
        moves = projector.project(positions, doubted) - positions
        moved = np.linalg.norm(moves[:, joint], axis=-1)
        trusted = np.linalg.norm(before[:, joint], axis=-1)
        assert moved.mean() > trusted.mean(), KINECT_V1.joints[joint]


def test_bones_keep_their_directions_rather_than_joints_their_places() -> None:
    # A straight leg is 3 cm too short for its bones: it is lengthened, not bent.
    skeleton, body = KINECT_V1, standard_body(KINECT_V1)
    short = body.rest_positions[None].copy()
    hip, knee, ankle, foot = (
        skeleton.index(f"{j}Left") for j in ("Hip", "Knee", "Ankle", "Foot")
    )
    short[0, knee] += [0.0, 0.015, 0.002]
    short[0, [ankle, foot]] += [0.0, 0.03, 0.0]
    right = BoneLengths(body).project(short, np.ones((1, 20)))

    def bend(joints: Array) -> float:
        thigh, shank = (
            joints[0, knee] - joints[0, hip],
            joints[0, ankle] - joints[0, knee],
        )
        lengths = np.linalg.norm(thigh) * np.linalg.norm(shank)
        return float(np.degrees(np.arccos(thigh @ shank / lengths)))

    assert abs(bend(right) - bend(short)) < 1.0


@pytest.mark.parametrize(("hand_is_trusted", "share"), [(False, 0.95), (True, 0.15)])
def test_an_invented_hand_gives_way_to_a_measured_arm_and_the_other_way_round(
    hand_is_trusted: bool, share: float
) -> None:
    elbow, wrist, hand = (
        KINECT_V1.index(f"{j}Left") for j in ("Elbow", "Wrist", "Hand")
    )
    wrong = standard_body(KINECT_V1).rest_positions[None].copy()
    # The arm is bent, so that a hand farther away can be reached.
    forearm = wrong[0, [wrist, hand]] - wrong[0, elbow]
    turned = forearm[:, [1, 0, 2]] * [-1.0, 1.0, 1.0]
    wrong[0, [wrist, hand]] = wrong[0, elbow] + turned
    wrong[0, hand] += 0.03 * turned[1] / np.linalg.norm(turned[1])
    confidence = np.ones((1, 20))
    confidence[0, [elbow, wrist] if hand_is_trusted else hand] = 0.0
    projected = BoneLengths(standard_body(KINECT_V1)).project(wrong, confidence)
    moved = np.linalg.norm(projected - wrong, axis=-1)[0] / 0.03
    assert (moved[hand] < share) if hand_is_trusted else (moved[hand] > share)


def test_the_trunk_keeps_its_shape_better_than_the_limbs() -> None:
    positions = noisy(KINECT_V1, 200, 0.01)
    projector = BoneLengths(standard_body(KINECT_V1))
    moves = projector.project(positions, np.ones((200, 20))) - positions
    moves -= moves[:, [j[:3] in ("Hip", "Sho") for j in KINECT_V1.joints]].mean(
        axis=1, keepdims=True
    )
    sizes = np.linalg.norm(moves, axis=2).mean(axis=0)
    moved = dict(zip(KINECT_V1.joints, sizes, strict=True))
    for side in ("Left", "Right"):
        assert moved[f"Hip{side}"] < 0.8 * moved[f"Knee{side}"]
        assert moved[f"Shoulder{side}"] < 0.8 * moved[f"Elbow{side}"]


def test_a_noisy_skeleton_comes_nearer_to_the_truth() -> None:
    right, rng = postures(KINECT_V1, 200), np.random.default_rng(1)
    # Whatever draws an elbow aside mostly draws the wrist along, too.
    errors = rng.normal(0.0, 0.01, right.shape)
    for j in KINECT_V1.segments:
        errors[:, j] += 0.8 * errors[:, KINECT_V1.parents[j]]
    positions = right + errors
    projector = BoneLengths(standard_body(KINECT_V1))
    projected = projector.project(positions, np.ones((200, 20)))
    before, after = (
        np.linalg.norm(x - right, axis=2).mean() for x in (positions, projected)
    )
    assert after < 0.95 * before


def test_fitting_lengths_are_those_that_all_frames_have() -> None:
    body = standard_body(KINECT_V1)
    longer = body.lengths * np.linspace(0.9, 1.1, 20)
    positions = postures(KINECT_V1, 10)
    bones = positions - positions[:, np.array(KINECT_V1.parents)]
    for j in KINECT_V1.segments:
        bone = bones[:, j] * longer[j] / body.lengths[j]
        positions[:, j] = positions[:, KINECT_V1.parents[j]] + bone
    found = BoneLengths(body).fitted_lengths(positions, np.ones((10, 20)))
    np.testing.assert_allclose(found, longer * (np.arange(20) > 0), atol=1e-7)


def test_joints_move_less_for_fitting_lengths_than_for_mean_ones() -> None:
    body, firm = standard_body(KINECT_V1), np.ones((100, 20))
    positions = noisy(KINECT_V1, 100, 0.003)
    mean, ends = body.lengths.copy(), KINECT_V1.segments
    mean[ends] = lengths_of(positions, KINECT_V1).mean(axis=0)
    fitting = BoneLengths(body).fitted_lengths(positions, firm)

    def cost(lengths: Array) -> float:
        projector = BoneLengths(replace(body, lengths=lengths))
        moves = projector.project(positions, firm) - positions
        return float(np.sum(moves * (resistance(firm[0]) @ moves)))

    assert cost(fitting) < cost(mean)


def test_two_joints_share_an_error_as_their_mobilities() -> None:
    # One segment that is free at both ends: mobilities 1 / (confidence + 0.02).
    skeleton = KINECT_V1
    body = standard_body(skeleton)
    a, b = skeleton.index("WristLeft"), skeleton.index("HandLeft")
    confidence = np.ones((1, 20))
    confidence[0, b] = 0.32
    wrong = body.rest_positions[None].copy()
    wrong[0, b] += [0.03, 0.0, 0.0]
    moved = BoneLengths(body).project(wrong, confidence) - wrong
    # The wrist cannot follow without the arm, so that it takes less than its share.
    share = (1 / 0.34) / (1 / 0.34 + 1 / 1.02)
    assert -0.03 < moved[0, b, 0] < -0.03 * share
    assert moved[0, a, 0] > 0.0
    assert moved[0, a, 0] - moved[0, b, 0] == pytest.approx(0.03, abs=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_the_weighted_move_is_the_smallest_there_is(seed: int) -> None:
    skeleton, body = KINECT_V1, standard_body(KINECT_V1)
    positions = noisy(skeleton, 1, 0.01, seed)
    confidence = np.random.default_rng(seed).uniform(0.1, 1.0, (1, 20))
    projected = BoneLengths(body).project(positions, confidence)
    resists = resistance(confidence[0])

    def cost(flat: Array) -> float:
        move = flat.reshape(20, 3) - positions[0]
        return float(np.sum(move * (resists @ move)))

    def slack(flat: Array) -> Array:
        return np.asarray(
            lengths_of(flat.reshape(1, 20, 3), skeleton)[0]
            - body.lengths[skeleton.segments]
        )

    best = minimize(
        cost,
        positions[0].ravel(),
        method="SLSQP",
        constraints=NonlinearConstraint(slack, 0.0, 0.0),
        options={"ftol": 1e-12, "maxiter": 200},
    )
    assert best.success
    found = cost(projected[0].ravel())
    assert best.fun > 1e-5
    assert 0.999 * best.fun < found < 1.05 * best.fun


def test_the_projection_moves_and_turns_with_the_posture() -> None:
    positions, confidence = noisy(KINECT_V1, 5, 0.01), np.ones((5, 20))
    projector = BoneLengths(standard_body(KINECT_V1))
    quarter = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    moved = projector.project(
        positions @ quarter.T + np.array([5.0, 1.0, -2.0]), confidence
    )
    expected = projector.project(positions, confidence) @ quarter.T + np.array(
        [5.0, 1.0, -2.0]
    )
    np.testing.assert_allclose(moved, expected, atol=1e-9)


def test_chunks_give_what_one_chunk_gives(monkeypatch: pytest.MonkeyPatch) -> None:
    positions = noisy(KINECT_V1, 23, 0.01)
    confidence = np.random.default_rng(0).uniform(0.1, 1.0, (23, 20))
    projector = BoneLengths(standard_body(KINECT_V1))
    whole = projector.project(positions, confidence)
    monkeypatch.setattr(bone_lengths, "_CHUNK", 5)
    np.testing.assert_allclose(
        projector.project(positions, confidence), whole, atol=1e-7
    )


@pytest.mark.parametrize("frames", [0, 1])
def test_short_motions_pass(frames: int) -> None:
    positions = noisy(KINECT_V1, 2, 0.01)[:frames]
    projected = BoneLengths(standard_body(KINECT_V1)).project(
        positions, np.ones((frames, 20))
    )
    assert projected.shape == (frames, 20, 3)
    assert np.isfinite(projected).all()


def test_a_frame_alone_gives_what_it_gives_among_others() -> None:
    points, firmness = noisy(KINECT_V1, 20, 0.03), np.ones((20, 20))
    bones = BoneLengths(standard_body(KINECT_V1))
    alone = [bones.project(points[[k]], firmness[[k]])[0] for k in range(20)]
    together = bones.project(points, firmness)
    np.testing.assert_allclose(alone, together, rtol=0.0, atol=1e-12)
