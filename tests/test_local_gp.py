"""Offsets learned per joint: local mixture, full process, exemplars."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import minimize
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel
from sklearn.linear_model import Ridge

from kinefilter.characters import KINECT_V1, KINECT_V2, InputError, standard_body
from kinefilter.pipeline.accuracy import Accuracy
from kinefilter.pipeline.correct import Correction, Observation
from kinefilter.pipeline.correct import gaussian_process as shared
from kinefilter.pipeline.correct import local_models as module
from kinefilter.pipeline.correct.exemplar import Exemplar
from kinefilter.pipeline.correct.full_gp import FullGP, JointFeatures
from kinefilter.pipeline.correct.local_gp import LocalGP, least_energy
from kinefilter.pipeline.correct.local_models import LinearTrend
from kinefilter.pipeline.training import TrainingSet, read_pairs, training_set

Array = NDArray[np.float64]
Method = LocalGP | FullGP | Exemplar

DATA = Path(__file__).parents[1].parent / "shared" / "data" / "ui-prmd"
ONES = np.ones(len(KINECT_V1))
WRIST, ELBOW = KINECT_V1.index("WristLeft"), KINECT_V1.index("ElbowLeft")
SPINE = KINECT_V1.index("Spine")
BIAS = np.array([0.03, -0.05, 0.02])


def _postures(count: int, seed: int) -> Array:
    """Return postures on the standard body that vary along three directions."""
    rest = standard_body(KINECT_V1).rest_positions
    directions = np.random.default_rng(99).normal(0.0, 0.1, (3, *rest.shape))
    latent = np.random.default_rng(seed).uniform(-1.0, 1.0, (count, 3))
    postures = rest - rest[KINECT_V1.root] + np.tensordot(latent, directions, axes=1)
    postures[:, KINECT_V1.root] = 0.0
    return np.asarray(postures)


def _lessons(
    offset: Callable[[Array], Array], count: int = 320, seed: int = 0
) -> TrainingSet:
    """Return postures whose left wrist is off; mocap has no spine."""
    seen = _postures(count, seed)
    truth = seen.copy()
    truth[:, WRIST] += offset(seen)
    truth[:, SPINE] = np.nan
    rate = np.ones(seen.shape[:2])
    first = np.zeros(count, dtype=bool)
    first[0] = True
    return TrainingSet(seen, rate, truth, first, KINECT_V1, "imagined")


def _bent(seen: Array) -> Array:
    return BIAS * np.sin(6.0 * seen[:, WRIST, :1])


def _constant(seen: Array) -> Array:
    return np.tile(BIAS, (len(seen), 1))


def _local(**settings: Any) -> LocalGP:
    return LocalGP(KINECT_V1, **{"clusters": 6, "samples": 30, **settings})


METHODS: dict[str, Callable[[], Method]] = {
    "local": _local,
    "full": lambda: FullGP(KINECT_V1, samples=300),
    "exemplar": lambda: Exemplar(KINECT_V1, samples=500, neighbors=5),
}


@pytest.fixture(scope="module")
def fitted() -> dict[str, Method]:
    return {name: make().fit(_lessons(_bent)) for name, make in METHODS.items()}


def _correct(model: Method, postures: Array, rate: Array = ONES) -> list[Correction]:
    model.start()
    return [
        model.step(Observation(posture, rate, rate, k / 30.0))
        for k, posture in enumerate(postures)
    ]


def _moves(model: Method, postures: Array) -> Array:
    """Return by how much joints move, each posture by itself, (N, J, 3)."""
    return np.array([_correct(model, p[None])[0].positions - p for p in postures])


def _copy(model: Method) -> Method:
    return type(model).from_arrays(KINECT_V1, model.arrays())


def test_one_local_model_is_the_process_of_scikit_learn() -> None:
    model = LocalGP(KINECT_V1, clusters=1, samples=120, redundancy=0.0)
    model.fit(_lessons(_bent, count=120))
    assert model.counts_.min() == 120
    features = JointFeatures(KINECT_V1, model.joints_, model.seen_)
    queries = features(_postures(20, seed=5))
    compared = 0
    for m, joint in enumerate(model.joints_):
        if joint not in (WRIST, ELBOW):
            continue
        size = features.sizes[m]
        theta0, theta1, noise, *roots = model.kernels_.table[m, : 3 + size]
        same = (
            ConstantKernel(theta0) * RBF(1.0 / np.array(roots))
            + ConstantKernel(theta1)
            + WhiteKernel(noise)
        )
        other = GaussianProcessRegressor(same, optimizer=None, alpha=0.0)
        other.fit(model.features_[m, 0, :, :size], model.offsets_[m, 0])
        means, deviations = other.predict(queries[:, m, :size], return_std=True)
        for k, query in enumerate(queries):
            mean, variance = model._models.predict(query * model.kernels_.roots, 9)
            np.testing.assert_allclose(mean[m], means[k], atol=1e-6)
            np.testing.assert_allclose(
                variance[m], deviations[k] ** 2, rtol=1e-6, atol=1e-9
            )
            compared += 1
    assert compared == 40


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
    fitted: dict[str, Method],
) -> None:
    model = _copy(fitted["local"])
    assert isinstance(model, LocalGP)
    model.temporal = model.reliability = 0.0
    posture = _postures(1, seed=5)[0]
    features = model._features(posture)
    mean, _ = model._models.predict(features * model.kernels_.roots, model.blended)
    moved = _correct(model, posture[None])[0].positions - posture
    expected = model.trend_(features) + mean
    np.testing.assert_allclose(moved[model.joints_], expected, atol=1e-12)


def test_the_temporal_term_calms_what_jumps(fitted: dict[str, Method]) -> None:
    shaken = _postures(1, seed=5) + 0.02 * np.random.default_rng(0).normal(
        size=(60, len(KINECT_V1), 3)
    )
    shaken[:, KINECT_V1.root] = 0.0

    def jumps(model: LocalGP) -> float:
        path = np.array([c.positions[WRIST] for c in _correct(model, shaken)])
        return float(np.linalg.norm(np.diff(path, n=2, axis=0), axis=1).mean())

    model = _copy(fitted["local"])
    assert isinstance(model, LocalGP)
    model.temporal = 50.0
    steady = jumps(model)
    model.temporal = 0.0
    assert steady < 0.8 * jumps(model)


@pytest.mark.parametrize("name", METHODS)
def test_no_offset_is_learned_from_none(name: str) -> None:
    model = METHODS[name]().fit(_lessons(lambda seen: np.zeros((len(seen), 3))))
    assert not _moves(model, _postures(5, seed=7)).any()


@pytest.mark.parametrize("name", METHODS)
def test_a_constant_offset_is_learned(name: str) -> None:
    moves = _moves(METHODS[name]().fit(_lessons(_constant)), _postures(20, seed=7))
    share = {"exemplar": 0.75}.get(name, 0.97)
    assert np.all(moves[:, WRIST] / BIAS > share)
    assert np.all(moves[:, WRIST] / BIAS < 1.02)
    others = np.delete(np.arange(len(KINECT_V1)), WRIST)
    assert np.abs(moves[:, others]).max() < 1e-6


@pytest.mark.parametrize("name", METHODS)
def test_offsets_follow_the_posture(name: str, fitted: dict[str, Method]) -> None:
    postures = _postures(60, seed=7)
    left = _moves(fitted[name], postures)[:, WRIST] - _bent(postures)
    ratio = np.linalg.norm(left, axis=1).mean()
    ratio /= np.linalg.norm(_bent(postures), axis=1).mean()
    assert ratio < {"exemplar": 0.5}.get(name, 0.2)


@pytest.mark.parametrize("name", METHODS)
def test_a_joint_that_mocap_lacks_is_not_moved(
    name: str, fitted: dict[str, Method]
) -> None:
    assert SPINE not in fitted[name].joints_
    assert not _moves(fitted[name], _postures(5, seed=7))[:, SPINE].any()


@pytest.mark.parametrize("name", METHODS)
def test_coverage_is_high_on_training_postures_and_none_far_away(
    name: str, fitted: dict[str, Method]
) -> None:
    near = _correct(fitted[name], _postures(20, seed=0))
    assert np.mean([c.coverage for c in near]) > 0.7
    assert all(0.0 <= c.coverage <= 1.0 for c in near)
    far = _correct(fitted[name], 30.0 * _postures(1, seed=0))
    # A joint at the root has features that are the same everywhere.
    assert far[0].coverage < 0.1


@pytest.mark.parametrize("name", METHODS)
def test_missing_joints_hang_on_their_corrected_parents(
    name: str, fitted: dict[str, Method]
) -> None:
    first, second = _postures(2, seed=7)
    second[[WRIST, WRIST + 1]] = np.nan
    before, after = _correct(fitted[name], np.stack([first, second]))
    assert np.isfinite(after.positions).all()
    assert after.trust[WRIST] == 0.0
    assert np.all(np.delete(after.trust, [WRIST, WRIST + 1]) == 0.9)
    bone = after.positions[WRIST] - after.positions[ELBOW]
    np.testing.assert_allclose(bone, first[WRIST] - first[ELBOW], atol=1e-3)
    everything = np.full_like(first, np.nan)
    assert np.isfinite(_correct(fitted[name], everything[None])[0].positions).all()
    assert before.rotations is None


@pytest.mark.parametrize("name", METHODS)
def test_the_arrays_bring_the_same_corrections_back(
    name: str, fitted: dict[str, Method]
) -> None:
    model = fitted[name]
    again = _copy(model)
    postures = _postures(10, seed=8)
    pairs = zip(_correct(model, postures), _correct(again, postures), strict=True)
    for one, two in pairs:
        np.testing.assert_array_equal(one.positions, two.positions)
        assert one.coverage == two.coverage
    for key, array in again.arrays().items():
        np.testing.assert_array_equal(array, model.arrays()[key])


@pytest.mark.parametrize("name", METHODS)
def test_the_seed_decides_everything(name: str, fitted: dict[str, Method]) -> None:
    twin = METHODS[name]().fit(_lessons(_bent)).arrays()
    for key, array in fitted[name].arrays().items():
        np.testing.assert_array_equal(twin[key], array)


@pytest.mark.parametrize("name", METHODS)
def test_too_few_pairs_and_other_skeletons_are_refused(name: str) -> None:
    with pytest.raises(InputError, match="too few"):
        METHODS[name]().fit(_lessons(_bent, count=60))
    lessons = _lessons(_bent)
    foreign = TrainingSet(
        lessons.positions,
        lessons.rate,
        lessons.truth,
        lessons.first,
        KINECT_V2,
        "another sensor",
    )
    with pytest.raises(InputError, match="another sensor: pairs of kinect_v2"):
        METHODS[name]().fit(foreign)


def test_a_joint_the_sensor_never_measures_tells_nothing() -> None:
    lessons = _lessons(_bent)
    hand = KINECT_V1.index("HandLeft")
    lessons.positions[:, hand] = np.nan
    model = _local().fit(lessons)
    waving, still = _postures(1, seed=5)[0], _postures(1, seed=5)[0]
    waving[hand] += 0.3
    moved = [_correct(model, p[None])[0].positions[WRIST] for p in (waving, still)]
    np.testing.assert_array_equal(*moved)


@pytest.mark.filterwarnings("ignore:Number of distinct clusters")
def test_a_joint_that_never_moves_is_learned_too() -> None:
    lessons = _lessons(_constant, count=150)
    lessons.positions[:] = lessons.positions[0]
    lessons.truth[:] = lessons.truth[0]
    model = _local(clusters=3).fit(lessons)
    moved = _correct(model, lessons.positions[:1])[0].positions - lessons.positions[0]
    np.testing.assert_allclose(
        moved[WRIST], lessons.truth[0, WRIST] - lessons.positions[0, WRIST], rtol=0.1
    )


@pytest.fixture(scope="module")
def adapting() -> LocalGP:
    return _local(adapt=True, redundancy=0.3).fit(_lessons(_bent))


def test_nothing_is_learned_online_unless_asked_for(fitted: dict[str, Method]) -> None:
    model = fitted["local"]
    assert isinstance(model, LocalGP)
    before = {key: array.copy() for key, array in model.arrays().items()}
    counts = model._models.counts.copy()
    _correct(model, _postures(40, seed=9))
    np.testing.assert_array_equal(model._models.counts, counts)
    for key, array in model.arrays().items():
        np.testing.assert_array_equal(array, before[key])


def test_adapting_learns_reliable_joints_only(adapting: LocalGP) -> None:
    rate = ONES.copy()
    rate[[WRIST, ELBOW]] = 0.89
    counts = adapting.counts_.sum(axis=1)
    _correct(adapting, _postures(80, seed=9), rate)
    gained = adapting._models.counts.sum(axis=1) - counts
    unreliable = np.isin(adapting.joints_, [WRIST, ELBOW])
    assert not gained[unreliable].any()
    _correct(adapting, _postures(80, seed=9))
    gained = adapting._models.counts.sum(axis=1) - counts
    assert gained[adapting.joints_ == WRIST] > 0


def test_what_was_learned_online_is_forgotten_with_the_frames(
    adapting: LocalGP,
) -> None:
    postures = _postures(60, seed=9)
    once, twice = (_correct(adapting, postures) for _ in range(2))
    for one, two in zip(once, twice, strict=True):
        np.testing.assert_array_equal(one.positions, two.positions)


def test_learning_online_factorizes_nothing_again(
    adapting: LocalGP, monkeypatch: pytest.MonkeyPatch
) -> None:
    adapting.start()
    before = adapting._models.counts.sum()

    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("a factorization or inverse from scratch")

    for place in (module, shared):
        monkeypatch.setattr(place, "cholesky", refuse)
    monkeypatch.setattr(np.linalg, "inv", refuse)
    postures = _postures(80, seed=9)
    for posture in postures:
        adapting.step(Observation(posture, ONES, ONES))
    assert adapting._models.counts.sum() > before


def test_a_grown_local_model_is_the_one_learned_at_once(adapting: LocalGP) -> None:
    adapting.start()
    models, m = adapting._models, int(np.flatnonzero(adapting.joints_ == WRIST)[0])
    kernel = adapting.kernels_.of_joint(m)
    x = models.centers[m, 0] + 0.1
    n = int(models.counts[m, 0])
    models.learn(m, x, BIAS, np.inf)
    assert models.counts[m].sum() == adapting.counts_[m].sum() + 1
    q = int(
        np.argmax(models.counts[m, : adapting.counts_.shape[1]] - adapting.counts_[m])
    )
    n = int(adapting.counts_[m, q])
    roots = adapting.kernels_.roots[m]
    rows = np.vstack([adapting.features_[m, q, :n] * roots, x])
    factor = models.factors[m, q, : n + 1, : n + 1]
    np.testing.assert_allclose(factor.T @ factor, kernel.of_samples(rows), atol=1e-9)


def test_a_posture_like_no_center_begins_a_local_model(adapting: LocalGP) -> None:
    adapting.start()
    models, m = adapting._models, int(np.flatnonzero(adapting.joints_ == WRIST)[0])
    known = adapting.counts_.shape[1]
    x = np.full(models.centers.shape[2], 50.0) * (adapting.kernels_.roots[m] > 0)
    models.learn(m, x, BIAS, float(adapting.reach_[m]))
    assert models.counts[m, known] == 1
    np.testing.assert_array_equal(models.centers[m, known], x)
    queries = np.zeros_like(models.centers[:, 0])
    queries[m] = x
    mean, _ = models.predict(queries, 9)
    assert np.all(mean[m] / BIAS > 0.5)


def _real(keep: Callable[[int], bool]) -> TrainingSet:
    pairs = [
        pair
        for pair in read_pairs(DATA / "s02.npz")
        if pair.clip[:3] in ("m01", "m07")
        and "_inc" not in pair.clip
        and keep(int(pair.clip[9:11]))
    ]
    return training_set(pairs)


@pytest.mark.skipif(not DATA.is_dir(), reason="paired recordings are not here")
def test_known_people_are_corrected_on_real_recordings() -> None:
    train, test = _real(lambda e: e <= 7), _real(lambda e: e > 7)
    accuracy = Accuracy(KINECT_V1)
    raw = np.nanmean(accuracy.standardized(test.positions, test.truth))
    for make in (
        lambda: LocalGP(KINECT_V1, clusters=8),
        lambda: FullGP(KINECT_V1, samples=400),
        lambda: Exemplar(KINECT_V1, samples=2000),
    ):
        found = np.empty_like(test.positions)
        model = make().fit(train)
        for k, (posture, rate) in enumerate(
            zip(test.positions, test.rate, strict=True)
        ):
            if test.first[k]:
                model.start()
            found[k] = model.step(Observation(posture, rate, rate, k / 30)).positions
        assert np.nanmean(accuracy.standardized(found, test.truth)) < 0.6 * raw
