"""Teach ``misplaced`` which limbs a second sensor in front of the person contradicts.

    python tests/teach_misplaced.py FOLDER pipeline/lab/misplaced.toml

FOLDER holds sessions as for ``evaluate --views``.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from sklearn.linear_model import LogisticRegression

from kinefilter.characters.arrays import Array, Flags
from kinefilter.pipeline.lab.two_views import FEATURES, PARTS, describe_limbs
from kinefilter.pipeline.lab.view_sessions import (
    FAR,
    LIMBS,
    Session,
    away_from,
    find_sessions,
    read_views,
)

_INVERSE_PENALTY = 0.1  # C of the regression


def lessons(sessions: Sequence[Session]) -> dict[str, tuple[Array, Flags, Array]]:
    """Return training data for each kind of joint where the frontal sensor is sure.

    That is features (N, F), whether the joint was wrong, and the session's name.
    """
    rows: dict[str, list[tuple[Array, Array, Array]]] = {part: [] for part in PARTS}
    for session in sessions:
        side, frames, truth, sure, *_ = read_views(session)
        away = away_from(side.positions[frames], truth, side.skeleton)
        features = describe_limbs(side)[frames]
        for k, joints in enumerate(LIMBS.values()):
            for joint in joints:
                j = side.skeleton.index(joint)
                kept = sure[:, k] & ~np.isnan(away[:, j])
                wrong = away[kept, j] > FAR
                names = np.repeat(session.name, len(wrong))
                part = side.skeleton.kinds[j]
                rows[part].append((features[kept, j], wrong, names))
    data = {}
    for part, found in rows.items():
        features, wrong, names = (np.concatenate(x) for x in zip(*found, strict=True))
        data[part] = (features, wrong, names)
    return data


def fit(features: Array, wrong: Flags) -> list[float]:
    """Return a bias and a weight of each feature, to four digits."""
    mean, spread = features.mean(axis=0), features.std(axis=0) + 1e-3
    model = LogisticRegression(C=_INVERSE_PENALTY, max_iter=500)
    model.fit((features - mean) / spread, wrong)
    weights = model.coef_[0] / spread
    bias = float(model.intercept_[0] - weights @ mean)
    return [float(f"{value:.4g}") for value in (bias, *weights)]


def learn_misplaced(sessions: Sequence[Session], path: Path) -> None:
    """Write the weights that ``misplaced`` reads (TOML)."""
    lines = [f"# bias, then: {', '.join(FEATURES)}"]
    for part, (features, wrong, _) in lessons(sessions).items():
        lines.append(f"{part} = {fit(features, wrong)}")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")


if __name__ == "__main__":
    beside = find_sessions([Path(sys.argv[1]) / "*_90deg_*"], None)
    learn_misplaced(beside, Path(sys.argv[2]))
