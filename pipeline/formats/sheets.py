"""Takes as tables, one row per frame: kinefilter's own CSV and the Kinects'.

In kinefilter's, joints are in any order and states are optional. If no state of MSRC-12
is 2, then 1 only marks a joint as present (Fothergill et al. 2012, CHI).
"""

import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain

import numpy as np

from kinefilter.characters import InputError, Take
from kinefilter.characters.arrays import Array, Codes, Flags, chunks
from kinefilter.characters.motion import CONTACTS, Clip, Origin, State, check_order
from kinefilter.characters.skeleton import KINECT_V1, KINECT_V2, SKELETONS, Skeleton

from .files import AnyPath, beginning, new_text, open_text
from .npz import read_npz
from .recording import Recording, check_length, mark_missing, takes_of_rows
from .rows import MOST_FRAMES, STATES, Block, RowReader, open_rows

PART = ".part.csv"
"""Suffix of recordings by ``live``; if it is killed, the last row may be incomplete."""
_LATEST = 1e19  # in any format's unit of time: some clocks count from centuries ago
_AXES = ("x", "y", "z")
_OURS = (*_AXES, "state")
_MERGED = ("reliability", "sensor")
"""Extra columns per joint of merged takes: informative, cleaning ignores them."""
_CONTACT_HEADER = ("time", *CONTACTS)
_ROUNDED = 5e-4  # s: tolerance for time stamps that a spreadsheet has rounded


def _columns(skeleton: Skeleton, parts: Sequence[str] = _OURS) -> tuple[str, ...]:
    return ("time", *(f"{joint}.{part}" for joint in skeleton.joints for part in parts))


def write_take_csv(motion: Take | Clip, path: AnyPath) -> None:
    """Write time [s], joint positions [m] and tracking states, one row per frame.

    The header is ``time,Joint.x,Joint.y,Joint.z,Joint.state,...`` in the sensor's
    order. In a clip, every joint that was corrected or filled counts as inferred.
    Positions have nine decimals, times are exact; missing ones are empty cells.
    """
    state = motion.state
    if isinstance(motion, Clip):
        measured = motion.origin == Origin.MEASURED
        state = np.where(measured, np.maximum(state, State.INFERRED), State.INFERRED)
    with new_text(path) as file:
        file.write(take_header(motion.skeleton))
        for span in chunks(len(motion)):
            rows = take_rows(motion.time[span], motion.positions[span], state[span])
            file.write(rows)


def write_merged_csv(
    take: Take, reliability: Array, shares: Array, path: AnyPath
) -> None:
    """Write a merged take, with two more columns per joint.

    These are ``Joint.reliability``, shape (T, J), and ``Joint.sensor``: the number,
    from 1, of the sensor with the largest share (T, S, J), 0 where none has the joint.
    """
    largest = np.where(shares.max(axis=1) > 0.0, 1 + shares.argmax(axis=1), 0)
    names = _columns(take.skeleton, _MERGED)[1:]
    each = np.stack([reliability, largest], axis=-1).reshape(len(take), -1)
    row = ",%.3f,%d" * len(take.skeleton) + "\n"
    with new_text(path) as file:
        file.write(take_header(take.skeleton).rstrip("\n") + f",{','.join(names)}\n")
        for k, one in enumerate(chunks(len(take), 1)):
            line = take_rows(take.time[one], take.positions[one], take.state[one])
            file.write(line.rstrip("\n") + row % tuple(each[k].tolist()))


def take_header(skeleton: Skeleton) -> str:
    """Return the header line of a take's CSV."""
    return ",".join(_columns(skeleton)) + "\n"


