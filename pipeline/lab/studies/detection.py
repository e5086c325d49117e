"""Detection of tracker errors: joints far off, and gross failures."""

import numpy as np
from scipy.ndimage import minimum_filter1d

from kinefilter import read_take
from kinefilter.characters import Take
from kinefilter.pipeline.failures import FailureKind, find_failures
from kinefilter.pipeline.lab.accuracy import LIMBS, Accuracy
from kinefilter.pipeline.lab.evaluate import reliability_auc
from kinefilter.pipeline.methods import SCORERS
from kinefilter.pipeline.pairs import PairedTake
from kinefilter.pipeline.progress import over

from .study import Options, Panel, Row, Series, Study, series_of
from .study_takes import CLASSES, clips_of, recorded_people, recorded_takes, study_takes

_FAR, _VARYING = "over_10_cm", "varying_over_7_cm"
_JOINTS = ("Elbow", "Wrist", "Knee", "Ankle")
_FAR_OFF = 0.2  # m from the mocap
_LASTING = 9  # frames, 0.3 s, for which a joint of a lost limb is far off


def reliability(options: Options, *, takes: int = 12, movements: int = 10) -> Study:
    """Detect joints over 10 cm from the truth by their reliability alone.

    The area under the ROC curve is 1 if every limb joint that is far off, as in
    ``evaluate``, is less reliable than every other joint, and 0.5 by chance. It is
    measured on ``takes`` of each class of Table IV and, with recordings, on clips of
    the first ``movements`` beside marker mocap.
    """
    pairs = {kind: study_takes(kind, options, count=takes) for kind in CLASSES}
    whole = [pair for part in pairs.values() for pair in part]
    groups = {"all": whole, **{f"({kind})": part for kind, part in pairs.items()}}
    parts = over([*groups.values()], "score", options.progress)
    areas = [reliability_auc(part) for part in parts]
    recorded: dict[str, dict[str, float | None]] = {}
    if options.data is not None:
        people = over(recorded_people(options.data), "read", options.progress)
        recorded = reliability_auc(clips_of(people, movements, options))
    recorded_columns = [f"recorded_{key}" for key in (_FAR, _VARYING)]
    rows, bars = list[Row](), []
    for scoring in SCORERS:
        far = [area[scoring][_FAR] for area in areas]
        bars.append(Series(scoring, [*groups], [area or 0.0 for area in far], "bars"))
        own = [recorded[scoring][key] if recorded else None for key in (_FAR, _VARYING)]
        rows.append((scoring, *far, areas[0][scoring][_VARYING], *own))
    title = "Joints over 10 cm off, detected by reliability (area under ROC)"
    header = ("scoring", *groups, _VARYING, *recorded_columns)
    panels = [Panel("class of movement", "area under the ROC curve", bars)]
    return Study(title, header, rows, panels)


def failures(options: Options, *, count: int = 1000, movements: int = 10) -> Study:
    """Count takes with a detected failure, among takes with gross failures and without.

    Those without are clips beside marker mocap in which no elbow, wrist, knee or ankle
    is over 20 cm off for 0.3 s, relative to the middle of the hips; without recordings,
    simulated ones, and no takes with failures. At most ``count`` takes of each group
    and ``count`` people in their first ``movements`` are used.
    """
    files, progress = recorded_takes(options.data), options.progress
    failed = [file for file in files if file.stem.endswith("_failure")][:count]
    quick = [file for file in files if file.parent.name == "precog16"][:count]
    found = [_kinds(read_take(file)) for file in over(failed, "failures", progress)]
    alarms = [_kinds(read_take(file)) for file in over(quick, "kicks", progress)]
    people = over(recorded_people(options.data)[:count], "people", progress)
    clips = clips_of(people, movements, options)
    leaping = {FailureKind.LEAPING}
    groups = {
        "recorded failures": [bool(kinds) for kinds in found],
        "recorded failures, by leaps alone": [kinds == leaping for kinds in found],
        "punches and kicks": [bool(kinds) for kinds in alarms],
        "near the mocap": [bool(_kinds(pair.take)) for pair in clips if _near(pair)],
    }
    rows: list[Row] = []
    for name, flags in groups.items():
        share = 100.0 * sum(flags) / len(flags) if flags else None
        rows.append((name, len(flags) or None, sum(flags) if flags else None, share))
    names = [name.replace(", ", ",\n") for name in groups]
    bars = series_of(rows, {"found": 3}, x=names, kind="bars")
    title = "Takes with a detected gross failure"
    header = ("takes", "count", "found", "found_percent")
    return Study(title, header, rows, [Panel("takes", "detected, %", bars)])


def _kinds(take: Take) -> set[FailureKind]:
    return {failure.kind for failure in find_failures(take)}


def _near(pair: PairedTake) -> bool:
    joints = [LIMBS.index(j + side) for j in _JOINTS for side in ("Left", "Right")]
    distances = Accuracy(pair.take.skeleton).distances(pair.take.positions, pair.truth)
    # Axes: time, arm or leg, joint of the limb, side.
    limbs = np.nan_to_num(distances[:, joints]).reshape(-1, 2, 2, 2).max(axis=2)
    return bool(minimum_filter1d(limbs, _LASTING, axis=0).max() < _FAR_OFF)
