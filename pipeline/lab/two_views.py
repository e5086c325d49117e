"""Comparison of a side sensor's limbs with those seen by a sensor in front.

Two sensors recorded the same person: the front sensor, which the person faces, sees
limbs that the side sensor has to guess. Frames are matched by the recording computer's
clock. For each session, one rigid transform over the joints of the trunk brings the two
sensors together. Each joint's constant offset in the heading frame is subtracted,
because it depends on the direction from which a sensor sees the joint. The heading of
the trunk is compared as well.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from kinefilter.characters import InputError, Skeleton, Take
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.cleaner import Cleaner
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.correct import LearnedCorrector
from kinefilter.pipeline.failures.sides import swapped_back, swapped_frames
from kinefilter.pipeline.formats.takes import read_take
from kinefilter.pipeline.merge.rigid import placement
from kinefilter.pipeline.pairs import PairedTake
from kinefilter.pipeline.progress import Progress, over, silent
from kinefilter.pipeline.target.smooth import smooth
from kinefilter.pipeline.workers import workers
from kinefilter.retarget import HeadingFrame, find_yaw

from .accuracy import area_under_roc
from .methods.training_data import TrainingSet
from .misplaced import misplaced
from .pairing import changed_bones
from .systems import check_untrained
from .training import teach, training_set

LIMBS = {
    f"{limb} {side.lower()}": tuple(joint + side for joint in joints)
    for limb, joints in (("arm", ("Elbow", "Wrist")), ("leg", ("Knee", "Ankle")))
    for side in ("Left", "Right")
}
"""Limbs that are compared, and their joints."""
_TRUNK = "trunk"  # of which the heading is compared
FAR = 0.12  # m from the front sensor's joint, beyond which a joint is wrong

_CUTOFF = 6.0  # Hz: the front sensor is lightly smoothed
_SPEED = 6.0  # m/s beyond which the front is in doubt
_FACING = 45.0  # degrees away from a sensor beyond which it loses limbs
_BESIDE = 10.0  # degrees that people turn away from B more than from A if B is beside
_FOLDS = 4  # groups of people; each is tested by training on the others
_LEAST = 30  # ticks at which both sensors have a frame

Figures = dict[str, Any]
_FRAMES = ("all", "sure")  # sure: without frames in which the front sensor is in doubt


class Session(NamedTuple):
    """Two simultaneous takes of a person, and the CSV ``milliseconds,A,B``."""

    name: str
    first: Path
    second: Path
    sync: Path

    @property
    def person(self) -> str:
        """The person: the name up to its first underscore."""
        return self.name.split("_")[0]


def find_sessions(paths: Sequence[Path], sync: Path | None) -> list[Session]:
    """Return the sessions at some paths, or raise an InputError.

    The paths are two takes with ``sync``, a CSV ``milliseconds,A,B`` with the time
    stamps [s] of both sensors' latest frames; or, without ``sync``, folders and
    patterns of sessions ``NAME.sync.csv``, ``NAME_A*.csv*`` and ``NAME_B*.csv*``.
    """
    if sync is not None:
        if len(paths) != 2:
            raise InputError(f"--sync is for two takes, --views names {len(paths)}")
        name = sync.name.removesuffix(".sync.csv")
        return [Session(name, paths[0], paths[1], sync)]
    sessions, end = [], ".sync.csv"
    for path in paths:
        pattern = f"*{end}" if path.is_dir() else path.name.removesuffix(end) + end
        files = sorted((path if path.is_dir() else path.parent).glob(pattern))
        if not files:
            raise InputError(f"{path}: no session, NAME{end}; two takes need --sync")
        for file in files:
            name = file.name.removesuffix(end)
            takes = [sorted(file.parent.glob(f"{name}_{s}*.csv*")) for s in "AB"]
            if not all(takes):
                raise InputError(f"{file}: no takes {name}_A*.csv* and {name}_B*.csv*")
            sessions.append(Session(name, takes[0][0], takes[1][0], file))
    return sessions


def compare_views(
    sessions: Sequence[Session],
    methods: Sequence[str],
    *,
    train: Sequence[PairedTake] = (),
    physics: bool = True,
    progress: Progress = silent,
) -> Figures:
    """Return the distances between two sensors' limbs [cm], by session and by angle.

    Beside them are the angles between the headings of the trunk [degrees], medians over
    frames, because sides may be swapped in some. The side sensor's take is cleaned with
    each method, with or without physics. All must work without training, as in
    ``measure_hidden``, except ``learned``, which is trained on the pairs ``train`` and
    the sessions of other people.

    Raises:
        InputError: A method is unknown, or takes do not belong together.
    """
    check_untrained([m for m in methods if m != "learned" or not train])
    trained: dict[str, LearnedCorrector] = {}
    if "learned" in methods:
        trained = _train_by_person(sessions, training_set(train), progress)
    arguments = [(s, methods, physics, trained.get(s.person)) for s in sessions]
    if len(sessions) == 1:
        results = [_compare(*arguments[0])]
    else:
        with workers() as pool:
            jobs = [pool.submit(_compare, *row) for row in arguments]
            results = [job.result() for job in over(jobs, "compare", progress)]
    angles: Figures = {}
    for angle in dict.fromkeys(figures["angle"] for figures in results):
        some = [figures for figures in results if figures["angle"] == angle]
        rows: Figures = {}
        for row in some[0]["rows"]:
            each = [figures["rows"][row] for figures in some]
            rows[row] = {
                part: {key: _mean([of[part][key] for of in each]) for key in _FRAMES}
                for part in (*LIMBS, _TRUNK)
            }
        areas = _areas([figures["joints"] for figures in some])
        angles[angle] = {"sessions": len(some), "rows": rows, "auc": areas}
    for figures in results:
        figures["auc"] = _areas([figures.pop("joints")])
    return {"sessions": results, "angles": angles}


class Views(NamedTuple):
    """The take of a sensor beside a person, and the motion seen by one in front.

    ``sure`` are limbs that the front sensor sees plausibly: no implausible bone length
    or speed, and the person faces it, that is, does not turn away from it.
    """

    side: Take  # the side sensor's take
    frames: NDArray[np.intp]  # its T frames for which the front sensor has one too
    truth: Array  # joint positions by the front sensor [m], (T, J, 3)
    sure: NDArray[np.bool_]  # (T, 4)
    sensor: str  # the side sensor, A or B
    facing: dict[str, float]  # median angle between heading and each sensor [degrees]
    faces: NDArray[np.bool_]  # frames in which the person faces the front sensor, (T,)


def read_views(session: Session) -> Views:
    """Read a session's takes and match their frames.

    Raises:
        InputError: The takes do not belong together.
    """
    first, second = read_take(session.first), read_take(session.second)
    if first.skeleton != second.skeleton:
        raise InputError(
            f"{second.source}: the skeleton is {second.skeleton.name}, but that of "
            f"{first.source} is {first.skeleton.name}; two views need the same skeleton"
        )
    rows = _matched(session, first, second)
    takes = {"A": (first, rows[0]), "B": (second, rows[1])}
    mended = {sensor: _mended(take) for sensor, (take, _) in takes.items()}
    turned = {sensor: _turned(mended[sensor], at) for sensor, (_, at) in takes.items()}
    facing = {sensor: float(np.nanmedian(turn)) for sensor, turn in turned.items()}
    sides = "BA" if facing["B"] > facing["A"] + _BESIDE else "AB"
    (side, at), (_, front_at) = (takes[sensor] for sensor in sides)
    truth, sure = _seen_in_front(mended[sides[1]])
    faces = turned[sides[1]] < _FACING
    sure = sure[front_at] & faces[:, None]
    return Views(side, at, truth[front_at], sure, sides[0], facing, faces)


def _train_by_person(
    sessions: Sequence[Session], lessons: TrainingSet, progress: Progress
) -> dict[str, LearnedCorrector]:
    """Return for each person a method that was not trained on them."""
    people = sorted({session.person for session in sessions})
    trained: dict[str, LearnedCorrector] = {}
    for k in range(min(_FOLDS, len(people))):
        held_out = people[k::_FOLDS]
        others = [session for session in sessions if session.person not in held_out]
        views = training_set(view_pairs(others, progress)) if others else None
        method = teach("learned", lessons, views=views, progress=progress)
        trained |= dict.fromkeys(held_out, method)
    return trained


def _compare(
    session: Session,
    methods: Sequence[str],
    physics: bool,
    learned: LearnedCorrector | None,
) -> Figures:
    side, at, truth, sure, sensor, facing, faces = read_views(session)
    skeleton = side.skeleton
    joints = [skeleton.index(joint) for limb in LIMBS.values() for joint in limb]
    seen = {"raw": side.positions[at]}
    for method in methods:
        config, corrector = CleanConfig(method=method, physics=physics), None
        if method == "learned" and learned is not None:
            config = CleanConfig(physics=physics)
            corrector = learned.from_arrays(skeleton, learned.arrays())
        clip = Cleaner(config, corrector=corrector).clean(side).clip
        seen[method] = clip.positions[at]
    away = {
        row: away_from(places, truth, skeleton)[:, joints]
        for row, places in seen.items()
    }
    wrong, known = away["raw"] > FAR, ~np.isnan(away["raw"])
    doubts = (1.0 - clip.reliability[at], misplaced(side)[at])
    doubt = np.stack([share[:, joints] for share in doubts], axis=2)
    rows: Figures = {}
    for row, distances in away.items():
        by_limb = distances.reshape(-1, len(LIMBS), 2) * 100.0
        rows[row] = {
            limb: {"all": _mean(by_limb[:, k]), "sure": _mean(by_limb[sure[:, k], k])}
            for k, limb in enumerate(LIMBS)
        }
        turned = _turned_from(seen[row], truth, skeleton)
        rows[row][_TRUNK] = {"all": _median(turned), "sure": _median(turned[faces])}
    return {
        "session": session.name,
        "angle": session.name.split("_")[1] if session.name.count("_") > 1 else "",
        "side": sensor,
        "facing_degrees": facing,
        "frames": len(at),
        "sure_share": float(sure.mean()),
        "rows": rows,
        "joints": [a[known] for a in (wrong, doubt, np.repeat(sure, 2, axis=1))],
    }


def _matched(session: Session, first: Take, second: Take) -> list[NDArray[np.intp]]:
    """Return the frames of both takes that were the latest at the same tick."""
    try:
        lines = session.sync.read_text("utf-8").splitlines()[1:]
        cells = [line.split(",")[1:3] for line in lines]
        stamps = np.unique(np.array(cells, dtype=float), axis=0)
        _, _ = stamps.T
    except (OSError, ValueError) as error:
        raise InputError(
            f"{session.sync}: not stamps of two sensors ({error}); expected a header "
            "and rows milliseconds,A,B"
        ) from None
    frames, both = [], np.ones(len(stamps), dtype=bool)
    for take, stamp in zip((first, second), stamps.T, strict=True):
        rows = np.searchsorted(take.time, stamp - 1e-6).clip(max=len(take) - 1)
        both &= np.abs(take.time[rows] - stamp) < 1e-5
        frames.append(rows)
    if both.sum() < _LEAST:
        raise InputError(
            f"{session.sync}: both takes have a frame at {both.sum()} ticks, expected "
            f"{_LEAST} or more; do the takes belong together?"
        )
    return [rows[both] for rows in frames]


def _mended(take: Take) -> Take:
    """Return a take with left and right swapped back; times may repeat."""
    _, first, frames = np.unique(take.time, return_index=True, return_inverse=True)
    once = take.at(first)
    return swapped_back(once, swapped_frames(once)).at(frames)


def _yaw(positions: Array, skeleton: Skeleton) -> Array:
    return find_yaw(positions, np.ones(positions.shape[:-1]), skeleton)


def _turned(take: Take, rows: NDArray[np.intp]) -> Array:
    """Return the angle between heading and sensor [degrees], NaN where unknown."""
    positions = take.positions[rows]
    to_sensor = -positions[:, take.skeleton.root]
    view = np.arctan2(to_sensor[:, 0], to_sensor[:, 2])
    return _size_of_turn(_yaw(positions, take.skeleton) - view)


def _size_of_turn(angles: Array) -> Array:
    """Return the size of turns [rad] in degrees, at most 180."""
    return np.asarray(np.degrees(np.abs(np.angle(np.exp(1j * angles)))))


def _seen_in_front(take: Take) -> tuple[Array, NDArray[np.bool_]]:
    """Return lightly smoothed positions [m] and plausible limbs, (T, J, 3) and (T, 4).

    A limb is implausible where a bone's length or a joint's speed is.
    """
    time, first, frames = np.unique(take.time, return_index=True, return_inverse=True)
    positions, skeleton = take.positions[first], take.skeleton
    missing = np.isnan(positions)
    weights = np.where(missing[..., 0], 1e-6, 1.0)
    path = smooth(time, np.nan_to_num(positions), weights, cutoff=_CUTOFF)
    odd = changed_bones(positions, skeleton)
    moved = np.linalg.norm(np.diff(positions, axis=0), axis=2)
    fast = moved / np.diff(time)[:, None] > _SPEED
    odd[1:] |= fast
    odd[:-1] |= fast
    joints = [[skeleton.index(joint) for joint in limb] for limb in LIMBS.values()]
    sure = ~np.asarray(odd[:, joints].any(axis=2))
    return np.where(missing, np.nan, path)[frames], sure[frames]


def view_pairs(
    sessions: Sequence[Session], progress: Progress = silent
) -> Iterator[PairedTake]:
    """Yield the takes of side sensors with the front sensor's joints as ground truth.

    The ground truth is in the side sensor's frame; it is NaN in frames that the front
    sensor lacks or in which the person turns away from it.
    """
    for session in over(sessions, "read views", progress):
        side, at, seen, *_, faces = read_views(session)
        side = _mended(side)
        at, truth = at[faces], np.full_like(side.positions, np.nan)
        truth[at] = _placed(seen[faces], side.positions[at], side.skeleton)
        yield PairedTake(side, truth, session.person, session.name)


def _placed(positions: Array, onto: Array, skeleton: Skeleton) -> Array:
    """Return positions [m] after aligning their trunk with another."""
    ends = [skeleton.index(f"Shoulder{side}") for side in ("Left", "Right")]
    trunk = [skeleton.girdle, *ends, *skeleton.hips]
    while (joint := skeleton.parents[trunk[0]]) != -1:
        trunk.insert(0, joint)
    return placement(positions[:, trunk], onto[:, trunk]).apply(positions)


def away_from(positions: Array, truth: Array, skeleton: Skeleton) -> Array:
    """Return joints' distances [m] from the truth less their median offset, (T, J)."""
    away = _placed(positions, truth, skeleton) - truth
    heading = HeadingFrame(np.zeros_like(truth[:, 0]), _yaw(truth, skeleton))
    facing = heading.remove(away)
    return np.asarray(np.linalg.norm(facing - np.nanmedian(facing, axis=0), axis=2))


