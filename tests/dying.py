"""Processes that die over some clips or takes, for the tests of render and batch."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from kinefilter.pipeline.batch.manifest import Row
    from kinefilter.pipeline.batch.plan import Job
    from kinefilter.pipeline.look.video import RenderTask
    from kinefilter.pipeline.look.video_files import Coded


def draw_or_die(task: RenderTask, _: range) -> list[list[Coded]]:
    if task.clip.stem == "deadly":
        os._exit(1)
    task.out.with_name(f"{task.clip.stem}.drawn").touch()
    return []


def clean_or_die(job: Job) -> Row:
    """Die over one take whenever it comes, and over another the first time."""
    name = Path(job.take).stem
    met = Path(job.store.root) / "met"
    if name == "deadly" or (name == "unlucky" and not met.exists()):
        met.touch()
        os._exit(1)
    # Here, as those that draw choose their OpenGL before MuJoCo is loaded.
    from kinefilter.pipeline.batch.task import clean_file

    return clean_file(job)
