"""Correctors of users' own: what they return is checked, and they can be measured."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from batch_takes import short_take

from kinefilter import CleanConfig, Cleaner, evaluate
from kinefilter.characters import InputError, standard_body
from kinefilter.pipeline.correct import (
    Correction,
    Corrector,
    CorrectorChain,
    Hold,
    Observation,
)
from kinefilter.pipeline.lab.simulation import simulate

QUICK = CleanConfig(physics=False)
J = 20  # of Kinect v1


class Own(Corrector):
    """A method that changes the result of ``Hold``."""

    def __init__(self, skeleton: Any, change: Callable[[Correction], Any]) -> None:
        self._hold, self._change = Hold(skeleton), change

    def start(self) -> None:
        """Reset the state for a new motion."""
        self._hold.start()

    def step(self, observation: Observation) -> Any:
        """Change the next frame."""
        return self._change(self._hold.step(observation))


class OwnWhole(Own):
    """The same for whole takes."""

    def whole(self, take: Observation, frames: Any = None) -> Any:
        """Change a take."""
        return self._change(self._hold.whole(take, frames))


WRONG: dict[str, Callable[[Correction], Any]] = {
    "must be a Correction, got None": lambda _: None,
    "must be a Correction, got array": lambda found: found.positions,
    "positions has shape": lambda found: replace(found, positions=np.zeros((J + 1, 3))),
    "positions is 'x', expected": lambda found: replace(found, positions="x"),
    "confidence has shape": lambda found: replace(found, confidence=1.0),
    "confidence has NaN": lambda found: replace(
        found, confidence=found.confidence * np.nan
    ),
    "coverage has shape": lambda found: replace(found, coverage=found.positions),
}


@pytest.mark.parametrize("told", WRONG)
@pytest.mark.parametrize("kind", [Own, OwnWhole])
def test_a_correction_that_does_not_fit_is_refused_by_its_name(
    kind: type[Own], told: str
) -> None:
    take = short_take(40)
    cleaner = Cleaner(QUICK, corrector=kind(take.skeleton, WRONG[told]))
    named = f"the correction by {kind.__name__}.* {told}|{kind.__name__}: {told}"
    with pytest.raises(InputError, match=named):
        cleaner.clean(take)
    cleaner.start(standard_body(take.skeleton))
    with pytest.raises(InputError, match=named):
        cleaner.step(take.positions[0], 0.0)


@pytest.mark.parametrize("first", [True, False])
@pytest.mark.parametrize("kind", [Own, OwnWhole])
def test_in_a_chain_the_one_that_does_not_fit_is_named(
    kind: type[Own], first: bool
) -> None:
    take, told = short_take(40), "positions has shape"
    own, hold = kind(take.skeleton, WRONG[told]), Hold(take.skeleton)
    chain = CorrectorChain(*((own, hold) if first else (hold, own)))
    cleaner = Cleaner(QUICK, corrector=chain)
    cleaner.start(standard_body(take.skeleton))
    with pytest.raises(InputError, match=f"the correction by {kind.__name__}: {told}"):
        cleaner.step(take.positions[0], 0.0)
    with pytest.raises(InputError, match=f"the correction by {kind.__name__}: {told}"):
        cleaner.clean(take)


def test_joints_that_were_seen_must_be_numbers_and_live_all() -> None:
    take, joint = short_take(40), 3
    positions, state = take.positions.copy(), take.state.copy()
    positions[:, joint], state[:, joint] = np.nan, 0
    hidden = replace(take, positions=positions, state=state)

    def hole(found: Correction) -> Correction:
        positions = found.positions.copy()
        positions[..., joint, :] = np.nan
        return replace(found, positions=positions)

    config = replace(QUICK, reconstruct=False)
    for kind in (Own, OwnWhole):
        cleaner = Cleaner(config, corrector=kind(take.skeleton, hole))
        assert np.isfinite(cleaner.clean(hidden).clip.positions).all()
        with pytest.raises(InputError, match=f"{kind.__name__}: positions has NaN"):
            cleaner.clean(take)
        cleaner.start(standard_body(take.skeleton))
        with pytest.raises(InputError, match=f"{kind.__name__}: positions has NaN"):
            cleaner.step(positions[0], 0.0)


def test_lists_of_numbers_are_a_correction() -> None:
    take = short_take(40)

    def listed(found: Correction) -> Any:
        return replace(found, positions=found.positions.tolist(), confidence=[1.0] * J)

    cleaner = Cleaner(QUICK, corrector=Own(take.skeleton, listed))
    cleaner.start(standard_body(take.skeleton))
    frame = cleaner.step(take.positions[0], 0.0, take.state[0])
    assert np.isfinite(frame.positions).all()


def test_ones_own_correctors_are_measured_beside_methods() -> None:
    pair = simulate("basic", "wave", sensor="v1", seed=4)
    brief = replace(pair, take=pair.take.at(slice(45)), truth=pair.truth[:45])
    skeleton = pair.take.skeleton

    def larger(found: Correction) -> Correction:
        return replace(found, positions=1.1 * found.positions)

    same, other = Own(skeleton, lambda found: found), Own(skeleton, larger)
    methods = ["none", same, OwnWhole(skeleton, lambda found: found), other]
    figures = evaluate([], [brief], methods, physics=False)
    rows, areas = figures["methods"], figures["reliability_auc"]["shum"]
    for name in (*figures, *areas, *rows["none"]):  # help(evaluate) explains it
        assert f"``{name}``" in (evaluate.__doc__ or "")
    assert [*rows] == ["raw", "none", "Own 1", "OwnWhole", "Own 2"]
    assert rows["Own 1"]["E"] == pytest.approx(rows["none"]["E"], abs=0.1)