def take_rows(time: Array, positions: Array, state: Codes) -> str:
    """Format frames as lines of CSV; shapes (T,), (T, J, 3) and (T, J)."""
    count, joints = state.shape
    row = ",".join(["%r", *["%.9f,%.9f,%.9f,%d"] * joints]) + "\n"
    each = np.concatenate([positions, state[..., None]], axis=-1)
    numbers = np.concatenate([time[:, None], each.reshape(count, -1)], axis=1)
    text: str = row * count % tuple(numbers.ravel().tolist())
    return text.replace("nan", "")


@dataclass(frozen=True)
class _Layout:
    skeleton: Skeleton
    columns: tuple[str, ...]
    normalize: Callable[[str], str]  # see RowReader
    seconds: float  # per unit of the time column, or per frame without this column
    has_header: bool = False
    weighted: bool = False  # states that are all 0 or 1 only mark missing joints


def separator_of(header: str) -> str:
    """Return what separates the columns of a header: a comma, semicolon or tab."""
    return max(",;\t", key=header.count)


def header_cells(line: str) -> tuple[str, ...]:
    """Return the columns of a header with commas, semicolons or tabs between them."""
    cells = [cell.strip().strip('"') for cell in line.split(separator_of(line))]
    return tuple("time" if cell.lower() == "time" else cell for cell in cells)


def _with_commas(header: str) -> Callable[[str], str]:
    """Return what turns the lines below a header into cells with commas between."""
    separator = separator_of(header)

    def normalize(line: str) -> str:
        line = line.replace('"', "")
        if separator != ",":  # then a comma is a decimal one
            line = line.replace(",", ".").replace(separator, ",")
        return line

    return normalize


def _kinefilter(line: str, source: str) -> _Layout:
    columns = header_cells(line)
    named = [column for column in columns if column]  # spreadsheets add empty ones
    parts = [column for column in named if column != "time"]
    joints = tuple(dict.fromkeys(part.rpartition(".")[0] or part for part in parts))
    skeletons = sorted(SKELETONS.values(), key=len)
    # The skeleton with most of the joints, the smallest among equals.
    skeleton = max(skeletons, key=lambda s: len(set(joints) & set(s.joints)))
    needed = [f"{joint}.{axis}" for joint in joints for axis in _AXES]
    twice = [name for name, times in Counter(named).items() if times > 1]
    known = {*_columns(skeleton), *_columns(skeleton, _MERGED)}
    wrong = ""
    if "time" not in named:
        wrong = f", column 1 is {columns[0][:40]!r}, expected the header 'time'"
    elif twice:
        wrong = f" has column {twice[0][:40]!r} twice; delete one of them"
    elif not joints:
        wrong = " names no joints; expected columns such as Head.x after 'time'"
    elif unknown := [joint for joint in joints if joint not in skeleton.joints]:
        wrong = (
            f", joint {unknown[0][:40]!r} is not one of {skeleton.name}: "
            f"{', '.join(skeleton.joints)}; rename its columns, such as Head.x, or "
            "delete them"
        )
    elif unknown := [name for name in named if name not in known]:
        wrong = (
            f", column {unknown[0][:40]!r} is unknown; expected x, y, z or state after "
            "the joint, such as Head.x"
        )
    elif missing := [column for column in needed if column not in columns]:
        wrong = f" has no column {missing[0]}; add it or delete the joint's columns"
    if wrong:
        raise InputError(f"{source}: row 1{wrong}")
    return _Layout(skeleton, columns, _with_commas(line), 1.0, has_header=True)


def _kinect_v1(line: str, source: str) -> _Layout:
    names = [n.strip().strip('"') for n in line.strip().rstrip(";").split(";")]
    joints = tuple(name for name in names if name in KINECT_V1.joints)
    strangers = [name for name in names[: len(KINECT_V1)] if name not in joints]
    if strangers or len(set(joints)) < len(KINECT_V1):
        found = f"{strangers[0][:40]!r}" if strangers else f"{len(set(joints))} joints"
        raise InputError(
            f"{source}: row 1 has {found}, expected the {len(KINECT_V1)} joint names "
            f"of {KINECT_V1.name} separated by ;: {', '.join(KINECT_V1.joints)}"
        )

    def normalize(line: str) -> str:
        cells = line.split(";")
        if len(cells) == len(KINECT_V1) + 1:
            del cells[-1]  # a label of the action
        return ",".join(",".join(cell.split()) or ",," for cell in cells)

    columns = tuple(f"{joint}.{axis}" for joint in joints for axis in _AXES)
    return _Layout(KINECT_V1, columns, normalize, 1 / 30, has_header=True)


