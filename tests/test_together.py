"""Several people of one recording, cleaned in one scene."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kinefilter import CleanConfig, clean, read_take
from kinefilter.characters import Take
from kinefilter.characters.errors import InputError
from kinefilter.pipeline.clean_result import CleanResult
from kinefilter.pipeline.cleaner import Cleaner
from kinefilter.scenes import SAMPLE

CONFIG = CleanConfig("none", scene="box")


@pytest.fixture(scope="module")
def take() -> Take:
    return read_take(SAMPLE).at(slice(0, 75))


def _beside(take: Take, across: float) -> Take:
    return replace(take, positions=take.positions + np.array([across, 0.0, 0.0]))


def _together(*takes: Take) -> list[CleanResult]:
    found = [*Cleaner(CONFIG).clean_together(takes)]
    assert not any(isinstance(result, InputError) for result in found)
    return [result for result in found if isinstance(result, CleanResult)]


@pytest.fixture(scope="module")
def alone(take: Take) -> CleanResult:
    return clean(take, CONFIG)


def test_far_from_each_other_they_are_as_if_alone(
    take: Take, alone: CleanResult
) -> None:
    first, second = _together(take, _beside(take, 2.5).at(slice(20, 60)))
    np.testing.assert_allclose(first.clip.positions, alone.clip.positions, atol=1e-4)
    assert len(second.clip) == 40
    away = second.clip.positions[10:] - alone.clip.positions[30:60]
    np.testing.assert_allclose(away, np.array([2.5, 0.0, 0.0]) + 0.0 * away, atol=0.05)


def test_near_each_other_they_push(take: Take, alone: CleanResult) -> None:
    first, second = _together(take, _beside(take, 0.15))
    pushed = first.clip.positions - alone.clip.positions
    assert np.linalg.norm(pushed, axis=2).max() > 0.01
    apart = second.clip.positions - first.clip.positions
    assert np.abs(apart[..., 0]).mean() > 0.155


def test_they_share_the_props(take: Take) -> None:
    first, second = _together(take, _beside(take, 2.5))
    for one, other in zip(first.clip.props, second.clip.props, strict=True):
        np.testing.assert_array_equal(one.positions, other.positions)


def test_who_is_out_of_view_touches_nobody(take: Take, alone: CleanResult) -> None:
    first, _ = _together(take, _beside(take, 0.15).at(slice(0, 10)))
    seen = np.linalg.norm(first.clip.positions - alone.clip.positions, axis=2)
    assert seen[:10].max() > 0.01
    assert seen[40:].max() < 0.005


def test_a_take_that_cannot_be_cleaned_leaves_the_others(take: Take) -> None:
    nothing = replace(take, positions=np.full_like(take.positions, np.nan))
    found = [*Cleaner(CONFIG).clean_together([nothing, take])]
    assert isinstance(found[0], InputError)
    assert isinstance(found[1], CleanResult)


def test_without_a_scene_they_share_no_world(take: Take) -> None:
    config = CleanConfig("none")
    found = [*Cleaner(config).clean_together([take, _beside(take, 0.0)])]
    alone = clean(take, config)
    for result in found:
        assert isinstance(result, CleanResult)
        np.testing.assert_array_equal(result.clip.positions, alone.clip.positions)
