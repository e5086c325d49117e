"""Input and output of a study: options in, table, plot and README's pictures out.

Only this file uses matplotlib.
"""

from __future__ import annotations

import csv
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from rich.table import Table

from kinefilter import Cleaner, clean, read_take, write_clip
from kinefilter.characters import Clip, InputError, State
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.extras import require
from kinefilter.pipeline.formats.files import atomic_path, make_folder
from kinefilter.pipeline.formats.sheets import write_take_csv
from kinefilter.pipeline.lab.hidden_limb_evaluation import join_cases, middle
from kinefilter.pipeline.lab.limb_guesses import HIDDEN, hide, simple_guesses
from kinefilter.pipeline.lab.limb_lessons import train_prior_on, with_prior
from kinefilter.pipeline.lab.simulation import simulate
from kinefilter.pipeline.pairs import read_pairs
from kinefilter.pipeline.progress import Progress, silent
from kinefilter.scenes import SAMPLE

Cell = str | int | float | None  # of a table; None if it is empty
Row = tuple[Cell, ...]
Kind = Literal["line", "bars", "level"]  # a level is a line across the panel


@dataclass(frozen=True)
class Options:
    """Settings common to all studies."""

    seed: int = 0  # seed of simulated people, performances and sensor errors
    data: Path | None = None  # folder of recordings; None: simulated takes only
    progress: Progress = silent  # wraps the loops, for a progress bar


@dataclass(frozen=True)
class Series:
    """One line of a plot, or one color of bars."""

    label: str  # in the legend; figures of the paper begin with paper
    x: Sequence[float] | Sequence[str]  # for bars, the names of the groups
    y: Sequence[float]  # values; a single one for a level
    kind: Kind = "line"


@dataclass(frozen=True)
class Panel:
    """One pair of axes."""

    x_label: str  # what is varied, with its unit
    y_label: str  # what is measured, with its unit
    series: Sequence[Series]
    log_x: bool = False
    log_y: bool = False
    zero: bool = True  # whether a linear y axis begins at 0


@dataclass(frozen=True)
class Study:
    """The result of one study."""

    title: str  # the topic, and where the paper covers it
    columns: Sequence[str]  # those of the paper's figures begin with paper
    rows: Sequence[Sequence[Cell]]
    panels: Sequence[Panel]  # the plot, row by row
    across: int = 1  # number of panels side by side


def series_of(
    rows: Sequence[Sequence[Cell]],
    columns: Mapping[str, int],
    *,
    x: int | Sequence[str] = 0,
    kind: Kind = "line",
) -> list[Series]:
    """Return a series for each entry of ``columns``, a label and a column number.

    ``x`` is the number of the column with the positions along the axis (for bars, the
    names of the groups), or those names themselves.
    """

    def numbers(column: int) -> list[float]:
        return [float(row[column] or 0.0) for row in rows]

    along: Sequence[float] | Sequence[str]
    if isinstance(x, int):
        along = [str(row[x]) for row in rows] if kind == "bars" else numbers(x)
    else:
        along = x
    return [Series(label, along, numbers(k), kind) for label, k in columns.items()]


def as_table(study: Study) -> Table:
    """Return the study's table for a terminal, with numbers to four digits."""
    table = Table(title=study.title, title_justify="left")
    for k, column in enumerate(study.columns):
        numeric = any(isinstance(row[k], int | float) for row in study.rows)
        # One word per line, so that ten columns fit into 80 characters.
        heading = column.replace("_", "\n").replace("percent", "%")
        table.add_column(heading, justify="right" if numeric else "left")
    for row in study.rows:
        cells = (f"{cell:.4g}" if isinstance(cell, float) else cell for cell in row)
        table.add_row(*("" if cell is None else str(cell) for cell in cells))
    return table


if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Distinct for color-blind readers (Okabe & Ito 2008); the paper's figures are gray.
_COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
_PAPER = ("#BBBBBB", "#777777")
_WIDTH, _HEIGHT = 4.4, 3.2  # of a panel, inches
_BARS = 0.8  # width of a group of bars, as a share of the distance between groups
_LEGEND = 5  # entries side by side
_LEVEL_NAMES = 6  # group names that fit side by side without rotation

