"""Rows of numbers in text: read fast where all is well, exact about where it is not."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import InputError

_BLOCK_LINES = 2000  # some megabytes of text at a time, whatever the file's length


@dataclass(frozen=True, eq=False)
class Block:
    """Some rows of a file."""

    rows: NDArray[np.intp]
    """Line number of each row, counted from 1, shape (R,)."""
    values: NDArray[np.float64]
    """The numbers, NaN where a cell is empty, none infinite, shape (R, C)."""


@dataclass(frozen=True)
class RowReader:
    """Reads rows of numbers and says where one is wrong."""

    source: str
    """The file, for messages."""
    columns: tuple[str, ...]
    """What each column is called."""
    normalize: Callable[[str], str]
    """Turns a line into comma-separated cells, one per column if the line is right."""

    def blocks(self, lines: Iterable[str], first_row: int) -> Iterator[Block]:
        """Yield the rows in order, blank lines left out.

        Args:
            lines: The lines, the first being number ``first_row`` of the file.
            first_row: Line number counted from 1.

        Raises:
            InputError: A row has the wrong number of columns, or a cell holds text or
                an infinite number.
        """
        numbered = enumerate(lines, start=first_row)
        while chunk := [(row, line) for row, line in islice(numbered, _BLOCK_LINES)]:
            filled = [(row, line.strip()) for row, line in chunk if line.strip()]
            if filled:
                yield self._block(filled)

    def _block(self, numbered: list[tuple[int, str]]) -> Block:
        rows = np.array([row for row, _ in numbered])
        texts = [self.normalize(line) for _, line in numbered]
        try:
            values = np.loadtxt(
                [_name_the_empty(text) for text in texts],
                delimiter=",",
                comments=None,
                ndmin=2,
            )
        except ValueError:
            values = None
        if values is None or values.shape != (len(rows), len(self.columns)):
            values = self._cell_by_cell(rows, texts)
        infinite = np.argwhere(np.isinf(values))
        if len(infinite):
            row, column = infinite[0]
            self.fail(rows[row], column, "is infinite; expected a finite number")
        return Block(rows, values)

    def _cell_by_cell(
        self, rows: NDArray[np.intp], texts: list[str]
    ) -> NDArray[np.float64]:
        """Return the numbers, or raise on the first cell that is none."""
        values = np.empty((len(rows), len(self.columns)))
        for i, (row, text) in enumerate(zip(rows, texts, strict=True)):
            cells = text.split(",")
            if len(cells) != len(self.columns):
                raise InputError(
                    f"{self.source}: row {row} has {len(cells)} columns, expected "
                    f"{len(self.columns)}; complete the row or delete it"
                )
            for column, cell in enumerate(cells):
                values[i, column] = self._number(row, column, cell)
        return values

    def _number(self, row: int, column: int, cell: str) -> float:
        if not cell.strip():
            return math.nan
        try:
            return float(cell)
        except ValueError:
            self.fail(
                row,
                column,
                f"is {_shortened(cell)!r}, expected a number; leave the cell empty if "
                "nothing was measured",
            )

    def fail(self, row: int, column: int, complaint: str) -> NoReturn:
        """Raise the InputError that a cell deserves.

        Args:
            row: Line number counted from 1.
            column: Index of the column.
            complaint: The rest of the sentence.
        """
        raise InputError(
            f"{self.source}: row {row}, column {self.columns[column]} {complaint}"
        )


def _name_the_empty(text: str) -> str:
    """Write nan into empty cells, which numpy's reader does not accept."""
    if ",," in text:
        # Twice: neighbors share a comma, so one pass fills every other cell.
        text = text.replace(",,", ",nan,").replace(",,", ",nan,")
    if text.startswith(","):
        text = f"nan{text}"
    return f"{text}nan" if text.endswith(",") else text


def _shortened(cell: str) -> str:
    cell = cell.strip()
    return cell if len(cell) <= 40 else f"{cell[:37]}..."