def _v2_cells(line: str) -> str:
    # The recorder puts a comma after every cell, including the last.
    return line[:-1] if line.count(",") == len(_V2_COLUMNS) else line


def _msrc_cells(line: str) -> str:
    return ",".join(line.replace(",", " ").split())


_V2_COLUMNS = _columns(KINECT_V2)
_V2 = _Layout(KINECT_V2, _V2_COLUMNS, _v2_cells, 100e-9)
_MSRC = _Layout(KINECT_V1, _columns(KINECT_V1), _msrc_cells, 1e-6, weighted=True)


def _read(layout_of: Callable[[str, str], _Layout], source: str) -> Recording:
    with open_rows(source) as (row, line, lines):
        layout = layout_of(line, source)
        if not layout.has_header:
            stamp, comma, _ = line.partition(",")
            if comma and "." in stamp:  # in seconds, while these clocks count ticks
                names = ",".join(layout.columns[:5])
                raise InputError(
                    f"{source}: row 1 begins with {stamp[:40]!r}; a table with times "
                    f"in seconds needs a header, {names},...; add it"
                )
            lines = chain([line], lines)
        reader = RowReader(source, layout.columns, layout.normalize)
        first, notes = row + layout.has_header, list[str]()
        if source.endswith(PART):
            lines = _without_torn_end(lines, first, layout.columns, notes)
        block = reader.read(lines, first, MOST_FRAMES)
    check_length(len(block.rows), source)
    positions, state = _joints(block, layout, reader)
    time = _time(block, layout, reader)
    check_order(time, lambda k: f"{source}: row {block.rows[k]}, column time", "rows")
    if layout.weighted and state.max() == State.INFERRED:
        # Not states but the w of homogeneous points, 1 for every joint present.
        state = np.where(state > 0, State.TRACKED, State.NOT_TRACKED).astype(np.uint8)
    takes, others = takes_of_rows(time, positions, state, layout.skeleton, source)
    return Recording(takes, notes=(*notes, *others))


def _without_torn_end(
    lines: Iterable[str], first_row: int, columns: Sequence[str], notes: list[str]
) -> Iterator[str]:
    """Yield lines except an incomplete last one, which is noted instead."""
    for row, line in enumerate(lines, start=first_row):
        if line.endswith("\n") or line.count(",") >= len(columns) - 1:
            yield line
        else:
            notes.append(f"row {row} is incomplete: it is left out")


read_kinefilter = partial(_read, _kinefilter)
read_kinect_v2 = partial(_read, lambda *_: _V2)
read_kinect_v1 = partial(_read, _kinect_v1)
read_msrc_12 = partial(_read, lambda *_: _MSRC)


def _joints(block: Block, layout: _Layout, reader: RowReader) -> tuple[Array, Codes]:
    """Return positions [m] (R, J, 3) and states (R, J)."""
    states = np.array([column.endswith(".state") for column in layout.columns])
    known = np.isnan(block.values) | np.isin(block.values, list(State))
    reader.refuse(block, states & ~known, f"is {{:g}}, expected {STATES}")
    index = {column: i for i, column in enumerate(layout.columns)}
    # A last column stands for those that the file does not have.
    values = np.pad(block.values, ((0, 0), (0, 1)), constant_values=np.nan)
    columns = [index.get(column, -1) for column in _columns(layout.skeleton)[1:]]
    joints = values[:, columns].reshape(len(values), len(layout.skeleton), -1)
    # An empty state does not make the joint missing.
    state = np.nan_to_num(joints[..., 3], nan=State.TRACKED)
    return mark_missing(joints[..., :3], state.astype(np.uint8))


