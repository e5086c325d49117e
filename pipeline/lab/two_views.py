"""How near a side sensor's limbs are to where the sensor in front sees them.

Two sensors recorded the same person. What the one beside the person guesses, the one
that the person faces sees. Both are read at the same tick of the recording computer.
One rigid transform over the joints of the trunk places a session of the side sensor in
the frame of the front one, and each joint's constant offset in the heading frame is
taken off: it is a matter of where a sensor sees that joint from there.
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
from kinefilter.pipeline.formats.takes import read_take
from kinefilter.pipeline.merge.rigid import placement
from kinefilter.pipeline.pairs import PairedTake
from kinefilter.pipeline.progress import Progress, over, silent
from kinefilter.pipeline.reliability import segment_lengths
from kinefilter.pipeline.target.smooth import smooth
from kinefilter.pipeline.workers import workers
from kinefilter.retarget import HeadingFrame, find_yaw

from .accuracy import area_under_roc
from .methods.lessons import TrainingSet
from .misplaced import misplaced
from .systems import check_untaught
from .teach import teach
from .training import training_set

LIMBS = {
    f"{limb} {side.lower()}": tuple(joint + side for joint in joints)
    for limb, joints in (("arm", ("Elbow", "Wrist")), ("leg", ("Knee", "Ankle")))
    for side in ("Left", "Right")
}
"""Limbs that are compared, and their joints."""
FAR = 0.12
"""Joints farther than this [m] from where the front sensor sees them are wrong."""

_CUTOFF = 6.0  # Hz: the front sensor is lightly smoothed
_LENGTH, _SPEED = 0.25, 6.0  # share of the median, m/s: beyond, the front is in doubt
_FACING = 45.0  # degrees; who turns away farther hides limbs from that sensor
_BESIDE = 10.0  # degrees by which people turn away more from B, where B is beside them
_FOLDS = 4  # of people: each learns from all others
_LEAST = 30  # ticks in which both sensors saw somebody

Figures = dict[str, Any]
_FRAMES = ("all", "sure")  # without those in which the front sensor is in doubt


class Session(NamedTuple):
    """Two takes of a person at the same time, and the CSV ``milliseconds,A,B``."""

    name: str
    first: Path
    second: Path
    sync: Path

    @property
    def person(self) -> str:
        """Who is in it: what comes before the name's first underscore."""
        return self.name.split("_")[0]


def find_sessions(paths: Sequence[Path], sync: Path | None) -> list[Session]:
    """Return the sessions that paths name; raises InputError where there is none.

    Args:
        paths: Two takes with their ``sync``; or folders and patterns of sessions, which
            are ``NAME.sync.csv`` beside ``NAME_A*.csv*`` and ``NAME_B*.csv*``.
        sync: CSV ``milliseconds,A,B``: the stamp [s] of either sensor's latest frame.
    """
    if sync is not None:
        if len(paths) != 2:
            raise InputError(f"--sync is for two takes, --views names {len(paths)}")
        name = sync.name.removesuffix(".sync.csv")
        return [Session(name, paths[0], paths[1], sync)]
    found = []
    for path in paths:
        end = ".sync.csv"
        pattern = f"*{end}" if path.is_dir() else path.name.removesuffix(end) + end
        files = sorted((path if path.is_dir() else path.parent).glob(pattern))
        if not files:
            raise InputError(f"{path}: no session, NAME{end}; two takes need --sync")
        for file in files:
            name = file.name.removesuffix(end)
            takes = [sorted(file.parent.glob(f"{name}_{s}*.csv*")) for s in "AB"]
            if not all(takes):
                raise InputError(f"{file}: no takes {name}_A*.csv* and {name}_B*.csv*")
            found.append(Session(name, takes[0][0], takes[1][0], file))
    return found


