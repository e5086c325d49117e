"""The learned corrector: random features, random effects, and what it leaves alone."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from offset_lessons import training_set_of
from real_data import PAIRS, paired

from kinefilter.characters import (
    KINECT_V1,
    KINECT_V2,
    InputError,
    Skeleton,
    standard_body,
)
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.correct import Observation, fourier_ridge
from kinefilter.pipeline.correct.fourier_ridge import FourierRidge
from kinefilter.pipeline.correct.posture_features import RandomFeatures, part_of_turn
from kinefilter.pipeline.factory import Model, make_corrector, save_model, shipped_model
from kinefilter.pipeline.lab.accuracy import Accuracy
from kinefilter.pipeline.lab.methods import fourier_ridge_learner as learner
from kinefilter.pipeline.lab.methods.fourier_ridge_learner import (
    FourierRidgeLearner,
    people_in,
)
from kinefilter.pipeline.lab.methods.training_data import TrainingSet
from kinefilter.pipeline.lab.training import observed, standard_truth, training_set
from kinefilter.pipeline.pairs import read_pairs
from kinefilter.retarget import HeadingFrame, Standardizer
from kinefilter.scenes.library import perform

Array = NDArray[np.float64]
MIRROR = np.array([-1.0, 1.0, 1.0])
PEOPLE = ("squat", "raise_arms", "squat")


def _act(motion: str, skeleton: Skeleton = KINECT_V1, seed: int = 1) -> Array:
    positions = perform(motion, standard_body(skeleton), seed=seed).positions[:120]
    return np.asarray(positions - positions[:, [skeleton.root]])


@cache
def _lessons() -> TrainingSet:
    """Return three people whose wrists are off, the higher the more."""
    truth = [_act(motion, seed=k) for k, motion in enumerate(PEOPLE)]
    counts = [len(positions) for positions in truth]
    together = np.concatenate(truth)
    seen = together.copy()
    for side in ("Left", "Right"):
        wrist = KINECT_V1.index("Wrist" + side)
        seen[:, wrist, 1] += 0.03 + 0.05 * seen[:, wrist, 1]
    first = np.zeros(len(seen), dtype=bool)
    first[np.cumsum([0, *counts[:-1]])] = True
    return training_set_of(
        seen,
        np.ones(seen.shape[:2]),
        together,
        first,
        person=np.repeat(np.arange(3), counts),
        people=("one", "two", "three"),
        time=np.concatenate([np.arange(count) / 30.0 for count in counts]),
    )


@pytest.fixture(scope="module")
def model() -> FourierRidge:
    return FourierRidgeLearner(KINECT_V1, samples=256).fit(_lessons())


def _observation(positions: Array, rate: float = 30.0) -> Observation:
    ones = np.ones(positions.shape[:-1])
    return Observation(positions, ones, ones, np.arange(len(positions)) / rate)


def test_products_of_features_are_the_kernel() -> None:
    rng = np.random.default_rng(0)
    x = (0.3 * rng.standard_normal((20, 50))).astype(np.float32)
    mean = x.mean(axis=0)
    weights = rng.uniform(0.1, 1.0, 50).astype(np.float32)
    made = RandomFeatures(mean, 40_000, 0, weights)(x)
    squares = np.sum((weights * (x[:, None] - x)) ** 2, axis=2)
    linear = weights * (x - mean)
    kernel = np.exp(-0.5 * squares) + 0.8 * linear @ linear.T
    np.testing.assert_allclose(made @ made.T, kernel, atol=0.02)


def test_weights_are_what_the_kernel_with_random_effects_says(
    model: FourierRidge,
) -> None:
    """The dual: a Gaussian process on all frames, of all people and mirror images."""
    people = list(people_in(_lessons(), learner._WEIGHT, learner._MOST))
    assert len(people) == 6
    count = len(model.weights_) - len(model.mean_)
    arm, first = (
        model._posture_features.parts[0],
        3 * len(model._posture_features.parts[0].joints),
    )
    random = RandomFeatures(model.mean_, count, 0, arm.weights)
    rows = random(np.concatenate([p.features for p in people])).astype(float)
    shared = rows @ rows.T
    covariance = shared.copy()
    ends = np.cumsum([0, *(len(p.features) for p in people)])
    for person, (a, b) in zip(people, pairwise(ends), strict=True):
        own = (slice(a, b), slice(a, b))
        same_clip = person.clips[:, None] == person.clips
        covariance[own] += 0.07 * (shared[own] + 1.0 + same_clip)
        covariance[own] += person.noise * np.eye(b - a)
    offsets = np.concatenate([p.offsets for p in people])
    offsets = offsets.reshape(len(offsets), -1, 3)[:, arm.joints].reshape(-1, first)
    dual = rows.T @ np.linalg.solve(covariance, offsets - model.offset_[:first])
    # Half precision, as in the file.
    found = rows @ model.weights_[:, :first]
    np.testing.assert_allclose(found, rows @ dual, atol=2e-4)
    assert np.abs(rows @ dual).max() > 0.005


def test_what_was_learned_is_taken_off(model: FourierRidge) -> None:
    lessons = _lessons()
    wrist = KINECT_V1.index("WristLeft")
    made = model.whole(_observation(lessons.positions[:120]))
    away = np.linalg.norm(made.positions - lessons.truth[:120], axis=2)[:, wrist]
    before = np.linalg.norm(lessons.positions - lessons.truth, axis=2)[:120, wrist]
    assert away.mean() < 0.5 * before.mean()


def test_mirror_images_are_corrected_to_mirror_images(model: FourierRidge) -> None:
    seen = _lessons().positions[120:240]
    mirrored = seen[:, KINECT_V1.mirror] * MIRROR
    one, other = (
        model.whole(_observation(positions)).positions for positions in (seen, mirrored)
    )
    # The centers are not symmetric themselves.
    moved = np.abs(one - seen).max()
    np.testing.assert_allclose(
        other[:, KINECT_V1.mirror] * MIRROR, one, atol=moved / 20
    )


def test_far_from_what_was_learned_nothing_is_moved(model: FourierRidge) -> None:
    """Neither in a file nor live, though the linear part would grow and grow."""
    far = 4.0 * _lessons().positions[:60]
    take = _observation(far)
    found = model.whole(take)
    np.testing.assert_allclose(found.positions, far, atol=1e-9)
    assert found.coverage.max() < 1e-6
    model.start()
    for k in range(len(far)):
        stepped = model.step(take.at(k)).positions
        np.testing.assert_allclose(stepped, far[k], atol=1e-9)


def test_where_nothing_is_known_nothing_is_added(model: FourierRidge) -> None:
    far = 40.0 * standard_body(KINECT_V1).rest_positions
    lengths = np.full(len(KINECT_V1), 9.0)
    ones = np.ones(len(KINECT_V1))
    model.start()
    result = model.step(Observation(far, ones, ones, 0.0, lengths))
    np.testing.assert_allclose(result.positions, far, atol=1e-9)
    assert result.coverage == pytest.approx(0.0, abs=1e-9)
    model.start()


def test_missing_joints_are_filled_by_the_model(model: FourierRidge) -> None:
    posture = standard_body(KINECT_V1).rest_positions
    posture = posture - posture[KINECT_V1.root]
    hand = KINECT_V1.index("HandRight")
    posture[hand] = np.nan
    ones = np.ones(len(KINECT_V1))
    model.start()
    result = model.step(Observation(posture, ones, ones))
    model.start()
    assert np.isfinite(result.positions).all()
    assert result.confidence[hand] == 0.0


def test_a_take_is_the_same_in_chunks(
    model: FourierRidge, monkeypatch: pytest.MonkeyPatch
) -> None:
    take = _observation(_lessons().positions[:100])
    at_once = model.whole(take).positions
    monkeypatch.setattr(fourier_ridge, "_CHUNK", 17)
    np.testing.assert_allclose(model.whole(take).positions, at_once, atol=1e-6)


def test_live_features_are_those_of_takes_without_what_comes_after(
    model: FourierRidge,
) -> None:
    points = model._posture_features.points(_lessons().positions[:40])
    time, toward = np.arange(40) / 30.0, np.tile([0.0, 1.0], (40, 1))
    whole = model._posture_features(points, points, time, time, toward)
    for k in (0, 1, 9, 39):
        past = slice(0, k + 1)
        live = model._posture_features(
            points[[k]], points[past], time[[k]], time[past], toward[[k]], live=True
        )
        np.testing.assert_allclose(
            live[0], whole[k, model._posture_features.live], atol=1e-6
        )


def test_movement_is_by_time_and_not_by_frames(model: FourierRidge) -> None:
    seen = _lessons().positions[:90]
    between = 0.5 * (seen[:-1] + seen[1:])
    twice = np.empty((2 * len(seen) - 1, *seen.shape[1:]))
    twice[::2], twice[1::2] = seen, between
    slow = model.whole(_observation(seen)).positions
    fast = model.whole(_observation(twice, 60.0)).positions
    np.testing.assert_allclose(fast[::2], slow, atol=2e-3)
    assert np.abs(slow - seen).max() > 0.02


def test_live_motion_goes_on_after_a_pause(model: FourierRidge) -> None:
    seen = _lessons().positions[:30]
    take = _observation(seen)
    late = replace(take, time=take.time + np.where(np.arange(30) < 15, 0.0, 5.0))
    model.start()
    made = np.array([model.step(late.at(k)).positions for k in range(30)])
    assert np.isfinite(made).all()
    assert 0.01 < np.abs(made - seen).max() < 0.2


def test_a_spine_joint_near_the_hips_does_not_bend_the_trunk(
    model: FourierRidge,
) -> None:
    """Trunks of people before Kinect v1, whose spine joint is low, bowed in punches."""
    standard = standard_body(KINECT_V1)
    lengths = standard.lengths.copy()
    root, spine, girdle = 0, *map(KINECT_V1.index, ("Spine", "ShoulderCenter"))
    lengths[[spine, girdle]] = 0.08, 0.38
    person = Standardizer(replace(standard, lengths=lengths))
    shift = np.random.default_rng(0).normal(0.0, 0.03, (20, 3))
    shift[root] = 0.0
    assert np.abs(model._trunk_shift(shift, standard.lengths)).max() < 1e-9
    there = HeadingFrame(np.zeros(3), np.zeros(()))
    before, after = (
        person.undo(standard.rest_positions + moved, there)
        for moved in (0.0, shift + model._trunk_shift(shift, lengths))
    )
    size = 0.46 / standard.lengths[[spine, girdle]].sum()
    np.testing.assert_allclose((after - before)[girdle], size * shift[girdle])


def test_missing_joints_go_along_with_their_limb(model: FourierRidge) -> None:
    hand, wrist = (KINECT_V1.index(part + "Left") for part in ("Hand", "Wrist"))
    seen = _lessons().positions[:60].copy()
    there = model.whole(_observation(seen)).positions
    np.testing.assert_allclose(
        there[:, hand] - there[:, wrist], seen[:, hand] - seen[:, wrist], atol=1e-12
    )
    seen[20:40, wrist] = np.nan
    found = model.whole(_observation(seen))
    assert np.isfinite(found.positions).all()
    assert (found.confidence[20:40, wrist] == 0.0).all()


def test_all_skeletons_are_corrected_alike(model: FourierRidge) -> None:
    """Joints that Kinect v1 lacks do not change what the others get."""
    other = FourierRidge.from_arrays(KINECT_V2, model.arrays())
    v1, v2 = _act("squat"), _act("squat", KINECT_V2)
    shifts = [
        found.whole(_observation(seen)).positions - seen
        for found, seen in ((model, v1), (other, v2))
    ]
    for joint in ("WristLeft", "KneeRight", "Head"):
        one = shifts[0][:, KINECT_V1.index(joint)]
        two = shifts[1][:, KINECT_V2.index(joint)]
        np.testing.assert_allclose(one, two, atol=1e-4)


@pytest.mark.parametrize("skeleton", [KINECT_V1, KINECT_V2], ids=lambda s: s.name)
def test_what_ships_keeps_calm_joints_calm(skeleton: Skeleton) -> None:
    """Somebody who stands still is moved by a constant, the same on both sides."""
    model = shipped_model(skeleton)
    rest = standard_body(skeleton).rest_positions
    still = np.tile(rest - rest[skeleton.root], (60, 1, 1))
    made = model.whole(_observation(still)).positions
    np.testing.assert_allclose(made, made[:1].repeat(60, axis=0), atol=1e-6)
    np.testing.assert_allclose(made[0][skeleton.mirror] * MIRROR, made[0], atol=0.003)


@paired
def test_what_ships_is_what_the_recordings_teach() -> None:
    """Of fewer clips and features, and nobody simulated: nearly the same offsets."""
    files = sorted(PAIRS.glob("s*.npz"))
    clips = {file: read_pairs(file) for file in files}
    lessons = training_set(p for some in clips.values() for p in some[::36])
    again = FourierRidgeLearner(KINECT_V1, samples=256).fit(lessons)
    shipped = shipped_model(KINECT_V1)
    differ, moved, raw, left = [], [], [], []
    accuracy = Accuracy(KINECT_V1)
    for some in clips.values():
        pair = some[4]
        draft = observed(pair)
        seen = Observation(
            draft.standard,
            draft.reliability,
            draft.geometry,
            draft.time,
            sensor=draft.heading.origin,
        )
        made = [method.whole(seen).positions for method in (again, shipped)]
        truth = standard_truth(pair, draft)
        differ.append(np.nanmean(accuracy.distances(made[0], made[1])))
        moved.append(np.nanmean(accuracy.distances(draft.standard, made[1])))
        raw.append(np.nanmean(accuracy.distances(draft.standard, truth)))
        left.append(np.nanmean(accuracy.distances(made[1], truth)))
    assert np.mean(differ) < 0.4 * np.mean(moved)
    assert np.mean(left) < 0.6 * np.mean(raw)


@cache
def _beside() -> TrainingSet:
    """Return three people seen from their right, whose left wrists are far too low."""
    lessons = _lessons()
    seen = lessons.truth.copy()
    seen[:, KINECT_V1.index("WristLeft"), 1] -= 0.10
    sensor = np.tile([-2.0, 0.0, 0.0], (len(seen), 1))
    return replace(lessons, positions=seen, sensor=sensor)


def test_limbs_on_the_far_side_are_put_where_a_sensor_in_front_saw_them() -> None:
    """Nearer ones and those of people whom the sensor faces stay as they are."""
    truthful = replace(_lessons(), positions=_lessons().truth)
    model = FourierRidgeLearner(KINECT_V1, samples=256).fit(truthful, views=_beside())
    beside = _beside()
    left, right = (KINECT_V1.index(f"Wrist{side}") for side in ("Left", "Right"))
    some = slice(0, 60)
    seen, truth, aside = beside.positions[some], beside.truth[some], beside.sensor[some]
    facing = np.tile([0.0, 0.0, 2.0], (60, 1))
    for sensor, least, most in (
        (aside, 0.0, 0.04),
        (aside * [-1.0, 1.0, 1.0], 0.095, 0.105),
        (facing, 0.095, 0.105),
    ):
        take = replace(_observation(seen), sensor=sensor)
        away = np.abs(model.whole(take).positions - truth)
        assert least <= away[:, left].max(axis=1).mean() < most
        if sensor[0, 0] <= 0.0:  # not on the other side
            np.testing.assert_allclose(away[:, right], 0.0, atol=0.01)
        model.start()
        live = [model.step(take.at(k)).positions for k in range(60)]
        away = np.abs(np.array(live) - truth)
        assert least <= away[:, left].max(axis=1).mean() < 1.5 * most


def test_trunks_are_turned_away_from_the_sensor_up_to_a_right_angle() -> None:
    """Not those that face it; those seen from behind as if they were in front."""
    shown = np.radians([[0.0, 10.0, 31.5, 60.0, 85.0, 90.0, 95.0, 180.0]])
    toward = np.stack([np.sin(shown), np.cos(shown)], axis=-1)
    turn = np.degrees(part_of_turn(toward * [-1.0, 1.0], 0.4))
    few, more = 0.4 * (31.5 - np.degrees(0.2)), 0.4 * (60.0 - np.degrees(0.2))
    expected = [[0.0, 0.0, few, more, 5.0, 0.0, -5.0, 0.0]]
    np.testing.assert_allclose(turn, expected, atol=1e-9)
    mirrored = np.degrees(part_of_turn(toward, 0.4))
    np.testing.assert_allclose(mirrored, np.negative(expected), atol=1e-9)


def test_a_known_person_is_corrected_as_that_person(tmp_path: Path) -> None:
    lessons = _lessons()
    own = lessons.positions.copy()
    ann = np.asarray(lessons.person) == 1
    own[ann, KINECT_V1.index("Head")] += [0.0, 0.05, 0.0]
    lessons = replace(lessons, positions=own, people=("bob", "ann", "eve"))
    knowing = FourierRidgeLearner(KINECT_V1, samples=256).fit(lessons, people=True)
    path = tmp_path / "people.npz"
    save_model(Model(knowing, "learned", KINECT_V1, "imagined"), path)
    takes = {"stranger": None, "ann": "ann", "nobody": "nobody"}
    left = {}
    for name, person in takes.items():
        knowing.select_person(person)
        for k, made in enumerate(
            (
                knowing.whole(_observation(own[ann])).positions,
                np.array(
                    [
                        knowing.step(_observation(own[ann]).at(k)).positions
                        for k in range(ann.sum())
                    ]
                ),
            )
        ):
            away = np.linalg.norm(made - lessons.truth[ann], axis=2)
            left[name, k] = away[:, KINECT_V1.index("Head")].mean()
    for k in range(2):
        assert left["ann", k] < 0.3 * left["stranger", k]
        assert left["nobody", k] == left["stranger", k]
    config = CleanConfig(model=path, person="ann")
    assert make_corrector(KINECT_V1, config)._person == 1
    with pytest.raises(InputError, match="does not know 'tom', only bob, ann"):
        make_corrector(KINECT_V1, replace(config, person="tom"))
    with pytest.raises(InputError, match="--person needs a --model"):
        make_corrector(KINECT_V1, CleanConfig(person="ann"))
