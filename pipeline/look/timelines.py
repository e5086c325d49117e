"""The timeline of ``view``: playback position, curves of a joint, and bars of flags."""

from collections.abc import Mapping

import numpy as np

from kinefilter.characters.arrays import Array, Flags, Indices, runs
from kinefilter.characters.motion import nominal_step

from .drawing import PHYSICS, Color, Drawing, StickFigure, reliability_colors

AXES = ("x (left)", "y (up)", "z (forward)")  # of the clip's world frame

_WIDTH = 600  # units of the pictures, roughly the pixels across a panel
_HEIGHT = 150  # px, height of the curves
_STRIP = 8  # px, height of the strip of reliability below
_COLUMNS = 300  # steps of a curve: however long the motion, no more can be seen
_RAW = (130, 130, 130)
_FLATTEST = 0.05  # m that the picture's height spans, at least
_ROW = 16  # px from one row of bars to the next
_BAR = 10  # px, height of a bar
_CLOSE = 300  # frames of a close-up: ten seconds, at least a pixel each
_COLORS = {"L": "#2f7fd6", "R": "#e08a2e", "edited": "#777", "doubtful": "#d9342b"}
_SHORTEST = 1.0 / 60.0  # s between two pictures: screens show no more


class Curves:
    """One coordinate of a joint in each figure of a drawing, and its reliability."""

    def __init__(self, drawing: Drawing, joint: str, axis: str) -> None:
        clip, get, self._count = drawing.clip, drawing.figures.get, len(drawing.clip)
        final = StickFigure(clip.skeleton, clip.positions, PHYSICS)
        shown = {"raw": get("raw"), "clip": final, "other": get("other")}
        # The mean of the frames in each column, where there are too many to be seen.
        starts = _starts(self._count, _COLUMNS)
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
        rates = clip.reliability[starts, clip.skeleton.joints.index(joint)]
        self._picture = "".join(lines) + _strip(starts * _WIDTH / self._count, rates)
        self._legend = " ".join(
            f'<span style="color:rgb{color}">&#9632;</span> {name}'
            for name, (_, color) in rows.items()
        )

    def _line(self, times: Array, values: Array, color: Color) -> str:
        heights = _HEIGHT * (self._high - values) / (self._high - self._low)
        points = [f"{x:.1f} {y:.1f}" for x, y in zip(times, heights, strict=True)]
        path = "".join("M" + "L".join(points[run]) for run in runs(np.isfinite(values)))
        return (
            f'<path class="curve" d="{path}" stroke="rgb{color}" fill="none" '
            'stroke-width="1.5" vector-effect="non-scaling-stroke"/>'
        )

    def html(self, frame: int) -> str:
        """Return the picture as HTML, with a mark at a frame."""
        mark = (frame + 0.5) * _WIDTH / self._count
        picture = _picture("curves", _HEIGHT + _STRIP, self._picture, mark)
        return (
            '<div style="font-size:11px;margin:4px 8px">'
            f"<div>{self._legend} &middot; {100.0 * self._low:.0f} to "
            f"{100.0 * self._high:.0f} cm; below, reliability</div>{picture}</div>"
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


def timeline_html(
    rows: Mapping[str, Flags], frame: int, chosen: tuple[int, int]
) -> str:
    """Return HTML that shows when flags (T,) are true, as rows of bars over time.

    ``frame`` is marked, and the frames from the first to the last ``chosen`` are
    shaded. Long motions also get a close-up of the frames around ``frame``.
    """
    flags = np.column_stack(list(rows.values()))
    count, height = len(flags), _ROW * len(rows)

    def strip(name: str, flags: Flags, frames: range) -> str:
        step, scale, bars = _WIDTH / len(flags), _WIDTH / len(frames), ""
        for k, row in enumerate(rows):
            path = "".join(
                f"M{run.start * step:.1f} {_ROW * k + _ROW // 2}"
                f"h{(run.stop - run.start) * step:.1f}"
                for run in runs(flags[:, k])
            )
            bars += (
                f'<path class="row" d="{path}" stroke="{_COLORS[row.split()[-1]]}" '
                f'stroke-width="{_BAR}" fill="none"/>'
            )
        ends = np.array([chosen[0], chosen[1] + 1]) - frames.start
        first, end = np.clip(ends, 0, len(frames)).tolist()
        shade = (
            f'<rect x="{first * scale:.1f}" width="{(end - first) * scale:.1f}" '
            f'height="{height}" fill="rgba(128,128,128,0.25)"/>'
        )
        mark = (frame - frames.start + 0.5) * scale
        return (
            '<div style="display:flex;gap:6px;font-size:11px;margin:4px 8px">'
            f'<div style="flex:none;line-height:{_ROW}px">{"<br>".join(rows)}</div>'
            f"{_picture(name, height, shade + bars, mark)}</div>"
        )

    coarse = np.logical_or.reduceat(flags, _starts(count, _WIDTH), axis=0)
    strips = strip("timeline", coarse, range(count))
    if count > 2 * _CLOSE:
        first = min(max(frame - _CLOSE // 2, 0), count - _CLOSE)
        near = range(first, first + _CLOSE)
        strips += strip("close-up", flags[near], near)
    return strips


def _starts(count: int, most: int) -> Indices:
    """Return where columns of frames start: no more than can be seen."""
    columns = min(count, most)
    return np.arange(columns) * count // columns


def _picture(name: str, height: int, inside: str, mark: float) -> str:
    """Return a picture as wide as the panel, with a mark at a frame."""
    return (
        f'<svg id="{name}" viewBox="0 0 {_WIDTH} {height}" width="100%" '
        f'height="{height}" preserveAspectRatio="none" '
        f'style="background:rgba(128,128,128,0.12)">{inside}'
        f'<path d="M{mark:.1f} 0V{height}" stroke="#d9342b" stroke-width="2" '
        'vector-effect="non-scaling-stroke"/></svg>'
    )


class Playback:
    """A position in a motion, paused or ``playing`` in a loop by a clock."""

    def __init__(self, time: Array) -> None:
        last = np.nan_to_num(nominal_step(time), nan=1.0)
        self._starts = time - time[0]
        self._ends = np.append(self._starts[1:], self._starts[-1] + last)
        self._frame, self._speed, self.playing = 0, 1.0, False
        self._began = 0.0  # clock time of frame 0 while playing

    def frame(self, clock: float) -> int:
        """Return the frame shown at a clock time [s]."""
        if not self.playing:
            return self._frame
        return int(np.searchsorted(self._ends[:-1], self._now(clock), side="right"))

    def play(self, clock: float) -> None:
        """Play from the current frame, or from the first if it is the last."""
        if not self.playing:
            last = self._frame == len(self._starts) - 1
            self._start(0 if last else self._frame, clock)

    def pause(self, clock: float) -> None:
        """Pause at the current frame."""
        self.seek(self.frame(clock))

    def seek(self, frame: int) -> None:
        """Pause at a frame, clipped to the motion."""
        self._frame = min(max(frame, 0), len(self._starts) - 1)
        self.playing = False

    def change_speed(self, speed: float, clock: float) -> None:
        """Play ``speed`` times as fast as recorded from now on."""
        frame, self._speed = self.frame(clock), speed
        if self.playing:
            self._start(frame, clock)

    def until_next(self, clock: float) -> float | None:
        """Return the time [s] until the picture changes; None when paused."""
        if not self.playing:
            return None
        left = self._ends[self.frame(clock)] - self._now(clock)
        return max(float(left) / self._speed, _SHORTEST)

    def _now(self, clock: float) -> float:
        return (clock - self._began) * self._speed % float(self._ends[-1])

    def _start(self, frame: int, clock: float) -> None:
        self._began, self.playing = clock - self._starts[frame] / self._speed, True
