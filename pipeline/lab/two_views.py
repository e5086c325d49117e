"""Comparison of a side sensor's limbs with those seen by a sensor in front.

One rigid transform over the joints of the trunk brings them together. Each joint's
constant offset in the heading frame is subtracted, because it depends on the direction
from which a sensor sees the joint. The heading of the trunk is compared as well.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Column, Table

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import wrapped
from kinefilter.pipeline.cleaner import Cleaner
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.correct import LearnedCorrector
from kinefilter.pipeline.merge.rigid import placement
from kinefilter.pipeline.pairs import PairedTake
from kinefilter.pipeline.progress import Progress, over, silent
from kinefilter.pipeline.workers import workers
from kinefilter.retarget import find_yaw

from .accuracy import area_under_roc
from .methods.training_data import TrainingSet
from .misplaced import misplaced
from .systems import check_untrained
from .training import teach, training_set
from .view_sessions import FAR, LIMBS, Session, away_from, read_views, view_pairs

_WALKS = 0.3  # m that somebody moves at least for the headings to be comparable
_TRUNK = "trunk"  # of which the heading is compared
_FOLDS = 4  # groups of people; each is tested by training on the others

Figures = dict[str, Any]
_FRAMES = ("all", "sure")  # sure: without frames in which the front sensor is in doubt


def compare_views(
    sessions: Sequence[Session],
    methods: Sequence[str],
    *,
    train: Sequence[PairedTake] = (),
    physics: bool = True,
    progress: Progress = silent,
) -> Figures:
    """Return the distances between two sensors' limbs [cm], by session and by angle.

    Beside them are the median angles between the headings of the trunk [degrees]. The
    side sensor's take is cleaned with each method. All must work without training
    except ``learned``, which is trained on the pairs ``train`` and the sessions of
    other people. Raises an InputError if a method is unknown, or if takes do not belong
    together.
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


def _train_by_person(
    sessions: Sequence[Session], lessons: TrainingSet, progress: Progress
) -> dict[str, LearnedCorrector]:
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
    session: Session, names: Sequence[str], physics: bool, own: LearnedCorrector | None
) -> Figures:
    side, at, truth, sure, sensor, facing, faces = read_views(session)
    skeleton = side.skeleton
    joints = [skeleton.index(joint) for limb in LIMBS.values() for joint in limb]
    seen = {"raw": side.positions[at]}
    for method in names:
        config, corrector = CleanConfig(method=method, physics=physics), None
        if method == "learned" and own is not None:
            config = CleanConfig(physics=physics)
            corrector = own.from_arrays(skeleton, own.arrays())
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


def _turned_from(positions: Array, truth: Array, skeleton: Skeleton) -> Array:
    """Return the angles between headings of trunks with one middle [degrees], (T,).

    They are NaN if the person hardly moves, which leaves the turn of an upright middle
    about itself open.
    """
    if np.ptp(truth[:, skeleton.root, [0, 2]], axis=0).max() < _WALKS:
        return np.full(len(truth), np.nan)
    names = ("Head", "KneeLeft", "AnkleLeft")
    line = [skeleton.root, skeleton.girdle, *map(skeleton.index, names)]
    mirror = skeleton.mirror[line]
    middles = (0.5 * (p[:, line] + p[:, mirror]) for p in (truth, positions))
    true_yaw = find_yaw(placement(*middles).rotate(truth), skeleton)
    return np.degrees(np.abs(wrapped(find_yaw(positions, skeleton) - true_yaw)))


def _mean(values: Any) -> float | None:
    known = np.array([v for v in np.ravel(values) if v is not None and not np.isnan(v)])
    return float(known.mean()) if len(known) else None


def _median(values: Array) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else None


def _areas(joints: Sequence[tuple[Any, Any, Any]]) -> dict[str, float | None]:
    wrong, doubt, sure = (np.concatenate(part) for part in zip(*joints, strict=True))
    areas: dict[str, float | None] = {}
    for name, some in (("all", np.ones_like(sure)), ("sure", sure)):
        for k, measure in enumerate(("", "misplaced_")):
            areas[measure + name] = area_under_roc(wrong[some], doubt[some, k])
    return areas


def as_table(figures: Figures) -> Table:
    """Return the figures as a table for the terminal."""
    headings = (*LIMBS, "trunk,\ndegrees")
    columns = [Column("session,\nside sensor", no_wrap=True)]
    columns += [Column(name, justify="right", no_wrap=True) for name in headings]
    table = Table(*columns, title="between the two sensors, cm", box=SIMPLE_HEAD)
    table.padding, table.pad_edge = 0, False  # 80 columns are enough then
    means = [
        {**mean, "session": f"mean of {mean['sessions']} {angle}", "side": ""}
        for angle, mean in figures["angles"].items()
    ]
    for session in (*figures["sessions"], *(means if figures["sessions"][1:] else ())):
        table.add_section()
        table.add_row(f"{session['session']} {session['side']}")
        for row, limbs in session["rows"].items():
            table.add_row(f"  {row}", *(_shown(limb, 1) for limb in limbs.values()))
        for measure, label in (("", "reliability"), ("misplaced_", "misplaced")):
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
