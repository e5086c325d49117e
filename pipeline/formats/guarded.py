"""Files that libraries in C++ read, in a process of bounded memory and time.

The readers of C3D and binary USD believe what a file says of itself: of a damaged one
they ask for any amount of memory, or never end. So they run in a process of their own,
which is ended where it goes too far, and hand over plain arrays.
"""

from __future__ import annotations

import importlib
import io
import os
import subprocess
import sys
import zipfile
from contextlib import suppress
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import InputError

from .files import AnyPath, check_file

_SECONDS, _PER_BYTE = 15.0, 2e-6
"""Processor time [s] for any file, and more for each byte: hundreds of times what whole
files need. A guess."""
_PATIENCE = 8.0  # times as long by the clock, on a machine that is busy
_LOOK = 0.1  # s between looks at its memory and time
_MEMORY = 2 * 2**30  # bytes, libraries included
_LARGEST_USD = 2**31  # bytes
_NAME = "kinefilter.pipeline.formats.guarded"
_REFUSED = 3  # exit code: the message is on the standard error


def read_guarded(reader: str, path: str) -> dict[str, NDArray[Any]]:
    """Return the arrays that a function of this package makes of a file.

    The reader is a module and a name, such as ``usd_reader:clip_arrays``. Raises
    InputError if it refuses the file, fails, or needs too much.
    """
    command = [sys.executable, "-m", _NAME, reader, path]
    import psutil  # only here is it needed

    own = {"OPENBLAS_NUM_THREADS": "1", "PYTHONIOENCODING": "utf-8"}
    pipes: Any = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    most = _SECONDS + _PER_BYTE * Path(path).stat().st_size
    with subprocess.Popen(command, env=os.environ | own, **pipes) as reading:
        for look in count(1):
            with suppress(subprocess.TimeoutExpired):
                output, said = reading.communicate(timeout=_LOOK)
                break
            used = 0.0
            with suppress(psutil.Error):
                watched = psutil.Process(reading.pid)
                used = sum(watched.cpu_times()[:2])
                if watched.memory_info().rss > _MEMORY:
                    reading.kill()
            if used > most or look * _LOOK > _PATIENCE * most:
                reading.kill()
                raise InputError(
                    f"{path}: takes over {most:.0f} s to read; it is damaged"
                )
    if reading.returncode == _REFUSED:
        raise InputError(said.decode("utf-8", "replace").splitlines()[-1])
    if reading.returncode != 0:
        raise InputError(
            f"{path}: the reader failed (code {reading.returncode}); damaged or too "
            "large?"
        )
    with np.load(io.BytesIO(output), allow_pickle=False) as file:
        return {key: file[key] for key in file.files}


def read_usd(reader: str, path: AnyPath) -> dict[str, NDArray[Any]]:
    """Return the arrays that a function of ``usd_reader`` makes of a file.

    Raises InputError as ``read_guarded``, and for files too large to be opened at all.
    """
    source, size = os.fspath(path), check_file(path).stat().st_size
    if size > _LARGEST_USD:
        raise InputError(f"{source}: {size / 1e6:.0f} MB is more than any USD clip has")
    if Path(source).suffix.lower() == ".usdz":
        try:
            with zipfile.ZipFile(source) as archive:
                members = archive.infolist()
        except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError):
            wrong = "damaged USD package; export it again"
            raise InputError(f"{source}: {wrong}") from None
        stored = all(member.compress_type == zipfile.ZIP_STORED for member in members)
        if not stored or sum(member.file_size for member in members) > size:
            wrong = "packed smaller than USD may be; export it again"
            raise InputError(f"{source}: {wrong}")
    return read_guarded(f"usd_reader:{reader}", source)


def _main(reader: str, path: str) -> int:
    if sys.platform == "linux":  # elsewhere who waits looks at the memory
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    # What the libraries themselves print must not get between the arrays.
    output = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    module, _, function = reader.partition(":")
    found = importlib.import_module(f"kinefilter.pipeline.formats.{module}")
    try:
        arrays = getattr(found, function)(path)
    except InputError as error:
        sys.stderr.write(f"\n{error}\n")
        return _REFUSED
    with output:
        np.savez(output, **arrays)
    return 0


if __name__ == "__main__":
    sys.exit(_main(*sys.argv[1:]))