def compare_views(
    sessions: Sequence[Session],
    methods: Sequence[str],
    *,
    train: Sequence[PairedTake] = (),
    physics: bool = True,
    progress: Progress = silent,
) -> Figures:
    """Return the distances [cm] between two sensors' limbs, by session and by angle.

    Args:
        sessions: What was recorded.
        methods: As of ``measure_hidden``, to clean the side sensor's take by; and
            ``learned``, from ``train`` and from the sessions of other people.
        train: Pairs of Kinect and mocap.
        physics: Pull the simulated character through the motion.
        progress: Wraps the loop over sessions, for a progress bar.

    Raises:
        InputError: Unknown methods, or takes that do not belong together.
    """
    check_untaught([m for m in methods if m != "learned" or not train])
    taught: dict[str, LearnedCorrector] = {}
    if "learned" in methods:
        taught = _taught(sessions, training_set(train), progress)
    rows = [
        (session, methods, physics, taught.get(session.person)) for session in sessions
    ]
    if len(sessions) == 1:
        found = [_compare(*rows[0])]
    else:
        with workers() as pool:
            jobs = [pool.submit(_compare, *row) for row in rows]
            found = [job.result() for job in over(jobs, "compare", progress)]
    angles: Figures = {}
    for angle in dict.fromkeys(figures["angle"] for figures in found):
        some = [figures for figures in found if figures["angle"] == angle]
        angles[angle] = {"sessions": len(some), "rows": {}}
        for row in some[0]["rows"]:
            limbs = [figures["rows"][row] for figures in some]
            angles[angle]["rows"][row] = {
                limb: {key: _mean([of[limb][key] for of in limbs]) for key in _FRAMES}
                for limb in LIMBS
            }
        angles[angle]["auc"] = _areas([figures["found"] for figures in some])
    for figures in found:
        figures["auc"] = _areas([figures.pop("found")])
    return {"sessions": found, "angles": angles}


class Views(NamedTuple):
    """The take of a sensor beside a person, and what one in front saw meanwhile."""

    side: Take
    """The sensor beside."""
    frames: NDArray[np.intp]
    """Its frames that the one in front has too, shape (T,)."""
    truth: Array
    """Joint positions of the sensor in front [m], shape (T, J, 3)."""
    sure: NDArray[np.bool_]
    """Where that sensor is not in doubt itself, limb by limb, shape (T, 4): nor where
    people turn away from it."""
    sensor: str
    """Which one is beside: A or B."""
    facing: dict[str, float]
    """How far people mostly turn away from each sensor [degrees]."""
    faces: NDArray[np.bool_]
    """Frames in which they do not turn away from the one in front, shape (T,)."""


def read_views(session: Session) -> Views:
    """Read a session's takes and bring them together.

    Raises:
        InputError: They do not belong together.
    """
    first, second = read_take(session.first), read_take(session.second)
    if first.skeleton != second.skeleton:
        raise InputError(
            f"{second.source}: {second.skeleton.name}, but {first.source} is "
            f"{first.skeleton.name}; two views need the same skeleton"
        )
    rows = _matched(session, first, second)
    takes = {"A": (first, rows[0]), "B": (second, rows[1])}
    turned = {sensor: _turned(take, rows) for sensor, (take, rows) in takes.items()}
    facing = {sensor: float(np.nanmedian(turn)) for sensor, turn in turned.items()}
    sides = "BA" if facing["B"] > facing["A"] + _BESIDE else "AB"
    (side, at), (front, front_at) = (takes[sensor] for sensor in sides)
    truth, sure = _seen_in_front(front)
    faces = turned[sides[1]] < _FACING
    sure = sure[front_at] & faces[:, None]
    return Views(side, at, truth[front_at], sure, sides[0], facing, faces)


def _taught(
    sessions: Sequence[Session], lessons: TrainingSet, progress: Progress
) -> dict[str, LearnedCorrector]:
    """Return a method for each person that has not learned from them."""
    people = sorted({session.person for session in sessions})
    made: dict[str, LearnedCorrector] = {}
    for k in range(min(_FOLDS, len(people))):
        out = people[k::_FOLDS]
        others = [session for session in sessions if session.person not in out]
        views = training_set(view_pairs(others, progress)) if others else None
        taught = teach("learned", lessons, views=views, progress=progress)
        made |= dict.fromkeys(out, taught)
    return made


