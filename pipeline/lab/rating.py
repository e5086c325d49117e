"""A page on which people grade clips, not knowing which system made which.

As in the user study of Shum et al. 2013 (Section V-B, Figure 6): 27 people saw the
video of a person, and the characters of three methods one after another, and graded
from 1 to 9 how accurate each was. Here a stick figure stands for the video, and by
default two systems are seen at a time, side by side.
"""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from kinefilter.characters import Clip, InputError, Skeleton, Take
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.formats import read_take
from kinefilter.pipeline.formats.export import WHOLE_CLIPS
from kinefilter.pipeline.formats.files import as_path, new_text
from kinefilter.pipeline.look.comparison import leveled_to_clip
from kinefilter.pipeline.look.drawing import read_finite_clip
from kinefilter.pipeline.look.page import facing, millimeters, packed, write_page
from kinefilter.pipeline.progress import Progress, over, silent
from kinefilter.pipeline.target.floor import leveled

HIGHEST = 9
"""The best grade; the worst is 1."""

_CLIPS = (*WHOLE_CLIPS, ".bvh", ".bvh.gz")
_FILES = (*_CLIPS, ".csv", ".csv.gz", ".skeleton")  # these may be takes
_NO_MOTION = "manifest.csv"  # of a batch
_NEAR = 0.15  # m from y = 0, within which feet stand; a guess
_OFF = 0.03  # m: feet of clips of the same motion are that near in height; a guess
_APART = 0.5  # s by which the same motion may last longer in one system than in another
_FARTHEST = 30.0  # m from the origin: no sensor and no hall is as large
_HEAD, _LEAST = 150.0, 1500.0  # mm above the head's joint, and of what is seen
_TURNED = 0.35  # rad, to see more than the front
_TEMPLATE = Path(__file__).parent / "template"

Motions = dict[str, Path]
"""The files of a system by the motion that is in them."""
Trial = tuple[tuple[int, int], ...]
"""What is seen and graded at once: motion and system, from left to right."""


def find_system(word: str) -> tuple[str, Motions]:
    """Return the name and the motions of a system: NAME=PATH, or a path.

    Motions are called after their files, without suffixes; in a folder, also after the
    folders below it. Raises an InputError if there are none, or two of one name.
    """
    name, equals, path = word.partition("=")
    if not equals or as_path(word).exists():
        name, path = as_path(word).name, word
        name = name if as_path(word).is_dir() else _motion_in(Path(name))
    if not name or not path:
        raise InputError(f"{word!r}: expected a clip, a folder of clips, or NAME=PATH")
    return name, motions_of(as_path(path))


def motions_of(path: Path) -> Motions:
    """Return the motions of a file or a folder, see ``find_system``."""
    if not path.is_dir():
        return {_motion_in(Path(path.name)): path}
    found: Motions = {}
    for file in sorted(path.rglob("*")):
        if not file.name.lower().endswith(_FILES) or file.name == _NO_MOTION:
            continue
        motion = _motion_in(file.relative_to(path))
        if motion in found:
            raise InputError(f"{file}: the same motion as {found[motion]}; keep one")
        found[motion] = file
    if not found:
        raise InputError(f"{path}: no {', '.join(_FILES)} file in this folder")
    return found


def _motion_in(path: Path) -> str:
    name = path.name.removesuffix(".gz")
    return path.with_name(Path(name).stem or name).as_posix()


def matched(systems: Mapping[str, Motions]) -> list[str]:
    """Return the motions that all systems have; single files are the same motion.

    Raises an InputError if there is none.
    """
    first, *others = systems.values()
    if all(len(motions) == 1 for motions in systems.values()):
        return list(first)
    common = [motion for motion in first if all(motion in other for other in others)]
    if not common:
        some = "; ".join(f"{n}: {', '.join([*m][:3])}" for n, m in systems.items())
        raise InputError(
            f"no motion is in every system ({some}); files of the same motion need "
            "the same name"
        )
    return common


