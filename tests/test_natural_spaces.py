"""What of a posture lies outside the natural posture spaces around it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from real_data import PAIRS, paired
from skeletons import every_skeleton

from kinefilter import PostureDatabase
from kinefilter.characters import KINECT_V1, Skeleton, standard_body
from kinefilter.pipeline.correct import LocalPCA, Observation
from kinefilter.pipeline.correct.posture_space import NaturalSpaces
from kinefilter.pipeline.database import builtin_database
from kinefilter.pipeline.lab.database_build import database_from_pairs
from kinefilter.pipeline.lab.evaluate import evaluate
from kinefilter.pipeline.pairs import read_pairs

Array = NDArray[np.float64]

KNEE, ANKLE = KINECT_V1.index("KneeLeft"), KINECT_V1.index("AnkleLeft")
HIPS = [KINECT_V1.index("HipLeft"), KINECT_V1.index("HipRight")]


@pytest.fixture(scope="module")
def database() -> PostureDatabase:
    return replace(builtin_database(KINECT_V1), recorded=True)


@pytest.fixture(scope="module")
def spaces(database: PostureDatabase) -> NaturalSpaces:
    return NaturalSpaces(database)


def _few(skeleton: Skeleton, count: int = 200) -> PostureDatabase:
    """Return postures scattered about the standing one, along few directions."""
    rng = np.random.default_rng(0)
    n = len(skeleton)
    rest = standard_body(skeleton).rest_positions
    directions = rng.normal(size=(8, n, 3))
    amounts = 0.05 * rng.normal(size=(count, 8))
    positions = rest - rest[skeleton.root] + np.tensordot(amounts, directions, axes=1)
    labels = np.full(count, "made up")
    return PostureDatabase(positions, labels, skeleton, recorded=True)


def test_the_shift_is_the_mean_of_a_gaussian_posterior() -> None:
    """With fewer postures than span a space, all spaces are one Gaussian."""
    few = _few(KINECT_V1)
    names = KINECT_V1.joints
    used = [j for j, name in enumerate(names) if "Hand" not in name]
    known = few.positions.astype(float)
    rows = known - known[:, HIPS].mean(axis=1, keepdims=True)
    rows = rows[:, used].reshape(len(few), -1)
    doubt = [1.4 if "Elbow" in names[j] or "Knee" in names[j] else 1.0 for j in used]
    noise = np.diag(np.repeat(0.013 * np.array(doubt), 3) ** 2)
    covariance = np.cov(rows.T, bias=True)
    gain = covariance @ np.linalg.inv(covariance + noise)
    rng = np.random.default_rng(1)
    for k in range(5):
        seen = few.positions[k] + 0.01 * rng.normal(size=(len(KINECT_V1), 3))
        row = (seen - seen[HIPS].mean(axis=0))[used].ravel()
        away = row - rows.mean(axis=0)
        expected = (gain @ away - away).reshape(-1, 3)
        shift = NaturalSpaces(few).shift(seen)
        np.testing.assert_allclose(shift[used], expected, atol=1e-9)


def test_what_no_posture_does_is_taken_back(
    database: PostureDatabase, spaces: NaturalSpaces
) -> None:
    rng = np.random.default_rng(2)
    error, left = [], []
    for k in rng.permutation(len(database))[:100]:
        wrong = 0.012 * rng.normal(size=(len(KINECT_V1), 3))
        wrong -= wrong[HIPS].mean(axis=0)
        posture = database.positions[k] + wrong
        moved = wrong + spaces.shift(posture)
        moved -= moved[HIPS].mean(axis=0)
        error.append(np.linalg.norm(wrong, axis=1).mean())
        left.append(np.linalg.norm(moved, axis=1).mean())
    assert np.mean(left) < 0.8 * np.mean(error)


def test_natural_postures_stay_within_a_centimeter(
    database: PostureDatabase, spaces: NaturalSpaces
) -> None:
    moved = [spaces.shift(posture) for posture in database.positions[::10]]
    assert np.linalg.norm(moved, axis=2).mean() < 0.01


def test_far_from_all_postures_nothing_moves(
    database: PostureDatabase, spaces: NaturalSpaces
) -> None:
    turned = database.positions[0] * [1.0, -1.0, 1.0]
    near = np.linalg.norm(spaces.shift(database.positions[0] + 0.02), axis=1).max()
    assert np.linalg.norm(spaces.shift(3.0 * turned), axis=1).max() < max(0.01, near)
    huge = spaces.shift(30.0 * turned)
    assert np.linalg.norm(huge, axis=1).max() < 0.002


@every_skeleton
def test_hands_go_along_with_their_wrists(skeleton: Skeleton) -> None:
    few = _few(skeleton)
    posture = few.positions[0] + 0.02 * np.random.default_rng(3).normal(
        size=(len(skeleton), 3)
    )
    shift = NaturalSpaces(few).shift(posture)
    wrist = skeleton.index("WristRight")
    for name in skeleton.joints:
        if "Hand" in name and name.endswith("Right"):
            np.testing.assert_array_equal(shift[skeleton.index(name)], shift[wrist])


def test_only_recorded_postures_move_reliable_joints(
    database: PostureDatabase,
) -> None:
    posture = database.positions[5] + 0.0
    posture[[KNEE, ANKLE]] += [0.04, 0.0, 0.0]
    ones = np.ones(len(KINECT_V1))
    seen = Observation(posture, ones, ones)
    scripted = LocalPCA(replace(database, recorded=False)).step(seen)
    np.testing.assert_array_equal(scripted.positions, posture)
    assert (scripted.confidence == 1.0).all()
    recorded = LocalPCA(database).step(seen)
    moved = np.linalg.norm(recorded.positions - posture, axis=1)
    assert moved[KNEE] > 0.005
    # What was moved does not count as measured.
    assert (recorded.confidence[moved > 0.002] < 1.0).all()


@paired
def test_others_mocap_brings_a_persons_postures_nearer_to_the_truth() -> None:
    others = [
        pair
        for person in ("s02", "s04", "s08")
        for pair in read_pairs(PAIRS / f"{person}.npz")[::32]
    ]
    test = read_pairs(PAIRS / "s06.npz")[::48]
    figures = evaluate(others, test, ["local-pca"], database="mocap", physics=False)
    figures = figures["methods"]
    assert figures["local-pca"]["E_std"] < 0.94 * figures["raw"]["E_std"]
    assert figures["local-pca"]["E_var"] < figures["raw"]["E_var"]
    database = database_from_pairs(others, others[0].take.skeleton)
    assert database.recorded
    assert database.source == "mocap of s02, s04, s08"
