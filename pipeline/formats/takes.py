"""Takes out of the files that sensors and their tools write, whatever their layout."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator

from kinefilter.characters import InputError, Take
from kinefilter.pipeline.config import TakeFormat

from .azure import LARGEST, read_azure
from .bvh_takes import read_bvh_take
from .files import beginning, open_text, read_limited
from .layouts import LAYOUTS, V2_CELLS
from .msr_action3d import read_msr_action3d
from .ntu import read_ntu
from .recording import Recording
from .sheets import read_sheet

_MSRC_CELLS = 81
_MSR_CELLS = 4
_NAMES = re.compile(r"\b(Spine|HipCenter|SpineBase)\b")
"""Joints that headers of takes name: the root or what hangs on it."""
_AZURE_KEYS = ('"bone_list"', '"joint_names"', '"timestamp_usec"', '"joint_positions"')
_AZURE_BEGINNING = 2**16  # characters: a bone list is a tenth of it

# Path of a file, number and text of its first line that is not blank, those after it.
_Reader = Callable[[str, tuple[int, str], Iterator[str]], Recording]


def read_take(
    path: str | os.PathLike[str],
    *,
    format: str | None = None,  # noqa: A002 - the word that users know
    body: int | None = None,
) -> Take:
    """Read a recording of a person.

    Known formats, told apart by content; each may be gzipped:

    - ``kinefilter``: header ``time,Joint.x,Joint.y,Joint.z,Joint.state,...``, seconds
      and meters. An empty cell is missing; joints in any order; states may be left out.
    - ``kinect-v2``: no header, time in units of 100 ns, then x, y, z and state of the
      25 joints in the SDK's order. Time is counted from the first frame.
    - ``kinect-v1``: header of 20 joint names split by ``;``, then ``x y z`` per joint;
      30 frames a second, no states.
    - ``msrc-12``: no header, time in microseconds, then x, y, z and state of Kinect
      v1's 20 joints in the SDK's order, split by blanks or commas. Where no state is 2,
      1 says that there is a joint (Fothergill et al. 2012, CHI).
    - ``msr-action3d``: see ``msr_action3d``. ``ntu``: see ``ntu``. ``azure``: see
      ``azure``. ``bvh``: see ``bvh_takes``.

    A joint that is not tracked, not a number or exactly at the origin, where the
    sensors put what they do not see, is missing: NaN and state 0.

    Args:
        path: The file.
        format: One of the names above, to not go by content.
        body: Which person, counted from 1 in the order in which they appear; by default
            the one who is seen in most frames.

    Raises:
        InputError: The file is missing, malformed, empty of joints or not in meters;
            the message says where.
    """
    return read_recording(path, format=format).take(body)


def read_takes(
    path: str | os.PathLike[str],
    *,
    format: str | None = None,  # noqa: A002 - the word that users know
) -> tuple[Take, ...]:
    """Read a recording of several people: a take each, as they appear.

    Raises:
        InputError: As ``read_take``.
    """
    return read_recording(path, format=format).takes


def read_recording(
    path: str | os.PathLike[str],
    *,
    format: str | None = None,  # noqa: A002 - the word that users know
) -> Recording:
    """Read a file with what there is to know about it.

    Raises:
        InputError: As ``read_take``.
    """
    source = os.fspath(path)
    if format is not None and format not in FORMATS:
        raise InputError(f"unknown take format {format!r}; known: {', '.join(FORMATS)}")
    name = format
    if name is None and beginning(path).startswith("{"):
        name = "azure"  # its first line may be all of it
    if name in _WHOLE:
        return _WHOLE[name](source)
    with open_text(path) as lines:
        head = _first_line(lines, source)
        name = name or _detected(head[1], source)
        if name in _WHOLE:
            return _WHOLE[name](source)
        return _BY_LINE[name](source, head, lines)


def claims_take(path: str | os.PathLike[str]) -> bool:
    """Return whether a file claims by how it begins to be a recording.

    What is said before the joints must be there: names of joints in a header, or
    numbers, so that notes and other tables are told from a recording that is damaged.

    Raises:
        InputError: The file is missing, empty, or cannot be read as text.
    """
    start = beginning(path, _AZURE_BEGINNING)
    if start.startswith("{"):
        return any(key in start for key in _AZURE_KEYS)
    source = os.fspath(path)
    with open_text(path) as lines:
        line = _first_line(lines, source)[1]
    try:
        name = _detected(line, source)
    except InputError:
        return False
    if name in ("kinefilter", "kinect-v1"):
        return _NAMES.search(line) is not None
    return name == "bvh" or _all_numbers(line)


def _all_numbers(line: str) -> bool:
    try:
        return bool([float(word) for word in line.replace(",", " ").split()])
    except ValueError:
        return False


def _first_line(lines: Iterator[str], source: str) -> tuple[int, str]:
    """Return number and text of the first line that is not blank."""
    for row, line in enumerate(lines, start=1):
        if line.strip():
            return row, line
    raise InputError(f"{source}: the file is empty; expected a recorded take")


def _detected(line: str, source: str) -> TakeFormat:
    """Return the format of a file by its first line."""
    cells, words = line.strip().split(","), line.replace(",", " ").split()
    if cells[0].strip().strip('"').lower() == "time":
        return "kinefilter"
    if words == ["HIERARCHY"]:
        return "bvh"
    if ";" in line:
        return "kinect-v1"
    if len(cells) in (V2_CELLS, V2_CELLS + 1):
        return "kinect-v2"
    if len(words) == _MSRC_CELLS:
        return "msrc-12"
    if len(words) == _MSR_CELLS and len(cells) == 1:
        return "msr-action3d"
    if len(words) == 1 and words[0].isdigit():
        return "ntu"
    raise InputError(
        f"{source}: row 1 is of no known layout ({len(cells)} comma-separated cells); "
        "expected a kinefilter CSV (header time,Joint.x,Joint.y,Joint.z,Joint.state), "
        f"Kinect v2 rows of {V2_CELLS} numbers, Kinect v1 joints split by ;, or one of "
        f"the other formats: {', '.join(list(FORMATS)[3:])}"
    )


def _sheet(name: str) -> _Reader:
    def read(source: str, head: tuple[int, str], lines: Iterator[str]) -> Recording:
        return read_sheet(source, head, lines, LAYOUTS[name](head[1], source))

    return read


def _azure(source: str) -> Recording:
    return read_azure(read_limited(source, LARGEST), source)


_BY_LINE: dict[str, _Reader] = {
    "kinefilter": _sheet("kinefilter"),
    "kinect-v2": _sheet("kinect-v2"),
    "kinect-v1": _sheet("kinect-v1"),
    "msrc-12": _sheet("msrc-12"),
    "msr-action3d": read_msr_action3d,
    "ntu": read_ntu,
}
_WHOLE: dict[str, Callable[[str], Recording]] = {
    "azure": _azure,
    "bvh": read_bvh_take,
}

FORMATS = (*_BY_LINE, *_WHOLE)
"""Names of all formats (pipeline.config.TakeFormat)."""
