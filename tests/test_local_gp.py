"""The local mixture of Gaussian processes: its parts against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from offset_lessons import (
    BIAS,
    ELBOW,
    WRIST,
    Array,
    bent,
    constant,
    copied,
    corrected,
    lessons_of,
    local_gp,
    postures_of,
)
from scipy.optimize import minimize
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel
from sklearn.linear_model import Ridge

from kinefilter.characters import KINECT_V1
from kinefilter.pipeline.correct import Observation
from kinefilter.pipeline.lab.methods.fused_offsets import least_energy
from kinefilter.pipeline.lab.methods.local_gp import LocalGP
from kinefilter.pipeline.lab.methods.local_models import JointFeatures, LinearTrend

pytestmark = pytest.mark.usefixtures("few_for_kernels")


@pytest.fixture(scope="module")
def fitted() -> LocalGP:
    return local_gp().fit(lessons_of(bent))


@pytest.mark.parametrize("clusters", [1, 4])
def test_a_local_model_is_the_process_of_scikit_learn(clusters: int) -> None:
    model = LocalGP(KINECT_V1, clusters=clusters, samples=120, redundancy=0.0)
    model.fit(lessons_of(bent, count=120))
    assert (model.counts_.sum(axis=1) == 120).all()
    features = JointFeatures(KINECT_V1, model.joints_, model.seen_)
    queries = features(postures_of(20, seed=5))
    models, found = model._models, set()
    for m in np.flatnonzero(np.isin(model.joints_, [WRIST, ELBOW])):
        for query in queries:
            scaled = query * model.kernels.roots
            mean, variance = models.predict(scaled, 1)
            apart = np.linalg.norm(models.centers[m, :clusters] - scaled[m], axis=1)
            q = int(apart.argmin())
            means, deviation = _reference(model, features.sizes[m], m, q, query[m])
            np.testing.assert_allclose(mean[m], means, atol=1e-6)
            np.testing.assert_allclose(variance[m], deviation**2, rtol=1e-6, atol=1e-9)
            found.add((m, q))
    assert len(found) > clusters


def _reference(
    model: LocalGP, size: int, m: int, q: int, query: Array
) -> tuple[Array, Array]:
    """Return mean [m] and deviation [m] of a joint's nearest process, shape (3,)."""
    theta0, theta1, noise, *roots = model.kernels_[m, : 3 + size]
    same = (
        ConstantKernel(theta0) * RBF(1.0 / np.array(roots))
        + ConstantKernel(theta1)
        + WhiteKernel(noise)
    )
    other = GaussianProcessRegressor(same, optimizer=None, alpha=0.0)
    count = model.counts_[m, q]
    other.fit(model.features_[m, q, :count, :size], model.offsets_[m, q, :count])
    means, deviations = other.predict(query[None, :size], return_std=True)
    return means[0], deviations[0]


def test_the_trend_is_the_ridge_regression_of_scikit_learn() -> None:
    rng = np.random.default_rng(4)
    features, slopes = rng.normal(size=(40, 2, 5)), rng.normal(size=(2, 5, 3))
    offsets = np.einsum("nmf,mfc->nmc", features, slopes) + 0.3
    offsets += 0.01 * rng.normal(size=offsets.shape)
    trend = LinearTrend.fitted(features, offsets)
    inside = 0.5 * features[:5]
    for m in range(2):
        other = Ridge(alpha=0.3**2).fit(features[:, m], offsets[:, m])
        np.testing.assert_allclose(
            trend(inside)[:, m], other.predict(inside[:, m]), atol=1e-9
        )
    beyond = features.max(axis=0)
    np.testing.assert_allclose(trend(beyond + 5.0), trend(beyond))


def test_the_least_energy_is_what_a_search_finds() -> None:
    rng = np.random.default_rng(3)
    mean, steady = rng.normal(0.0, 0.05, (2, 4, 3))
    variance, rate = rng.uniform(1e-4, 1e-3, (4, 3)), rng.uniform(0.0, 1.0, 4)
    prior = 2e-3

    def energy(flat: Array) -> float:
        y = flat.reshape(4, 3)
        # The negative log density, without its constant, in units of the prior.
        spatial = 2.0 * prior * np.sum((y - mean) ** 2 / (2.0 * variance))
        temporal = np.sum((y - steady) ** 2)
        reliability = np.sum((rate[:, None] * y) ** 2)
        return float(0.6 * spatial + 0.2 * temporal + 0.2 * reliability)

    weights = {"spatial": 0.6, "temporal": 0.2, "reliability": 0.2}
    closed = least_energy(mean, prior / variance, steady, rate, **weights)
    found = minimize(energy, np.zeros(12), tol=1e-14).x.reshape(4, 3)
    np.testing.assert_allclose(closed, found, atol=1e-6)
    steady[1] = np.nan
    without = least_energy(mean, prior / variance, steady, rate, **weights)
    alone = least_energy(
        mean, prior / variance, steady, rate, **{**weights, "temporal": 0.0}
    )
    np.testing.assert_allclose(without[1], alone[1])


