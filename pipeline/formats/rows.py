"""Rows of numbers in text: read fast where all is well, exact about where it is not."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import ClassVar, NoReturn

import numpy as np

from kinefilter.characters import InputError
from kinefilter.characters.arrays import Array, Flags, Indices

LARGEST_NUMBER = 1e9
"""Of lengths and angles at most, whatever their unit; a damaged number may be more."""
_BLOCK_LINES = 2000  # some megabytes of text at a time, whatever the file's length


@dataclass(frozen=True, eq=False)
class Block:
    """Some rows of a file."""

    rows: Indices  # line number of each row, counted from 1, shape (R,)
    values: Array  # the numbers, NaN where a cell is empty, none infinite, (R, C)


@dataclass(frozen=True)
class RowReader:
    """Reads rows of numbers and says where one is wrong."""

    source: str
    columns: tuple[str, ...]
    normalize: Callable[[str], str] = lambda line: ",".join(line.split())
    """Turns a line into comma-separated cells, one per column if the line is right."""

    def blocks(self, lines: Iterable[str], first_row: int) -> Iterator[Block]:
        """Yield the rows in order, blank lines left out.

        The first of the lines has number ``first_row``, counted from 1. Raises
        InputError for a wrong number of columns, text, or an infinite number.
        """
        numbered = enumerate(lines, start=first_row)
        while chunk := list(islice(numbered, _BLOCK_LINES)):
            filled = {row: line.strip() for row, line in chunk if line.strip()}
            if filled:
                texts = [self.normalize(line) for line in filled.values()]
                yield self._block(np.array(list(filled)), texts)

    def _block(self, rows: Indices, texts: list[str]) -> Block:
        try:
            named = [_name_the_empty(text) for text in texts]
            values = np.loadtxt(named, delimiter=",", comments=None, ndmin=2)
        except ValueError:
            values = None
        if values is None or values.shape != (len(rows), len(self.columns)):
            values = np.array(
                [self._cells(row, text) for row, text in zip(rows, texts, strict=True)]
            )
        block = Block(rows, values)
        for column in np.flatnonzero(np.isinf(values).any(axis=0)).tolist():
            words = "is infinite; expected a finite number"
            self.refuse(block, column, np.isinf(values[:, column]), words)
        return block

    def _cells(self, row: int, text: str) -> list[float]:
        cells, numbers = [cell.strip() for cell in text.split(",")], []
        if len(cells) != len(self.columns):
            raise InputError(
                f"{self.source}: row {row} has {len(cells)} columns, expected "
                f"{len(self.columns)}; complete the row or delete it"
            )
        for column, cell in enumerate(cells):
            try:
                numbers.append(float(cell or "nan"))
            except ValueError:
                word = cell if len(cell) <= 40 else f"{cell[:37]}..."
                words = "leave the cell empty if nothing was measured"
                self._fail(row, column, f"is {word!r}, expected a number; {words}")
        return numbers

    def refuse(self, block: Block, column: int, wrong: Flags, words: str) -> None:
        """Raise InputError for the first wrong row (R,); ``{}`` is its number."""
        if wrong.any():
            k = int(np.argmax(wrong))
            self._fail(block.rows[k], column, words.format(block.values[k, column]))

    def _fail(self, row: int, column: int, complaint: str) -> NoReturn:
        name = self.columns[column]
        raise InputError(f"{self.source}: row {row}, column {name} {complaint}")


def _name_the_empty(text: str) -> str:
    """Write nan into empty cells, which numpy's reader does not accept."""
    if ",," in text:
        # Twice: neighbors share a comma, so one pass fills every other cell.
        text = text.replace(",,", ",nan,").replace(",,", ",nan,")
    if text.startswith(","):
        text = f"nan{text}"
    return f"{text}nan" if text.endswith(",") else text


@dataclass
class LineReader:
    """Goes through the lines of a text that is no table, and knows where it is."""

    source: str
    lines: Iterator[str]
    row: int = 0  # number of the last line that was read, counted from 1
    noun: ClassVar[str] = "line"

    def filled(self, comments: str = "") -> Iterator[list[str]]:
        """Yield the words of each line that has some and is no comment."""
        for line in self.lines:
            self.row += 1
            words = line.split()
            if words and words[0][0] not in comments:
                yield words

    def numbers(self, words: Sequence[str], count: int, what: str = "") -> Array:
        """Return words as that many finite numbers, or fail."""
        try:
            numbers = np.array(words, dtype=np.float64)
        except ValueError:
            numbers = np.full(count, np.nan)
        if len(numbers) != count or not (np.abs(numbers) < LARGEST_NUMBER).all():
            found = " ".join(words)[:40]
            self.fail(f"has {what}{found!r}, expected {count} finite numbers")
        return numbers

    def fail(self, complaint: str) -> NoReturn:
        """Raise an InputError about the last line that was read."""
        raise InputError(f"{self.source}: {self.noun} {self.row} {complaint}")
