"""How well postures are reconstructed: Shum 2013, tables III and IV, eq. 18."""

from __future__ import annotations

import numpy as np

from kinefilter.characters import KINECT_V1, Take, random_body
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.cleaner import clean
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.correct import LocalPCA, Observation
from kinefilter.pipeline.database import builtin_database
from kinefilter.pipeline.pairs import PairedTake
from kinefilter.pipeline.progress import Progress, silent
from kinefilter.retarget import HeadingFrame, Standardizer
from kinefilter.retarget.heading_frame import find_yaw
from kinefilter.scenes.library import perform

from .bone_errors import bone_errors
from .study import Panel, Series, Study
from .takes import CLASSES, Kind, people_of, study_takes

_ENDS = ("HandLeft", "HandRight", "FootLeft", "FootRight")
_MIDDLES = ("ElbowLeft", "ElbowRight", "KneeLeft", "KneeRight")
_GIVEN: dict[str, tuple[str, ...]] = {
    "(a) left hand, left foot": ("HandLeft", "FootLeft"),
    "(b) hands": ("HandLeft", "HandRight"),
    "(c) hands, feet": _ENDS,
    "(d) hands, feet, elbows, knees": _ENDS + _MIDDLES,
    "(e) all parts": KINECT_V1.joints,
}
_PAPER_DIFFERENCES = (6.38, 5.60, 4.52, 4.15, 3.90)  # cm
_MOTIONS = (
    *("walk", "run", "pick_up", "carry", "point"),
    *("scratch", "punch", "kick", "swing", "dodge"),
)
"""The examples of the paper's own motion database (table I)."""

_PAPER_ERRORS = {"a": (9.59, 7.26), "b": (10.89, 7.44), "c": (12.41, 7.76)}  # cm


def shum_table_3(
    *, seed: int = 0, motions: int = 10, progress: Progress = silent
) -> Study:
    """Reconstruct whole postures from some of their joints, given without error.

    The paper's figure is that of the posture of least energy in the natural posture
    space (``difference_cm``), which moves the given joints too; the correction that is
    shipped keeps them where they are (``joints_kept_cm``). Lengths are those of the
    standard body on both sides; position and heading of the body are known in every
    setup, as they are taken out before.

    Args:
        seed: Draws people and performances.
        motions: How many of the ten motions, each by another person.
        progress: Wraps the loops, for a progress bar.
    """
    database = builtin_database(KINECT_V1)
    acts = [_natural(_MOTIONS[k], people_of(seed) + k) for k in range(motions)]
    found = []
    for given in _GIVEN.values():
        joints = [KINECT_V1.index(name) for name in given]
        rate = np.zeros(len(KINECT_V1))
        rate[joints] = 1.0
        parts = [
            _reconstructed(acts[k], rate, LocalPCA(database))
            for k in progress(f"from {len(joints)} joints", len(acts))
        ]
        found.append(np.concatenate(parts).mean(axis=0) * 100.0)
    rows = zip(_GIVEN, found, _PAPER_DIFFERENCES, strict=True)
    setups = [name[:3] for name in _GIVEN]
    return Study(
        name="shum-table-3",
        title="Postures from some of their joints (Shum 2013, Table III)",
        columns=("joints_given", "difference_cm", "joints_kept_cm", "paper_cm"),
        rows=tuple((name, float(f[0]), float(f[1]), paper) for name, f, paper in rows),
        panels=(
            Panel(
                "joints given",
                "difference (eq. 18), cm",
                (
                    Series("posture space", setups, [f[0] for f in found], "bars"),
                    Series("given joints kept", setups, [f[1] for f in found], "bars"),
                    Series("paper", setups, _PAPER_DIFFERENCES, "bars", paper=True),
                ),
            ),
        ),
    )


def _natural(motion: str, person: int) -> Array:
    """Return a performance's postures on the standard body, without yaw, (T, J, 3)."""
    body = random_body(KINECT_V1, np.random.default_rng(person))
    positions = perform(motion, body, seed=person).positions
    yaw = find_yaw(positions, np.ones(len(KINECT_V1)), KINECT_V1)
    view = HeadingFrame(positions[:, KINECT_V1.root], yaw)
    return Standardizer(body).standardize(positions, view)