def _compare(
    session: Session,
    methods: Sequence[str],
    physics: bool,
    learned: LearnedCorrector | None,
) -> Figures:
    pair = read_views(session)
    side, at, truth, sure = pair.side, pair.frames, pair.truth, pair.sure
    skeleton = side.skeleton
    joints = [skeleton.index(joint) for limb in LIMBS.values() for joint in limb]
    away = {"raw": away_from(side.positions[at], truth, skeleton)[:, joints]}
    for method in methods:
        config, corrector = CleanConfig(method=method, physics=physics), None
        if method == "learned" and learned is not None:
            config = CleanConfig(physics=physics)
            corrector = learned.from_arrays(skeleton, learned.arrays())
        clip = Cleaner(config, corrector=corrector).clean(side).clip
        away[method] = away_from(clip.positions[at], truth, skeleton)[:, joints]
    wrong, known = away["raw"] > FAR, ~np.isnan(away["raw"])
    doubts = (1.0 - clip.reliability[at], misplaced(side)[at])
    doubt = np.stack([share[:, joints] for share in doubts], axis=2)
    rows_cm: Figures = {}
    for row, distances in away.items():
        by_limb = distances.reshape(-1, len(LIMBS), 2) * 100.0
        rows_cm[row] = {
            limb: {"all": _mean(by_limb[:, k]), "sure": _mean(by_limb[sure[:, k], k])}
            for k, limb in enumerate(LIMBS)
        }
    return {
        "session": session.name,
        "angle": session.name.split("_")[1] if session.name.count("_") > 1 else "",
        "side": pair.sensor,
        "facing_degrees": pair.facing,
        "frames": len(at),
        "sure_share": float(sure.mean()),
        "rows": rows_cm,
        "found": [a[known] for a in (wrong, doubt, np.repeat(sure, 2, axis=1))],
    }


