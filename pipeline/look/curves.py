"""Curves of a joint's path and reliability over time, as a picture in a page."""

from __future__ import annotations

import numpy as np

from kinefilter.characters.arrays import Array

from .drawing import PHYSICS, Drawing, StickFigure, reliability_colors

AXES = ("x (left)", "y (up)", "z (forward)")
"""The coordinates of a joint, in the clip's world frame."""

_WIDTH, _HEIGHT = 600, 150  # units of the picture, roughly pixels
_STRIP = 8  # px, height of the strip of reliability below
_COLUMNS = 300  # steps of a curve: however long the motion, no more can be seen
_RAW = (130, 130, 130)
_FLATTEST = 0.05  # m that the picture's height spans, at least


class Curves:
    """One coordinate of a joint in each figure of a drawing, and its reliability."""

    def __init__(self, drawing: Drawing, joint: str, axis: str) -> None:
        figures, self._count = drawing.figures, len(drawing.clip)
        final = StickFigure(drawing.clip.skeleton, drawing.clip.positions, PHYSICS)
        shown = {
            "raw": figures.get("raw"),
            "clip": final,
            "other": figures.get("other"),
        }
        # The mean of the frames in each column, where there are too many to be seen.
        columns = min(self._count, _COLUMNS)
        starts = np.arange(columns) * self._count // columns
        sizes = np.diff([*starts, self._count])
        rows = {}
        for name, figure in shown.items():
            if figure is not None and joint in figure.skeleton.joints:
                j, k = figure.skeleton.joints.index(joint), AXES.index(axis)
                path = figure.positions[:, j, k]
                rows[name] = np.add.reduceat(path, starts) / sizes, figure.color or _RAW
        heights = np.concatenate([row for row, _ in rows.values()])
        low, high = float(np.nanmin(heights)), float(np.nanmax(heights))
        room = max(0.05 * (high - low), 0.5 * (_FLATTEST - (high - low)))
        self._low, self._high = low - room, high + room
        times = (starts + 0.5 * sizes) * _WIDTH / self._count
        lines = [self._line(times, *row) for row in rows.values()]
        j = drawing.clip.skeleton.joints.index(joint)
        rates = drawing.clip.reliability[starts, j]
        self._picture = "".join(lines) + _strip(starts * _WIDTH / self._count, rates)
        names = {name: f"rgb{color}" for name, (_, color) in rows.items()}
        self._legend = " ".join(
            f'<span style="color:{color}">&#9632;</span> {name}'
            for name, color in names.items()
        )

    def _line(self, times: Array, values: Array, color: tuple[int, int, int]) -> str:
        heights = _HEIGHT * (self._high - values) / (self._high - self._low)
        path, begins = [], True
        for x, y in zip(times.tolist(), heights.tolist(), strict=True):
            if np.isfinite(y):
                path.append(f"{'M' if begins else 'L'}{x:.1f} {y:.1f}")
            begins = not np.isfinite(y)
        return (
            f'<path class="curve" d="{"".join(path)}" stroke="rgb{color}" fill="none" '
            'stroke-width="1.5" vector-effect="non-scaling-stroke"/>'
        )

    def html(self, frame: int) -> str:
        """Return the picture as HTML, with a mark at a frame."""
        mark, height = (frame + 0.5) * _WIDTH / self._count, _HEIGHT + _STRIP
        return (
            '<div style="font-size:11px;margin:4px 8px">'
            f"<div>{self._legend} &middot; {100.0 * self._low:.0f} to "
            f"{100.0 * self._high:.0f} cm; below, reliability</div>"
            f'<svg id="curves" viewBox="0 0 {_WIDTH} {height}" width="100%" '
            f'height="{height}" preserveAspectRatio="none" '
            f'style="background:rgba(128,128,128,0.12)">{self._picture}'
            f'<path d="M{mark:.1f} 0V{height}" stroke="#d9342b" stroke-width="2" '
            'vector-effect="non-scaling-stroke"/></svg></div>'
        )


def _strip(starts: Array, rates: Array) -> str:
    """Return a strip below the curves, colored by reliability in steps of a tenth."""
    tenths = np.nan_to_num(np.round(rates, 1), nan=-1.0)
    first = np.flatnonzero(np.diff(tenths, prepend=-2.0))
    edges = [*starts[first].tolist(), _WIDTH]
    colors = reliability_colors(np.where(tenths < 0.0, np.nan, tenths)[first])
    return "".join(
        f'<rect x="{x:.1f}" y="{_HEIGHT}" width="{end - x:.1f}" height="{_STRIP}" '
        f'fill="rgb({",".join(f"{255.0 * part:.0f}" for part in color)})"/>'
        for x, end, color in zip(edges[:-1], edges[1:], colors, strict=True)
    )
