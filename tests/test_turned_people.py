"""People who stand turned from the sensor, as some of those with markers do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from offset_lessons import training_set_of
from real_data import PAIRS, paired
from test_fourier_ridge import _act, _lessons, _observation

from kinefilter import CleanConfig, clean
from kinefilter.characters import KINECT_V1
from kinefilter.pipeline.correct import fourier_ridge
from kinefilter.pipeline.lab.accuracy import Accuracy
from kinefilter.pipeline.lab.methods.fourier_ridge_learner import FourierRidgeLearner
from kinefilter.pipeline.pairs import read_pairs
from kinefilter.pipeline.target.floor import leveled

ASIDE = (-2.0, 0.0, 0.0)  # m: where the sensor is, seen from them


def test_the_training_data_that_a_posture_resembles_more_decides() -> None:
    similar = np.array([[0.9, 0.85], [0.9, 0.9], [0.9, 0.95], [0.2, 0.3]])
    share = fourier_ridge._beside_share(similar)
    np.testing.assert_allclose(share, [[0.0], [0.5], [1.0], [0.0]], atol=1e-9)


def test_turned_people_with_markers_teach_the_limbs_behind_the_body_too() -> None:
    """Others before two sensors, who do something else, have nothing to say there."""
    lessons, wrist = _lessons(), KINECT_V1.index("WristLeft")
    seen = lessons.truth.copy()
    seen[:, wrist, 1] -= 0.10
    turned = replace(
        lessons, positions=seen, sensor=np.broadcast_to(ASIDE, (len(seen), 3))
    )
    steps = _act("march", seed=5)
    beside = training_set_of(
        steps,
        np.ones(steps.shape[:2]),
        steps,
        np.arange(len(steps)) == 0,
        person=np.zeros(len(steps), dtype=int),
        people=("other",),
        time=np.arange(len(steps)) / 30.0,
    )
    beside = replace(beside, sensor=np.broadcast_to(ASIDE, (len(steps), 3)))
    model = FourierRidgeLearner(KINECT_V1, samples=256).fit(turned, views=beside)
    take = replace(_observation(seen[:60]), sensor=turned.sensor[:60])
    live = [model.step(take.at(k)).positions for k in range(60)]
    for made in (model.whole(take).positions, np.array(live)):
        away = np.linalg.norm(made - lessons.truth[:60], axis=2)[:, wrist]
        assert away.mean() < 0.02


@paired
def test_what_ships_corrects_people_who_stand_turned() -> None:
    """In front of UI-PRMD's Kinect they extend an arm turned by 50 degrees or more."""
    accuracy = Accuracy(KINECT_V1)
    raw, cleaned = [], []
    for file in sorted(PAIRS.glob("s*.npz")):
        pair = next(p for p in read_pairs(file) if p.clip.startswith("m08"))
        clip = clean(pair.take, CleanConfig(physics=False)).clip
        truth = leveled(pair.truth, clip.tilt, clip.roll)
        raw.append(np.nanmean(accuracy.distances(pair.take.positions, pair.truth)))
        cleaned.append(np.nanmean(accuracy.distances(clip.positions, truth)))
    assert np.mean(cleaned) < 0.7 * np.mean(raw)