def planned(
    systems: int, motions: int, *, single: bool, repeats: int, seed: int
) -> list[Trial]:
    """Return what is seen, in order, see ``write_rating_page``.

    Every two systems meet in every motion. Each is on the left as often as on the
    right, up to one, and so is each of two among the times they meet.
    """
    rng = np.random.default_rng(seed)
    found: list[Trial] = []
    if single:
        found = [((m, s),) for m in range(motions) for s in range(systems)]
    else:
        who, order = (rng.permutation(count).tolist() for count in (systems, motions))
        for a, b in combinations(range(systems), 2):
            # Around a circle, each is on the left of the half that follows.
            ahead = 2 * (b - a) <= systems
            for k, motion in enumerate(order):
                left, right = (a, b) if ahead == (k % 2 == 0) else (b, a)
                found.append(((motion, who[left]), (motion, who[right])))
    found = [found[k] for k in rng.permutation(len(found))]
    return found + (found[:repeats] if single else _exchanged(found, repeats))


def _exchanged(found: Sequence[Trial], count: int) -> list[Trial]:
    """Return some pairs with their sides exchanged, those that leave systems balanced.

    The first come first, as they were seen the longest ago.
    """
    lead = Counter(left for (_, left), _ in found)  # how often a system is left
    lead.subtract(right for _, (_, right) in found)  # rather than right
    rest, again = list(found), list[Trial]()
    while rest and len(again) < count:
        pair = min(rest, key=lambda pair: lead[pair[1][1]] - lead[pair[0][1]])
        rest.remove(pair)
        again.append(pair[::-1])
        lead[pair[1][1]] += 1
        lead[pair[0][1]] -= 1
    return again


def write_rating_page(
    systems: Mapping[str, Motions],
    path: Path,
    key: Path,
    *,
    reference: Motions | None = None,
    single: bool = False,
    repeats: int = 2,
    seed: int = 0,
    progress: Progress = silent,
) -> dict[str, Any]:
    """Write the page, and the key that says whose clips are on it; return the key.

    The page names neither systems nor motions.

    Args:
        systems: Two or more, with their motions.
        path: The page.
        key: The key (.json).
        reference: How the people really moved; it is seen beside the clips.
        single: Show one clip at a time, not two.
        repeats: Trials that come once more at the end, with their sides exchanged.
        seed: Of what is shuffled.
        progress: Wraps the loop over motions, for a progress bar.

    Raises:
        InputError: Clips cannot be read, or are not of the same motions.
    """
    if len(systems) < 2:
        raise InputError("give two systems or more, to compare")
    listed = {**systems, **({} if reference is None else {"--reference": reference})}
    motions, names = matched(listed), list(systems)
    plan = planned(len(names), len(motions), single=single, repeats=repeats, seed=seed)
    places = [(m, s) for m in range(len(motions)) for s in range(len(names))]
    shuffled = np.random.default_rng((seed, 1)).permutation(len(places))
    stages, drawn = [], list[dict[str, Any]]()
    skeleton: Skeleton | None = None
    for m, motion in enumerate(over(motions, "read", progress)):
        files = [own.get(motion) or next(iter(own.values())) for own in listed.values()]
        stage, clips = _staged(files)
        skeleton = clips[0].skeleton if skeleton is None else skeleton
        if clips[0].skeleton != skeleton:
            raise InputError(f"{files[0]}: other joints than in {motions[0]}")
        if reference is not None:
            stage["reference"] = _packed(clips.pop())
        stages.append(stage)
        drawn += [{"motion": m, **_packed(clip)} for clip in clips]
    which = "the" if single else "each"
    word, question = "natural", f"How natural is {which} movement?"
    if reference is not None:
        word = "accurate"
        question = f"How accurate is {which} movement, beside what the person did?"
    places = [places[k] for k in shuffled]
    contents: dict[str, Any] = {
        "seed": seed,
        "question": question,
        "word": word,  # what the highest grade means
        "highest": HIGHEST,
        "joints": clips[0].skeleton.joints,
        "parents": clips[0].skeleton.parents,
        "motions": stages,
        "clips": [drawn[k] for k in shuffled],
        "trials": [[places.index(place) for place in trial] for trial in plan],
    }
    page = hashlib.sha256(json.dumps(contents).encode()).hexdigest()[:16]
    told = {
        "page": page,
        "systems": names,
        "motions": motions,
        "clips": [{"system": names[s], "motion": motions[m]} for m, s in places],
        "trials": contents["trials"],
    }
    with new_text(key) as file:
        file.write(json.dumps(told) + "\n")
    files = [_TEMPLATE / f"rating.{suffix}" for suffix in ("html", "css", "js")]
    write_page(path, "How good are these movements?", {"page": page, **contents}, files)
    return told