_ARM_LENGTH = 2.6  # s, of the animation of a hidden arm
_OTHERS = 4  # one in this many clips of other people trains the prior
_MIMED: tuple[tuple[str, str, str, int, dict[str, float]], ...] = (
    ("held_box.gif", "box", "store_box", 5012, {"begin": 0.8}),
    ("dribbled_ball.gif", "basketball", "dribble", 5003, {"begin": 1.6, "end": 6.4}),
)
"""Animations of things that are mimed: scene, motion, seed, and seconds of the clip."""
_WALK, _WALK_LENGTH = 5020, 2.4  # seed, and s of the animation of unseen legs
_UPPER = ("Head", "Shoulder", "Elbow", "Wrist", "Hand")  # joints that are seen there
_SIZE, _RATE = "480x270", 10.0  # of animations: small enough to load quickly


def write_study(name: str, study: Study, folder: Path) -> tuple[Path, Path]:
    """Write ``NAME.csv`` and ``NAME.png``, or InputError; return their paths."""
    make_folder(folder)
    table, plot = folder / f"{name}.csv", folder / f"{name}.png"
    with atomic_path(table) as new_table, atomic_path(plot) as new_plot:
        write_table([study.columns, *study.rows], new_table)
        draw(study, new_plot)
    return table, plot


def write_table(rows: Iterable[Sequence[Cell]], path: Path) -> None:
    """Write a CSV file, with numbers to six digits."""
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(
            [f"{cell:.6g}" if isinstance(cell, float) else cell for cell in row]
            for row in rows
        )


def check_drawing() -> None:
    """Raise an InputError if matplotlib is not installed."""
    require("matplotlib", "a plot", "reproduce")


def draw(study: Study, path: Path) -> None:
    """Write the plot of a study as PNG; InputError if matplotlib is not installed."""
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
    across = min(len(labels), _LEGEND)
    figure.legend(handles, labels, loc="outside lower center", ncols=across)
    figure.suptitle(study.title, fontsize="medium")
    figure.savefig(path, dpi=120)


def _draw_panel(panel: Panel, axis: Axes) -> None:
    bars = [series for series in panel.series if series.kind == "bars"]
    ours, papers = cycle(_COLORS), cycle(_PAPER)
    for series in panel.series:
        color = next(papers if series.label.startswith("paper") else ours)
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
    axis.set(xlabel=panel.x_label, ylabel=panel.y_label, axisbelow=True)
    axis.grid(axis="y", alpha=0.3)
    axis.spines[["top", "right"]].set_visible(False)


def _draw_bars(axis: Axes, series: Series, color: str, k: int, count: int) -> None:
    groups = np.arange(len(series.x), dtype=float)
    width = _BARS / count
    centers = groups + (k - (count - 1) / 2.0) * width
    axis.bar(centers, series.y, width, color=color, label=series.label)
    axis.set_xticks(groups, [str(name) for name in series.x])
    if len(series.x) > _LEVEL_NAMES:
        axis.tick_params("x", rotation=60.0)
        for label in axis.get_xticklabels():
            label.set_horizontalalignment("right")


def make_pictures(
    folder: Path, *, data: Path | None = None, progress: Progress = silent
) -> Iterator[str]:
    """Make README's animations (OpenGL, recordings), and yield a line on each."""
    path = folder / "raw_beside_cleaned.gif"
    try:
        _animate(clean(read_take(SAMPLE)).clip, path, progress, compare=SAMPLE)
        yield f"wrote {path}"
        for name, scene, motion, seed, part in _MIMED:
            path = folder / name
            take = simulate(scene, motion, seed=seed).take
            clip = clean(take, CleanConfig(scene=scene)).clip
            _animate(clip, path, progress, scene=scene, **part)
            yield f"wrote {path}"
        path = folder / "unseen_legs.gif"
        _hide_legs(path, progress)
        yield f"wrote {path}"
        if data is not None:
            path = folder / "hidden_arm.gif"
            _hide_an_arm(path, data, progress)
            yield f"wrote {path}"
    except InputError as error:
        yield f"not made: {path.name} ({error})"


