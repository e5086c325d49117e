"""Readers in C++ libraries, run in a process with limited memory and time.

The readers of C3D and binary USD trust what a file says about itself: a damaged one may
make them ask for any amount of memory, or never return. They run in a process of their
own, which is killed above its limits, and hand over plain arrays.
"""

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

from .files import AnyPath, check_file, refused

_SECONDS, _PER_BYTE = 15.0, 2e-6
"""Limit of processor time [s] for any file, and in addition per byte: hundreds of times
what valid files need. A guess."""
_PATIENCE = 8.0  # wall time over processor time at most, on a busy machine
_INTERVAL = 0.1  # s between checks of memory and time
_MEMORY, _MEMORY_PER_BYTE = 2 * 2**30, 40
"""Limit of memory [bytes] for any file, libraries included, and in addition per byte:
twice what USD of an hour takes."""
_LARGEST_USD = 2**31  # bytes
_REFUSED = 3  # exit code: the message is on standard error


def read_guarded(reader: str, path: str) -> dict[str, NDArray[Any]]:
    """Read arrays from a file with a function of this package, in another process.

    ``reader`` is its module and name, such as ``usd_reader:clip_arrays``. Raises
    InputError if the reader refuses the file, fails, or exceeds a limit.
    """
    import psutil  # needed only here

    command = [sys.executable, "-m", __name__, reader, path]
    own = {"OPENBLAS_NUM_THREADS": "1", "PYTHONIOENCODING": "utf-8"}
    pipes: Any = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    most, memory = _SECONDS + _PER_BYTE * Path(path).stat().st_size, _memory(path)
    with subprocess.Popen(command, env=os.environ | own, **pipes) as process:
        for checks in count(1):
            with suppress(subprocess.TimeoutExpired):
                output, errors = process.communicate(timeout=_INTERVAL)
                break
            used = 0.0
            with suppress(psutil.Error):
                watched = psutil.Process(process.pid)
                used = sum(watched.cpu_times()[:2])
                if watched.memory_info().rss > memory:
                    process.kill()
            if used > most or checks * _INTERVAL > _PATIENCE * most:
                process.kill()
                raise InputError(
                    f"{path}: takes over {most:.0f} s to read; it may be damaged"
                )
    if process.returncode == _REFUSED:
        raise InputError(errors.decode("utf-8", "replace").splitlines()[-1])
    if process.returncode != 0:
        raise InputError(
            f"{path}: the reader failed (code {process.returncode}); the file may be "
            "damaged or too large, export it again"
        )
    with np.load(io.BytesIO(output), allow_pickle=False) as arrays:
        return dict(arrays)


def read_usd(reader: str, path: AnyPath) -> dict[str, NDArray[Any]]:
    """Read arrays from USD with a function of ``usd_reader``, or raise InputError."""
    source, size = os.fspath(path), check_file(path).stat().st_size
    if size > _LARGEST_USD:
        raise InputError(f"{source}: {size / 1e6:.0f} MB is too large; split it")
    if Path(source).suffix.lower() == ".usdz":
        damaged = "is a damaged USD package; export it again"
        with refused(source, damaged), zipfile.ZipFile(source) as archive:
            members = archive.infolist()
        stored = all(member.compress_type == zipfile.ZIP_STORED for member in members)
        if not stored or sum(member.file_size for member in members) > size:
            raise InputError(f"{source}: packed, as USD must not be; export it again")
    return read_guarded(f"usd_reader:{reader}", source)


def _memory(path: str) -> int:
    return _MEMORY + _MEMORY_PER_BYTE * Path(path).stat().st_size


def _main(reader: str, path: str) -> int:
    if sys.platform == "linux":  # elsewhere, only the parent process limits memory
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (_memory(path),) * 2)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    # Keep what the libraries print out of the arrays.
    output = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    module, _, function = reader.partition(":")
    read = getattr(importlib.import_module(f".{module}", __package__), function)
    try:
        arrays = read(path)
    except InputError as error:
        sys.stderr.write(f"\n{error}\n")
        return _REFUSED
    with output:
        np.savez(output, **arrays)
    return 0


if __name__ == "__main__":
    sys.exit(_main(*sys.argv[1:]))
