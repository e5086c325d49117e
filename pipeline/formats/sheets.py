"""Takes that hold a frame a row."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import InputError, State, Take

from .layouts import Layout
from .recording import (
    MOST_FRAMES,
    Recording,
    check_extent,
    check_length,
    check_rate,
    missing_marked,
)
from .rows import Block, RowReader

_LATEST = 1e19  # of the units of any format: a sensor's clock starts centuries ago

# A block's time [s], positions [m] (R, J, 3) and states (R, J).
_Frames = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.uint8]]


def read_sheet(
    source: str, head: tuple[int, str], lines: Iterator[str], layout: Layout
) -> Recording:
    """Read a recording with a frame a row.

    Args:
        source: The file, for messages.
        head: Number and text of the first line that is not blank.
        lines: The lines after it.
        layout: Which column is what.

    Raises:
        InputError: A row is malformed, or the whole is no take in meters.
    """
    row, line = head
    if layout.has_header:
        row += 1
    else:
        lines = chain([line], lines)
    reader = RowReader(source, layout.columns, layout.normalize)
    rows: list[NDArray[np.intp]] = []
    frames: list[_Frames] = []
    count = 0
    for block in reader.blocks(lines, row):
        frames.append(_frames(block, layout, reader))
        rows.append(block.rows)
        count += len(block.rows)
        if count > MOST_FRAMES:
            break
    check_length(count, source)
    take = _take(np.concatenate(rows), frames, layout, source)
    return Recording((take,), layout.name)


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
    return _times(block, layout, reader), *missing_marked(positions, state)


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
    absurd = np.flatnonzero(np.abs(times) > _LATEST)
    if len(absurd):
        reader.fail(
            block.rows[absurd[0]],
            column,
            f"is {times[absurd[0]]:.3g}, expected a time; correct or delete the row",
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
    check_rate(time, source)
    positions, state = np.concatenate(places), np.concatenate(states)
    check_extent(positions, source)
    if layout.weighted and state.max() == State.INFERRED:
        # The w of a homogeneous point, which is 1 wherever there is one.
        state = np.where(state > 0, State.TRACKED, State.NOT_TRACKED).astype(np.uint8)
    return Take(time, positions, state, layout.skeleton, source)


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
