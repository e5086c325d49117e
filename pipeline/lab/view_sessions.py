"""Reads what two sensors recorded of one person at the same time.

The front sensor, which the person faces, sees limbs that the side sensor has to guess.
Frames are matched by the recording computer's clock.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import InputError, Skeleton, Take
from kinefilter.characters.arrays import Array, Flags
from kinefilter.characters.rotations import wrapped
from kinefilter.pipeline.failures.sides import (
    root_velocity,
    swapped_back,
    swapped_frames,
)
from kinefilter.pipeline.formats.takes import read_take
from kinefilter.pipeline.merge.rigid import placement
from kinefilter.pipeline.pairs import PairedTake, check_same_skeleton
from kinefilter.pipeline.progress import Progress, over, silent
from kinefilter.pipeline.target.smooth import smooth
from kinefilter.retarget import HeadingFrame, find_yaw

from .pairing import changed_bones

LIMBS = {
    f"{limb} {side.lower()}": tuple(joint + side for joint in joints)
    for limb, joints in (("arm", ("Elbow", "Wrist")), ("leg", ("Knee", "Ankle")))
    for side in ("Left", "Right")
}
"""Limbs that are compared, and their joints."""
FAR = 0.12  # m from the front sensor's joint, beyond which a joint is wrong
_CUTOFF = 6.0  # Hz: the front sensor is lightly smoothed
_SPEED = 6.0  # m/s beyond which the front is in doubt
_FACING = 45.0  # degrees away from a sensor beyond which it loses limbs
_BESIDE = 10.0  # degrees that people turn away from B more than from A if B is beside
_LEAST = 30  # ticks at which both sensors have a frame
_WALKING = 0.3  # m/s
_STRAIGHT = 0.5  # cosine between the course and the way to the front sensor


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
    """Read a session and match its frames; InputError if the takes are of two."""
    first, second = read_take(session.first), read_take(session.second)
    check_same_skeleton(second, first, "two views need the same skeleton")
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


def _matched(session: Session, first: Take, second: Take) -> list[NDArray[np.intp]]:
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


def _turned(take: Take, rows: NDArray[np.intp]) -> Array:
    positions = take.positions[rows]
    to_sensor = -positions[:, take.skeleton.root]
    view = np.arctan2(to_sensor[:, 0], to_sensor[:, 2])
    return np.degrees(np.abs(wrapped(find_yaw(positions, take.skeleton) - view)))


def _seen_in_front(take: Take) -> tuple[Array, NDArray[np.bool_]]:
    """Return smoothed positions [m], (T, J, 3), and limbs without odd bones, (T, 4)."""
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


def toward(views: Views) -> Flags:
    """Return the frames in which people stand, or walk to the front sensor, (T,).

    Of people who pass it from the side, that sensor cannot tell left from right either.
    """
    root = views.truth[:, views.side.skeleton.root, [0, 2]]
    velocity = root_velocity(views.side.time[views.frames], root)
    speed = np.linalg.norm(velocity, axis=1)
    along = np.vecdot(velocity, -root) / np.linalg.norm(root, axis=1)
    return np.asarray((speed < _WALKING) | (along > _STRAIGHT * speed))


def view_pairs(
    sessions: Sequence[Session], progress: Progress = silent
) -> Iterator[PairedTake]:
    """Yield side takes with the front's joints, where the person faces it, as truth."""
    for session in over(sessions, "read views", progress):
        side, at, seen, *_, faces = read_views(session)
        side = _mended(side)
        at, truth = at[faces], np.full_like(side.positions, np.nan)
        truth[at] = placed(seen[faces], side.positions[at], side.skeleton)
        yield PairedTake(side, truth, session.person, session.name)


def placed(positions: Array, onto: Array, skeleton: Skeleton) -> Array:
    """Return positions [m] after aligning their trunk with another."""
    ends = [skeleton.index(f"Shoulder{side}") for side in ("Left", "Right")]
    trunk = [skeleton.girdle, *ends, *skeleton.hips]
    while (joint := skeleton.parents[trunk[0]]) != -1:
        trunk.insert(0, joint)
    return placement(positions[:, trunk], onto[:, trunk]).apply(positions)


def away_from(positions: Array, truth: Array, skeleton: Skeleton) -> Array:
    """Return joints' distances [m] from the truth less their median offset, (T, J)."""
    away = placed(positions, truth, skeleton) - truth
    heading = HeadingFrame(np.zeros_like(truth[:, 0]), find_yaw(truth, skeleton))
    facing = heading.remove(away)
    return np.asarray(np.linalg.norm(facing - np.nanmedian(facing, axis=0), axis=2))
