"""Correction in the natural posture space."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from numpy.typing import NDArray
from skeletons import every_skeleton
from sklearn.decomposition import PCA

from kinefilter.characters import KINECT_V1, Skeleton, Take, standard_body
from kinefilter.pipeline.correct import Hold, LocalPCA, Observation
from kinefilter.pipeline.correct.hold import RELIABLE, Blend, measurement_confidence
from kinefilter.pipeline.correct.posture_space import (
    EnergyWeights,
    PostureEnergy,
    PostureSpace,
    solve,
    stochastic_search,
)
from kinefilter.pipeline.database import PostureDatabase, builtin_database
from kinefilter.pipeline.lab.methods.baselines import Nearest, NoReliability
from kinefilter.pipeline.reliability import ReliabilityScorer, measure_reference
from kinefilter.retarget import Standardizer, measured_body
from kinefilter.scenes.library import perform
from kinefilter.scenes.sensor import sample_take

Array = NDArray[np.float64]
JOINTS = len(KINECT_V1)


@pytest.fixture(scope="module")
def database() -> PostureDatabase:
    return builtin_database(KINECT_V1)


def _observations(take: Take) -> Iterator[Observation]:
    reference = measure_reference(take)
    body = measured_body(take.skeleton, reference.lengths, reference.directions)
    scorer, standardizer = (
        ReliabilityScorer(take.skeleton, reference),
        Standardizer(body),
    )
    for positions, state in zip(take.positions, take.state, strict=True):
        reliability, _, geometry = scorer.step(positions, state)
        yield Observation(
            standardizer.step(positions, reliability)[0], reliability, geometry
        )


def _seen(positions: Array, reliability: Array | None = None) -> Observation:
    reliability = np.ones(JOINTS) if reliability is None else reliability
    return Observation(positions, reliability, np.ones(JOINTS))


def _performed(name: str, seed: int) -> Array:
    """Return a motion, normalized; from seed 5 on one that no database has seen."""
    body = standard_body(KINECT_V1)
    act = perform(name, body, seed=seed)
    return Standardizer(body).steps(act.positions, np.ones((len(act.time), JOINTS)))[0]


def test_the_posture_space_is_scikit_learns(database: PostureDatabase) -> None:
    postures = database.flat[:30].astype(float)
    space, pca = PostureSpace(postures, 20), PCA(20).fit(postures)
    np.testing.assert_allclose(space.mean, pca.mean_, atol=1e-12)
    np.testing.assert_allclose(
        np.abs(np.sum(space.basis * pca.components_.T, axis=0)), 1.0, atol=1e-6
    )
    np.testing.assert_allclose(
        space.deviations**2 * 30, pca.explained_variance_ * 29, rtol=1e-6
    )


def test_the_basis_is_orthonormal_and_projection_inverts(
    database: PostureDatabase,
) -> None:
    space = PostureSpace(database.flat[100:130].astype(float), 20)
    np.testing.assert_allclose(
        space.basis.T @ space.basis, np.eye(space.basis.shape[1]), atol=1e-8
    )
    latent = np.random.default_rng(0).standard_normal(space.basis.shape[1])
    np.testing.assert_allclose(space.project(space.posture(latent)), latent, atol=1e-9)


def test_identical_postures_span_a_space_of_no_dimension_but_their_own() -> None:
    postures = np.tile(np.arange(60.0), (30, 1))
    space = PostureSpace(postures, 20)
    assert np.isfinite(space.basis).all()
    np.testing.assert_allclose(space.posture(space.project(postures[0])), postures[0])


def test_the_energy_is_the_papers_sums(database: PostureDatabase) -> None:
    rng = np.random.default_rng(1)
    body, weights = standard_body(KINECT_V1), EnergyWeights(1.1, 0.6, 1.4, 0.3)
    neighbors = database.flat[:7].astype(float)
    space = PostureSpace(neighbors, 4)
    measured, reliability = database.positions[9], rng.uniform(0, 1, JOINTS)
    before, last = database.flat[10].astype(float), database.flat[11].astype(float)
    steady = 2 * last - before
    energy = PostureEnergy(space, body, measured, reliability, steady, weights)
    latent = 0.3 * rng.standard_normal(4)
    posture = space.posture(latent)
    p = posture.reshape(-1, 3)
    control = sum(
        reliability[j] * np.sum((p[j] - measured[j]) ** 2) for j in range(JOINTS)
    )
    style = min(np.sum((posture - n) ** 2) / JOINTS for n in neighbors)
    kinematics = np.mean(
        [
            (np.linalg.norm(p[j] - p[KINECT_V1.parents[j]]) - body.lengths[j]) ** 2
            for j in KINECT_V1.segments
        ]
    )
    continuity = np.sum((posture - 2 * last + before) ** 2) / JOINTS
    expected = 1.1 * control + 0.6 * style + 1.4 * kinematics + 0.3 * continuity
    found = energy(latent[None])[0][0] + energy.constant
    assert found == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("take", [sample_take()], ids=["sample"])
def test_the_solver_reaches_lower_energy_than_the_stochastic_search(
    database: PostureDatabase, take: Take
) -> None:
    corrector = LocalPCA(database)
    rng = np.random.default_rng(0)
    lower, stationary = [], []
    for k, seen in enumerate(_observations(take)):
        corrector.step(seen)  # leaves the energy as the frame set it
        if k % 5:
            continue
        energy = corrector.energy
        start = energy.space.latent[0]
        solved = solve(energy, start)
        sampled = stochastic_search(energy, start, rng)
        energies = energy(np.array([solved, sampled]))[0]
        lower.append(energies[0] <= energies[1] + 1e-12)
        nearby = solved + 1e-3 * rng.standard_normal((50, len(solved)))
        stationary.append(energies[0] <= energy(nearby)[0].min() + 1e-7)
    assert len(lower) > 50
    assert np.mean(lower) >= 0.95
    assert np.mean(stationary) >= 0.95


def test_same_seed_same_search(database: PostureDatabase) -> None:
    motion = _performed("wave", 77)[:8]
    runs = [LocalPCA(database, search="stochastic", seed=s) for s in (5, 5, 6)]
    results = [
        np.array([r.step(_seen(p, np.full(JOINTS, 0.5))).positions for p in motion])
        for r in runs
    ]
    np.testing.assert_array_equal(results[0], results[1])
    assert np.abs(results[0] - results[2]).max() > 0


def test_starting_again_forgets(database: PostureDatabase) -> None:
    motion = _performed("bend", 78)[:6]
    corrector = LocalPCA(database)
    rates = np.full(JOINTS, 0.5)
    first = [corrector.step(_seen(p, rates)).positions for p in motion]
    corrector.start()
    again = [corrector.step(_seen(p, rates)).positions for p in motion]
    np.testing.assert_array_equal(first, again)


def test_reliable_joints_stay_where_they_are(database: PostureDatabase) -> None:
    rng = np.random.default_rng(2)
    corrector = LocalPCA(database)
    reliability = np.ones(JOINTS)
    reliability[KINECT_V1.index("WristLeft")] = 0.0
    kept = reliability > 0
    for posture in _performed("wave", 79)[:20]:
        seen = posture + 0.01 * rng.standard_normal(posture.shape)
        result = corrector.step(_seen(seen, reliability))
        np.testing.assert_array_equal(result.positions[kept], seen[kept])


@pytest.mark.parametrize(
    ("motion", "left"),
    [("punch", 0.65), ("walk", 0.6), ("lift_box", 0.6), ("squat", 0.6), ("run", 0.6)],
)
def test_hidden_joints_come_back_nearer_than_where_the_sensor_lost_them(
    database: PostureDatabase, motion: str, left: float
) -> None:
    """Where the rest of the body tells what an arm does: not in waving or clapping.

    A fist may be the one that punches or the one that guards.
    """
    rng = np.random.default_rng(3)
    arm = [KINECT_V1.index(f"{j}Left") for j in ("Elbow", "Wrist", "Hand")]
    corrector = LocalPCA(database)
    before, after = [], []
    for truth in _performed(motion, 80)[:90]:
        seen = truth + 0.01 * rng.standard_normal(truth.shape)
        astray = rng.standard_normal(3)
        seen[arm] += 0.25 * astray / np.linalg.norm(astray)
        reliability = np.ones(JOINTS)
        reliability[arm] = 0.0
        result = corrector.step(_seen(seen, reliability))
        before.append(np.linalg.norm(seen[arm] - truth[arm], axis=1).mean())
        after.append(np.linalg.norm(result.positions[arm] - truth[arm], axis=1).mean())
    assert np.mean(after) < left * np.mean(before)


def test_outside_the_database_sound_measurements_are_kept(
    database: PostureDatabase,
) -> None:
    upside_down = _performed("wave", 81)[0] * [1.0, -1.0, 1.0]
    reliability = np.full(JOINTS, 0.3)
    result = LocalPCA(database).step(_seen(upside_down, reliability))
    assert result.coverage == 0.0
    np.testing.assert_allclose(result.positions, upside_down, atol=2e-3)


def test_what_the_database_holds_is_covered(database: PostureDatabase) -> None:
    corrector = LocalPCA(database)
    result = [corrector.step(_seen(p)) for p in _performed("clap", 0)]
    assert np.mean([r.coverage for r in result]) > 0.9


def test_missing_joints_are_filled_and_claim_no_measurement(
    database: PostureDatabase,
) -> None:
    posture = _performed("point", 82)[20].copy()
    hidden = [KINECT_V1.index(j) for j in ("WristRight", "HandRight")]
    posture[hidden] = np.nan
    result = LocalPCA(database).step(
        _seen(posture, np.where(np.isnan(posture[:, 0]), 0.0, 1.0))
    )
    assert np.isfinite(result.positions).all()
    assert np.all(result.confidence[hidden] == 0.0)


def test_a_frame_in_which_nothing_is_seen_still_gives_a_posture(
    database: PostureDatabase,
) -> None:
    corrector = LocalPCA(database)
    motion = _performed("walk", 83)
    for posture in motion[:5]:
        last = corrector.step(_seen(posture)).positions
    blind = Observation(
        np.full((JOINTS, 3), np.nan), np.zeros(JOINTS), np.zeros(JOINTS)
    )
    result = corrector.step(blind)
    assert np.isfinite(result.positions).all()
    corrector.start()  # nothing speaks against the database
    assert corrector.step(blind).coverage == 1.0
    assert np.linalg.norm(result.positions - last, axis=1).mean() < 0.15


def _all_tracked(positions: Array) -> NDArray[np.uint8]:
    return np.full(positions.shape[:2], 2, dtype=np.uint8)


def test_hold_keeps_measurements_and_hangs_the_missing_on_their_last_bones() -> None:
    rest = standard_body(KINECT_V1).rest_positions
    rest = rest - rest[KINECT_V1.root]
    hold = Hold(KINECT_V1)
    np.testing.assert_allclose(hold.step(_seen(rest)).positions, rest)
    hand, wrist = KINECT_V1.index("HandLeft"), KINECT_V1.index("WristLeft")
    moved = rest.copy()
    moved[wrist] += [0.0, 0.1, 0.05]
    moved[hand] = np.nan
    filled = hold.step(_seen(moved)).positions
    np.testing.assert_allclose(
        filled[hand] - filled[wrist], rest[hand] - rest[wrist], atol=1e-4
    )


def test_blending_with_full_trust_is_the_measurement_and_with_none_the_prior() -> None:
    rng = np.random.default_rng(4)
    prior, measured = rng.standard_normal((2, JOINTS, 3))
    blend = Blend(KINECT_V1)
    np.testing.assert_array_equal(blend(prior, measured, np.ones(JOINTS)), measured)
    np.testing.assert_allclose(blend(prior, measured, np.zeros(JOINTS)), prior)


def test_an_untrusted_joint_moves_by_the_mean_of_its_trusted_neighbors() -> None:
    rng = np.random.default_rng(5)
    prior = rng.standard_normal((JOINTS, 3))
    confidence = np.ones(JOINTS)
    shoulder, elbow, wrist = (
        KINECT_V1.index(f"{j}Left") for j in ("Shoulder", "Elbow", "Wrist")
    )
    confidence[elbow] = 0.0
    measured = prior.copy()
    measured[shoulder] += [0.1, 0.0, 0.0]
    measured[wrist] += [0.0, 0.3, 0.0]
    blended = Blend(KINECT_V1)(prior, measured, confidence)
    np.testing.assert_allclose(
        blended[elbow] - prior[elbow], [0.05, 0.15, 0], atol=1e-3
    )


def test_trust_is_full_for_the_reliable_none_for_the_missing_and_monotonic() -> None:
    reliability = np.linspace(0, 1, 101)
    missing = np.zeros(101, dtype=bool)
    covered = measurement_confidence(reliability, reliability, missing, 1.0)
    outside = measurement_confidence(reliability, np.ones(101), missing, 0.0)
    assert np.all(np.diff(covered) >= 0)
    assert covered[0] == 0.0
    assert np.all(covered[reliability >= RELIABLE] == 1.0)
    assert np.all(outside == 1.0)
    assert np.all(
        measurement_confidence(reliability, reliability, ~missing, 0.5) == 0.0
    )


@every_skeleton
def test_it_works_on_either_skeleton(skeleton: Skeleton) -> None:
    body = standard_body(skeleton)
    act = perform("reach_up", body, seed=5)
    take = Take(
        act.time[:10], act.positions[:10], _all_tracked(act.positions[:10]), skeleton
    )
    corrector = LocalPCA(builtin_database(skeleton))
    for seen in _observations(take):
        result = corrector.step(seen)
        np.testing.assert_allclose(result.positions, seen.positions, atol=1e-6)


def test_method_a_is_a_posture_of_the_database(database: PostureDatabase) -> None:
    posture = _performed("wave", 85)[10]
    found = Nearest(database).step(_seen(posture))
    away = np.sum((database.positions - posture) ** 2, axis=(1, 2))
    np.testing.assert_array_equal(found.positions, database.positions[np.argmin(away)])


def test_method_b_does_not_care_about_reliability(database: PostureDatabase) -> None:
    posture = _performed("wave", 86)[10]
    low = NoReliability(database).step(_seen(posture, np.full(JOINTS, 0.1)))
    high = NoReliability(database).step(_seen(posture))
    np.testing.assert_array_equal(low.positions, high.positions)