def _turned_from(positions: Array, truth: Array, skeleton: Skeleton) -> Array:
    """Return the angles between the trunk's heading and the true one [degrees], (T,).

    The two are brought together by the middle line of the body, because a sensor may
    show hips and shoulders turned.
    """
    names = ("Head", "KneeLeft", "AnkleLeft")
    line = [skeleton.root, skeleton.girdle, *map(skeleton.index, names)]
    mirror = skeleton.mirror[line]
    middles = (0.5 * (p[:, line] + p[:, mirror]) for p in (truth, positions))
    apart = _yaw(positions, skeleton) - _yaw(
        placement(*middles).rotate(truth), skeleton
    )
    return _size_of_turn(apart)


def _mean(values: Any) -> float | None:
    known = np.array([v for v in np.ravel(values) if v is not None and not np.isnan(v)])
    return float(known.mean()) if len(known) else None


def _median(values: Array) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else None


def _areas(joints: Sequence[tuple[Any, Any, Any]]) -> dict[str, float | None]:
    """Return the area under ROC of wrong joints, in all frames and in sure ones."""
    wrong, doubt, sure = (np.concatenate(part) for part in zip(*joints, strict=True))
    areas: dict[str, float | None] = {}
    for name, some in (("all", np.ones_like(sure)), ("sure", sure)):
        for k, measure in enumerate(("", "misplaced_")):
            areas[measure + name] = area_under_roc(wrong[some], doubt[some, k])
    return areas