def test_the_mean_alone_is_left_without_the_other_terms(
    fitted: LocalGP,
) -> None:
    model = copied(fitted)
    assert isinstance(model, LocalGP)
    model.temporal = model.reliability = 0.0
    posture = postures_of(1, seed=5)[0]
    features = model._features(posture)
    mean, _ = model._models.predict(features * model.kernels.roots, model.blended)
    moved = corrected(model, posture[None])[0].positions - posture
    expected = model._trend(features) + mean
    np.testing.assert_allclose(moved[model.joints_], expected, atol=1e-12)


def test_the_temporal_term_calms_what_jumps(fitted: LocalGP) -> None:
    shaken = postures_of(1, seed=5) + 0.02 * np.random.default_rng(0).normal(
        size=(60, len(KINECT_V1), 3)
    )
    shaken[:, KINECT_V1.root] = 0.0

    def jumps(model: LocalGP) -> float:
        path = np.array([c.positions[WRIST] for c in corrected(model, shaken)])
        return float(np.linalg.norm(np.diff(path, n=2, axis=0), axis=1).mean())

    model = copied(fitted)
    assert isinstance(model, LocalGP)
    model.temporal = 50.0
    steady = jumps(model)
    model.temporal = 0.0
    assert steady < 0.8 * jumps(model)


def test_a_joint_the_sensor_never_measures_tells_nothing() -> None:
    lessons = lessons_of(bent)
    hand = KINECT_V1.index("HandLeft")
    lessons.positions[:, hand] = np.nan
    model = local_gp().fit(lessons)
    waving, still = postures_of(1, seed=5)[0], postures_of(1, seed=5)[0]
    waving[hand] += 0.3
    moved = [corrected(model, p[None])[0].positions[WRIST] for p in (waving, still)]
    np.testing.assert_array_equal(*moved)


@pytest.mark.filterwarnings("ignore:Number of distinct clusters")
def test_a_joint_that_never_moves_is_learned_too() -> None:
    lessons = lessons_of(constant, count=150)
    lessons.positions[:] = lessons.positions[0]
    lessons.truth[:] = lessons.truth[0]
    model = local_gp(clusters=3).fit(lessons)
    moved = corrected(model, lessons.positions[:1])[0].positions - lessons.positions[0]
    np.testing.assert_allclose(
        moved[WRIST], lessons.truth[0, WRIST] - lessons.positions[0, WRIST], rtol=0.1
    )


def test_doubt_alone_calls_for_the_temporal_term(fitted: LocalGP) -> None:
    """A reliable joint is spared; an unreliable one goes on as far as it is carried."""
    model = fitted.adjusted(
        likelihood="density", temporal=1e9, reliability=0.0, spared=1.0, carry=0.5
    )
    still, moved = postures_of(1, seed=5)[0], postures_of(1, seed=5)[0].copy()
    moved[WRIST] += [0.1, 0.0, 0.0]
    plain = model.adjusted(temporal=0.0)
    for reliability in (1.0, 0.0):
        rate = np.full(len(KINECT_V1), 1.0)
        path, free = [], []
        for model_, found in ((model, path), (plain, free)):
            model_.start()
            for k, posture in enumerate((still, moved, still)):
                rate[WRIST] = reliability if k == 2 else 1.0
                seen = Observation(posture, rate.copy(), rate.copy())
                found.append(model_.step(seen).positions[WRIST])
        if reliability == 1.0:
            np.testing.assert_allclose(path, free, atol=1e-9)
        else:
            np.testing.assert_allclose(
                path[2], path[1] + 0.5 * (path[1] - path[0]), atol=1e-4
            )


def test_the_densities_have_the_variances_of_what_is_learned_from(
    fitted: LocalGP,
) -> None:
    steps = np.diff(lessons_of(bent).positions[:, WRIST], n=2, axis=0)
    m = int(np.flatnonzero(fitted.joints_ == WRIST)[0])
    np.testing.assert_allclose(fitted.movement_[m], np.mean(steps**2), rtol=1e-9)


