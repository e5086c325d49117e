"""Wang et al., recovery of takes as low-rank matrices: table I and figure 1."""

from time import process_time

import numpy as np

from kinefilter.characters.arrays import Array
from kinefilter.pipeline.correct import Observation
from kinefilter.pipeline.lab.methods.baselines import LowRank
from kinefilter.pipeline.lab.systems import systems_of
from kinefilter.pipeline.lab.training import observed
from kinefilter.pipeline.pairs import PairedTake

from .study import Options, Panel, Row, Study, series_of
from .study_takes import clips_of, first_person, performed_by, recorded_people

_WANG_1 = {241: 0.6190, 463: 0.8001, 1245: 1.1470, 1423: 1.3740}  # seconds by frames
_RANK = 5  # of the paper's dance, read off figure 1
_SMALL = 0.01  # share of the largest singular value that counts for the rank: a guess


def wang_table_1(options: Options, *, sizes: int = 4) -> Study:
    """Time the recovery of dances of the paper's lengths, in seconds of one core."""
    lengths = [*_WANG_1][:sizes]
    (system,) = systems_of((), ["wang-low-rank"])
    dances = _dances(options, max(lengths))
    skeleton = dances[0].take.skeleton
    dance = np.concatenate([observed(pair, system.config).standard for pair in dances])
    rows: list[Row] = []
    for count in lengths:
        method = LowRank(skeleton, **system.config.parameters.method)
        weights = np.ones(dance[:count].shape[:2])
        take = Observation(dance[:count], weights, weights, np.arange(count) / 30.0)
        start = process_time()
        method.whole(take)
        seconds, converged = process_time() - start, str(method.converged_)
        rows.append((count, seconds, method.iterations_, converged, _WANG_1[count]))
    lines = series_of(rows, {"wang-low-rank": 1, "paper": 4})
    title = "Time to recover a take (Wang, Table I)"
    header = ("frames", "seconds", "iterations", "converged", "paper_seconds")
    return Study(title, header, rows, [Panel("frames", "s", lines)])


def _dances(options: Options, frames: int) -> list[PairedTake]:
    first, dances = first_person(options.seed), list[PairedTake]()
    while sum(len(pair.take) for pair in dances) < frames:
        person = first + len(dances)
        dances += performed_by([person], ["dance"], progress=options.progress)
    return dances


def wang_figure_1(options: Options, *, frames: int = 1423) -> Study:
    """Compare the singular values of takes as matrices, a row per coordinate and frame.

    People dance in front of a virtual Kinect v2, for as many frames as in the paper;
    for comparison, as many frames of the first recorded person's clips. Both are taken
    as recorded, and in the heading frame, as the preset does. The rank is the number of
    values of at least 1 % of the largest.
    """
    config = systems_of((), ["wang-low-rank"])[0].config
    takes = {"dance": _dances(options, frames)}
    if options.data is not None:
        takes["recorded"] = clips_of(recorded_people(options.data)[:1], 10, options)
    spectra: dict[str, Array] = {}
    for name, pairs in takes.items():
        drafts = [observed(pair, config) for pair in pairs]
        for form, parts in {
            "as recorded": [draft.measured for draft in drafts],
            "centered": [draft.standard for draft in drafts],
        }.items():
            spectra[f"{name}, {form}"] = _spectrum(np.concatenate(parts)[:frames])
    count = min(map(len, spectra.values()))
    rows: list[Row] = [
        (k + 1, *(float(values[k]) for values in spectra.values()), None)
        for k in range(count)
    ]
    lines = series_of(rows, {name: k for k, name in enumerate(spectra, 1)})
    ranks = [int((values >= _SMALL).sum()) for values in spectra.values()]
    names = [name.replace(", ", "_").replace(" ", "_") for name in spectra]
    title = "Singular values of takes (Wang, Figure 1)"
    header = ("value", *names, "paper")
    panels = [Panel("singular value", "share of the largest", lines, log_y=True)]
    return Study(title, header, [*rows, ("rank", *ranks, _RANK)], panels)


def _spectrum(positions: Array) -> Array:
    """Return a take's nonzero singular values, as shares of the largest."""
    known = positions[:, ~np.isnan(positions).all(axis=(0, 2))]
    flat = np.nan_to_num(known).transpose(0, 2, 1).reshape(3 * len(known), -1)
    values = np.linalg.svd(flat, compute_uv=False)
    return np.asarray((values / values[0])[values > 1e-6 * values[0]])
