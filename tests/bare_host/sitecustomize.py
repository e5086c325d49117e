"""Takes from every process that finds it on PYTHONPATH what Windows does not have."""

from __future__ import annotations

import asyncio
import os
import re
import signal
import subprocess
import sys
import warnings
from asyncio import unix_events
from multiprocessing import popen_fork
from typing import Any, NoReturn

for module in ("fcntl", "resource", "pwd", "grp", "termios", "tty", "pty", "syslog"):
    sys.modules[module] = None  # type: ignore[assignment]  # so it cannot be imported
for name in ("fork", "forkpty", "killpg", "getuid", "geteuid", "getpgid", "setsid"):
    delattr(os, name)
for name in ("SIGKILL", "SIGHUP", "SIGALRM", "SIGUSR1"):
    delattr(signal, name)
for process in (subprocess.Popen, popen_fork.Popen):
    process.kill = process.terminate  # type: ignore[method-assign]


def _missing(*_: Any, **__: Any) -> NoReturn:
    raise NotImplementedError


for name in ("add_signal_handler", "connect_read_pipe", "connect_write_pipe"):
    setattr(unix_events._UnixSelectorEventLoop, name, _missing)
    setattr(asyncio.BaseEventLoop, name, _missing)

# There a text without an encoding is in the code page of the country.
warnings.filterwarnings("ignore", category=EncodingWarning)  # of libraries
warnings.filterwarnings("error", category=EncodingWarning, module="kinefilter")
# There is no such warning there: a native lock always is.
warnings.filterwarnings("ignore", message=re.escape("only soft file lock"))
