"""A web page for blind grading of clips made by different systems.

After the user study of Shum et al. 2013 (Section V-B, Figure 6), in which 27 people
graded from 1 to 9 how accurate the characters of three methods were. Here a stick
figure replaces the person's video, and by default two systems are side by side.
"""

import hashlib
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations, product
from pathlib import Path
from typing import Any

import numpy as np

from kinefilter.characters import Clip, InputError, Skeleton, Take
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.formats import read_take
from kinefilter.pipeline.formats.export import WHOLE_CLIPS
from kinefilter.pipeline.formats.files import as_path, check_file, new_text
from kinefilter.pipeline.look.comparison import laid_onto_clip
from kinefilter.pipeline.look.drawing import read_finite_clip
from kinefilter.pipeline.look.page import facing, millimeters, packed, write_page
from kinefilter.pipeline.progress import Progress, over, silent

HIGHEST = 9  # best grade; the worst is 1

_CLIPS = (*WHOLE_CLIPS, ".bvh", ".bvh.gz")
_FILES = (*_CLIPS, ".csv", ".csv.gz", ".skeleton")  # CSV and .skeleton may be takes
_NO_MOTION = "manifest.csv"  # of a batch
_NEAR = 0.15  # m from y = 0 within which feet count as on the floor; a guess
_OFF = 0.03  # m by which the feet of one motion may differ in height; a guess
_APART = 0.5  # s by which the duration of one motion may differ between systems
_FARTHEST = 30.0  # m from the origin: beyond the range of any sensor or hall
_HEAD, _LEAST = 150.0, 1500.0  # mm: margin above the head joint, least view height
_TURNED = 0.35  # rad off the frontal view, to show depth
_TEMPLATE = Path(__file__).parent / "template"

Motions = dict[str, Path]  # files of a system, by motion
Trial = tuple[tuple[int, int], ...]  # clips (motion, system) shown at once


def find_systems(words: Sequence[str]) -> dict[str, Motions]:
    """Return the motions of systems given as NAME=PATH or as paths, by name."""
    systems: dict[str, Motions] = {}
    for word in words:
        name, equals, path = word.partition("=")
        if not equals or as_path(word).exists():
            name, path = as_path(word).name, word
            name = name if as_path(word).is_dir() else _motion_in(Path(name))
        if not name or not path:
            expected = "a clip, a folder of clips, or NAME=PATH"
            raise InputError(f"{word!r}: expected {expected}")
        if name in systems:
            wrong = f"another system is also called {name!r}"
            raise InputError(f"{word}: {wrong}; rename it as NAME=PATH")
        systems[name] = motions_of(as_path(path))
    return systems


def motions_of(path: Path) -> Motions:
    """Return the motions in a file or folder by file name; InputError if not unique."""
    if not path.is_dir():
        check_file(path)
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
    """Return the motions that all systems, or single files, have; or InputError."""
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
    """Return the trials in order, with every two systems as often left as right."""
    rng = np.random.default_rng(seed)
    trials: list[Trial] = []
    if single:
        trials = [((m, s),) for m in range(motions) for s in range(systems)]
    else:
        who, order = (rng.permutation(count).tolist() for count in (systems, motions))
        for a, b in combinations(range(systems), 2):
            # Arranged in a circle, each is on the left of the half that follows it.
            ahead = 2 * (b - a) <= systems
            for k, motion in enumerate(order):
                left, right = (a, b) if ahead == (k % 2 == 0) else (b, a)
                trials.append(((motion, who[left]), (motion, who[right])))
    trials = [trials[k] for k in rng.permutation(len(trials))]
    # Repeated with swapped sides: the earliest pairs that keep the sides balanced.
    lead = Counter(trial[0][1] for trial in trials)  # how much more often left
    lead.subtract(trial[-1][1] for trial in trials)  # than right, by system
    rest = list(trials)
    for _ in range(min(repeats, len(rest))):
        again = min(rest, key=lambda trial: lead[trial[-1][1]] - lead[trial[0][1]])
        rest.remove(again)
        trials.append(again[::-1])
        lead[again[-1][1]] += 1
        lead[again[0][1]] -= 1
    return trials


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
    """Write the page, and the key that links its clips to systems; return the key.

    The page names neither systems nor motions. It shows two clips at a time, or one if
    ``single``, and ``repeats`` trials once more at the end with swapped sides. The true
    motions, ``reference``, are shown beside the clips. The seed determines the order,
    the sides and the clip numbers. Raises an InputError if clips cannot be read, or do
    not show the same motions.
    """
    if len(systems) < 2:
        raise InputError("give two systems or more to compare")
    listed = {**systems, **({"--reference": reference} if reference else {})}
    motions, names = matched(listed), list(systems)
    plan = planned(len(names), len(motions), single=single, repeats=repeats, seed=seed)
    every = list(product(range(len(motions)), range(len(names))))
    numbered = np.random.default_rng((seed, 1)).permutation(every).tolist()
    stages, drawn = [], list[list[dict[str, Any]]]()  # by motion, then by system
    skeleton: Skeleton | None = None
    for m, motion in enumerate(over(motions, "read", progress)):
        files = [own.get(motion) or next(iter(own.values())) for own in listed.values()]
        stage, clips = _staged(files)
        skeleton = skeleton or clips[0].skeleton
        if clips[0].skeleton != skeleton:
            raise InputError(f"{files[0]}: other joints than in {motions[0]}")
        if reference is not None:
            stage["reference"] = _packed(clips.pop())
        stages.append(stage)
        drawn.append([{"motion": m, **_packed(clip)} for clip in clips])
    word = "natural" if reference is None else "accurate"
    question = f"How {word} is {'the' if single else 'each'} movement"
    compared = "" if reference is None else ", compared with what the person did"
    contents: dict[str, Any] = {
        "seed": seed,
        "question": f"{question}{compared}?",
        "word": word,  # meaning of the highest grade
        "highest": HIGHEST,
        "joints": clips[0].skeleton.joints,
        "parents": clips[0].skeleton.parents,
        "motions": stages,
        "clips": [drawn[m][s] for m, s in numbered],
        "trials": [[numbered.index([*clip]) for clip in trial] for trial in plan],
    }
    page = hashlib.sha256(json.dumps(contents).encode()).hexdigest()[:16]
    key_contents = {
        "page": page,
        "systems": names,
        "motions": motions,
        "clips": [{"system": names[s], "motion": motions[m]} for m, s in numbered],
        "trials": contents["trials"],
    }
    with new_text(key) as file:
        file.write(json.dumps(key_contents) + "\n")
    files = [_TEMPLATE / f"rating.{suffix}" for suffix in ("html", "css", "js")]
    write_page(path, "How good are these movements?", {"page": page, **contents}, files)
    return key_contents


