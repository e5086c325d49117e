"""Arrays larger than memory, written to a file on disk and read memory-mapped."""

import tempfile
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from kinefilter.characters import InputError


class Spool:
    """An array that grows row by row in a temporary file.

    The file is in the system's temporary folder (``TMPDIR``), has no name, and is
    deleted with the last array that maps it.
    """

    def __init__(self, dtype: DTypeLike) -> None:
        self._dtype = np.dtype(dtype)
        self._file = tempfile.TemporaryFile()  # noqa: SIM115 - open as long as self
        self._count, self._shape = 0, (0,)

    def __len__(self) -> int:
        return self._count

    def add(self, rows: NDArray[Any]) -> None:
        """Append rows of one shape, or raise an InputError if the disk is full."""
        self._shape = rows.shape[1:]
        self._count += len(rows)
        try:
            np.ascontiguousarray(rows, dtype=self._dtype).tofile(self._file)
            self._file.flush()
        except OSError as error:
            raise InputError(
                f"{tempfile.gettempdir()}: cannot store temporary data "
                f"({error.strerror or error}); free space or point TMPDIR elsewhere"
            ) from None

    def array(self) -> NDArray[Any]:
        """Return all rows, read-only; rows are loaded into memory on access."""
        shape = (self._count, *self._shape)
        if 0 in shape:
            return np.empty(shape, dtype=self._dtype)
        rows = np.memmap(self._file, dtype=self._dtype, mode="r", shape=shape)
        return np.asarray(rows)
