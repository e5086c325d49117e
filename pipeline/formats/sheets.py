"""Takes as tables with a frame a row: kinefilter's own CSV and the Kinects'."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import (
    KINECT_V1,
    KINECT_V2,
    SKELETONS,
    Clip,
    InputError,
    Origin,
    Skeleton,
    State,
    Take,
)
from kinefilter.characters.arrays import Array

from .files import atomic_path
from .recording import (
    MOST_FRAMES,
    Recording,
    check_length,
    check_order,
    missing_marked,
    open_rows,
    recording_of,
)
from .rows import Block, RowReader

_FRAMES_AT_ONCE = 1000  # about a megabyte of text
_LATEST = 1e19  # of the units of any format: a sensor's clock starts centuries ago
_AXES = ("x", "y", "z")
_PARTS = (*_AXES, "state")


def _columns(skeleton: Skeleton) -> tuple[str, ...]:
    return ("time", *(f"{j}.{part}" for j in skeleton.joints for part in _PARTS))


# Writing


def write_take_csv(motion: Take | Clip, path: str | os.PathLike[str]) -> None:
    """Write time [s], joint positions [m] and states, one row per frame.

    The header is ``time,Joint.x,Joint.y,Joint.z,Joint.state,...`` in the sensor's
    order. In a clip, a joint that was not measured as it is counts as inferred.
    Positions have nine decimals, time reads back the same; a missing coordinate is an
    empty cell.
    """
    state = motion.state
    if isinstance(motion, Clip):
        # What the sensor did not see has a place now, but only inferred.
        measured = motion.origin == Origin.MEASURED
        state = np.where(measured, np.maximum(state, State.INFERRED), State.INFERRED)
    with (
        atomic_path(path) as temporary,
        temporary.open("w", encoding="utf-8", newline="\n") as file,
    ):
        file.write(take_header(motion.skeleton))
        for start in range(0, len(motion), _FRAMES_AT_ONCE):
            some = slice(start, start + _FRAMES_AT_ONCE)
            file.write(
                take_rows(motion.time[some], motion.positions[some], state[some])
            )


def take_header(skeleton: Skeleton) -> str:
    """Return the line of the columns' names."""
    return ",".join(_columns(skeleton)) + "\n"


def take_rows(time: Array, positions: Array, state: NDArray[np.uint8]) -> str:
    """Return the lines of frames, shapes (T,), (T, J, 3) and (T, J)."""
    count, joints = state.shape
    row = ",".join(["%r", *["%.9f,%.9f,%.9f,%d"] * joints]) + "\n"
    each = np.concatenate([positions, state[..., None]], axis=-1)
    numbers = np.concatenate([time[:, None], each.reshape(count, -1)], axis=1)
    text: str = row * count % tuple(numbers.ravel().tolist())
    return text.replace("nan", "")


# Layouts


@dataclass(frozen=True)
class _Layout:
    name: str
    skeleton: Skeleton
    columns: tuple[str, ...]
    normalize: Callable[[str], str]  # a line into comma-separated cells, one a column
    seconds: float  # one unit of the time column; one frame where there is none
    has_header: bool = False
    weighted: bool = False  # states that are all 1 or 0 say that there is a point


def _kinefilter(line: str, source: str) -> _Layout:
    columns = tuple(cell.strip().strip('"') for cell in line.strip().split(","))
    if columns[0] != "time":
        raise InputError(
            f"{source}: row 1, column 1 is {columns[0][:40]!r}, expected the header "
            "'time'; give the file's own format"
        )
    if len(set(columns)) < len(columns):
        twice = Counter(columns).most_common(1)[0][0]
        raise InputError(f"{source}: row 1 has column {twice[:40]!r} twice; delete one")
    joints = tuple(dict.fromkeys(c.rpartition(".")[0] or c for c in columns[1:]))
    skeleton = _skeleton_with(joints, source)
    needed = [f"{joint}.{axis}" for joint in joints for axis in _AXES]
    unknown = set(columns).difference(_columns(skeleton), needed)
    for column in columns:
        if column in unknown:
            raise InputError(
                f"{source}: row 1, column {column[:40]!r} is unknown; expected "
                "Joint.x, Joint.y, Joint.z or Joint.state"
            )
    present = set(columns)
    for column in needed:
        if column not in present:
            raise InputError(
                f"{source}: row 1 has no column {column}; add it or delete the other "
                "columns of that joint"
            )
    return _Layout("kinefilter", skeleton, columns, str, 1.0, has_header=True)


def _skeleton_with(joints: tuple[str, ...], source: str) -> Skeleton:
    """Return the smallest skeleton that has all the joints."""
    if not joints:
        raise InputError(f"{source}: row 1 names no joints; expected Joint.x and so on")
    skeletons = sorted(SKELETONS.values(), key=len)
    for skeleton in skeletons:
        if set(joints) <= set(skeleton.joints):
            return skeleton
    nearest = max(skeletons, key=lambda s: len(set(joints) & set(s.joints)))
    unknown = next(joint for joint in joints if joint not in nearest.joints)
    raise InputError(
        f"{source}: row 1, joint {unknown[:40]!r} is not one of {nearest.name}: "
        f"{', '.join(nearest.joints)}; rename or delete its columns"
    )


