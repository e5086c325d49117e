"""The reliability of whole takes: frame by frame, simulated and recorded."""

from __future__ import annotations

import numpy as np
import pytest
from real_data import TAKES, recorded
from scored_takes import Array, average, blind, score
from skeletons import every_skeleton

from kinefilter.characters import Skeleton, State, Take, Term
from kinefilter.pipeline.formats import read_take
from kinefilter.pipeline.reliability import ReliabilityScorer, measure_reference
from kinefilter.scenes.sensor import sample_take


@every_skeleton
def test_rates_stay_in_zero_to_one_whatever_happens(skeleton: Skeleton) -> None:
    rng = np.random.default_rng(0)
    shape = (200, len(skeleton))
    positions = rng.normal(size=(*shape, 3)) * rng.choice([0.01, 1.0, 1e6], (*shape, 1))
    positions[rng.random(shape) < 0.2] = np.nan
    state = rng.integers(0, 3, shape).astype(np.uint8)
    take = Take(np.arange(200) / 30.0, positions, state, skeleton)
    for reference in (average(skeleton), blind(skeleton)):
        result = score(take, reference)
        for values in (result.reliability, result.geometry):
            assert (values >= 0.0).all()
            assert (values <= 1.0 + 1e-12).all()
        assert (result.reliability <= result.geometry + 1e-12).all()
        assert np.isin(result.term, [0, 1, 2]).all()


def assert_frames_equal_the_whole(take: Take) -> None:
    reference = measure_reference(take)
    whole = ReliabilityScorer(take.skeleton, reference).score(take)
    scorer = ReliabilityScorer(take.skeleton, reference)
    for k in range(len(take)):
        reliability, term, geometry = scorer.step(take.positions[k], take.state[k])
        np.testing.assert_array_equal(reliability, whole.reliability[k])
        np.testing.assert_array_equal(term, whole.term[k])
        np.testing.assert_array_equal(geometry, whole.geometry[k])
    again = scorer.score(take)
    np.testing.assert_array_equal(again.reliability, whole.reliability)


def test_frame_by_frame_equals_the_whole_take_bit_for_bit() -> None:
    assert_frames_equal_the_whole(sample_take())


def test_a_take_with_errors_scores_low_where_they_are() -> None:
    take = sample_take()
    result = score(take, measure_reference(take))
    tracked = take.state == State.TRACKED
    assert (~tracked).mean() > 0.05
    assert np.median(result.reliability[tracked]) > 0.85
    assert (
        result.reliability[~tracked].mean() < 0.5 * result.reliability[tracked].mean()
    )


@recorded
@pytest.mark.parametrize("name", ["labanotation/joints.csv", "precog16/Seq1_1.csv.gz"])
def test_recorded_takes_score_alike_frame_by_frame(name: str) -> None:
    assert_frames_equal_the_whole(read_take(TAKES / name))


@recorded
def test_inferred_joints_of_a_recorded_take_are_not_trusted() -> None:
    take = read_take(TAKES / "labanotation" / "joints.csv")
    reference = measure_reference(take)
    assert (reference.lengths[take.skeleton.segments] > 0.0).all()
    result = score(take, reference)
    tracked = take.state == State.TRACKED
    longer = np.array([tracked[max(k - 5, 0) : k + 1].all(0) for k in range(len(take))])
    assert np.median(result.reliability[longer]) > 0.85
    lost = np.array([~tracked[max(k - 5, 0) : k + 1].any(0) for k in range(len(take))])
    assert lost.any()
    np.testing.assert_allclose(result.reliability[lost], 0.0, atol=1e-12)
    assert (result.term[~tracked] != Term.BEHAVIOR).mean() > 0.9


@recorded
def test_a_failure_of_the_tracker_scores_under_a_good_take() -> None:
    worst: dict[bool, list[float]] = {False: [], True: []}
    for path in sorted((TAKES / "ui-prmd").glob("*.csv")):
        rates = lowest_rates(read_take(path))
        worst["_failure" in path.name].append(float(rates.mean()))
    assert worst[True]
    assert np.mean(worst[True]) < np.mean(worst[False])


def lowest_rates(take: Take) -> Array:
    """Return each frame's worst reliability among the joints that the take has."""
    reliability = score(take, measure_reference(take)).reliability
    present = ~np.isnan(take.positions[..., 0]).all(axis=0)
    return np.asarray(reliability[:, present].min(axis=1))
