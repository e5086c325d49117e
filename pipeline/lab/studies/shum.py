"""Shum 2013, local PCA: tables I to IV, table V with figure 8."""

from collections.abc import Sequence
from time import perf_counter
from typing import Any

import numpy as np

from kinefilter import CleanConfig, clean
from kinefilter.characters import KINECT_V1, Skeleton
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.correct import LocalPCA, Observation
from kinefilter.pipeline.correct.local_pca import Search
from kinefilter.pipeline.database import PostureDatabase, builtin_database
from kinefilter.pipeline.draft import Draft
from kinefilter.pipeline.lab.database_build import filtered_database, scripted_postures
from kinefilter.pipeline.lab.training import observed, standard_truth
from kinefilter.pipeline.pairs import PairedTake
from kinefilter.pipeline.progress import Progress, over
from kinefilter.retarget import Standardizer
from kinefilter.scenes.library import perform, random_body

from .study import Kind, Options, Panel, Row, Study, series_of
from .study_takes import CLASSES, first_person, performed_by, standardized, study_takes

_SHUM_1 = {
    "locomotion": (("walk", "run", "march"), 8.1, 15.27),
    "object handling": (("pick_up", "carry"), 8.9, 11.80),
    "upper body movement": (("point", "scratch"), 17.8, 6.6),
    "boxing": (("punch", "kick"), 11.8, 13.7),
    "sword fighting": (("swing", "dodge"), 16.3, 13.4),
}
"""Classes of the database: motions, deviations [cm] of the upper and lower body."""
_SHUM_2 = {
    "basic": (13.4, 9.24),
    "box": (12.26, 6.39),
    "flip_chart": (13.24, 7.38),
    "basketball": (11.81, 4.18),
    "chair": (7.87, 11.86),
    "office": (13.23, 9.51),
}
"""Scenes of the test data: deviations [cm] of the upper and lower body."""

_HANDS, _FEET = ("HandLeft", "HandRight"), ("FootLeft", "FootRight")
_MIDDLES = ("ElbowLeft", "ElbowRight", "KneeLeft", "KneeRight")
_SETUPS: dict[str, tuple[Sequence[str], float]] = {
    "(a) left hand, left foot": (("HandLeft", "FootLeft"), 6.38),
    "(b) hands": (_HANDS, 5.60),
    "(c) hands, feet": (_HANDS + _FEET, 4.52),
    "(d) hands, feet, elbows, knees": (_HANDS + _FEET + _MIDDLES, 4.15),
    "(e) all parts": (KINECT_V1.joints, 3.90),
}
"""Given joints, and the paper's difference [cm] (table III)."""
_DATABASE_MOTIONS = (
    *("walk", "run", "pick_up", "carry", "point"),
    *("scratch", "punch", "kick", "swing", "dodge"),
)
"""Examples from the paper's own motion database (table I)."""
_PAPER_ERRORS = {"a": (9.59, 7.26), "b": (10.89, 7.44), "c": (12.41, 7.76)}
"""Errors of raw and reconstructed motion [cm] (table IV)."""
_MOTIONS = ("cross_arms", "squat", "punch", "tai_chi", "wave")
_FRAMES = 60  # of each take: 2 s
_PARAMETERS: dict[str, tuple[int, Sequence[int]]] = {
    "postures": (2574, (50, 200, 500, 1000, 2574, 5000, 10000)),
    "neighbors": (30, (5, 10, 20, 30, 60, 120)),
    "dimensions": (20, (2, 5, 10, 20, 29)),
    "steps": (20, (1, 5, 10, 20, 40)),
    "samples": (100, (5, 20, 50, 100, 200)),
}
"""The paper's choice (table V) and the values tried; each has a column of panels."""
_SAMPLING_ONLY = ("steps", "samples")