def _reconstructed(postures: Array, rate: Array, method: LocalPCA) -> Array:
    """Return eq. 18 of each frame [m], shape (T, 2).

    First without, then with the given joints put back where they were.
    """
    seen = np.where(rate[:, None] > 0.0, postures, np.nan)
    made = np.empty((2, *postures.shape))
    method.start()
    for k, frame in enumerate(seen):
        made[0, k] = method.synthesize(frame, rate)[0]
    method.start()
    for k, frame in enumerate(seen):
        made[1, k] = method.step(Observation(frame, rate, rate)).positions
    errors = [bone_errors(one, postures, KINECT_V1).mean(axis=1) for one in made]
    return np.stack(errors, axis=1)


def shum_table_4(
    *, seed: int = 0, takes: int = 12, progress: Progress = silent
) -> Study:
    """Clean takes of three classes of movement, and compare them with the truth.

    Everything as ``clean`` does it without options, on a take's own frame and the
    person's own lengths, as recorded and as cleaned; the truth has its own. Raw and
    reconstructed motion are compared over the parts that raw has.

    Args:
        seed: Draws people, performances and the sensor's errors.
        takes: How many takes of each class.
        progress: Wraps the loops, for a progress bar.
    """
    rows = []
    for kind in CLASSES:
        pairs = study_takes(kind, seed=seed, count=takes, progress=progress)
        rows.append(_cleaned(kind, pairs, progress))
    kinds = [f"({kind})" for kind in CLASSES]
    before, after = zip(*_PAPER_ERRORS.values(), strict=True)
    return Study(
        name="shum-table-4",
        title="Takes cleaned, against the truth (Shum 2013, Table IV)",
        columns=(
            *("class", "time_s", "raw_cm", "no_physics_cm", "clean_cm", "cut_percent"),
            *("paper_raw_cm", "paper_clean_cm", "paper_cut_percent"),
        ),
        rows=tuple(rows),
        panels=(
            Panel(
                "class of movement",
                "error (eq. 18), cm",
                (
                    Series("raw", kinds, [row[2] for row in rows], "bars"),
                    Series("reconstructed", kinds, [row[4] for row in rows], "bars"),
                    Series("paper, raw", kinds, before, "bars", paper=True),
                    Series("paper, reconstructed", kinds, after, "bars", paper=True),
                ),
            ),
        ),
    )


def _cleaned(
    kind: Kind, pairs: list[PairedTake], progress: Progress
) -> tuple[str, float, float, float, float, float, float, float, float]:
    """Return the row of a class: means over the frames and parts of all its takes."""
    errors: tuple[list[Array], ...] = ([], [], [])
    for k in progress(f"clean ({kind})", len(pairs)):
        take, truth = pairs[k].take, pairs[k].truth
        made = [_clean(take, physics=physics) for physics in (False, True)]
        motions = (take.positions, *made)
        parts = [bone_errors(one, truth, take.skeleton) for one in motions]
        for found, part in zip(errors, parts, strict=True):
            found.append(part[~np.isnan(parts[0])])
    raw, still, moving = (100.0 * float(np.concatenate(e).mean()) for e in errors)
    seconds = sum(float(pair.take.time[-1]) for pair in pairs)
    before, after = _PAPER_ERRORS[kind]
    return (
        f"({kind})",
        seconds,
        raw,
        still,
        moving,
        _cut(raw, moving),
        before,
        after,
        _cut(before, after),
    )


def _clean(take: Take, *, physics: bool) -> Array:
    """Return what ``clean`` makes of a take [m], (T, J, 3)."""
    return clean(take, CleanConfig(physics=physics)).clip.positions


def _cut(before: float, after: float) -> float:
    """Return by how much an error fell [%]."""
    return 100.0 * (1.0 - after / before)
