"""Scores how likely a limb's joint is far from where the sensor places it.

A logistic regression recognizes limbs that the sensor guesses from their motion and the
sensor's view. It was trained on people in front of two sensors, of which the frontal
one showed which joints of the side-on one were off by more than 12 cm. The scores rank
joints and are not calibrated. No stage of cleaning uses them.

``python -m kinefilter.pipeline.lab.misplaced FOLDER OUT.toml`` trains it; FOLDER holds
sessions as for ``evaluate --views``.
"""

import sys
import tomllib
from collections.abc import Sequence
from importlib import resources
from pathlib import Path

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.special import expit
from sklearn.linear_model import LogisticRegression

from kinefilter.characters import Take
from kinefilter.characters.arrays import Array, Flags
from kinefilter.characters.motion import nominal_step
from kinefilter.characters.rotations import unit
from kinefilter.characters.skeleton import SIDES
from kinefilter.pipeline.merge.lag import interpolate_gaps
from kinefilter.retarget import HeadingFrame, find_yaw

from .view_sessions import FAR, LIMBS, Session, away_from, find_sessions, read_views

PARTS = {"Elbow": "Shoulder", "Wrist": "Shoulder", "Knee": "Hip", "Ankle": "Hip"}
"""The scored joints, and the first joints of their limbs."""
FEATURES = (
    *("acceleration", "near side", "hangs", "own length", "length beyond"),
    *("length before", "ahead"),
)
"""What describes a joint: of 18, those that tell most of p00 to p08 of two-kinects."""
_WINDOW = 1.0  # s over which accelerations are averaged
_SHARPEST = 300.0  # m/s^2 at which they are clipped
_INVERSE_PENALTY = 0.1  # C of the regression


def misplaced(take: Take) -> Array:
    """Return a score in [0, 1] of each joint of PARTS being 12 cm off, shape (T, J)."""
    scores = np.zeros(take.positions.shape[:2])
    path = resources.files("kinefilter.pipeline.lab").joinpath("misplaced.toml")
    weights = tomllib.loads(path.read_text("utf-8"))
    features = describe_limbs(take)
    for part in PARTS:
        bias, *scales = weights[part]
        for j in take.skeleton.sides(part):
            scores[:, j] = expit(bias + features[:, j] @ np.array(scales))
    return scores


def describe_limbs(take: Take) -> Array:
    """Return the FEATURES of each joint, 0 for joints not scored, shape (T, J, F)."""
    time, first, rows = np.unique(take.time, return_index=True, return_inverse=True)
    skeleton, step = take.skeleton, nominal_step(time)
    filled = interpolate_gaps(time, take.positions[first].reshape(len(time), -1))
    positions = filled.reshape(len(time), -1, 3)
    features = np.zeros((*positions.shape[:2], len(FEATURES)))
    yaw = np.nan_to_num(find_yaw(positions, skeleton))
    root = positions[:, skeleton.root]
    placed = HeadingFrame(root, yaw).remove(positions)
    turned = yaw - np.arctan2(-root[:, 0], -root[:, 2])  # 0 facing the sensor
    elapsed = np.diff(time, prepend=time[0] - step)[:, None, None]
    velocity = np.diff(placed, axis=0, prepend=placed[:1]) / elapsed
    change = np.diff(velocity, axis=0, prepend=velocity[:1]) / elapsed
    acceleration = np.minimum(np.linalg.norm(change, axis=2), _SHARPEST)
    acceleration = uniform_filter1d(acceleration, max(round(_WINDOW / step), 1), axis=0)
    bones = positions - positions[:, skeleton.parents]
    lengths = np.maximum(np.linalg.norm(bones, axis=2), 1e-3)
    odd = np.abs(np.log(lengths / np.median(lengths, axis=0)))
    for part, top in PARTS.items():
        for side, sign in zip(SIDES, (1.0, -1.0), strict=True):
            j, begin = skeleton.index(part + side), skeleton.index(top + side)
            columns = [
                acceleration[:, j],
                np.maximum(-sign * np.sin(turned), 0.0),
                -unit(bones[:, j])[:, 1],
                odd[:, j],
                odd[:, skeleton.children[j][0]],
                odd[:, skeleton.parents[j]],
                placed[:, j, 2] - placed[:, begin, 2],
            ]
            features[:, j] = np.stack(columns, axis=1)
    return features[rows]


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
