"""Offsets learned per joint: by local mixtures, full processes and exemplars."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from offset_lessons import (
    BIAS,
    ELBOW,
    SPINE,
    WRIST,
    Array,
    Method,
    bent,
    constant,
    copied,
    corrected,
    lessons_of,
    local_gp,
    moves_of,
    postures_of,
    recorded_lessons,
)
from real_data import paired

from kinefilter.characters import KINECT_V1, KINECT_V2, InputError
from kinefilter.pipeline.correct import Observation
from kinefilter.pipeline.lab.accuracy import Accuracy
from kinefilter.pipeline.lab.methods.baselines import Exemplar, FullGP
from kinefilter.pipeline.lab.methods.clustered_gp import ClusteredGP
from kinefilter.pipeline.lab.methods.local_gp import LocalGP

pytestmark = pytest.mark.usefixtures("few_for_kernels")

METHODS: dict[str, Callable[[], Method]] = {
    "local": local_gp,
    "full": lambda: FullGP(KINECT_V1, samples=300),
    "exemplar": lambda: Exemplar(KINECT_V1, samples=500, neighbors=5),
}
WITH_WHOLE_BODIES: dict[str, Callable[[], Method]] = {
    **METHODS,
    "clustered": lambda: ClusteredGP(KINECT_V1, centroids=60),
}


@pytest.fixture(scope="module")
def fitted() -> dict[str, Method]:
    made = WITH_WHOLE_BODIES.items()
    return {name: make().fit(lessons_of(bent)) for name, make in made}


@pytest.mark.parametrize("name", METHODS)
def test_no_offset_is_learned_from_none(name: str) -> None:
    def none(seen: Array) -> Array:
        return np.zeros((len(seen), 3))

    model = METHODS[name]().fit(lessons_of(none, count=120))
    assert not moves_of(model, postures_of(5, seed=7)).any()


@pytest.mark.parametrize("name", METHODS)
def test_a_constant_offset_is_learned(name: str) -> None:
    model = METHODS[name]().fit(lessons_of(constant, count=160))
    moves = moves_of(model, postures_of(20, seed=7))
    share = {"exemplar": 0.75}.get(name, 0.97)
    assert np.all(moves[:, WRIST] / BIAS > share)
    assert np.all(moves[:, WRIST] / BIAS < 1.02)
    others = np.delete(np.arange(len(KINECT_V1)), WRIST)
    assert np.abs(moves[:, others]).max() < 1e-6


@pytest.mark.parametrize("name", METHODS)
def test_offsets_follow_the_posture(name: str, fitted: dict[str, Method]) -> None:
    postures = postures_of(60, seed=7)
    left = moves_of(fitted[name], postures)[:, WRIST] - bent(postures)
    ratio = np.linalg.norm(left, axis=1).mean()
    ratio /= np.linalg.norm(bent(postures), axis=1).mean()
    assert ratio < {"exemplar": 0.5}.get(name, 0.2)


@pytest.mark.parametrize("name", METHODS)
def test_a_joint_that_mocap_lacks_is_not_moved(
    name: str, fitted: dict[str, Method]
) -> None:
    assert SPINE not in fitted[name].joints_
    assert not moves_of(fitted[name], postures_of(5, seed=7))[:, SPINE].any()


@pytest.mark.parametrize("name", METHODS)
def test_coverage_is_high_on_training_postures_and_none_far_away(
    name: str, fitted: dict[str, Method]
) -> None:
    near = corrected(fitted[name], postures_of(20, seed=0))
    assert np.mean([c.coverage for c in near]) > 0.7
    assert all(0.0 <= c.coverage <= 1.0 for c in near)
    far = corrected(fitted[name], 30.0 * postures_of(1, seed=0))
    # A joint at the root has features that are the same everywhere.
    assert far[0].coverage < 0.1


@pytest.mark.parametrize("name", METHODS)
def test_missing_joints_hang_on_their_corrected_parents(
    name: str, fitted: dict[str, Method]
) -> None:
    first, second = postures_of(2, seed=7)
    second[[WRIST, WRIST + 1]] = np.nan
    _, after = corrected(fitted[name], np.stack([first, second]))
    assert np.isfinite(after.positions).all()
    assert after.confidence[WRIST] == 0.0
    assert np.all(np.delete(after.confidence, [WRIST, WRIST + 1]) == 0.9)
    bone = after.positions[WRIST] - after.positions[ELBOW]
    held = first[WRIST] - first[ELBOW]
    if name in ("local", "full"):  # which predict an offset of it where it is held
        still = second.copy()
        still[WRIST] = second[ELBOW] + held
        still[WRIST + 1] = still[WRIST] + first[WRIST + 1] - first[WRIST]
        measured = corrected(fitted[name], np.stack([first, still]))[1]
        held = measured.positions[WRIST] - measured.positions[ELBOW]
        assert np.linalg.norm(held - (first[WRIST] - first[ELBOW])) > 0.01
    np.testing.assert_allclose(bone, held, atol=3e-3)
    everything = np.full_like(first, np.nan)
    assert np.isfinite(corrected(fitted[name], everything[None])[0].positions).all()


@pytest.mark.parametrize("name", WITH_WHOLE_BODIES)
def test_the_arrays_bring_the_same_corrections_back(
    name: str, fitted: dict[str, Method]
) -> None:
    model = fitted[name]
    again = copied(model)
    postures = postures_of(10, seed=8)
    pairs = zip(corrected(model, postures), corrected(again, postures), strict=True)
    for one, two in pairs:
        np.testing.assert_array_equal(one.positions, two.positions)
        assert one.coverage == two.coverage
    for key, array in again.arrays().items():
        np.testing.assert_array_equal(array, model.arrays()[key])


@pytest.mark.parametrize("name", WITH_WHOLE_BODIES)
def test_the_seed_decides_everything(name: str, fitted: dict[str, Method]) -> None:
    twin = WITH_WHOLE_BODIES[name]().fit(lessons_of(bent)).arrays()
    for key, array in fitted[name].arrays().items():
        np.testing.assert_array_equal(twin[key], array)


@pytest.mark.parametrize("name", METHODS)
def test_too_few_pairs_and_other_skeletons_are_refused(name: str) -> None:
    with pytest.raises(InputError, match="too few"):
        METHODS[name]().fit(lessons_of(bent, count=60))
    lessons = lessons_of(bent)
    foreign = replace(lessons, skeleton=KINECT_V2, source="another sensor")
    with pytest.raises(InputError, match="another sensor: pairs of kinect_v2"):
        METHODS[name]().fit(foreign)


@paired
def test_known_people_are_corrected_on_real_recordings() -> None:
    train = recorded_lessons(lambda repetition: repetition in (1, 4, 7))
    test = recorded_lessons(lambda repetition: repetition == 9)
    accuracy = Accuracy(KINECT_V1)
    raw = np.nanmean(accuracy.standardized(test.positions, test.truth))
    for method, share in (
        (LocalGP(KINECT_V1, clusters=8), 0.6),
        (FullGP(KINECT_V1, samples=400), 0.6),
        (Exemplar(KINECT_V1, samples=2000), 0.6),
        (ClusteredGP(KINECT_V1, centroids=300), 0.5),
    ):
        found = np.empty_like(test.positions)
        model = method.fit(train)
        for k, (posture, reliability) in enumerate(
            zip(test.positions, test.reliability, strict=True)
        ):
            if test.first[k]:
                model.start()
            found[k] = model.step(
                Observation(posture, reliability, reliability, k / 30)
            ).positions
        left = np.nanmean(accuracy.standardized(found, test.truth))
        assert left < share * raw, type(method).__name__
