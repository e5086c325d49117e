"""Every correction against marker mocap, on people or repetitions not learned from."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from kinefilter.pipeline.lab.evaluate import evaluate
from kinefilter.pipeline.pairs import PairedTake
from kinefilter.pipeline.progress import Progress, silent
from kinefilter.pipeline.workers import workers

from .recordings import people, person
from .study import Cell, Panel, Series, Study

_METHODS = (
    *("butterworth", "savgol", "one-euro", "kalman", "low-rank", "local-pca"),
    *("default", "exemplar", "full-gp", "local-gp", "clustered-gp", "best"),
)
_ERRORS = ("E", "E_std", "E_var")
_Each = dict[str, dict[str, dict[str, float]]]  # method, person, error [cm]


class _Clips(NamedTuple):
    """Whose clips there are, and how many of them."""

    data: Path | None
    names: Sequence[str]
    seed: int
    movements: int

    def read(self, names: Sequence[str]) -> list[PairedTake]:
        """Return the clips of some of the people."""
        found: list[PairedTake] = []
        for name in names:
            found += person(self.data, name, self.seed, self.movements)
        return found


def methods_new_people(
    *,
    seed: int = 0,
    count: int = 1000,
    movements: int = 10,
    data: Path | None = None,
    progress: Progress = silent,
) -> Study:
    """Test every method on each person, and let it learn from all the others.

    As ``kinefilter evaluate --train PEOPLE --ablation --mocap-database``: ``local-pca``
    searches the mocap of the others. Errors are means over frames and joints, then over
    people. Without recordings simulated people stand in.

    Args:
        seed: Draws simulated people, performances and the sensor's errors.
        count: How many people at most.
        movements: How many of the movements, from the first.
        data: Folder of recordings; None: simulated.
        progress: Wraps the loops, for a progress bar.
    """
    clips = _Clips(data, people(data)[:count], seed, movements)
    each = _side_by_side(partial(_new_person, clips), clips.names, progress)
    title = "Methods on people whom they did not learn from"
    return _study("methods-new-people", title, each)


def methods_known_people(
    *,
    seed: int = 0,
    count: int = 1000,
    movements: int = 10,
    data: Path | None = None,
    progress: Progress = silent,
) -> Study:
    """Test every method on new repetitions of the people whom it learned from.

    As ``kinefilter evaluate --train PEOPLE --ablation --protocol repetitions``: the
    repetitions 1 to 7 teach, 8 to 10 test; ``local-pca`` searches the built-in
    database. Otherwise like ``methods_new_people``.

    Args:
        seed: Draws simulated people, performances and the sensor's errors.
        count: How many people at most.
        movements: How many of the movements, from the first.
        data: Folder of recordings; None: simulated.
        progress: Wraps the loops, for a progress bar.
    """
    clips = _Clips(data, people(data)[:count], seed, movements)
    figures = evaluate(
        clips.read(clips.names),
        [],
        _METHODS,
        protocol="repetitions",
        ablation=True,
        progress=progress,
    )
    title = "Methods on new repetitions of the people whom they learned from"
    return _study("methods-known-people", title, _each(figures))


def untrained(
    *,
    seed: int = 0,
    count: int = 1000,
    movements: int = 10,
    data: Path | None = None,
    progress: Progress = silent,
) -> Study:
    """Test what ``clean`` does by itself, physics included, on everybody.

    As ``kinefilter evaluate --test PEOPLE --methods none,default --physics``. The worst
    person is the one whose error changes for the worse most, or falls least. No model
    was trained on recordings; the virtual Kinect that the embedded offsets were learned
    from was fitted to some of these people.

    Args:
        seed: Draws simulated people, performances and the sensor's errors.
        count: How many people at most.
        movements: How many of the movements, from the first.
        data: Folder of recordings; None: simulated.
        progress: Wraps the loops, for a progress bar.
    """
    clips = _Clips(data, people(data)[:count], seed, movements)
    each = _side_by_side(partial(_untrained, clips), clips.names, progress)
    title = "The default, with no model trained on recordings, physics included"
    return _study("untrained", title, each)


def _new_person(clips: _Clips, name: str) -> _Each:
    others = [other for other in clips.names if other != name]
    train, test = clips.read(others), clips.read([name])
    return _each(evaluate(train, test, _METHODS, ablation=True, database="mocap"))


def _untrained(clips: _Clips, name: str) -> _Each:
    test = clips.read([name])
    return _each(evaluate([], test, ("none", "default"), physics=True))


def _each(figures: dict[str, Any]) -> _Each:
    """Return the errors of every method on every person."""
    return {
        method: {
            name: {key: float(errors[key]) for key in _ERRORS}
            for name, errors in found["people"].items()
        }
        for method, found in figures["methods"].items()
    }


def _side_by_side(
    run: Callable[[str], _Each], names: Sequence[str], progress: Progress
) -> _Each:
    """Run for every person on all cores, and put what comes together."""
    merged: _Each = {}
    with workers() as pool:
        parts = pool.map(run, names)
        for _ in progress("people", len(names)):
            for method, each in next(parts).items():
                merged.setdefault(method, {}).update(each)
    return merged


def _study(name: str, title: str, each: _Each) -> Study:
    """Return errors, their change against raw, and that of the person it fits least."""
    raw = each["raw"]
    rows: list[tuple[Cell, ...]] = []
    for method, found in each.items():
        changes = [
            100.0 * (_mean(found, key) / _mean(raw, key) - 1.0) for key in _ERRORS
        ]
        worst = [
            max(100.0 * (found[p][key] / raw[p][key] - 1.0) for p in found)
            for key in _ERRORS
        ]
        errors = [_mean(found, key) for key in _ERRORS]
        rows.append((method, *errors, *changes, *worst))
    series = tuple(
        Series(key, list(each), [_mean(found, key) for found in each.values()], "bars")
        for key in _ERRORS
    )
    return Study(
        name=name,
        title=f"{title}: {len(raw)} people",
        columns=(
            "method",
            *(f"{key}_cm" for key in _ERRORS),
            *(f"{key}_change_percent" for key in _ERRORS),
            *(f"{key}_worst_person_percent" for key in _ERRORS),
        ),
        rows=tuple(rows),
        panels=(Panel("method", "error, cm", series),),
    )


def _mean(found: dict[str, dict[str, float]], key: str) -> float:
    """Return an error's mean over people [cm]."""
    return float(np.mean([errors[key] for errors in found.values()]))
