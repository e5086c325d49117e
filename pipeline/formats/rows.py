"""Readers of numbers in text files: fast on valid rows, precise about wrong ones."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from typing import ClassVar, NoReturn

import numpy as np

from kinefilter.characters import InputError
from kinefilter.characters.arrays import Array, Flags, Indices

from .files import open_text
from .plain import counted

MOST_FRAMES = 1_000_000  # per recording: nine hours at 30 frames/s
STATES = "a tracking state: 0 not tracked, 1 inferred or 2 tracked"
LARGEST_NUMBER = 1e9
"""Largest length or angle in any unit; a larger number means damage."""
_BLOCK_LINES = 2000  # a few megabytes of text in memory, however long the file


@contextmanager
def open_rows(source: str) -> Iterator[tuple[int, str, Iterator[str]]]:
    """Yield the number and text of the first line that is not blank, and the rest."""
    with open_text(source) as lines:
        for row, line in enumerate(lines, start=1):
            if line.strip():
                yield row, line, lines
                return
        raise InputError(f"{source}: the file is empty; expected a recorded take")


@dataclass(frozen=True, eq=False)
class Block:
    """Consecutive rows of a file."""

    rows: Indices  # line number of each row, counted from 1, shape (R,)
    values: Array  # the numbers, NaN for empty cells, never infinite, shape (R, C)


@dataclass(frozen=True)
class RowReader:
    """Parser of rows of numbers whose errors name the row and the column."""

    source: str
    columns: tuple[str, ...]
    normalize: Callable[[str], str] = lambda line: ",".join(line.split())
    """Turns a line into comma-separated cells, one per column if the line is valid."""
    hint: str = "leave the cell empty if nothing was measured"
    """What to do about a cell that is no number."""

    def read(self, lines: Iterable[str], first: int, most: float = math.inf) -> Block:
        """Read all rows in order, without blank lines.

        ``first`` is the number of the first line, counted from 1. Stops early, after
        ``most`` rows or more. Raises InputError for all but rows of finite numbers.
        """
        numbered, count = enumerate(lines, start=first), 0
        blocks = [Block(np.empty(0, int), np.empty((0, len(self.columns))))]
        while count <= most and (chunk := list(islice(numbered, _BLOCK_LINES))):
            # A tab at either end may be next to an empty cell.
            if filled := {k: line.strip(" \r\n") for k, line in chunk if line.strip()}:
                texts = [self.normalize(line) for line in filled.values()]
                blocks.append(self._block(np.array(list(filled)), texts))
                count += len(filled)
        rows = np.concatenate([block.rows for block in blocks])
        return Block(rows, np.concatenate([block.values for block in blocks]))

    def _block(self, rows: Indices, texts: list[str]) -> Block:
        try:
            named = [_fill_empty_cells(text) for text in texts]
            values = np.loadtxt(named, delimiter=",", comments=None, ndmin=2)
        except ValueError:
            values = np.empty(0)
        if values.shape != (len(rows), len(self.columns)):
            numbered = zip(rows, texts, strict=True)
            values = np.array([self._numbers(row, text) for row, text in numbered])
        block = Block(rows, values)
        self.refuse(block, np.isinf(values), "is infinite; expected a finite number")
        return block

    def _numbers(self, row: int, text: str) -> list[float]:
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
                is_time = self.columns[column] == "time"
                hint = "correct or delete the row" if is_time else self.hint
                self._fail(row, column, f"is {word!r}, expected a number; {hint}")
        return numbers

    def refuse(self, block: Block, wrong: Flags, complaint: str) -> None:
        """Refuse the first wrong number (R, C), which is ``{}`` in the complaint."""
        if wrong.any():
            k, column = np.argwhere(wrong)[0].tolist()
            self._fail(block.rows[k], column, complaint.format(block.values[k, column]))

    def _fail(self, row: int, column: int, complaint: str) -> NoReturn:
        name = self.columns[column]
        raise InputError(f"{self.source}: row {row}, column {name} {complaint}")


def _fill_empty_cells(text: str) -> str:
    """Write nan into empty cells, which numpy's reader does not accept."""
    if ",," in text:
        # Twice: neighbors share a comma, so one pass fills every other cell.
        text = text.replace(",,", ",nan,").replace(",,", ",nan,")
    if text.startswith(","):
        text = f"nan{text}"
    return f"{text}nan" if text.endswith(",") else text


@dataclass
class LineReader:
    """Reader of a text that is not a table; its errors name the current line."""

    source: str
    lines: Iterator[str]
    row: int = 0  # number of the last line read, counted from 1
    noun: ClassVar[str] = "line"

    def filled(self, comments: str = "") -> Iterator[list[str]]:
        """Yield the words of each line that is neither blank nor a comment."""
        for line in self.lines:
            self.row += 1
            words = line.split()
            if words and words[0][0] not in comments:
                yield words

    def numbers(self, words: Sequence[str], count: int, what: str = "") -> Array:
        """Convert words to ``count`` finite numbers, or fail."""
        try:
            numbers = np.array(words, dtype=np.float64)
        except ValueError:
            numbers = np.full(count, np.nan)
        if len(numbers) != count or not (np.abs(numbers) < LARGEST_NUMBER).all():
            found = " ".join(words)[:40]
            wanted = f"{counted(count, 'finite number')} under {LARGEST_NUMBER:g}"
            self.fail(f"has {what}{found!r}, expected {wanted}")
        return numbers

    def fail(self, complaint: str) -> NoReturn:
        """Raise an InputError about the last line that was read."""
        raise InputError(f"{self.source}: {self.noun} {self.row} {complaint}")