def as_table(figures: Figures) -> Table:
    """Return the figures as a table for the terminal."""
    table = Table("session, side sensor", title="between the two sensors, cm")
    for heading in (*LIMBS, "trunk, degrees"):
        table.add_column(heading, justify="right", no_wrap=True)
    means = [
        {**mean, "session": f"mean of {mean['sessions']} {angle}", "side": ""}
        for angle, mean in figures["angles"].items()
    ]
    for session in (*figures["sessions"], *(means if figures["sessions"][1:] else ())):
        table.add_section()
        table.add_row(f"{session['session']} {session['side']}")
        for row, limbs in session["rows"].items():
            table.add_row(f"  {row}", *(_shown(limb, 1) for limb in limbs.values()))
        for measure, label in (("", "1 - reliability"), ("misplaced_", "misplaced")):
            areas = {name: session["auc"][measure + name] for name in ("all", "sure")}
            table.add_row(f"  ROC, {label}", _shown(areas, 2))
    table.caption = (
        "second figure: without frames in which the front sensor is in doubt; ROC: "
        f"area under the curve for joints over {FAR * 100:.0f} cm away"
    )
    return table


def _shown(values: dict[str, float | None], digits: int) -> str:
    figures = [values[key] for key in _FRAMES]
    return " / ".join("-" if v is None else f"{v:.{digits}f}" for v in figures)
