"""Feet of live motion, which does not look ahead."""

from __future__ import annotations

import numpy as np
import pytest

from kinefilter.characters import KINECT_V1, State, standard_body
from kinefilter.characters.arrays import runs
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.draft import Draft
from kinefilter.pipeline.target import feet
from kinefilter.pipeline.target.target_stages import Bones, Feet
from kinefilter.scenes.library import perform

BODY = standard_body(KINECT_V1)


def test_no_foot_stands_where_it_no_longer_is() -> None:
    """A foot that creeps too slowly for a step is planted again and again."""
    tracker, ankles = feet.StanceTracker(), np.tile([0.0, 0.08, 2.0], (120, 2, 1))
    ankles[:, 0, 0] += np.linspace(0.0, 1.0, 120)
    stands = [tracker.step(frame, 0.08, 1.0 / 30.0) for frame in ankles]
    stances = runs(np.array(stands)[:, 0])
    assert len(stances) > 3
    for stance in stances:
        assert np.ptp(ankles[stance, 0, 0]) < feet._DRIFT + 0.05
    assert np.array(stands)[:, 1].all()


def test_a_foot_is_lifted_while_it_steps_and_only_then() -> None:
    tracker, sole = feet.StanceTracker(), 0.03
    toes = np.tile([0.0, sole, 2.0], (90, 2, 1))
    toes[:, 0, 0] += np.interp(np.arange(90), [30, 50], [0.0, 1.0])
    up = []
    for frame in toes:
        tracker.step(np.add(frame, [0.0, 0.05, 0.0]), 0.08, 1.0 / 30.0)
        up.append(tracker.lift(frame, frame[:, 1] - sole, 1.0 / 30.0))
    lifted = np.array(up)
    assert not lifted[:30].any()
    assert lifted[:, 0].max() == pytest.approx(feet.CLEARANCE)
    assert not lifted[70:].any()
    assert not lifted[:, 1].any()


@pytest.mark.parametrize("motion", ["walk", "dance"])
def test_live_feet_do_not_drag_the_hips_along(motion: str) -> None:
    """Without looking ahead, a foot is let go of after it has begun to step."""
    act, skeleton = perform(motion, BODY, seed=1), KINECT_V1
    stages, found = (Feet(CleanConfig()), Bones()), []
    for stage in stages:
        stage.start(act.body)
    state = np.full(len(skeleton), State.TRACKED, dtype=np.uint8)
    for now, seen in zip(act.time, act.positions, strict=True):
        draft = Draft(skeleton, float(now), seen, state)
        draft.positions, draft.body = seen, act.body
        draft.confidence, draft.elapsed = np.ones(len(skeleton)), 1.0 / 30.0
        for stage in stages:
            stage.step(draft)
        found.append(draft.positions)
    off = np.linalg.norm(np.array(found) - act.positions, axis=2)
    assert off.mean() < 0.015
    leaps = [
        np.linalg.norm(np.diff(positions[:, skeleton.root], 2, axis=0), axis=1).max()
        for positions in (np.array(found), act.positions)
    ]
    assert leaps[0] < 3.0 * leaps[1]
