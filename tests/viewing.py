"""kinefilter view in a process of its own, and how it ends."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager


@contextmanager
def viewing(arguments: Sequence[str]) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """Yield the process and the address that it prints; it ends with the block."""
    command = [sys.executable, "-m", "kinefilter.pipeline.cli", "view", *arguments]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True) as process:
        try:
            assert process.stdout is not None
            line = process.stdout.readline()
            address = line.split()[0] if line else ""
            yield process, address
        finally:
            process.kill()


def ended(
    process: subprocess.Popen[str], sent: signal.Signals = signal.SIGINT
) -> tuple[int, str]:
    """Ask it to end; return its exit code and what it complained about."""
    process.send_signal(sent)
    _, complaints = process.communicate(timeout=20)
    return process.returncode, complaints
