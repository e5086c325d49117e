"""Arrays larger than memory: they grow in a file on disk and are read through a map."""

from __future__ import annotations

import tempfile
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from kinefilter.characters import InputError


class Spool:
    """Rows put aside one part after another, in a file that nobody else sees.

    The file lies where temporary files lie (``TMPDIR``), has no name, and is gone with
    the last array that shows it.
    """

    def __init__(self, dtype: DTypeLike) -> None:
        self._dtype = np.dtype(dtype)
        self._file = tempfile.TemporaryFile()  # noqa: SIM115 - open as long as this
        self._count, self._shape = 0, (0,)

    def __len__(self) -> int:
        return self._count

    def add(self, rows: NDArray[Any]) -> None:
        """Put rows after others of their shape; an InputError if the disk is full."""
        self._shape = rows.shape[1:]
        self._count += len(rows)
        try:
            np.ascontiguousarray(rows, dtype=self._dtype).tofile(self._file)
            self._file.flush()
        except OSError as error:
            raise InputError(
                f"{tempfile.gettempdir()}: cannot keep what was read so far "
                f"({error.strerror or error}); make room or set TMPDIR to a larger disk"
            ) from None

    def array(self) -> NDArray[Any]:
        """Return all rows, to be read; what is looked at comes into memory."""
        shape = (self._count, *self._shape)
        if 0 in shape:
            return np.empty(shape, dtype=self._dtype)
        rows = np.memmap(self._file, dtype=self._dtype, mode="r", shape=shape)
        return np.asarray(rows)
