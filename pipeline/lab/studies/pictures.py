"""The pictures of README, made anew."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from kinefilter.characters import InputError
from kinefilter.pipeline.cleaner import clean
from kinefilter.pipeline.formats import read_take, write_clip
from kinefilter.pipeline.lab.bench import sample_path
from kinefilter.pipeline.progress import Progress, silent

_SIZE, _RATE = "480x270", 10.0  # a moving picture that loads quickly
_LONGEST = 600.0  # s that a script may take, ten times what it needs. A guess.
_PAGES = Path(__file__).parents[2] / "tests" / "pictures" / "pages.py"


def make_pictures(folder: Path, *, progress: Progress = silent) -> Iterator[str]:
    """Make the pictures of README in a folder, and yield what became of each.

    The moving picture needs OpenGL; those of pages need viser, Chromium and the script
    of the checkout.

    Args:
        folder: Where to write; it is there.
        progress: Wraps the loop over the frames, for a progress bar.
    """
    path = folder / "raw_beside_cleaned.gif"
    try:
        _draw(path, progress)
        yield f"wrote {path}"
    except InputError as error:
        yield f"not made: {path.name} ({error})"
    yield _run(_PAGES, folder)


def _draw(path: Path, progress: Progress) -> None:
    """Write the sample take, raw beside cleaned, as a moving picture."""
    from kinefilter.pipeline.look import Look, render_clips

    sample = sample_path()
    with tempfile.TemporaryDirectory() as folder:
        clip = Path(folder) / "clip.npz"
        write_clip(clean(read_take(sample)).clip, clip)
        look = Look(size=_SIZE, fps=_RATE, compare=sample)
        render_clips([clip], path, look, progress=progress)


def _run(script: Path, out: Path) -> str:
    """Run a script of the checkout, and return what became of it."""
    if not script.is_file():
        return f"not made: what {script.name} draws (a script of the checkout)"
    command = [sys.executable, str(script), str(out)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=_LONGEST)
    except subprocess.TimeoutExpired:
        return f"not made: what {script.name} draws (not done in {_LONGEST:g} s)"
    if done.returncode:
        reason = (done.stderr.strip().splitlines() or ["no reason given"])[-1]
        return f"not made: what {script.name} draws ({reason})"
    return f"{script.name}: wrote into {out}"
