"""Foot contacts as a table that people can edit."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import CONTACTS, Clip, InputError

from .archive import read_npz
from .files import atomic_path, beginning, open_text
from .rows import RowReader

_HEADER = ("time", *CONTACTS)
_ROUNDED = 5e-4  # s: stamps that were rounded in a spreadsheet are the same


def write_contacts(clip: Clip, path: str | os.PathLike[str]) -> None:
    """Write when which part of a foot stands: 1 on the floor, 0 not, a row a frame.

    Raises:
        InputError: The file cannot be written.
    """
    rows = zip(clip.time.tolist(), clip.contacts.astype(int).tolist(), strict=True)
    with (
        atomic_path(path) as temporary,
        temporary.open("w", encoding="utf-8", newline="\n") as file,
    ):
        file.write(",".join(_HEADER) + "\n")
        file.writelines(
            ",".join([repr(time), *map(str, flags)]) + "\n" for time, flags in rows
        )


def read_contacts(
    path: str | os.PathLike[str], time: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Return the contacts (CONTACTS) of a file at some times, shape (T, 4).

    Each time gets the last row at or before it: a file may have a row per frame, or
    one per change.

    Args:
        path: What ``write_contacts`` wrote, edited or not, or a clip as npz.
        time: Time stamps [s], shape (T,).

    Raises:
        InputError: The file is missing, is no such table, or is of another time.
    """
    if Path(path).suffix.lower() == ".npz":
        clip = read_npz(path)
        stamps, flags = clip.time, clip.contacts
    else:
        stamps, flags = contact_table(path)
    if stamps[0] > time[-1] + _ROUNDED or (len(stamps) > 1 and stamps[-1] < time[0]):
        raise InputError(
            f"{os.fspath(path)}: its times, {stamps[0]:.3f} to {stamps[-1]:.3f} s, lie "
            f"outside of the take's, {time[0]:.3f} to {time[-1]:.3f} s; give the "
            "contacts of this take"
        )
    rows = np.searchsorted(stamps, time + _ROUNDED, side="right") - 1
    return np.asarray(flags[np.maximum(rows, 0)])


def claims_contacts(path: str | os.PathLike[str]) -> bool:
    """Tell whether a file begins as ``write_contacts`` does."""
    return beginning(path).startswith(",".join(_HEADER))


def contact_table(
    path: str | os.PathLike[str],
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return times [s], shape (T,), and contacts (CONTACTS), shape (T, 4), of a table.

    Raises:
        InputError: The file is missing or no such table.
    """
    source = os.fspath(path)
    with open_text(path) as file:
        header = tuple(cell.strip() for cell in next(iter(file), "").split(","))
        if header != _HEADER:
            raise InputError(
                f"{source}: row 1 is {','.join(header)[:60]!r}; expected the header "
                f"{','.join(_HEADER)} that 'kinefilter clean --save-contacts' writes"
            )
        reader = RowReader(source, _HEADER, str.strip)
        blocks = list(reader.blocks(file, 2))
    values = np.concatenate([np.empty((0, 5)), *(block.values for block in blocks)])
    rows = np.concatenate([np.empty(0, int), *(block.rows for block in blocks)])
    wrong = ~np.isin(values[:, 1:], (0.0, 1.0)).all(axis=1) | np.isnan(values[:, 0])
    wrong[1:] |= np.diff(values[:, 0]) < 0.0
    if len(values) == 0 or wrong.any():
        row = int(rows[wrong][0]) if wrong.any() else 2
        raise InputError(
            f"{source}: row {row} is no time after the last and four times 0 or 1; "
            "correct or remove it"
        )
    return values[:, 0], values[:, 1:] == 1.0
