"""Plots of studies as PNG, by matplotlib, which only this file knows."""

from __future__ import annotations

from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from kinefilter.pipeline.extras import require

from .study import Panel, Series, Study

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Told apart by the color-blind, too (Okabe & Ito 2008); the paper's are gray.
_COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
_PAPER = ("#BBBBBB", "#777777")
_WIDTH, _HEIGHT = 4.4, 3.2  # of a panel, inches
_BARS = 0.8  # of the distance between two groups
_LEGEND = 5  # entries side by side
_LEVEL_NAMES = 6  # names of groups that fit side by side


def check_drawing() -> None:
    """Raise an InputError if there is nothing to draw with."""
    require("matplotlib", "the plot of a study", "reproduce")


def draw(study: Study, path: Path) -> None:
    """Write the plot of a study as PNG.

    Raises:
        InputError: matplotlib is not installed.
    """
    check_drawing()
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    rows = -(-len(study.panels) // study.across)
    size = (max(study.across * _WIDTH, 6.4), rows * _HEIGHT + 0.4)
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(rows, study.across, squeeze=False).ravel()
    for panel, axis in zip(study.panels, axes, strict=False):
        _draw_panel(panel, axis)
    for axis in axes[len(study.panels) :]:
        axis.set_visible(False)
    handles, labels = axes[0].get_legend_handles_labels()
    # Below the panels, where it hides nothing.
    across = min(len(labels), _LEGEND)
    figure.legend(handles, labels, loc="outside lower center", ncols=across)
    figure.suptitle(study.title, fontsize="medium")
    figure.savefig(path, dpi=120)


def _draw_panel(panel: Panel, axis: Axes) -> None:
    bars = [series for series in panel.series if series.kind == "bars"]
    ours, theirs = cycle(_COLORS), cycle(_PAPER)
    for series in panel.series:
        color = next(theirs if series.paper else ours)
        if series.kind == "bars":
            _draw_bars(axis, series, color, bars.index(series), len(bars))
        elif series.kind == "level":
            axis.axhline(series.y[0], color=color, linestyle="--", label=series.label)
        else:
            axis.plot(series.x, series.y, "o-", color=color, label=series.label, ms=4)
    if panel.log_x:
        values = [float(x) for x in panel.series[0].x]
        axis.set_xscale("log")
        axis.set_xticks(values, [f"{x:g}" for x in values])
        axis.set_xticks([], minor=True)
    if panel.log_y:
        axis.set_yscale("log")
    elif panel.zero:
        axis.set_ylim(bottom=0.0)
    axis.set_xlabel(panel.x_label)
    axis.set_ylabel(panel.y_label)
    axis.set_axisbelow(True)
    axis.grid(axis="y", alpha=0.3)
    axis.spines[["top", "right"]].set_visible(False)


def _draw_bars(axis: Axes, series: Series, color: str, k: int, count: int) -> None:
    """Draw the k-th of ``count`` bars of every group."""
    places = np.arange(len(series.x), dtype=float)
    width = _BARS / count
    left = places + (k - (count - 1) / 2.0) * width
    axis.bar(left, series.y, width, color=color, label=series.label)
    axis.set_xticks(places, [str(name) for name in series.x])
    if len(series.x) > _LEVEL_NAMES:
        axis.tick_params("x", rotation=60.0)
        for label in axis.get_xticklabels():
            label.set_horizontalalignment("right")
