"""How far joints may be off, and how often they are."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from real_data import PAIRS, paired

from kinefilter import clean
from kinefilter.characters import KINECT_V1, Clip, InputError, Take
from kinefilter.characters.skeleton import LIMB_PARTS
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.formats import read_clip, write_clip
from kinefilter.pipeline.lab.accuracy import Accuracy, Tally
from kinefilter.pipeline.lab.limb_guesses import HIDDEN as LIMBS
from kinefilter.pipeline.lab.limb_guesses import hide
from kinefilter.pipeline.lab.methods.fourier_ridge_learner import FourierRidgeLearner
from kinefilter.pipeline.lab.training import training_set
from kinefilter.pipeline.lab.uncertainty_lessons import Rows, fit, lessons, within
from kinefilter.pipeline.pairs import PairedTake, read_pairs
from kinefilter.pipeline.uncertainty import HIDDEN, SEEN
from kinefilter.scenes.sensor import sample_take

Array = NDArray[np.float64]

GAP = slice(120, 180)


def arm() -> list[int]:
    names = [joint for joint in LIMBS["left-arm"] if joint in KINECT_V1.joints]
    return [KINECT_V1.index(joint) for joint in names]


def part(frames: slice, take: Take | None = None) -> Take:
    take = take or sample_take()
    arrays = (take.time, take.positions, take.state)
    return Take(*(array[frames] for array in arrays), take.skeleton, take.source)


@cache
def cleaned(*, blind: bool) -> Clip:
    take = sample_take()
    if blind:
        take = hide(take, arm(), GAP, "none")
    return clean(take, CleanConfig(physics=False)).clip


def test_every_joint_that_was_ever_seen_may_be_off_by_a_little() -> None:
    for blind in (False, True):
        uncertainty = cleaned(blind=blind).uncertainty
        assert uncertainty.shape == cleaned(blind=blind).reliability.shape
        assert uncertainty.min() >= 0.005
        assert uncertainty.max() <= 0.5


def test_a_limb_hidden_across_a_long_gap_was_not_seen_for_as_many_seconds() -> None:
    take, wrist = sample_take(), KINECT_V1.index("WristLeft")
    late = replace(take, time=take.time + np.where(np.arange(len(take)) < 125, 0, 60))
    clip = clean(hide(late, arm(), GAP, "none"), CleanConfig(physics=False)).clip
    found, usual = clip.uncertainty[:, wrist], cleaned(blind=True).uncertainty[:, wrist]
    # Seen 5 frames before the gap, but 50 frames after this one.
    assert found[130] / usual[130] > 1.1 * found[124] / usual[124]


def test_a_hidden_limb_is_less_certain_the_longer_it_was_not_seen() -> None:
    wrist = KINECT_V1.index("WristLeft")
    seen, blind = (cleaned(blind=b).uncertainty for b in (False, True))
    path = blind[GAP, wrist]
    middle = len(path) // 2
    # For some of these frames the wrist is in doubt also where it is seen.
    assert np.median(path / seen[GAP, wrist]) > 1.3
    assert path[middle] > 1.2 * path[[0, -1]].max()


def test_hands_and_feet_are_as_certain_as_what_they_hang_on() -> None:
    uncertainty = cleaned(blind=True).uncertainty
    for tip, end in (("Hand", "Wrist"), ("Foot", "Ankle")):
        for side in ("Left", "Right"):
            columns = [KINECT_V1.index(part + side) for part in (tip, end)]
            np.testing.assert_array_equal(*uncertainty[:, columns].T)


def test_of_a_limb_that_was_never_seen_nobody_knows() -> None:
    blind = part(slice(1, None), hide(sample_take(), arm(), slice(1, None), "none"))
    uncertainty = clean(blind, CleanConfig(physics=False)).clip.uncertainty
    unknown = np.isnan(uncertainty)
    assert unknown[:, arm()].all()
    assert not np.delete(unknown, arm(), axis=1).any()


def test_two_frames_have_an_uncertainty() -> None:
    uncertainty = clean(part(slice(0, 2)), CleanConfig(physics=False)).clip.uncertainty
    assert np.isfinite(uncertainty).all()


def made_up(person: str, seed: int, count: int = 20_000) -> Rows:
    """Return errors that are Student's t, whose scale features tell."""
    rng = np.random.default_rng(seed)
    joints = 2 * len(LIMB_PARTS)
    seen = rng.normal(size=(count, joints, len(SEEN)))
    gone = rng.normal(size=(count, joints, len(HIDDEN)))
    hidden = rng.random((count, joints)) < 0.5
    logs = np.where(hidden, -2.0 + 0.4 * gone[..., 1], -3.0 + 0.3 * seen[..., 0])
    away = np.exp(logs)[..., None] * rng.standard_t(4.0, size=(count, joints, 3))
    return Rows(person, seen, gone, hidden, away)