def _matched(
    session: Session, first: Take, second: Take
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
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
    found = []
    for take, stamp in zip((first, second), stamps.T, strict=True):
        rows = np.searchsorted(take.time, stamp - 1e-6).clip(max=len(take) - 1)
        found.append((rows, np.abs(take.time[rows] - stamp) < 1e-5))
    both = found[0][1] & found[1][1]
    if both.sum() < _LEAST:
        raise InputError(
            f"{session.sync}: {both.sum()} ticks are of frames in both takes, expected "
            f"{_LEAST} or more; do the takes belong together?"
        )
    return found[0][0][both], found[1][0][both]


def _yaw(positions: Array, skeleton: Skeleton) -> Array:
    return find_yaw(positions, np.ones(positions.shape[:-1]), skeleton)


def _turned(take: Take, rows: NDArray[np.intp]) -> Array:
    """Return how far people turn away from the sensor [degrees], NaN where unknown."""
    positions = take.positions[rows]
    there = -positions[:, take.skeleton.root]
    turn = _yaw(positions, take.skeleton) - np.arctan2(there[:, 0], there[:, 2])
    return np.asarray(np.degrees(np.abs(np.angle(np.exp(1j * turn)))))


def _seen_in_front(take: Take) -> tuple[Array, NDArray[np.bool_]]:
    """Return positions [m] lightly smoothed, and which limbs are surely there, (T, 4).

    They are not where the length of a bone or the speed of a joint is not a person's.
    """
    time, first, frames = np.unique(take.time, return_index=True, return_inverse=True)
    positions, skeleton = take.positions[first], take.skeleton
    missing = np.isnan(positions)
    weights = np.where(missing[..., 0], 1e-6, 1.0)
    path = smooth(time, np.nan_to_num(positions), weights, cutoff=_CUTOFF)
    lengths = segment_lengths(positions, skeleton)
    lengths[:, skeleton.root] = 1.0  # has no bone
    strange = np.abs(lengths / np.nanmedian(lengths, axis=0) - 1.0) > _LENGTH
    moved = np.linalg.norm(np.diff(positions, axis=0), axis=2)
    fast = moved / np.diff(time)[:, None] > _SPEED
    strange[1:] |= fast
    strange[:-1] |= fast
    joints = [[skeleton.index(joint) for joint in limb] for limb in LIMBS.values()]
    sure = ~np.asarray(strange[:, joints].any(axis=2))
    return np.where(missing, np.nan, path)[frames], sure[frames]


def view_pairs(
    sessions: Sequence[Session], progress: Progress = silent
) -> Iterator[PairedTake]:
    """Yield the takes of side sensors, with what the sensor in front saw as the truth.

    Placed in the side sensor's frame; NaN in frames that the other does not have, or in
    which people turn away from it.
    """
    for session in over(sessions, "read views", progress):
        views = read_views(session)
        side, frames = views.side, views.frames[views.faces]
        truth = np.full_like(side.positions, np.nan)
        seen = views.truth[views.faces]
        truth[frames] = _placed(seen, side.positions[frames], side.skeleton)
        yield PairedTake(side, truth, session.person, session.name)


def _placed(positions: Array, onto: Array, skeleton: Skeleton) -> Array:
    """Return positions [m] moved and turned so that the trunk lies on another's."""
    ends = [skeleton.index(f"Shoulder{side}") for side in ("Left", "Right")]
    trunk = [skeleton.girdle, *ends, *skeleton.hips]
    while (joint := skeleton.parents[trunk[0]]) != -1:
        trunk.insert(0, joint)
    fit = placement(positions[:, trunk], onto[:, trunk])
    return fit.apply(positions)


def away_from(positions: Array, truth: Array, skeleton: Skeleton) -> Array:
    """Return each joint's distance [m] from the truth, offsets taken off, (T, J)."""
    away = _placed(positions, truth, skeleton) - truth
    heading = HeadingFrame(np.zeros_like(truth[:, 0]), _yaw(truth, skeleton))
    facing = heading.remove(away)
    return np.asarray(np.linalg.norm(facing - np.nanmedian(facing, axis=0), axis=2))


def _mean(values: Any) -> float | None:
    known = np.array([v for v in np.ravel(values) if v is not None and not np.isnan(v)])
    return float(known.mean()) if len(known) else None


def _areas(found: Sequence[tuple[Any, Any, Any]]) -> dict[str, float | None]:
    """Return the area under ROC of wrong joints, and where the front is sure."""
    wrong, doubt, sure = (np.concatenate(one) for one in zip(*found, strict=True))
    areas: dict[str, float | None] = {}
    for name, some in (("all", np.ones_like(sure)), ("sure", sure)):
        for k, measure in enumerate(("", "misplaced_")):
            areas[measure + name] = area_under_roc(wrong[some], doubt[some, k])
    return areas


def as_table(figures: Figures) -> Table:
    """Return the figures for a terminal."""
    table = Table("session, side sensor", title="cm between the two sensors' limbs")
    for heading in LIMBS:
        table.add_column(heading, justify="right", no_wrap=True)
    means = [
        {**mean, "session": f"mean of {mean['sessions']} {angle}", "side": ""}
        for angle, mean in figures["angles"].items()
    ]
    for session in (*figures["sessions"], *(means if figures["sessions"][1:] else ())):
        table.add_section()
        table.add_row(f"{session['session']} {session['side']}")
        for row, limbs in session["rows"].items():
            table.add_row(f"  {row}", *(_pair(limb, 1) for limb in limbs.values()))
        for measure, label in (("", "1 - reliability"), ("misplaced_", "misplaced")):
            areas = {name: session["auc"][measure + name] for name in ("all", "sure")}
            table.add_row(f"  ROC, {label}", _pair(areas, 2))
    table.caption = (
        "second figure: without frames in which the front sensor is in doubt; area "
        f"under ROC for joints over {FAR * 100:.0f} cm away"
    )
    return table


def _pair(values: dict[str, float | None], digits: int) -> str:
    figures = [values[key] for key in _FRAMES]
    return " / ".join("-" if v is None else f"{v:.{digits}f}" for v in figures)