def _kinect_v2(_line: str, _source: str) -> _Layout:
    columns = _columns(KINECT_V2)

    def normalize(line: str) -> str:
        # The recorder ends every cell with a comma, the last one too.
        return line[:-1] if line.count(",") == len(columns) else line

    return _Layout("kinect-v2", KINECT_V2, columns, normalize, 100e-9)


def _kinect_v1(line: str, source: str) -> _Layout:
    names = [n.strip().strip('"') for n in line.strip().rstrip(";").split(";")]
    joints = tuple(name for name in names if name in KINECT_V1.joints)
    strangers = [name for name in names[: len(KINECT_V1)] if name not in joints]
    if strangers or len(set(joints)) < len(KINECT_V1):
        found = f"{strangers[0][:40]!r}" if strangers else f"{len(set(joints))} joints"
        raise InputError(
            f"{source}: row 1 has {found}, expected the {len(KINECT_V1)} joint names "
            f"of {KINECT_V1.name} split by ;: {', '.join(KINECT_V1.joints)}"
        )

    def normalize(line: str) -> str:
        cells = line.split(";")
        if len(cells) == len(KINECT_V1) + 1:
            del cells[-1]  # the label of the action
        return ",".join(",".join(cell.split()) or ",," for cell in cells)

    columns = tuple(f"{joint}.{axis}" for joint in joints for axis in _AXES)
    return _Layout("kinect-v1", KINECT_V1, columns, normalize, 1 / 30, has_header=True)


def _msrc_12(_line: str, _source: str) -> _Layout:
    def normalize(line: str) -> str:
        return ",".join(line.replace(",", " ").split())

    columns = _columns(KINECT_V1)
    return _Layout("msrc-12", KINECT_V1, columns, normalize, 1e-6, weighted=True)


# Reading


def _read(lay_out: Callable[[str, str], _Layout], source: str) -> Recording:
    """Read a recording whose layout follows from its first line."""
    with open_rows(source) as (row, line, lines):
        layout = lay_out(line, source)
        if not layout.has_header:
            lines = chain([line], lines)
        reader = RowReader(source, layout.columns, layout.normalize)
        blocks, count = [], 0
        for block in reader.blocks(lines, row + layout.has_header):
            blocks.append(_frames(block, layout, reader))
            count += len(block.rows)
            if count > MOST_FRAMES:
                break
    check_length(count, source)
    rows, time, positions, state = map(np.concatenate, zip(*blocks, strict=True))
    if "time" not in layout.columns:
        time = np.arange(len(time)) * layout.seconds
    elif not layout.has_header:
        # The clock of the machine; subtracted before scaling, which rounds.
        time = (time - time[0]) * layout.seconds
    check_order(time, lambda k: f"{source}: row {rows[k]}, column time", "rows")
    if layout.weighted and state.max() == State.INFERRED:
        # The w of a homogeneous point, which is 1 wherever there is one.
        state = np.where(state > 0, State.TRACKED, State.NOT_TRACKED).astype(np.uint8)
    return recording_of(time, positions, state, layout.skeleton, source, layout.name)


read_kinefilter = partial(_read, _kinefilter)
read_kinect_v2 = partial(_read, _kinect_v2)
read_kinect_v1 = partial(_read, _kinect_v1)
read_msrc_12 = partial(_read, _msrc_12)


def _frames(
    block: Block, layout: _Layout, reader: RowReader
) -> tuple[NDArray[np.intp], Array, Array, NDArray[np.uint8]]:
    """Return row numbers, times [s], positions [m] (R, J, 3) and states (R, J)."""
    skeleton, values = layout.skeleton, block.values
    index = {column: i for i, column in enumerate(layout.columns)}
    positions = np.full((len(values), len(skeleton), 3), np.nan)
    state = np.zeros((len(values), len(skeleton)), dtype=np.uint8)
    for j, joint in enumerate(skeleton.joints):
        if f"{joint}.x" not in index:
            continue
        positions[:, j] = values[:, [index[f"{joint}.{axis}"] for axis in _AXES]]
        state[:, j] = State.TRACKED
        if f"{joint}.state" in index:
            state[:, j] = _states(block, index[f"{joint}.state"], reader)
    time = np.zeros(len(values))
    if "time" in index:
        time = values[:, index["time"]]
        for wrong, words in (
            (np.isnan(time), "is empty, expected a time; delete the row"),
            (
                np.abs(time) > _LATEST,
                "is {:.3g}, expected a time; correct or delete the row",
            ),
        ):
            reader.refuse(block, index["time"], wrong, words)
    return block.rows, time, *missing_marked(positions, state)


def _states(block: Block, column: int, reader: RowReader) -> Array:
    """Return the states in a column; an empty cell says nothing against the joint."""
    values = block.values[:, column]
    states = np.where(np.isnan(values), State.TRACKED, values)
    reader.refuse(
        block,
        column,
        ~np.isin(states, list(State)),
        "is {:g}, expected a tracking state: 0 not tracked, 1 inferred, 2 tracked",
    )
    return states
