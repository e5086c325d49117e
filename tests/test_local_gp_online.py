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

pytestmark = pytest.mark.usefixtures("few_for_kernels")


@pytest.fixture(scope="module")
def fitted() -> LocalGP:
    return local_gp().fit(lessons_of(bent))


@pytest.fixture(scope="module")
def adapting() -> LocalGP:
    return local_gp(adapt=True, redundancy=0.3).fit(lessons_of(bent))


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