def shum_tables_1_2(options: Options, *, people: int = 4, takes: int = 12) -> Study:
    """Measure how far joints spread in classes of motion, and in the test takes.

    The spread is the standard deviation of a joint's position in a take, on the
    standard body in the heading frame: its mean over takes, for the joints of the arms
    and of the legs. The scenes are recorded by a virtual Kinect.
    """
    first, rows = first_person(options.seed), list[Row]()
    performers = range(first, first + people)
    for name, (motions, *paper) in _SHUM_1.items():
        pairs = performed_by(performers, motions, progress=options.progress)
        postures = [standard_truth(pair, observed(pair)) for pair in pairs]
        rows.append(("I", name, *_deviations(pairs, postures), *paper))
    recorded = [p for c in CLASSES for p in study_takes(c, options, count=takes)]
    for scene, figures in _SHUM_2.items():
        pairs = [pair for pair in recorded if pair.clip.startswith(f"{scene}_")]
        postures = [observed(pair).standard for pair in pairs]
        if pairs:
            rows.append(("II", scene, *_deviations(pairs, postures), *figures))
    columns = {"upper body": 3, "lower body": 4, "paper, upper": 5, "paper, lower": 6}
    bars = series_of(rows, columns, x=[str(row[1]) for row in rows], kind="bars")
    title = "Spread of joints by class of motion (Shum 2013, Tables I and II)"
    header = (
        *("table", "class", "frames", "upper_cm", "lower_cm"),
        *("paper_upper_cm", "paper_lower_cm"),
    )
    panels = [Panel("class of motion, scene", "standard deviation, cm", bars)]
    return Study(title, header, rows, panels)


def _deviations(
    pairs: Sequence[PairedTake], postures: Sequence[Array]
) -> tuple[int, float, float]:
    """Return the number of frames, and upper and lower body's deviations [cm]."""
    spread, skeletons = [], [pair.take.skeleton for pair in pairs]
    for parts in (("Shoulder", "Elbow", "Wrist"), ("Knee", "Ankle", "Foot")):
        names = [part + side for part in parts for side in ("Left", "Right")]
        # Take by take, because each sensor has its own tilt.
        variances = [
            np.ma.masked_invalid(posture[:, [*map(skeleton.index, names)]]).var(axis=0)
            for posture, skeleton in zip(postures, skeletons, strict=True)
        ]
        deviations = np.ma.sqrt(np.ma.stack(variances).sum(axis=2))
        spread.append(float(100.0 * deviations.mean()))
    return sum(map(len, postures)), spread[0], spread[1]


def shum_table_3(options: Options, *, motions: int = 10) -> Study:
    """Reconstruct whole postures from some of their joints, given without error.

    The paper's figure is that of the posture of least energy in the natural posture
    space (``difference_cm``), which moves the given joints too; the shipped correction
    keeps them (``joints_kept_cm``). Both motions have the segment lengths of the
    standard body, without its position and heading. Each of the ``motions`` is by
    another person.
    """
    database, first = builtin_database(KINECT_V1), first_person(options.seed)
    names = enumerate(_DATABASE_MOTIONS[:motions])
    acts = [_standard_postures(motion, first + k) for k, motion in names]
    rows = []
    for setup, (given, paper) in _SETUPS.items():
        reliability = np.isin(KINECT_V1.joints, given).astype(float)
        errors = [
            _errors(act, reliability, LocalPCA(database))
            for act in over(acts, f"from {len(given)} joints", options.progress)
        ]
        free, kept = (100.0 * np.concatenate(errors).mean(axis=0)).tolist()
        rows.append((setup, free, kept, paper))
    columns = {"posture space": 1, "given joints kept": 2, "paper": 3}
    bars = series_of(rows, columns, x=[setup[:3] for setup in _SETUPS], kind="bars")
    title = "Postures from some of their joints (Shum 2013, Table III)"
    header = ("joints_given", "difference_cm", "joints_kept_cm", "paper_cm")
    panels = [Panel("joints given", "difference (eq. 18), cm", bars)]
    return Study(title, header, rows, panels)


