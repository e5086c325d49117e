"""Foot contacts as a table that people can edit."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import CONTACTS, Clip, InputError
from kinefilter.characters.arrays import Array

from .files import atomic_path, beginning, open_text
from .npz import read_npz
from .rows import RowReader

_HEADER = ("time", *CONTACTS)
_ROUNDED = 5e-4  # s: stamps that were rounded in a spreadsheet are the same


def write_contacts(clip: Clip, path: str | os.PathLike[str]) -> None:
    """Write 1 where a part of a foot is on the floor, else 0, one row per frame.

    Raises InputError if the file cannot be written.
    """
    rows = zip(clip.time.tolist(), clip.contacts.astype(int).tolist(), strict=True)
    with (
        atomic_path(path) as temporary,
        temporary.open("w", encoding="utf-8", newline="\n") as file,
    ):
        file.write(",".join(_HEADER) + "\n")
        for time, flags in rows:
            file.write(",".join([repr(time), *map(str, flags)]) + "\n")


def read_contacts(path: str | os.PathLike[str], time: Array) -> NDArray[np.bool_]:
    """Return the contacts (CONTACTS) of a file at times [s] (T,), shape (T, 4).

    The file is one of ``write_contacts``, edited or not, or a clip as npz. Each time
    gets the last row at or before it: a file may have a row per frame, or one per
    change. Raises InputError if it is missing, no such table, or of another time.
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


def contact_table(path: str | os.PathLike[str]) -> tuple[Array, NDArray[np.bool_]]:
    """Return times [s] (T,) and contacts (T, 4) of a table; raises InputError."""
    source = os.fspath(path)
    with open_text(path) as file:
        header = tuple(cell.strip() for cell in next(iter(file), "").split(","))
        if header != _HEADER:
            raise InputError(
                f"{source}: row 1 is {','.join(header)[:60]!r}; expected the header "
                f"{','.join(_HEADER)} that 'kinefilter clean --save-contacts' writes"
            )
        blocks = list(RowReader(source, _HEADER, str.strip).blocks(file, 2))
    values = np.concatenate([np.empty((0, 5)), *(block.values for block in blocks)])
    rows = np.concatenate([np.empty(0, int), *(block.rows for block in blocks)])
    time, flags = values[:, 0], values[:, 1:]
    wrong = ~np.isin(flags, (0.0, 1.0)).all(axis=1) | np.isnan(time)
    wrong[1:] |= np.diff(time) < 0.0
    if len(values) == 0 or wrong.any():
        row = int(rows[wrong][0]) if wrong.any() else 2
        raise InputError(
            f"{source}: row {row} is not a time after the last and four times 0 or 1; "
            "correct or remove it"
        )
    return time, flags == 1.0
