"""One thread of linear algebra a process: over small matrices several only fight."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

from threadpoolctl import threadpool_limits

__all__ = ["one_thread"]

_VARIABLES = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


@contextmanager
def one_thread() -> Iterator[None]:
    """Give linear algebra one thread, in this process and in those begun inside.

    On two busy cores training is eight times as fast so.
    """
    before = {name: os.environ.get(name) for name in _VARIABLES}
    # For libraries that are loaded later, and for new processes.
    os.environ.update(dict.fromkeys(_VARIABLES, "1"))
    try:
        with threadpool_limits(1):
            yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
