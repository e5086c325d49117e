"""Takes out of the files that sensors and their tools write."""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import TextIO

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import InputError, State, Take

from .files import open_text
from .layouts import Layout, layout_of
from .rows import Block, RowReader

__all__ = ["read_take"]

_LONGEST_LINE = 1_000_000  # characters; a binary file may have no line end at all
_LARGEST_PERSON = 10.0  # m; no one spans that, in centimeters everyone does
_FRAMES_MEASURED = 1000  # enough for a median

# A block's time [s], positions [m] (R, J, 3) and states (R, J).
_Frames = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.uint8]]


def read_take(
    path: str | os.PathLike[str],
    *,
    format: str | None = None,  # noqa: A002 - the word that users know
) -> Take:
    """Read a recording.

    Known formats, told apart by content; each may be gzipped:

    - ``kinefilter``: header ``time,Joint.x,Joint.y,Joint.z,Joint.state,...``, seconds
      and meters. An empty cell is missing; joints in any order; states may be left out.
    - ``kinect-v2``: no header, time in units of 100 ns, then x, y, z and state of the
      25 joints in the SDK's order. Time is counted from the first frame.
    - ``kinect-v1``: header of 20 joint names split by ``;``, then ``x y z`` per joint;
      30 frames a second, no states.

    A joint that is not tracked, not a number or exactly at the origin, where the
    sensors put what they do not see, is missing: NaN and state 0.

    Args:
        path: The file.
        format: One of the names above, to not go by content.

    Raises:
        InputError: The file is missing, malformed, empty of joints or not in meters;
            the message says where.
    """
    source = os.fspath(path)
    with open_text(path) as file:
        first_row, line = _first_line(file, source)
        layout = layout_of(line, source, format)
        reader = RowReader(source, layout.columns, layout.normalize)
        rows: list[NDArray[np.intp]] = []
        frames: list[_Frames] = []
        for block in reader.blocks(
            _rows_after(file, line, layout), first_row + layout.has_header
        ):
            frames.append(_frames(block, layout, reader))
            rows.append(block.rows)
    _check_length(sum(map(len, rows)), source)
    return _take(np.concatenate(rows), frames, layout, source)


def _first_line(file: TextIO, source: str) -> tuple[int, str]:
    """Return number and text of the first line that is not blank."""
    row = 0
    while line := file.readline(_LONGEST_LINE):
        row += 1
        if "\0" in line:
            raise InputError(
                f"{source}: row {row} is binary; expected a text file, export it as CSV"
            )
        if line.strip():
            return row, line
    raise InputError(f"{source}: the file is empty; expected a recorded take")


def _rows_after(file: TextIO, line: str, layout: Layout) -> Iterator[str]:
    if not layout.has_header:
        yield line
    yield from file


def _check_length(frames: int, source: str) -> None:
    if frames < 2:
        raise InputError(
            f"{source}: has {frames} frame{'s' * (frames != 1)}, "
            "expected at least 2; record a longer take"
        )


def _frames(block: Block, layout: Layout, reader: RowReader) -> _Frames:
    """Return what a block of rows says; raises InputError on an impossible value."""
    skeleton, index, values = layout.skeleton, layout.index, block.values
    positions = np.full((len(values), len(skeleton), 3), np.nan)
    state = np.zeros((len(values), len(skeleton)), dtype=np.uint8)
    for j, joint in enumerate(skeleton.joints):
        if f"{joint}.x" not in index:
            continue
        positions[:, j] = values[:, [index[f"{joint}.{axis}"] for axis in "xyz"]]
        state[:, j] = State.TRACKED
        if f"{joint}.state" in index:
            state[:, j] = _states(block, index[f"{joint}.state"], reader)
    seen = np.isfinite(positions).all(-1) & (positions != 0).any(-1) & (state > 0)
    positions[~seen] = np.nan
    state[~seen] = State.NOT_TRACKED
    return _times(block, layout, reader), positions, state


def _states(block: Block, column: int, reader: RowReader) -> NDArray[np.float64]:
    """Return the states in a column; an empty cell says nothing against the joint."""
    values = block.values[:, column]
    states = np.where(np.isnan(values), State.TRACKED, values)
    wrong = np.flatnonzero(~np.isin(states, list(State)))
    if len(wrong):
        reader.fail(
            block.rows[wrong[0]],
            column,
            f"is {states[wrong[0]]:g}, expected a tracking state: 0 not tracked, "
            "1 inferred, 2 tracked",
        )
    return states


def _times(block: Block, layout: Layout, reader: RowReader) -> NDArray[np.float64]:
    if "time" not in layout.index:
        return np.zeros(len(block.rows))
    column = layout.index["time"]
    times = block.values[:, column]
    empty = np.flatnonzero(np.isnan(times))
    if len(empty):
        reader.fail(
            block.rows[empty[0]], column, "is empty, expected a time; delete the row"
        )
    return times


def _take(
    rows: NDArray[np.intp], frames: list[_Frames], layout: Layout, source: str
) -> Take:
    times, places, states = zip(*frames, strict=True)
    time = np.concatenate(times)
    if "time" not in layout.index:
        time = np.arange(len(time)) * layout.seconds
    elif not layout.has_header:
        # The clock of the machine; subtracted before scaling, which rounds.
        time = (time - time[0]) * layout.seconds
    _check_order(time, rows, source)
    positions = np.concatenate(places)
    _check_extent(positions, source)
    return Take(time, positions, np.concatenate(states), layout.skeleton, source)


def _check_order(
    time: NDArray[np.float64], rows: NDArray[np.intp], source: str
) -> None:
    backwards = np.flatnonzero(np.diff(time) < 0)
    if len(backwards):
        k = int(backwards[0])
        raise InputError(
            f"{source}: row {rows[k + 1]}, column time goes backwards "
            f"({time[k]:.4f} s, then {time[k + 1]:.4f} s); "
            "sort the rows by time or cut the take there"
        )


def _check_extent(positions: NDArray[np.float64], source: str) -> None:
    """Raise InputError where nobody is seen or no one can be that tall."""
    seen = np.flatnonzero(np.isfinite(positions[..., 0]).any(axis=1))
    if not len(seen):
        raise InputError(
            f"{source}: no joint is tracked in any of {len(positions)} frames (all "
            "zero, empty or state 0); record again with the person in view"
        )
    some = positions[seen[:: 1 + len(seen) // _FRAMES_MEASURED]]
    spans = np.fmax.reduce(some, axis=1) - np.fmin.reduce(some, axis=1)
    span = float(np.median(spans.max(axis=-1)))
    if span > _LARGEST_PERSON:
        unit, factor = ("milli", 1000) if span > 600 else ("centi", 100)
        raise InputError(
            f"{source}: the skeleton spans {span:.0f} m in a typical frame, expected a "
            f"person in meters; if the file is in {unit}meters, divide positions by "
            f"{factor}"
        )
