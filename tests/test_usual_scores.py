"""Hidden joints, and those beside them, are corrected by their usual scores."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import KINECT_V1, Skeleton
from kinefilter.pipeline.cleaner import Cleaner
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.draft import Draft
from kinefilter.pipeline.progress import Progress
from kinefilter.pipeline.reliability import UsualScores
from kinefilter.pipeline.stages import Stage
from kinefilter.scenes.sensor import sample_take


def hidden_hands(skeleton: Skeleton) -> tuple[NDArray[np.float64], ...]:
    """Return scores of 40 frames, flags of a hand hidden in some, and tracked flags."""
    scores = np.random.default_rng(0).uniform(0.5, 1.0, (2, 40, len(skeleton)))
    hidden = np.zeros((40, len(skeleton)), dtype=np.bool_)
    hidden[15:20, skeleton.index("WristLeft")] = True
    return scores, hidden, np.ones_like(hidden)


def test_a_hidden_joint_and_those_beside_it_get_their_usual_scores() -> None:
    scores, hidden, tracked = hidden_hands(KINECT_V1)
    arm = [KINECT_V1.index(f"{name}Left") for name in ("Elbow", "Wrist", "Hand")]
    spoiled = np.zeros_like(hidden)
    spoiled[15:25, arm] = True  # six frames are averaged
    found = UsualScores(KINECT_V1).whole(scores, hidden, tracked)
    np.testing.assert_array_equal(found[:, ~spoiled], scores[:, ~spoiled])
    good = np.delete(scores, slice(15, 25), axis=1)
    usual = np.median(good[:, :, arm], axis=1)[:, None]
    np.testing.assert_allclose(found[:, 15:25, arm], np.repeat(usual, 10, axis=1))


def test_frame_by_frame_usual_scores_are_the_mean_of_those_before() -> None:
    scores, hidden, tracked = hidden_hands(KINECT_V1)
    usual = UsualScores(KINECT_V1)
    found = np.stack(
        [usual.step(scores[:, k], hidden[k], tracked[k]) for k in range(40)], axis=1
    )
    elbow = KINECT_V1.index("ElbowLeft")
    mean = scores[:, :15, elbow].mean(axis=1)
    np.testing.assert_allclose(found[:, 15:25, elbow], np.repeat(mean[:, None], 10, 1))
    np.testing.assert_array_equal(found[:, 25:], scores[:, 25:])


def test_joints_that_were_never_tracked_have_no_usual_scores() -> None:
    scores, hidden, tracked = hidden_hands(KINECT_V1)
    elbow, wrist = (KINECT_V1.index(f"{name}Left") for name in ("Elbow", "Wrist"))
    found = UsualScores(KINECT_V1).whole(scores, hidden, tracked & False)
    np.testing.assert_array_equal(found[:, :, elbow], scores[:, :, elbow])
    np.testing.assert_array_equal(found[:, 15:20, wrist], 1.0)


class Told(Stage):
    """Tells a joint's own measurements as its reconstruction."""

    name = "reconstruct"

    def __init__(self, hidden: NDArray[np.bool_], filled: NDArray[np.float64]) -> None:
        self._hidden, self._filled = hidden, filled

    def step(self, draft: Draft) -> None:
        raise NotImplementedError

    def whole(self, draft: Draft, progress: Progress) -> None:  # noqa: ARG002
        draft.hidden, draft.filled = self._hidden, self._filled


def test_a_perfectly_reconstructed_arm_is_corrected_like_a_seen_one() -> None:
    take = sample_take()
    arm = [take.skeleton.index(f"{name}Right") for name in ("Elbow", "Wrist", "Hand")]
    hidden = np.zeros(take.state.shape, dtype=np.bool_)
    hidden[225:265, arm] = True
    blind = replace(take, positions=np.where(hidden[..., None], np.nan, take.positions))
    cleaner = Cleaner(CleanConfig("local-pca", physics=False)).until("correct")
    seen = cleaner.whole(take).positions
    told = cleaner.replaced(Told(hidden, take.positions)).whole(blind).positions
    assert np.linalg.norm(told - seen, axis=2)[225:265][:, arm].mean() < 0.004
