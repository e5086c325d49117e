"""What the drawn files are called."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from kinefilter.characters import InputError
from kinefilter.pipeline.formats import check_folder

from .frames import is_numbered

_EXTENSIONS = (".mp4", ".gif", ".png")
_CLIP = "{clip}"


def outputs(clips: Sequence[Path], out: Path) -> list[Path]:
    """Return the file, or pattern of files, of each clip.

    ``{clip}`` in a name stands for the clip's. Where it is missing and there are
    several, it is put before the extension, or before the number as a folder. Folders
    of numbered pictures are made.

    Raises:
        InputError: No such file can be written, or two clips have the same.
    """
    if out.suffix.lower() not in _EXTENSIONS:
        raise InputError(
            f"{out}: unknown extension {out.suffix!r}; known: {', '.join(_EXTENSIONS)}"
        )
    numbered = out.suffix.lower() == ".png"
    if numbered and not is_numbered(out.name):
        raise InputError(
            f"{out}: pictures need a place for their number in their name, such as "
            f"{out.with_name(out.stem + '-%05d.png')}"
        )
    named = out
    if len(clips) > 1 and _CLIP not in str(out):
        named = out.parent / _CLIP / out.name
        if not numbered:
            named = out.with_name(f"{out.stem}.{_CLIP}{out.suffix}")
    paths = [Path(str(named).replace(_CLIP, _stem(clip))) for clip in clips]
    twice = [path for path, count in Counter(paths).items() if count > 1]
    if twice:
        same = [str(c) for c, path in zip(clips, paths, strict=True) if path in twice]
        raise InputError(
            f"{', '.join(same)}: would be drawn into one file, {twice[0]}; draw clips "
            "of the same name one at a time"
        )
    for path in paths:
        if numbered:
            _make(path.parent)
        check_folder(path)
    return paths


def _stem(clip: Path) -> str:
    return clip.name.removesuffix(".gz").rpartition(".")[0] or clip.name


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"{folder}: cannot be made ({error.strerror}); write elsewhere"
        ) from error
