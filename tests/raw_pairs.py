"""Recordings that others have paired before, and how far ours are from theirs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from real_data import DATA
from scipy.spatial.transform import Rotation

from kinefilter import read_take
from kinefilter.characters import KINECT_V1
from kinefilter.pipeline.formats.mocap import read_mocap
from kinefilter.pipeline.formats.recording import Mocap
from kinefilter.pipeline.lab.pairing import pair_session
from kinefilter.pipeline.merge.lag import Spline
from kinefilter.pipeline.pairs import read_pairs

__all__ = ["RAW", "compared"]

Array = NDArray[np.float64]
RAW = DATA / "raw-pairs"
joint = KINECT_V1.index


def finished(clip: str) -> tuple[Array, Array]:
    """Return Kinect and mocap of a clip that was paired by others [m]."""
    for pair in read_pairs(DATA / "ui-prmd" / f"{clip[4:7]}.npz"):
        if pair.clip == clip:
            return pair.take.positions, pair.truth
    raise AssertionError(clip)


def placed_by_wrists(
    markers: Mocap, truth: Array, after: float
) -> tuple[float, Rotation, Array]:
    """Return lag and transform of a finished pair, whose wrists are mean markers.

    They are the same points in both, so the two are exact: to 0.1 mm.
    """
    names, points = list(markers.names), markers.positions / 1000.0
    middle = [
        np.mean([points[:, names.index(f"{s}WR{k}")] for k in "AB"], axis=0)
        for s in "LR"
    ]
    track = Spline(np.arange(len(points)) * 0.01, np.stack(middle, axis=1))
    wrists = truth[:, [joint("WristLeft"), joint("WristRight")]].reshape(-1, 3)
    best: tuple[float, Rotation, Array, float] | None = None
    for lag in np.arange(-50, 51) * 0.01:
        there = track.at(np.arange(len(truth)) / 30 + after + lag + 1e-6).reshape(-1, 3)
        known = ~np.isnan(there + wrists).any(axis=1)
        if known.sum() < 0.9 * len(known):
            continue
        one, other = there[known], wrists[known]
        turn, off = Rotation.align_vectors(other - other.mean(0), one - one.mean(0))
        if best is None or off < best[3]:
            best = (lag, turn, other.mean(0) - turn.apply(one.mean(0)), off)
    assert best is not None
    assert best[3] < 0.02
    return best[:3]


def compared(clip: str) -> tuple[float, float, float, Array]:
    """Return how far a raw pair is from the finished one.

    Lag [ms], turn [degrees], shift of the body [cm], and each joint's median distance
    [cm] by the finished transform, so that what is called a joint is what is left.
    """
    take = read_take(RAW / f"{clip}.kinect.csv")
    markers = read_mocap(RAW / f"{clip}.markers.c3d")
    (pairing,), _ = pair_session([(take, markers)], subject="ann")
    kinect, truth = finished(clip)

    def row_of(frame: Array) -> int:
        return int(np.nanargmin(np.nansum(np.abs(take.positions - frame), axis=(1, 2))))

    first = row_of(kinect[0])
    lag, turn, shift = placed_by_wrists(markers, truth, take.time[first])
    there = pairing.placed.turn.inv().apply(
        (pairing.pair.truth - pairing.placed.shift).reshape(-1, 3)
    )
    again = (turn.apply(there) + shift).reshape(pairing.pair.truth.shape)
    moved = np.linalg.norm(np.nanmean(again - pairing.pair.truth, axis=(0, 1)))
    begin = first - row_of(pairing.pair.take.positions[0])
    ours, theirs = again[max(begin, 0) :], truth[max(-begin, 0) :]
    count = min(len(ours), len(theirs))
    apart = np.linalg.norm(ours[:count] - theirs[:count], axis=2)
    apart = apart[:, ~np.isnan(apart).all(axis=0)]
    degrees = np.degrees((pairing.placed.turn * turn.inv()).magnitude())
    medians = 100.0 * np.nanmedian(apart, axis=0)
    return 1000.0 * (pairing.clock.lag - lag), float(degrees), 100.0 * moved, medians