def _standard_postures(motion: str, person: int) -> Array:
    """Return a performance's postures in the heading frame, shape (T, J, 3)."""
    body = random_body(KINECT_V1, np.random.default_rng(person))
    positions = perform(motion, body, seed=person).positions
    return Standardizer(body).steps(positions, np.ones(positions.shape[:2]))[0]


def _errors(postures: Array, reliability: Array, method: LocalPCA) -> Array:
    """Return eq. 18 [m] at least energy, and with the given joints kept, (T, 2)."""
    seen = np.where(reliability[:, None] > 0.0, postures, np.nan)
    method.start()
    free = [method.synthesize(frame, reliability)[0] for frame in seen]
    method.start()
    frames = [Observation(frame, reliability, reliability) for frame in seen]
    kept = [method.step(frame).positions for frame in frames]
    motions = np.array([free, kept])
    errors = [bone_errors(motion, postures, KINECT_V1) for motion in motions]
    return np.stack([error.mean(axis=1) for error in errors], axis=1)


def bone_errors(one: Array, other: Array, skeleton: Skeleton) -> Array:
    """Return each segment's error relative to its parent joint [m], shape (T, S).

    Shum 2013, eq. 18, is their mean over frames and segments. NaN where a joint of the
    segment is missing in either motion. The motions [m], (T, J, 3), have the same
    frames and orientation.
    """
    ends, starts = skeleton.segments, skeleton.segment_parents
    offsets = one - other
    return np.asarray(np.linalg.norm(offsets[:, ends] - offsets[:, starts], axis=2))


def shum_table_4(options: Options, *, takes: int = 12) -> Study:
    """Clean ``takes`` of each class of movement, and compare them with the truth.

    Takes are compared in their own frame, each motion with its own segment lengths: as
    recorded, as cleaned, or true, over the segments that the raw one has.
    """
    rows: list[Row] = []
    for kind in CLASSES:
        pairs = study_takes(kind, options, count=takes)
        errors = []
        for pair in over(pairs, f"clean ({kind})", options.progress):
            configs = [CleanConfig(physics=physics) for physics in (False, True)]
            clips = [clean(pair.take, config).clip.positions for config in configs]
            motions = [pair.take.positions, *clips]
            skeleton = pair.take.skeleton
            parts = np.array([bone_errors(m, pair.truth, skeleton) for m in motions])
            errors.append(parts[:, ~np.isnan(parts[0])])
        means = 100.0 * np.concatenate(errors, axis=1).mean(axis=1)
        raw, corrected, cleaned = means.tolist()
        cut = 100.0 * (1.0 - cleaned / raw)
        seconds = sum(float(pair.take.time[-1]) for pair in pairs)
        before, after = _PAPER_ERRORS[kind]
        ours = (seconds, raw, corrected, cleaned, cut)
        rows.append((f"({kind})", *ours, before, after, 100.0 * (1.0 - after / before)))
    columns = {"raw": 2, "reconstructed": 4, "paper, raw": 6, "paper, reconstructed": 7}
    bars = series_of(rows, columns, kind="bars")
    title = "Errors of cleaned takes (Shum 2013, Table IV)"
    header = (
        *("class", "time_s", "raw_cm", "no_physics_cm", "clean_cm", "cut_percent"),
        *("paper_raw_cm", "paper_clean_cm", "paper_cut_percent"),
    )
    panels = [Panel("class of movement", "error (eq. 18), cm", bars)]
    return Study(title, header, rows, panels)


