"""Takes that hang, for the tests of batches: no polite request ends them."""

from __future__ import annotations

import signal
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from kinefilter.pipeline.batch.manifest import Row
    from kinefilter.pipeline.batch.plan import Job

HALF_A_CLIP = f".{'0' * 12}4{'0' * 3}8{'0' * 15}.usdc"


def done_or_hang(job: Job) -> Row:
    """Hang over one take with half a clip written; the others are done at once."""
    if job.take == "hangs.csv":
        (Path(job.store.root) / HALF_A_CLIP).write_text("half a clip")
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGTERM, signal.SIG_IGN)
        while True:
            time.sleep(3600.0)
    return job.row("done")
