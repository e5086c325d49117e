"""Wang et al., recovery of takes as matrices of low rank: table I and figure 1."""

from __future__ import annotations

from time import process_time

import numpy as np

from kinefilter.characters.arrays import Array
from kinefilter.pipeline.correct import Observation
from kinefilter.pipeline.lab.methods.low_rank import LowRank
from kinefilter.pipeline.lab.systems import systems_of
from kinefilter.pipeline.lab.training import observed
from kinefilter.pipeline.pairs import PairedTake

from .study import Cell, Options, Panel, Study, series_of
from .takes import clips_of, first_person, performed_by, recorded_people

_WANG_1 = {241: 0.6190, 463: 0.8001, 1245: 1.1470, 1423: 1.3740}
"""Seconds by frames."""
_RANK = 5  # of its dance, read off figure 1
_SMALL = 0.01
"""Share of the largest singular value under which others do not count. A guess: the
paper does not say what it counts."""


def wang_table_1(options: Options, *, sizes: int = 4) -> Study:
    """Time the recovery of takes of the paper's lengths, in seconds of one core.

    People dance one after the other, as recorded by a virtual Kinect v2; lengths are
    those of the paper's takes.
    """
    lengths = [*_WANG_1][:sizes]
    (system,), dances = (
        systems_of((), ["wang-low-rank"]),
        _dances(options, max(lengths)),
    )
    dance = np.concatenate([observed(pair, system.config).standard for pair in dances])
    rows: list[tuple[Cell, ...]] = []
    for count in lengths:
        skeleton = dances[0].take.skeleton
        method = LowRank(skeleton, **system.config.parameters.method)
        weights = np.ones(dance[:count].shape[:2])
        take = Observation(dance[:count], weights, weights, np.arange(count) / 30.0)
        began = process_time()
        method.whole(take)
        seconds = process_time() - began
        ends = str(method.converged_)
        rows.append((count, seconds, method.iterations_, ends, _WANG_1[count]))
    lines = series_of(rows, {"wang-low-rank": 1, "paper": 4})
    return Study(
        title="Time to recover a take (Wang, Table I)",
        columns=("frames", "seconds", "iterations", "converged", "paper_seconds"),
        rows=rows,
        panels=[Panel("frames", "s", lines)],
    )


def _dances(options: Options, frames: int) -> list[PairedTake]:
    """Return people who dance one after the other, for as many frames at least."""
    first, dances = first_person(options.seed), list[PairedTake]()
    while sum(len(pair.take) for pair in dances) < frames:
        someone = range(first + len(dances), first + len(dances) + 1)
        dances += performed_by(someone, ["dance"], progress=options.progress)
    return dances


def wang_figure_1(options: Options, *, frames: int = 1423) -> Study:
    """Count the singular values of takes as matrices: a row a coordinate and frame.

    People dance before a virtual Kinect v2, as many frames as in the paper; beside them
    as many of the first recorded person's clips. Each as the sensor gave them, and as
    the preset recovers them: centered on the root, facing ahead. The rank counts values
    of 1 % of the largest or more.
    """
    config = systems_of((), ["wang-low-rank"])[0].config
    takes = {"dance": _dances(options, frames)}
    if options.data is not None:
        takes["recorded"] = clips_of(recorded_people(options.data)[:1], 10, options)
    spectra: dict[str, Array] = {}
    for name, pairs in takes.items():
        drafts = [observed(pair, config) for pair in pairs]
        for how, parts in {
            "as recorded": [draft.measured for draft in drafts],
            "centered": [draft.standard for draft in drafts],
        }.items():
            spectra[f"{name}, {how}"] = _spectrum(np.concatenate(parts)[:frames])
    count = min(map(len, spectra.values()))
    rows: list[tuple[Cell, ...]] = [
        (k + 1, *(float(values[k]) for values in spectra.values()), None)
        for k in range(count)
    ]
    columns = {name: k for k, name in enumerate(spectra, 1)}
    lines = series_of(rows, columns)
    ranks = [int((values >= _SMALL).sum()) for values in spectra.values()]
    names = [name.replace(", ", "_").replace(" ", "_") for name in spectra]
    return Study(
        title="Singular values of takes (Wang, Figure 1)",
        columns=("value", *names, "paper"),
        rows=[*rows, ("rank", *ranks, _RANK)],
        panels=[Panel("singular value", "share of the largest", lines, log_y=True)],
    )


def _spectrum(positions: Array) -> Array:
    """Return a take's singular values, as shares of the largest, without zeros."""
    known = positions[:, ~np.isnan(positions).all(axis=(0, 2))]
    flat = np.nan_to_num(known).transpose(0, 2, 1).reshape(3 * len(known), -1)
    values = np.linalg.svd(flat, compute_uv=False)
    return np.asarray((values / values[0])[values > 1e-6 * values[0]])