def test_the_scale_of_errors_is_found_again() -> None:
    """And 72 and 93 % of Student's t lie within 1.25 and 2.45 times its scale."""
    rows = made_up("a", 1)
    weights = fit([rows])
    for table, bias, k, scale in (("seen", -3.0, 1, 0.3), ("hidden", -2.0, 2, 0.4)):
        for part in LIMB_PARTS[1:3]:
            found = np.array(weights[table][part])
            expected = np.zeros(len(found))
            expected[0], expected[k] = bias + np.log(1.25), scale
            np.testing.assert_allclose(found, expected, atol=0.02)
    for shares in within(weights, made_up("b", 2)).values():
        assert shares is not None
        np.testing.assert_allclose(shares, (72.1, 93.0), atol=2.5)


@paired
def test_intervals_hold_for_a_person_whom_nothing_has_learned_from() -> None:
    taught = [p for s in ("s02", "s03") for p in read_pairs(PAIRS / f"{s}.npz")[:40:10]]
    corrector = FourierRidgeLearner(KINECT_V1, samples=256).fit(training_set(taught))
    # Two movements, each done twice; over them, arms and legs are hidden.
    first, second = (
        lessons(corrector, [every[k] for k in some], 2)
        for person, some in (("s06", (12, 13, 21, 22)), ("s07", (10, 11, 20, 21)))
        for every in [read_pairs(PAIRS / f"{person}.npz")]
    )
    for learned, tested in ((first, second), (second, first)):
        held = within(fit([learned]), tested)["seen"]
        assert held is not None
        share, more = held
        assert 45.0 < share < 92.0
        assert more > 75.0


def test_a_tally_counts_errors_within_what_a_clip_says() -> None:
    rng = np.random.default_rng(3)
    take = replace(sample_take(), positions=np.nan_to_num(sample_take().positions))
    scale = np.full(take.positions.shape[:2], 0.03)
    noise = rng.normal(scale=0.03, size=take.positions.shape)
    noise[:, KINECT_V1.hips] = 0.0
    tally = Tally(Accuracy(KINECT_V1))
    pair = PairedTake(take, take.positions + noise, "a", "clip")
    tally.add(pair, take.positions, 0.0, scale)
    tally.add(pair, pair.truth, 0.0)
    found = tally.summary()
    limbs = 10 / 12  # hips are exact
    assert found["within_68"] == pytest.approx(100 - 31.7 * limbs, abs=1.5)
    assert found["within_95"] == pytest.approx(100 - 5.0 * limbs, abs=1.0)
    tally = Tally(Accuracy(KINECT_V1))
    tally.add(pair, pair.truth, 0.0)
    assert tally.summary()["found"] == pytest.approx(1.0)


def test_archives_without_it_are_refused(tmp_path: Path) -> None:
    write_clip(cleaned(blind=False), tmp_path / "clip.npz")
    with np.load(tmp_path / "clip.npz") as archive:
        arrays = {k: archive[k] for k in archive.files if k != "uncertainty"}
    np.savez(tmp_path / "old.npz", **arrays)
    with pytest.raises(InputError, match=r"old\.npz.*uncertainty"):
        read_clip(tmp_path / "old.npz")