def _time(block: Block, layout: _Layout, reader: RowReader) -> Array:
    """Return times [s] (R,)."""
    if "time" not in layout.columns:
        return np.arange(len(block.rows), dtype=np.float64) * layout.seconds
    times = np.array(layout.columns) == "time"
    empty = "is empty, expected a time; delete the row"
    reader.refuse(block, times & np.isnan(block.values), empty)
    late = "is {:.3g}, expected a time; correct or delete the row"
    reader.refuse(block, times & (np.abs(block.values) > _LATEST), late)
    time: Array = block.values[:, times][:, 0]
    # Without a header they are clock readings, which scaling alone would round.
    return time if layout.has_header else (time - time[0]) * layout.seconds


def write_contacts(clip: Clip, path: AnyPath) -> None:
    """Write the contacts of a clip: 1 on the floor, else 0, one row per frame."""
    with new_text(path) as file:
        file.write(",".join(_CONTACT_HEADER) + "\n")
        for time, flags in zip(clip.time.tolist(), clip.contacts, strict=True):
            file.write(",".join([repr(time), *map(str, flags.astype(int))]) + "\n")


def read_contacts(path: AnyPath, time: Array) -> Flags:
    """Read contacts (CONTACTS) at times [s] (T,) from a file, shape (T, 4).

    The file comes from ``write_contacts``, edited or not, or is a clip as npz. Each
    time gets the last row at or before it, so a file may have one row per frame or one
    per change. Raises InputError if the file is missing or malformed, or if its times
    and those given do not overlap.
    """
    stamps, flags = contact_table(path)
    if stamps[0] > time[-1] + _ROUNDED or (len(stamps) > 1 and stamps[-1] < time[0]):
        raise InputError(
            f"{os.fspath(path)}: its times, {stamps[0]:.3f} to {stamps[-1]:.3f} s, are "
            f"outside the take's, {time[0]:.3f} to {time[-1]:.3f} s; use this take's"
        )
    rows = np.searchsorted(stamps, time + _ROUNDED, side="right") - 1
    return np.asarray(flags[np.maximum(rows, 0)])


def claims_contacts(path: AnyPath) -> bool:
    """Return True if a file begins like one of ``write_contacts``."""
    return header_cells(beginning(path).partition("\n")[0]) == _CONTACT_HEADER


def contact_table(path: AnyPath) -> tuple[Array, Flags]:
    """Read times [s] (T,) and contacts (T, 4), from CSV or npz, or raise InputError."""
    source = os.fspath(path)
    if source.lower().endswith(".npz"):
        clip = read_npz(path)
        return clip.time, clip.contacts
    with open_text(path) as file:
        header = next(iter(file), "")
        if header_cells(header) != _CONTACT_HEADER:
            raise InputError(
                f"{source}: row 1 is {header.strip()[:60]!r}; expected the header "
                f"{','.join(_CONTACT_HEADER)} of 'kinefilter clean --save-contacts'"
            )
        cells, hint = _with_commas(header), "write 1 on the floor, 0 above it"
        block = RowReader(source, _CONTACT_HEADER, cells, hint).read(file, 2)
    time, flags = block.values[:, 0], block.values[:, 1:]
    wrong = ~np.isin(flags, (0.0, 1.0)).all(axis=1) | np.isnan(time)
    wrong[1:] |= np.diff(time) < 0.0
    if len(time) == 0 or wrong.any():
        row = int(block.rows[wrong][0]) if wrong.any() else 2
        raise InputError(
            f"{source}: row {row}: expected a time not before the previous row's and "
            "four flags, 0 or 1; correct or remove the row"
        )
    return time, flags == 1.0
