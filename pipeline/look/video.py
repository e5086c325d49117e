"""Rendering clips as videos, animations and pictures, with several processes.

MuJoCo is imported only by processes that draw, as it then chooses its OpenGL.
"""

from __future__ import annotations

import atexit
import re
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from kinefilter.characters import Clip, InputError, Prop
from kinefilter.characters.props import CORNERS
from kinefilter.pipeline.formats.export import resampled
from kinefilter.pipeline.formats.files import atomic_path, check_folder
from kinefilter.pipeline.progress import Progress, silent
from kinefilter.pipeline.target.floor import find_placement
from kinefilter.pipeline.workers import ProcessDiedError, cores, given_up, workers

from .cameras import CAMERAS, axes_toward, camera_of, camera_path
from .comparison import raw_positions
from .drawing import Drawing, corners_of, offset_beside, read_finite_clip
from .options import Look
from .video_opengl import Backend, find_backend

if TYPE_CHECKING:
    from .video_files import Coded, Pixels
    from .video_model import OffscreenRenderer

PART = 60  # frames in a part of a video, which starts with a keyframe to seek to

_EXTENSIONS = (".mp4", ".gif", ".png")
_CLIP = "{clip}"
_NUMBERED = re.compile(r"[^%]*%0?\d*d[^%]*")  # such as %05d.png
# Stretches per process, roughly. With fewer, the last one keeps the others waiting;
# with more, every process has to read every clip.
_STRETCHES = 4
_FASTEST_GIF = 50.0  # frames per second that programs still play at the right speed
_LONGEST = 600  # frames: a few seconds, after which a progress bar should move
_SKIN = 0.13  # m from a joint to the skin, at most: roughly the head's radius
_GPU_SAMPLES = 4  # makes edges smooth, and a GPU is hardly slower
_ASTRAY = 1.0  # m from the character, within which a raw joint counts for the camera
_SKEW = 1e-6  # s by which a frame may lie outside --begin and --end


@dataclass(frozen=True)
class Rendering:
    """What drew clips, the files or patterns written, and a message per failed clip."""

    backend: Backend
    written: tuple[Path, ...]
    failures: tuple[str, ...]


@dataclass(frozen=True)
class RenderTask:
    """A clip, how to draw it, and the file or pattern (``%05d.png``) to write."""

    clip: Path
    out: Path
    look: Look
    frames: int = 0  # pictures to draw
    rate: float = 0.0  # of the pictures [1/s]
    gpu: bool = False  # whether one draws; without, shadows and smooth edges take long

    @property
    def kind(self) -> str:
        """The extension of the output."""
        return self.out.suffix.lower()


