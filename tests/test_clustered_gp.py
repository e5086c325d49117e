"""The process over the whole standardized body."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from offset_lessons import ELBOW, ONES, SPINE, WRIST, postures_of, training_set_of
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

from kinefilter.characters import KINECT_V1, InputError, standard_body
from kinefilter.pipeline.correct import Correction, Observation
from kinefilter.pipeline.lab.methods.clustered_gp import ClusteredGP
from kinefilter.pipeline.lab.methods.filters import BoneWalk
from kinefilter.pipeline.lab.methods.training_data import TrainingFrames, TrainingSet

Array = NDArray[np.float64]

SHIFT = np.array([0.1, -0.15, 0.1])


def _lessons(shift: Array, count: int = 400, seed: int = 0) -> TrainingSet:
    """Return postures on standard bones whose left wrist is off."""
    seen = BoneWalk(KINECT_V1).standardized(postures_of(count, seed))
    truth = seen.copy()
    truth[:, WRIST] += shift
    truth[:, SPINE] = np.nan
    reliability = np.ones(seen.shape[:2])
    first = np.zeros(count, dtype=bool)
    return training_set_of(seen, reliability, truth, first)


@pytest.fixture(scope="module")
def model() -> ClusteredGP:
    return ClusteredGP(KINECT_V1, centroids=60).fit(_lessons(SHIFT))


def _step(model: ClusteredGP, posture: Array) -> Correction:
    model.start()
    return model.step(Observation(posture, ONES, ONES))


def test_bones_come_back_from_standard_lengths() -> None:
    walk, postures = BoneWalk(KINECT_V1), postures_of(10, seed=1)
    directions, lengths = walk.measure(postures)
    standard = walk.posture(directions, walk.lengths)
    np.testing.assert_allclose(
        walk.measure(standard)[1], np.tile(walk.lengths, (10, 1)), atol=1e-12
    )
    assert np.abs(lengths - walk.lengths).max() > 0.02
    again = walk.posture(walk.measure(standard)[0], lengths)
    np.testing.assert_allclose(again, postures, atol=1e-12)


def test_legs_need_not_be_reliable_to_learn_from() -> None:
    lessons = _lessons(SHIFT)
    for joint, complete in (("KneeLeft", True), ("WristLeft", False)):
        reliability = lessons.reliability.copy()
        reliability[::2, KINECT_V1.index(joint)] = 0.1
        doubted = replace(lessons, reliability=reliability)
        frames = TrainingFrames.draw(doubted, KINECT_V1, 400, 0, least_reliability=0.7)
        assert len(frames.postures) == (400 if complete else 200)


def test_a_bone_without_a_length_points_as_at_rest() -> None:
    walk, rest = BoneWalk(KINECT_V1), standard_body(KINECT_V1).rest_positions
    posture = rest - rest[KINECT_V1.root]
    posture[WRIST] = posture[ELBOW]
    np.testing.assert_allclose(
        walk.standardized(posture), rest - rest[KINECT_V1.root], atol=1e-12
    )


def test_corrected_bones_have_the_standard_lengths(model: ClusteredGP) -> None:
    walk = BoneWalk(KINECT_V1)
    for posture in postures_of(10, seed=1):
        corrected = _step(model, posture).positions
        np.testing.assert_allclose(walk.measure(corrected)[1], walk.lengths, atol=1e-12)


def test_a_constant_shift_is_learned_as_a_direction(model: ClusteredGP) -> None:
    walk = BoneWalk(KINECT_V1)
    lessons = _lessons(SHIFT, count=30, seed=5)
    away, before = [], []
    for seen in lessons.positions:
        truth = seen.copy()
        truth[WRIST] += SHIFT
        wanted = walk.standardized(truth)
        away.append(np.linalg.norm(_step(model, seen).positions - wanted, axis=1))
        before.append(np.linalg.norm(seen - wanted, axis=1))
    assert np.mean(away, axis=0)[WRIST] < 0.15 * np.mean(before, axis=0)[WRIST]
    unmoved = [j for j in range(len(KINECT_V1)) if j not in (WRIST, WRIST + 1)]
    assert np.max(np.array(away)[:, unmoved]) < 2e-3


def test_no_shift_is_learned_from_none() -> None:
    still = ClusteredGP(KINECT_V1, centroids=40).fit(_lessons(np.zeros(3)))
    posture = BoneWalk(KINECT_V1).standardized(postures_of(1, seed=5)[0])
    np.testing.assert_allclose(_step(still, posture).positions, posture, atol=1e-9)


def test_the_process_is_that_of_scikit_learn() -> None:
    lessons = _lessons(SHIFT, count=150)
    # As many centroids as frames: every cluster is one posture.
    model = ClusteredGP(KINECT_V1, centroids=150).fit(lessons)
    kernel = model.kernel
    same = WhiteKernel(kernel.noise) + sum(
        (
            ConstantKernel(variance) * RBF(1.0 / float(scale[0]))
            for variance, scale in zip(kernel.variances, kernel.scales, strict=True)
        ),
        start=ConstantKernel(1e-12),
    )
    rows = model.rows_.astype(float)
    outputs = kernel.of_samples(rows) @ model.weights_
    other = GaussianProcessRegressor(same, optimizer=None, alpha=0.0)
    other.fit(rows, outputs)
    for posture in _lessons(SHIFT, count=10, seed=5).positions:
        mean = other.predict(model._features(posture)[None])
        offsets, _ = model._predict(posture)
        np.testing.assert_allclose(offsets.ravel(), mean[0], atol=1e-5)


def test_unreliable_postures_teach_nothing() -> None:
    lessons = _lessons(SHIFT)
    spoilt = lessons.truth.copy()
    spoilt[::2, ELBOW] += 0.5
    reliability = lessons.reliability.copy()
    reliability[::2, WRIST] = 0.6
    mixed = replace(lessons, reliability=reliability, truth=spoilt, source="half wrong")
    half = training_set_of(
        lessons.positions[1::2],
        lessons.reliability[1::2],
        lessons.truth[1::2],
        lessons.first[1::2],
    )
    posture = postures_of(1, seed=5)[0]
    one, two = (
        _step(ClusteredGP(KINECT_V1, centroids=50).fit(part), posture).positions
        for part in (mixed, half)
    )
    np.testing.assert_allclose(one, two, atol=0.01)
    reliability[:] = 0.6
    with pytest.raises(InputError, match="half wrong: 0 frames"):
        ClusteredGP(KINECT_V1).fit(mixed)


def test_coverage_is_high_on_training_postures_and_none_far_away() -> None:
    lessons = _lessons(np.zeros(3))
    # Only what varies with the posture tells how far a posture is known.
    lessons.truth[:, WRIST] += SHIFT * np.sin(12.0 * lessons.positions[:, WRIST, :1])
    model = ClusteredGP(KINECT_V1, centroids=100).fit(lessons)
    near = [_step(model, posture).coverage for posture in lessons.positions[:20]]
    assert min(near) > 0.8
    assert max(near) <= 1.0
    upside_down = lessons.positions[0] * [1.0, -1.0, 1.0]
    result = _step(model, upside_down)
    assert result.coverage < 0.1
    np.testing.assert_allclose(result.positions, upside_down, atol=5e-3)


def test_missing_joints_are_filled_with_their_last_bones(model: ClusteredGP) -> None:
    first, second = BoneWalk(KINECT_V1).standardized(postures_of(2, seed=7))
    second[[WRIST, WRIST + 1]] = np.nan
    model.start()
    model.step(Observation(first, ONES, ONES))
    result = model.step(Observation(second, ONES, ONES))
    bone = result.positions[WRIST] - result.positions[ELBOW]
    np.testing.assert_allclose(bone, first[WRIST] - first[ELBOW], atol=2e-3)
    assert result.confidence[WRIST] == 0.0
    assert np.all(np.delete(result.confidence, [WRIST, WRIST + 1]) == 0.9)
    nothing = _step(model, np.full_like(first, np.nan))
    assert np.isfinite(nothing.positions).all()


def test_people_get_back_the_bones_that_mocap_had() -> None:
    """Two people whose forearms Kinect sees too short, one more than the other."""
    lessons = _lessons(SHIFT)
    wrist, elbow = KINECT_V1.index("WristLeft"), KINECT_V1.index("ElbowLeft")
    own = np.tile(standard_body(KINECT_V1).lengths, (len(lessons), 1))
    tall = np.arange(len(lessons)) % 2 == 1
    own[tall] *= 1.2
    truth = lessons.positions.copy()
    bone = truth[:, wrist] - truth[:, elbow]
    truth[:, wrist] += np.where(tall, 0.2, 0.1)[:, None] * bone
    seen = replace(lessons, truth=truth, lengths=own)
    model = ClusteredGP(KINECT_V1, centroids=60).fit(seen)
    posture = lessons.positions[0]
    forearm = np.linalg.norm(posture[wrist] - posture[elbow])
    for person, factor in ((own[0], 1.1), (own[1], 1.2)):
        model.start()
        found = model.step(Observation(posture, ONES, ONES, lengths=person)).positions
        length = np.linalg.norm(found[wrist] - found[elbow])
        assert length == pytest.approx(factor * forearm, rel=0.02)