def _animate(clip: Clip, path: Path, progress: Progress, **look: Any) -> None:
    from kinefilter.pipeline.look.options import Look
    from kinefilter.pipeline.look.video import render_clips

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "clip.npz"
        write_clip(clip, file)
        look = {"size": _SIZE, "fps": _RATE, **look}
        render_clips([file], path, Look(**look), progress=progress)


def _hide_legs(path: Path, progress: Progress) -> None:
    """Write an animation of a walker of whom only head, shoulders and arms are seen."""
    take = simulate("basic", "walk", seed=_WALK, stay_in_view=True).take
    shown = np.array([joint.startswith(_UPPER) for joint in take.skeleton.joints])
    positions = np.where(shown[:, None], take.positions, np.nan)
    state = np.where(shown, take.state, State.NOT_TRACKED).astype(np.uint8)
    blind = replace(take, positions=positions, state=state)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "take.csv"
        write_take_csv(blind, file)
        part = {"begin": 0.6, "end": 0.6 + _WALK_LENGTH}
        _animate(clean(blind).clip, path, progress, compare=file, **part)


def _hide_an_arm(path: Path, data: Path, progress: Progress) -> None:
    """Write an animation of a recorded arm: visible, held while hidden, and hidden."""
    from matplotlib.image import imread

    from kinefilter.pipeline.look.video_files import encode_png, write_gif

    people = {file.stem: file for file in sorted((data / "ui-prmd").glob("s*.npz"))}
    pairs = [
        pair
        for pair in read_pairs(people.pop("s04"))
        if pair.clip.startswith("m07") and not pair.clip.endswith("_inc")
    ]
    others = (pair for file in people.values() for pair in read_pairs(file)[::_OTHERS])
    cleaner = with_prior(Cleaner(), CleanConfig(), train_prior_on(others))
    take, cases = next(iter(join_cases(pairs, "repetitions")))
    arm, hidden = [j for j in HIDDEN["right-arm"] if j in take.skeleton.joints], take
    joints = [take.skeleton.index(joint) for joint in arm]
    held = take.positions.copy()
    for pair, start in cases:
        span = middle(pair.take, "55%")
        assert span is not None
        rows, clip = slice(start, start + len(pair.take)), pair.take.positions
        held[rows] = simple_guesses(clip, take.skeleton, joints, span)["hold"]
        gap = slice(start + span.start, start + span.stop)
        hidden = hide(hidden, joints, gap, "none")
    begin = take.time[cases[1][1]]
    x, _, z = take.positions[0, take.skeleton.root]
    center = np.array([x, 1.0, z])
    position = center * (1.0 - 4.2 / np.hypot(x, z))  # on the line to the sensor
    position[1] = 1.1
    columns = []
    with tempfile.TemporaryDirectory() as folder:
        camera = Path(folder) / "camera.toml"
        place = f"position = {position.tolist()}\ntarget = {center.tolist()}\n"
        camera.write_text(f"{place}fov = 36.0\n", encoding="utf-8", newline="\n")
        look = {"size": "200x240", "camera": str(camera)}
        look |= {"begin": begin, "end": begin + _ARM_LENGTH}
        for k, shown in enumerate((take, replace(take, positions=held), hidden)):
            pictures = Path(folder) / str(k)
            _animate(cleaner.clean(shown).clip, pictures / "%05d.png", progress, **look)
            columns.append([imread(f) for f in sorted(pictures.glob("*.png"))])
    frames = [np.concatenate(row, axis=1) for row in zip(*columns, strict=True)]
    coded = [(encode_png((255 * f[..., :3]).astype(np.uint8)), True) for f in frames]
    height, width = frames[0].shape[:2]
    write_gif([coded], path, (width, height), _RATE)