def test_reliability_tells_of_offsets_what_the_prediction_does_not() -> None:
    """Its density is a ratio: how much smaller offsets of reliable joints are."""
    lessons = lessons_of(constant, count=120)
    offsets = lessons.truth[:, WRIST] - lessons.positions[:, WRIST]
    lessons.truth[::2, WRIST] += offsets[::2]
    lessons.reliability[::2, WRIST] = 0.5
    model = local_gp(clusters=2).fit(lessons)
    m = int(np.flatnonzero(model.joints_ == WRIST)[0])
    small, usual = np.mean(BIAS**2), np.mean([np.mean(BIAS**2), 4 * np.mean(BIAS**2)])
    expected = 1.0 / (1.0 / small - 1.0 / usual)
    np.testing.assert_allclose(model.misplaced_[m], expected, rtol=1e-9)
    lessons.reliability[:] = 1.0  # all alike: it tells nothing
    assert local_gp(clusters=2).fit(lessons).misplaced_[m] > 1e6


def test_the_temporal_term_pulls_to_the_velocity_as_its_weight_grows() -> None:
    mean, steady = np.full((1, 3), 0.01), np.full((1, 3), 0.07)
    for weight in (0.0, 0.2, 2.0, 20.0):
        found = least_energy(
            mean,
            np.full((1, 3), 3.0),
            steady,
            np.zeros(1),
            spatial=0.6,
            temporal=weight,
            reliability=0.2,
        )
        share = weight / (0.6 * 3.0 + weight)
        np.testing.assert_allclose(found, mean + share * (steady - mean))


def _doubted(model: LocalGP, wrists: Array, rate: float) -> Array:
    """Return what becomes of a posture seen three times, then with other wrists."""
    posture = postures_of(1, seed=5)[0]
    model.start()
    found = []
    for k in range(3 + len(wrists)):
        reliability, seen = np.ones(len(KINECT_V1)), posture.copy()
        if k >= 3:
            reliability[WRIST], seen[WRIST] = rate, wrists[k - 3]
        found.append(model.step(Observation(seen, reliability, reliability)).positions)
    return np.array(found)


def test_where_the_sensor_guessed_an_unreliable_joint_does_not_matter(
    fitted: LocalGP,
) -> None:
    model = fitted.adjusted(likelihood="density", carry=0.7, spared=1.0)
    one, other = np.random.default_rng(1).normal(0.0, 0.5, (2, 4, 3))
    np.testing.assert_array_equal(
        _doubted(model, one, 0.0), _doubted(model, other, 0.0)
    )
    missing = _doubted(model, np.full((4, 3), np.nan), 0.0)
    np.testing.assert_allclose(missing, _doubted(model, one, 0.0), atol=1e-12)
    assert np.ptp(missing[2:, WRIST], axis=0).max() < 0.01  # it stays where it was
    as_measured = model.adjusted(inputs="measured")
    assert (
        np.abs(_doubted(as_measured, one, 0.0)[3:, WRIST] - missing[3:, WRIST]).max()
        > 0.1
    )


def test_what_is_reliable_is_taken_from_where_it_was_measured(
    fitted: LocalGP,
) -> None:
    wrists = postures_of(4, seed=8)[:, WRIST]
    held, measured = (
        _doubted(fitted.adjusted(inputs=inputs), wrists, 0.96)
        for inputs in ("held", "measured")
    )
    np.testing.assert_allclose(held, measured, atol=1e-12)


def test_a_joint_is_not_doubted_because_its_neighbor_is_missing(
    fitted: LocalGP,
) -> None:
    """Its bone's missing end is scored as a wrong length."""
    postures = postures_of(2, seed=8)
    postures[1, WRIST] = np.nan
    model = fitted.adjusted(temporal=0.0)

    def elbow(rate: float) -> Array:
        model.start()
        for k, posture in enumerate(postures):
            reliability = np.ones(len(KINECT_V1))
            reliability[ELBOW] = rate if k else 1.0
            found = model.step(Observation(posture, reliability, reliability))
        return found.positions[ELBOW] - postures[1, ELBOW]

    assert np.linalg.norm(elbow(0.66) - elbow(1.0)) < 1e-3
    assert np.linalg.norm(elbow(0.0) - elbow(1.0)) > 1e-2
