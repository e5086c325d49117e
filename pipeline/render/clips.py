"""Clips into videos, animations and pictures, several processes at a time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from pathlib import Path

from kinefilter.characters import InputError
from kinefilter.pipeline.progress import Progress, silent
from kinefilter.pipeline.workers import workers

from .backend import Backend, find_backend
from .cameras import check_camera
from .codec import Coded
from .look import Look
from .naming import outputs
from .shot import Shot, Staged
from .video import FASTEST_GIF, write_gif, write_mp4
from .work import draw_part

__all__ = ["Rendering", "render_clips"]

PART = 60
"""Frames that one process draws in one go: in a video each part begins with a whole
picture, and two seconds are about how far players like to jump."""


_GPU_SAMPLES = 4  # edges are smooth, and a GPU hardly slower


@dataclass(frozen=True)
class Rendering:
    """What became of clips that were to be drawn."""

    backend: Backend
    """What drew."""
    written: tuple[Path, ...]
    """The files, or patterns of files, that are there now."""
    failures: tuple[str, ...]
    """A message for each clip that could not be drawn."""


@dataclass
class _Job:
    """A shot and what is known of it so far."""

    shot: Shot
    rate: float
    fingerprint: str
    parts: list[range]
    futures: list[Future[list[Coded]]] = field(default_factory=list)


def render_clips(
    clips: Sequence[Path],
    out: Path,
    look: Look | None = None,
    *,
    jobs: int | None = None,
    progress: Progress = silent,
) -> Rendering:
    """Draw clips, each into a file or into numbered pictures.

    The same clip and look give the same pixels, however many processes draw. Pictures
    that an earlier run left are kept if they are of the same clip and look.

    Args:
        clips: Files of clips, see ``read_motion``.
        out: ``.mp4``, ``.gif`` or ``.png`` with a place for the number; see
            ``outputs`` for several clips.
        look: How they are drawn.
        jobs: Processes that draw; by default one a core.
        progress: Wraps the loop over all frames, for a progress bar.

    Raises:
        InputError: Nothing can be drawn: the look, the name of the output or OpenGL is
            wrong, or the only clip is. One of several that is wrong is left out.
    """
    look = look or Look()
    if look.compare is not None and len(clips) > 1:
        raise InputError("--compare is the take of one clip; draw them one at a time")
    check_camera(look.camera)
    paths = outputs(clips, out)
    _check_size(look, out)
    backend = find_backend()
    shadows = not backend.software if look.shadows is None else look.shadows
    samples = look.samples
    if samples is None:
        samples = 0 if backend.software else _GPU_SAMPLES
    written, failures = [], []
    planned = []
    for clip, path in zip(clips, paths, strict=True):
        try:
            planned.append(_planned(Shot(clip, path, look, shadows, samples)))
        except InputError as error:
            failures.append(str(error))
    steps = iter(progress("draw", sum(len(p) for job in planned for p in job.parts)))
    for job, failure in _drawn(planned, backend, jobs, steps):
        if failure is None:
            written.append(job.shot.out)
        else:
            failures.append(failure)
    if failures and len(clips) == 1:
        raise InputError(failures[0])
    return Rendering(backend, tuple(written), tuple(failures))


def _check_size(look: Look, out: Path) -> None:
    if out.suffix.lower() == ".mp4" and any(side % 2 for side in look.pixels):
        raise InputError(
            f"--size {look.size}: a video's width and height are even; add a pixel"
        )


def _planned(shot: Shot) -> _Job:
    staged = Staged(shot)
    if shot.out.suffix.lower() == ".gif" and staged.rate > FASTEST_GIF:
        raise InputError(
            f"{shot.clip}: a GIF has at most {FASTEST_GIF:g} frames a second, not "
            f"{staged.rate:g}; lower --fps or raise --every"
        )
    _ = staged.camera
    count = len(staged)
    parts = [range(k, min(k + PART, count)) for k in range(0, count, PART)]
    return _Job(shot, staged.rate, shot.fingerprint(), parts)


def _drawn(
    planned: list[_Job], backend: Backend, jobs: int | None, steps: Iterator[int]
) -> Iterator[tuple[_Job, str | None]]:
    """Yield each job when it is done, with what went wrong."""
    done = 0
    with workers(jobs, environment=backend.environment) as pool:
        try:
            for job in planned:
                _submit(job, pool)
            for job in planned:
                yield job, _finished(job, steps)
                done += 1
        except BrokenProcessPool:
            pass
    left = planned[done:]
    if len(left) == 1 and len(planned) == 1:
        message = f"{left[0].shot.clip}: a process that drew it died; is memory short?"
        yield left[0], message
        return
    # Which of them it was shows when each has processes of its own.
    for job in left:
        yield from _drawn([job], backend, jobs, steps)


def _submit(job: _Job, pool: ProcessPoolExecutor) -> None:
    job.futures = [
        pool.submit(draw_part, job.shot, part, job.fingerprint) for part in job.parts
    ]


def _finished(job: _Job, steps: Iterator[int]) -> str | None:
    """Write a job's file from its parts; return what went wrong."""
    try:
        parts = _results(job, steps)
        suffix, pixels = job.shot.out.suffix.lower(), job.shot.look.pixels
        if suffix == ".mp4":
            write_mp4(parts, job.shot.out, pixels, job.rate)
        elif suffix == ".gif":
            write_gif(parts, job.shot.out, pixels, job.rate)
        else:
            list(parts)
    except BrokenProcessPool:
        raise
    except Exception as error:  # the other clips are to be drawn, whatever it is
        for future in job.futures:
            future.cancel()
        told = str(error)
        known = isinstance(error, InputError)
        return told if known else f"{job.shot.clip}: {type(error).__name__}: {told}"
    return None


def _results(job: _Job, steps: Iterator[int]) -> Iterator[list[Coded]]:
    for future, part in zip(job.futures, job.parts, strict=True):
        yield future.result()
        for _ in part:
            next(steps, None)