def _staged(files: Sequence[Path]) -> tuple[dict[str, Any], list[Clip | Take]]:
    """Return the camera [mm, rad] of a motion, and its clips on a common floor."""
    clips = [_read(file) for file in files]
    seconds = max(float(clip.time[-1]) for clip in clips)
    standing = _standing(clips)
    if standing is None:
        raise InputError(
            f"{files[0]}: its feet are nowhere near y = 0, nor are those of another "
            "system; takes are leveled to a clip, so give a clip too"
        )
    for k, (file, clip) in enumerate(zip(files, clips, strict=True)):
        if clip.skeleton != clips[0].skeleton:
            raise InputError(
                f"{file}: other joints than {files[0]}, which would give the system "
                "away to raters; give clips of one skeleton"
            )
        if seconds - clip.time[-1] > _APART:
            raise InputError(
                f"{file}: lasts {clip.time[-1]:.1f} s, but the same motion lasts "
                f"{seconds:.1f} s in another system; give clips of the same take"
            )
        if isinstance(clip, Take):
            try:
                clips[k] = replace(clip, positions=_on_floor(clip, standing))
            except InputError as error:
                raise InputError(f"{file}: {error}") from None
    points = np.concatenate([clip.positions.reshape(-1, 3) for clip in clips])
    points = np.clip(points, -_FARTHEST, _FARTHEST)
    low, high = 1e3 * np.nanpercentile(points, (1, 99), axis=0)
    return {
        "seconds": seconds,
        "yaw": facing(standing) + _TURNED,
        "tall": round(max(high[1] + _HEAD, _LEAST)),
        "center": [round((low[axis] + high[axis]) / 2) for axis in (0, 2)],
        "wide": round(max(high[0] - low[0], high[2] - low[2])),
    }, clips


def _read(path: Path) -> Clip | Take:
    """Read a clip or a take, with time [s] counted from its first frame."""
    is_clip = path.name.lower().endswith(_CLIPS)
    clip: Clip | Take = read_finite_clip(path) if is_clip else read_take(path)
    if len(clip) < 2 or clip.time[-1] <= clip.time[0]:
        raise InputError(f"{path}: a movement needs two frames or more")
    return replace(clip, time=clip.time - clip.time[0])


def _standing(clips: Sequence[Clip | Take]) -> Clip | Take | None:
    """Return a clip, or a take that stands on the floor."""
    cleaned = (clip for clip in clips if isinstance(clip, Clip))
    if (standing := next(cleaned, None)) is not None:
        return standing
    nearest = min(clips, key=lambda clip: abs(_foot_height(clip.positions)))
    return nearest if abs(_foot_height(nearest.positions)) < _NEAR else None


def _on_floor(take: Take, standing: Clip | Take) -> Array:
    """Return a take's joints [m], leveled and with its feet at a clip's height."""
    height, positions = _foot_height(standing.positions), take.positions
    if abs(_foot_height(positions) - height) < _OFF:
        return positions
    positions = laid_onto_clip(take, standing)
    rise = np.array([0.0, height - _foot_height(positions), 0.0])
    return np.asarray(positions + rise)


def _foot_height(positions: Array) -> float:
    """Return the median height [m] of the lowest joint, 0 if no joint is known."""
    lowest = np.fmin.reduce(positions[..., 1], axis=1)
    return float(np.nanmedian(lowest)) if np.isfinite(lowest).any() else 0.0


def _packed(clip: Clip | Take) -> dict[str, dict[str, str]]:
    return {
        "time": packed(clip.time, "f8"),
        "positions": packed(millimeters(clip.positions), "i2"),
    }