class Composition:
    """What the pictures of a task show; needs no OpenGL.

    Raises an InputError if the clip, the take, the scene or the camera is invalid.
    """

    def __init__(self, task: RenderTask) -> None:
        look, source = task.look, str(task.clip)  # rather than its take, in messages
        whole = replace(read_finite_clip(task.clip), source=source)
        clip, self.rate = shown_frames(whole, look)  # frame rate of the pictures [1/s]
        if look.scene is not None:
            clip = replace(clip, props=props_around(whole, clip.props, look.scene))
        width, height = look.pixels
        aspect, rate = width / height, self.rate
        seen_by = partial(camera_path, look.camera, clip, aspect=aspect, rate=rate)
        joints, raw = clip.positions, None
        points = [(joints[:, :, None] + _SKIN * CORNERS).reshape(len(clip), -1, 3)]
        points += [corners_of(prop, len(clip)) for prop in clip.props]
        if look.compare is not None:
            raw = raw_positions(look.compare, whole, clip.time)
            if look.place == "beside":
                right, _ = axes_toward(seen_by(joints).toward)
                raw = raw + offset_beside(joints, -right, 2.0 * _SKIN)
            # For raw joints that are missing or far off, use the character's joints.
            place = joints + np.nanmedian(raw - joints, axis=(0, 1))
            near = np.linalg.norm(raw - place, axis=-1) < _ASTRAY
            points.append(np.where(near[..., None], raw, place))
        self.drawing = Drawing(clip, raw)  # the frames that are drawn
        self.camera = seen_by(np.concatenate(points, axis=1))  # shows everything


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
    planned, written, failures = [], [], []
    with ThreadPoolExecutor(1) as thread:  # drivers are slow to start
        search = thread.submit(find_backend)
        for clip, path in zip(clips, paths, strict=True):
            try:
                planned.append(_planned(RenderTask(clip, path, look)))
            except InputError as error:
                failures.append(str(error))
        backend = search.result()
    tasks = [replace(task, gpu=not backend.software) for task in planned]
    count, total = jobs or cores(), sum(task.frames for task in tasks)
    groups = [stretches(task.frames, total // count) for task in tasks]
    processes = min(count, max(sum(map(len, groups)), 1))
    steps = iter(progress("draw", total))
    with workers(processes, environment=backend.environment) as pool:
        drawn = [
            {pool.submit(draw_parts, task, frames): frames for frames in group}
            for task, group in zip(tasks, groups, strict=True)
        ]
        for task, futures in zip(tasks, drawn, strict=True):
            try:
                _write(task, futures, steps)
                written.append(task.out)
            except Exception as error:  # the other clips are drawn nevertheless
                for future in futures:
                    future.cancel()
                reason = f"cannot be drawn ({type(error).__name__}: {error})"
                if isinstance(error, ProcessDiedError):
                    reason = "a process drawing it died, perhaps for lack of memory"
                named = isinstance(error, InputError)
                failures.append(str(error) if named else f"{task.clip}: {reason}")
    if failures and len(clips) == 1:
        raise InputError(failures[0])
    return Rendering(backend, tuple(written), tuple(failures))


def _planned(task: RenderTask) -> RenderTask:
    """Return a task with the number and rate of its pictures."""
    what = Composition(task)
    if task.kind == ".gif" and what.rate > _FASTEST_GIF:
        raise InputError(
            f"{task.clip}: GIF has at most {_FASTEST_GIF:g} frames per second, "
            f"not {what.rate:g}; lower --fps"
        )
    return replace(task, frames=len(what.drawing.clip), rate=what.rate)


def _write(
    task: RenderTask,
    futures: dict[Future[list[list[Coded]]], range],
    steps: Iterator[int],
) -> None:
    """Write a file from the parts that processes draw; pictures are written already."""
    from .video_files import write_gif, write_mp4  # loads av

    def parts() -> Iterator[list[Coded]]:
        for future, frames in futures.items():
            yield from future.result()
            deque(islice(steps, len(frames)), maxlen=0)

    if task.kind == ".png":
        deque(parts(), maxlen=0)
    else:
        write = write_mp4 if task.kind == ".mp4" else write_gif
        write(parts(), task.out, task.look.pixels, task.rate)


def output_paths(clips: Sequence[Path], out: Path) -> list[Path]:
    """Return the file, or pattern of numbered pictures, of each clip.

    ``{clip}`` stands for the clip's name, after its folder's if others share it. With
    several clips and no ``{clip}``, that is added before the extension, or as a folder
    of numbered pictures. Raises an InputError for invalid names.
    """
    if out.suffix.lower() not in _EXTENSIONS:
        raise InputError(
            f"{out}: unknown extension {out.suffix!r}; use {', '.join(_EXTENSIONS)}"
        )
    numbered = out.suffix.lower() == ".png"
    if numbered and not _NUMBERED.fullmatch(out.name):
        example = out.with_name(f"{out.stem}-%05d.png")
        raise InputError(f"{out}: pictures need a number, such as {example}")
    if len(clips) > 1 and _CLIP not in str(out):
        added = f"{_CLIP}/{out.name}" if numbered else f"{out.stem}.{_CLIP}{out.suffix}"
        out = out.parent / added
    stems = [c.name.removesuffix(".gz").rpartition(".")[0] or c.name for c in clips]
    counts, pairs = Counter(stems), zip(clips, stems, strict=True)
    stems = [f"{c.absolute().parent.name}-" * (counts[s] > 1) + s for c, s in pairs]
    sign = "%%" if numbered else "%"  # in a name that is a pattern
    names = [out.name.replace(_CLIP, stem.replace("%", sign)) for stem in stems]
    folders = [str(out.parent).replace(_CLIP, stem) for stem in stems]
    paths = [Path(*parts) for parts in zip(folders, names, strict=True)]
    if twice := [path for path, count in Counter(paths).items() if count > 1]:
        same = [str(c) for c, path in zip(clips, paths, strict=True) if path in twice]
        raise InputError(
            f"{', '.join(same)}: would be drawn to one file, {twice[0]}; draw clips "
            "of one folder with the same name one at a time"
        )
    for path in paths:
        check_folder(path)
    return paths


def stretches(count: int, share: int) -> list[range]:
    """Split the frames of a clip into stretches that one process draws in one go.

    ``share`` is the number of frames per process, over all clips. Stretches consist of
    whole parts (PART), so that videos do not depend on the number of processes.
    """
    size = PART * max(1, min(share // _STRETCHES, _LONGEST) // PART)
    return [range(k, min(k + size, count)) for k in range(0, count, size)]


def shown_frames(clip: Clip, look: Look) -> tuple[Clip, float]:
    """Return frames to draw, even in time, and their rate [1/s]; InputError if none."""
    rate = look.fps or clip.fps
    even = resampled(clip, rate)
    since = even.time - even.time[0]
    end = np.inf if look.end is None else look.end
    chosen = np.flatnonzero((since >= look.begin - _SKEW) & (since <= end + _SKEW))
    if not len(chosen):
        to = "the end" if look.end is None else f"{look.end:g} s"
        none = f"no frames from {look.begin:g} s to {to}"
        raise InputError(f"{clip.source}: {none}; it lasts {since[-1]:.2f} s")
    return even.at(chosen), rate


def props_around(clip: Clip, props: tuple[Prop, ...], scene: str) -> tuple[Prop, ...]:
    """Return props and the rest of a scene, placed as ``clean --scene`` does, at rest.

    The person starts at the scene's origin in ``clip``, which is the whole clip. Raises
    an InputError as ``load_scene`` does.
    """
    import mujoco  # by now its OpenGL is chosen

    from kinefilter.pipeline.physics.scene_props import SceneProps
    from kinefilter.scenes import load_scene

    data = mujoco.MjData(load_scene(scene).compile())
    mujoco.mj_forward(data.model, data)
    things = SceneProps(data, (), 1)
    things.record(0)
    names = {prop.name for prop in props}
    others = things.props(find_placement(clip.positions, clip.skeleton))
    return props + tuple(prop for prop in others if prop.name not in names)


def draw_parts(task: RenderTask, frames: range) -> list[list[Coded]]:
    """Draw frames of a task, counted from its first picture.

    Returns the encoded parts of a video or a GIF; numbered pictures are written. Raises
    an InputError if something cannot be drawn or written.
    """
    from .video_files import encode_png, encode_video  # loads av

    parts = [frames[k : k + PART] for k in range(0, len(frames), PART)]
    if task.kind == ".gif":
        return [[(encode_png(p), True) for p in _pictures(task, k)] for k in parts]
    if task.kind == ".mp4":
        size, rate = task.look.pixels, task.rate
        return [encode_video(_pictures(task, k), size, rate) for k in parts]
    for number, picture in zip(frames, _pictures(task, frames), strict=True):
        with atomic_path(task.out.with_name(task.out.name % number)) as temporary:
            temporary.write_bytes(encode_png(picture))
    return []


# What draws the latest task, kept open: the next part is often of the same task.
_open: list[tuple[RenderTask, OffscreenRenderer]] = []


def _pictures(task: RenderTask, numbers: range) -> Iterator[Pixels]:
    """Yield pictures of a task, after closing what drew the previous one."""
    if not _open or _open[0][0] != task:
        from .video_model import ClipModel, OffscreenRenderer

        _close()
        what, look = Composition(task), task.look
        model = ClipModel(
            what.drawing,
            size=look.pixels,
            samples=_GPU_SAMPLES if task.gpu else 0,
            toward=what.camera.toward,
            seams=look.seams,
            translucent=what.drawing.raw is not None and look.place == "over",
        )
        shadows = look.shadows or task.gpu
        _open.append((task, OffscreenRenderer(model, what.camera, shadows=shadows)))
    for number in numbers:
        if given_up():
            raise InputError(f"{task.clip}: interrupted")
        yield _open[0][1].render(number)


@atexit.register
def _close() -> None:
    """Release OpenGL's resources; after Python's shutdown it would be too late."""
    while _open:
        _open.pop()[1].close()
