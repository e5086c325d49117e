"""The local mixture learns from reliable frames while it corrects."""

from __future__ import annotations

import numpy as np
import pytest
from offset_lessons import (
    BIAS,
    ELBOW,
    ONES,
    WRIST,
    bent,
    corrected,
    lessons_of,
    local_gp,
    postures_of,
)

from kinefilter.pipeline.correct import Observation
from kinefilter.pipeline.lab.methods import gaussian_process as shared
from kinefilter.pipeline.lab.methods import local_models as module
from kinefilter.pipeline.lab.methods.local_gp import LocalGP
from kinefilter.pipeline.lab.methods.local_models import LocalModels

pytestmark = pytest.mark.usefixtures("few_for_kernels")


@pytest.fixture(scope="module")
def fitted() -> LocalGP:
    return local_gp().fit(lessons_of(bent))


@pytest.fixture(scope="module")
def adapting() -> LocalGP:
    return local_gp(adapt=True, redundancy=0.3).fit(lessons_of(bent))


@pytest.fixture(scope="module")
def small() -> LocalGP:
    """Return local models with room for few samples, of which some are full."""
    return local_gp(samples=12, redundancy=0.0).fit(lessons_of(bent))


def test_nothing_is_learned_online_unless_asked_for(fitted: LocalGP) -> None:
    before = {key: array.copy() for key, array in fitted.arrays().items()}
    counts = fitted._models.counts.copy()
    corrected(fitted, postures_of(40, seed=9))
    np.testing.assert_array_equal(fitted._models.counts, counts)
    for key, array in fitted.arrays().items():
        np.testing.assert_array_equal(array, before[key])


def test_adapting_learns_reliable_joints_only(adapting: LocalGP) -> None:
    reliability = ONES.copy()
    reliability[[WRIST, ELBOW]] = 0.89
    counts = adapting.counts_.sum(axis=1)
    corrected(adapting, postures_of(80, seed=9), reliability)
    gained = adapting._models.counts.sum(axis=1) - counts
    unreliable = np.isin(adapting.joints_, [WRIST, ELBOW])
    assert not gained[unreliable].any()
    corrected(adapting, postures_of(80, seed=9))
    gained = adapting._models.counts.sum(axis=1) - counts
    assert gained[adapting.joints_ == WRIST] > 0


def test_what_was_learned_online_is_forgotten_with_the_frames(
    adapting: LocalGP,
) -> None:
    postures = postures_of(60, seed=9)
    once, twice = (corrected(adapting, postures) for _ in range(2))
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
    postures = postures_of(80, seed=9)
    for posture in postures:
        adapting.step(Observation(posture, ONES, ONES))
    assert adapting._models.counts.sum() > before


def test_a_grown_local_model_is_the_one_learned_at_once(adapting: LocalGP) -> None:
    adapting.start()
    models, m = adapting._models, int(np.flatnonzero(adapting.joints_ == WRIST)[0])
    kernel = adapting.kernels.of_joint(m)
    x = models.centers[m, 0] + 0.1
    n = int(models.counts[m, 0])
    models.learn(m, x, BIAS, np.inf)
    assert models.counts[m].sum() == adapting.counts_[m].sum() + 1
    q = int(
        np.argmax(models.counts[m, : adapting.counts_.shape[1]] - adapting.counts_[m])
    )
    n = int(adapting.counts_[m, q])
    roots = adapting.kernels.roots[m]
    rows = np.vstack([adapting.features_[m, q, :n] * roots, x])
    factor = models.factors[m, q, : n + 1, : n + 1]
    np.testing.assert_allclose(factor.T @ factor, kernel.of_samples(rows), atol=1e-9)


def test_a_posture_like_no_center_begins_a_local_model(adapting: LocalGP) -> None:
    adapting.start()
    models, m = adapting._models, int(np.flatnonzero(adapting.joints_ == WRIST)[0])
    known = adapting.counts_.shape[1]
    x = np.full(models.centers.shape[2], 50.0) * (adapting.kernels.roots[m] > 0)
    models.learn(m, x, BIAS, float(adapting.reach_[m]))
    assert models.counts[m, known] == 1
    np.testing.assert_array_equal(models.centers[m, known], x)
    queries = np.zeros_like(models.centers[:, 0])
    queries[m] = x
    mean, _ = models.predict(queries, 9)
    assert np.all(mean[m] / BIAS > 0.5)


def _full(model: LocalGP, m: int) -> tuple[LocalModels, int]:
    """Return local models without room, and one of a joint that is full."""
    models = LocalModels(
        model.kernels,
        model.centers_,
        model.features_,
        model.offsets_,
        model.counts_,
        redundancy=0.01,
    )
    (q,) = np.flatnonzero(model.counts_[m] == model.features_.shape[2])[:1]
    return models, int(q)


def test_a_full_model_gives_up_the_sample_that_tells_least(small: LocalGP) -> None:
    model, m = small, int(np.flatnonzero(small.joints_ == WRIST)[0])
    models, q = _full(model, m)
    kernel, x = model.kernels.of_joint(m), models.centers[m, q] + 0.05
    before = np.vstack([model.features_[m, q] * model.kernels.roots[m], x])
    offsets = np.vstack([model.offsets_[m, q], BIAS])
    inverse = np.linalg.inv(kernel.of_samples(before))
    least = int(
        shared.divergence_of(
            1.0 / np.diag(inverse), inverse @ offsets, kernel.noise
        ).argmin()
    )
    assert least < len(before) - 1
    models.learn(m, x, BIAS, np.inf)
    kept = np.delete(before, least, axis=0)
    factor = models.factors[m, q]
    matrix = kernel.of_samples(kept)
    np.testing.assert_allclose(factor.T @ factor, matrix, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(
        models._inverse[m, q] @ matrix, np.eye(len(kept)), atol=1e-5
    )
    assert models.counts[m, q] == len(kept)


def test_a_full_model_still_learns_what_comes_again_and_keeps_its_size(
    small: LocalGP,
) -> None:
    m = int(np.flatnonzero(small.joints_ == WRIST)[0])
    models, q = _full(small, m)
    x = np.zeros_like(models.centers[:, 0])
    x[m] = models.centers[m, q] + 0.4
    new, size = models.predict(x, 1)[0][m] + BIAS, models.counts[m, q]
    off = [np.linalg.norm(new - models.predict(x, 1)[0][m])]
    for _ in range(4):
        models.learn(m, x[m], new, np.inf)
        off.append(np.linalg.norm(new - models.predict(x, 1)[0][m]))
        assert models.counts[m, q] == size
    assert np.all(np.diff(off) <= 1e-9)
    assert off[-1] < 0.2 * off[0]


def test_what_the_others_predict_is_not_learned(small: LocalGP) -> None:
    model, m = small, int(np.flatnonzero(small.joints_ == WRIST)[0])
    models, q = _full(model, m)
    again = model.features_[m, q, 0] * model.kernels.roots[m]
    rows = models._rows.copy()
    mean = model.offsets_[m, q, 0].astype(float)
    models.learn(m, again, mean, np.inf)
    np.testing.assert_array_equal(models._rows, rows)