def _staged(files: Sequence[Path]) -> tuple[dict[str, Any], list[Clip | Take]]:
    """Return the camera [mm, rad] of a motion, and the clips in it on one floor.

    A take whose feet are not where those of a clip are is leveled to that clip.
    """
    clips = [_read(file) for file in files]
    seconds = max(float(clip.time[-1]) for clip in clips)
    standing = _standing(clips)
    if standing is None:
        raise InputError(
            f"{files[0]}: its feet are nowhere near y = 0, nor are another system's; "
            "takes are leveled to a clip, so give one too"
        )
    for k, (file, clip) in enumerate(zip(files, clips, strict=True)):
        if clip.skeleton != clips[0].skeleton:
            raise InputError(
                f"{file}: other joints than {files[0]}; raters would see whose it is"
            )
        if seconds - clip.time[-1] > _APART:
            raise InputError(
                f"{file}: lasts {clip.time[-1]:.1f} s, the same motion elsewhere "
                f"{seconds:.1f} s; give clips of the same take"
            )
        if isinstance(clip, Take):
            try:
                clips[k] = replace(clip, positions=_on_floor(clip, standing))
            except InputError as error:
                raise InputError(f"{file}: {error}") from None
    everywhere = np.concatenate([clip.positions.reshape(-1, 3) for clip in clips])
    near = np.clip(everywhere, -_FARTHEST, _FARTHEST)
    low, high = 1e3 * np.nanpercentile(near, (1, 99), axis=0)
    return {
        "seconds": seconds,
        "yaw": facing(standing) + _TURNED,
        "tall": round(max(high[1] + _HEAD, _LEAST)),
        "center": [round((low[axis] + high[axis]) / 2) for axis in (0, 2)],
        "wide": round(max(high[0] - low[0], high[2] - low[2])),
    }, clips


def _read(path: Path) -> Clip | Take:
    """Read a clip or a take, with the time [s] from its first frame."""
    is_clip = path.name.lower().endswith(_CLIPS)
    clip: Clip | Take = read_finite_clip(path) if is_clip else read_take(path)
    if len(clip) < 2 or clip.time[-1] <= clip.time[0]:
        raise InputError(f"{path}: two frames or more are needed to see a movement")
    return replace(clip, time=clip.time - clip.time[0])


def _standing(clips: Sequence[Clip | Take]) -> Clip | Take | None:
    """Return a clip that stands on the floor, if it can be one that says its tilt.

    A CSV may be a take, in the frame of its sensor: only without other clips, the one
    whose feet are nearest to y = 0.
    """
    for known in (True, False):
        for clip in clips:
            if isinstance(clip, Clip) and np.isfinite(clip.tilt) == known:
                return clip
    nearest = min(clips, key=lambda clip: abs(_foot_height(clip.positions)))
    return nearest if abs(_foot_height(nearest.positions)) < _NEAR else None


def _on_floor(take: Take, standing: Clip | Take) -> Array:
    """Return the joints [m] of a take, leveled, its feet as high as those of a clip.

    What is no higher or lower than the clip is returned as it is, shape (T, J, 3).
    """
    wanted, places = _foot_height(standing.positions), take.positions
    if abs(_foot_height(places) - wanted) < _OFF:
        return places
    if isinstance(standing, Clip) and np.isfinite(standing.tilt):
        places = leveled(places, standing.tilt, standing.roll)
    else:
        places = leveled_to_clip(take, standing)
    rise = np.array([0.0, wanted - _foot_height(places), 0.0])
    return np.asarray(places + rise)


def _foot_height(positions: Array) -> float:
    """Return the height [m] of the lowest joint, the median over frames (T, J, 3)."""
    heights = positions[..., 1]
    there = ~np.isnan(heights).all(axis=1)
    return float(np.median(np.nanmin(heights[there], axis=1))) if there.any() else 0.0


def _packed(clip: Clip | Take) -> dict[str, dict[str, str]]:
    return {
        "time": packed(clip.time, "f8"),
        "positions": packed(millimeters(clip.positions), "i2"),
    }