def shum_figure_8(options: Options, *, motions: int = 5, values: int = 7) -> Study:
    """Vary each parameter, with the others as in Table V.

    The paper's search samples (``stochastic``); kinefilter's ``solver`` has neither
    steps nor samples, and is a level in their panels. Energy is that of the posture
    found (the paper plots a score, which rises). The error is eq. 18 of that posture
    alone, with the person's own segment lengths. Time covers neighbors, posture space
    and search, as the median over frames. At most ``values`` of each parameter are
    tried, on ``motions`` takes of 2 s.
    """
    first, progress = first_person(options.seed), options.progress
    takes = [
        (pair, standardized(pair))
        for k, motion in enumerate(_MOTIONS[:motions])
        for pair in performed_by([first + k], [motion], sensor="v1")
    ]
    paper = {name: choice for name, (choice, _) in _PARAMETERS.items()}
    tried = {name: _spread(every, values) for name, (_, every) in _PARAMETERS.items()}
    databases = _databases({*tried["postures"], paper["postures"]}, progress)

    def measure(search: Search, **varied: int) -> list[float]:
        settings: dict[str, Any] = paper | varied
        database = databases[settings.pop("postures")]
        return _measure(LocalPCA(database, search=search, **settings), takes)

    solved = measure("solver")
    rows: list[Row] = []
    for name, tries in tried.items():
        for value in over(tries, name, progress):
            varied = {name: value}
            sampled = measure("stochastic", **varied)
            rows.append((name, value, "stochastic", *sampled, paper[name]))
            own = solved if name in _SAMPLING_ONLY else measure("solver", **varied)
            rows.append((name, value, "solver", *own, paper[name]))
    figures = ("energy_m2", "error_cm", "ms")
    labels = ("energy, m²", "error (eq. 18), cm", "ms per frame")
    title = "Parameters of local PCA (Shum 2013, Table V and Figure 8)"
    header = ("parameter", "value", "search", *figures, "paper_chosen_value")
    panels = [
        _panel(rows, name, 3 + k, label)
        for k, label in enumerate(labels)
        for name in _PARAMETERS
    ]
    return Study(title, header, rows, panels, across=len(_PARAMETERS))


def _spread(choices: Sequence[int], count: int) -> list[int]:
    count = min(count, len(choices))
    return [choices[k * len(choices) // count] for k in range(count)]


def _databases(sizes: set[int], progress: Progress) -> dict[int, PostureDatabase]:
    shipped, found = builtin_database(KINECT_V1), dict[int, PostureDatabase]()
    parts: list[Any] = [("shipped", shipped.positions)]
    for size in over(sorted(sizes), "filter", progress):
        if size > len(shipped) and len(parts) == 1:
            parts = [*scripted_postures(KINECT_V1, progress)]
        found[size] = filtered_database(parts, KINECT_V1, "scripted", size)
    return found


def _measure(pca: LocalPCA, takes: Sequence[tuple[PairedTake, Draft]]) -> list[float]:
    energies, seconds, errors = [], [], []
    for pair, draft in takes:
        pca.start()
        postures = draft.standard.copy()
        for k in range(min(_FRAMES, len(postures))):
            start = perf_counter()
            postures[k] = pca.synthesize(draft.standard[k], draft.reliability[k])[0]
            seconds.append(perf_counter() - start)
            energy = pca.energy
            found = energy.space.project(postures[k].ravel())
            energies.append(energy.constant + float(energy(found[None])[0][0]))
        positions = Standardizer(draft.body).undo(postures, draft.heading)
        errors.append(bone_errors(positions, pair.truth, KINECT_V1)[:_FRAMES])
    error = float(np.concatenate(errors).mean())
    return [float(np.mean(energies)), 100.0 * error, 1e3 * float(np.median(seconds))]


def _panel(rows: Sequence[Row], name: str, column: int, label: str) -> Panel:
    lines = []
    for search in ("stochastic", "solver"):
        own = [row for row in rows if (row[0], row[2]) == (name, search)]
        level = search == "solver" and name in _SAMPLING_ONLY
        kind: Kind = "level" if level else "line"
        lines += series_of(own, {search: column}, x=1, kind=kind)
    return Panel(name, label, lines, log_x=True, zero=label.startswith("ms"))
