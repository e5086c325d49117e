"""Clips into videos, animations and pictures, several processes at a time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from pathlib import Path

from kinefilter.characters import InputError
from kinefilter.pipeline.progress import Progress, silent
from kinefilter.pipeline.workers import cores, workers

from .backend import Backend, find_backend
from .cameras import check_camera
from .codec import Coded
from .look import Look
from .naming import outputs
from .parts import Parts, stretches
from .shot import Shot, Staged
from .video import FASTEST_GIF, write_gif, write_mp4
from .work import draw_parts


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
    """A shot, and its frames as they are drawn."""

    shot: Shot
    frames: int
    rate: float
    fingerprint: str = ""
    futures: dict[Future[list[list[Coded]]], Parts] = field(default_factory=dict)


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
    paths = _checked(clips, out, look)
    with ThreadPoolExecutor(1) as beside:
        asked = beside.submit(find_backend)
        planned, failures = _plan(clips, paths, look)
        backend = asked.result()
    for job in planned:
        job.shot = job.shot.drawn_by(backend)
        job.fingerprint = job.shot.fingerprint()
    steps = iter(progress("draw", sum(job.frames for job in planned)))
    written = []
    for job, failure in _drawn(planned, backend, jobs or cores(), steps):
        if failure is None:
            written.append(job.shot.out)
        else:
            failures.append(failure)
    if failures and len(clips) == 1:
        raise InputError(failures[0])
    return Rendering(backend, tuple(written), tuple(failures))


def _checked(clips: Sequence[Path], out: Path, look: Look) -> list[Path]:
    """Return the outputs; raise what is wrong with all clips before any work."""
    if look.compare is not None and len(clips) > 1:
        raise InputError("--compare is the take of one clip; draw them one at a time")
    if out.suffix.lower() == ".mp4" and any(side % 2 for side in look.pixels):
        raise InputError(
            f"--size {look.size}: a video's width and height are even; add a pixel"
        )
    check_camera(look.camera)
    return outputs(clips, out)


def _plan(
    clips: Sequence[Path], paths: Sequence[Path], look: Look
) -> tuple[list[_Job], list[str]]:
    """Return what is to be drawn, and messages for what cannot be."""
    planned, failures = [], []
    for clip, path in zip(clips, paths, strict=True):
        try:
            planned.append(_planned(Shot(clip, path, look)))
        except InputError as error:
            failures.append(str(error))
    return planned, failures


def _planned(shot: Shot) -> _Job:
    staged = Staged(shot)
    if shot.out.suffix.lower() == ".gif" and staged.rate > FASTEST_GIF:
        raise InputError(
            f"{shot.clip}: a GIF has at most {FASTEST_GIF:g} frames a second, not "
            f"{staged.rate:g}; lower --fps or raise --every"
        )
    return _Job(shot, len(staged), staged.rate)


def _drawn(
    planned: list[_Job], backend: Backend, count: int, steps: Iterator[int]
) -> Iterator[tuple[_Job, str | None]]:
    """Yield each job when it is done, with what went wrong."""
    done = 0
    share = sum(job.frames for job in planned) // count
    tasks = sum(len(stretches(job.frames, share)) for job in planned)
    with workers(min(count, max(tasks, 1)), environment=backend.environment) as pool:
        try:
            for job in planned:
                _submit(job, share, pool)
            for job in planned:
                yield job, _finished(job, steps)
                done += 1
        except BrokenProcessPool:
            pass
    left = planned[done:]
    if left and len(planned) == 1:
        clip = left[0].shot.clip
        yield left[0], f"{clip}: a process that drew it died; is memory short?"
        return
    # Which of them it was shows when each has processes of its own.
    for job in left:
        yield from _drawn([job], backend, count, steps)


def _submit(job: _Job, share: int, pool: ProcessPoolExecutor) -> None:
    job.futures = {
        pool.submit(draw_parts, job.shot, parts, job.fingerprint): parts
        for parts in stretches(job.frames, share)
    }


def _finished(job: _Job, steps: Iterator[int]) -> str | None:
    """Write a job's file from its parts; return what went wrong."""
    shot, parts = job.shot, _results(job, steps)
    try:
        if shot.out.suffix.lower() == ".mp4":
            write_mp4(parts, shot.out, shot.look.pixels, job.rate)
        elif shot.out.suffix.lower() == ".gif":
            write_gif(parts, shot.out, shot.look.pixels, job.rate)
        else:
            list(parts)
    except BrokenProcessPool:
        raise
    except Exception as error:  # the other clips are to be drawn, whatever it is
        for future in job.futures:
            future.cancel()
        if isinstance(error, InputError):
            return str(error)
        return f"{shot.clip}: cannot be drawn ({type(error).__name__}: {error})"
    return None


def _results(job: _Job, steps: Iterator[int]) -> Iterator[list[Coded]]:
    for future, parts in job.futures.items():
        yield from future.result()
        for _ in range(sum(map(len, parts))):
            next(steps, None)
