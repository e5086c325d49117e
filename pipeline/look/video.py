"""Rendering clips as videos, animations and pictures, with several processes."""

from __future__ import annotations

import re
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

from kinefilter.characters import InputError
from kinefilter.pipeline.formats.files import check_folder, make_folder
from kinefilter.pipeline.progress import Progress, silent
from kinefilter.pipeline.workers import ProcessDiedError, cores, workers

from .cameras import CAMERAS, camera_of
from .options import Look
from .video_opengl import Backend, find_backend
from .video_task import PART, Composition, RenderTask, draw_parts

if TYPE_CHECKING:
    from .video_files import Coded

_EXTENSIONS = (".mp4", ".gif", ".png")
_CLIP = "{clip}"
_NUMBERED = re.compile(r"[^%]*%0?\d*d[^%]*")  # such as %05d.png
# Stretches per process, roughly. With fewer, the last one keeps the others waiting;
# with more, every process has to read every clip.
_STRETCHES = 4
_FASTEST_GIF = 50.0  # frames per second that programs still play at the right speed
_LONGEST = 600  # frames: a few seconds, after which a progress bar should move


@dataclass(frozen=True)
class Rendering:
    """What drew clips, the files or patterns written, and a message per failed clip."""

    backend: Backend
    written: tuple[Path, ...]
    failures: tuple[str, ...]


@dataclass
class _Job:
    task: RenderTask
    frames: int
    rate: float
    failure: str = ""
    futures: dict[Future[list[list[Coded]]], range] = field(default_factory=dict)


def render_clips(
    clips: Sequence[Path],
    out: Path,
    look: Look | None = None,
    *,
    jobs: int | None = None,
    progress: Progress = silent,
) -> Rendering:
    """Draw clips, each to one file or to numbered pictures (``output_paths``).

    The same clip and look give the same pixels for any number of processes (``jobs``,
    by default one per core). If one of several clips cannot be drawn, it is left out.
    Raises an InputError if the look, the output, OpenGL or the only clip is invalid.
    """
    look = look or Look()
    if look.compare is not None and len(clips) > 1:
        raise InputError("--compare is the take of one clip; draw clips one at a time")
    if out.suffix.lower() == ".mp4" and any(side % 2 for side in look.pixels):
        raise InputError(f"--size {look.size}: MP4 needs even numbers; add a pixel")
    if look.camera not in CAMERAS:
        camera_of(look.camera)  # raises an error before anything is read
    paths = output_paths(clips, out)
    with ThreadPoolExecutor(1) as thread:  # drivers are slow to start
        search = thread.submit(find_backend)
        planned, failures = [], []
        for clip, path in zip(clips, paths, strict=True):
            try:
                what = Composition(task := RenderTask(clip, path, look))
                if path.suffix.lower() == ".gif" and what.rate > _FASTEST_GIF:
                    raise InputError(
                        f"{clip}: GIF has at most {_FASTEST_GIF:g} frames per second, "
                        f"not {what.rate:g}; lower --fps"
                    )
                planned.append(_Job(task, len(what.drawing.clip), what.rate))
            except InputError as error:
                failures.append(str(error))
        backend = search.result()
    for job in planned:
        job.task = replace(job.task, gpu=not backend.software)
    steps = iter(progress("draw", sum(job.frames for job in planned)))
    _draw(planned, backend, jobs or cores(), steps)
    failures += [job.failure for job in planned if job.failure]
    if failures and len(clips) == 1:
        raise InputError(failures[0])
    written = tuple(job.task.out for job in planned if not job.failure)
    return Rendering(backend, written, tuple(failures))


def output_paths(clips: Sequence[Path], out: Path) -> list[Path]:
    """Return the file, or pattern of numbered pictures, of each clip.

    ``{clip}`` stands for the clip's name. With several clips and no ``{clip}``, the
    clip's name is added before the extension, or as a folder of numbered pictures.
    Folders of numbered pictures are created. Raises an InputError for invalid names.
    """
    if out.suffix.lower() not in _EXTENSIONS:
        raise InputError(
            f"{out}: unknown extension {out.suffix!r}; use {', '.join(_EXTENSIONS)}"
        )
    numbered = out.suffix.lower() == ".png"
    if numbered and not _NUMBERED.fullmatch(out.name):
        example = out.with_name(f"{out.stem}-%05d.png")
        raise InputError(f"{out}: pictures need a number, such as {example}")
    named = out
    if len(clips) > 1 and _CLIP not in str(out):
        added = f"{_CLIP}/{out.name}" if numbered else f"{out.stem}.{_CLIP}{out.suffix}"
        named = out.parent / added
    stems = [c.name.removesuffix(".gz").rpartition(".")[0] or c.name for c in clips]
    paths = [Path(str(named).replace(_CLIP, stem)) for stem in stems]
    twice = [path for path, count in Counter(paths).items() if count > 1]
    if twice:
        same = [str(c) for c, path in zip(clips, paths, strict=True) if path in twice]
        raise InputError(
            f"{', '.join(same)}: would be drawn to one file, {twice[0]}; draw clips "
            "with the same name one at a time"
        )
    for path in paths:
        if numbered:
            make_folder(path.parent)
        check_folder(path)
    return paths


def stretches(count: int, share: int) -> list[range]:
    """Split the frames of a clip into stretches that one process draws in one go.

    ``share`` is the number of frames per process, over all clips. Stretches consist of
    whole parts (PART), so that videos do not depend on the number of processes.
    """
    size = PART * max(1, min(share // _STRETCHES, _LONGEST) // PART)
    return [range(k, min(k + size, count)) for k in range(0, count, size)]


def _draw(
    planned: list[_Job], backend: Backend, count: int, steps: Iterator[int]
) -> None:
    """Draw jobs with ``count`` processes; note the failure of each that fails."""
    share = sum(job.frames for job in planned) // count
    groups = [stretches(job.frames, share) for job in planned]
    processes = min(count, max(sum(map(len, groups)), 1))
    with workers(processes, environment=backend.environment) as pool:
        for job, group in zip(planned, groups, strict=True):
            job.futures = {pool.submit(draw_parts, job.task, k): k for k in group}
        for job in planned:
            _finish(job, steps)


def _finish(job: _Job, steps: Iterator[int]) -> None:
    """Write a job's file from its parts, or note its failure."""
    from .video_files import write_gif, write_mp4  # loads av

    out, size = job.task.out, job.task.look.pixels

    def parts() -> Iterator[list[Coded]]:
        for future, frames in job.futures.items():
            yield from future.result()
            deque(islice(steps, len(frames)), maxlen=0)

    try:
        if out.suffix.lower() == ".png":  # written already
            deque(parts(), maxlen=0)
        else:
            write = write_mp4 if out.suffix.lower() == ".mp4" else write_gif
            write(parts(), out, size, job.rate)
    except Exception as error:  # the other clips are drawn nevertheless
        for future in job.futures:
            future.cancel()
        reason = f"cannot be drawn ({type(error).__name__}: {error})"
        if isinstance(error, ProcessDiedError):
            reason = "a process drawing it died, perhaps for lack of memory"
        named = isinstance(error, InputError)
        job.failure = str(error) if named else f"{job.task.clip}: {reason}"
