"""Which way people face, by how they bend."""

from __future__ import annotations

import numpy as np
import pytest
from known_motions import performed
from real_data import CMU, PAIRS, captured, paired
from skeletons import every_skeleton

from kinefilter.characters import Skeleton
from kinefilter.pipeline.failures.sides import FACING_WEIGHTS, facing_inputs
from kinefilter.pipeline.lab.facing_lessons import Lesson, learn, lessons_in


@every_skeleton
def test_swapped_sides_change_the_sign_of_all_inputs(skeleton: Skeleton) -> None:
    take = performed("walk", skeleton)
    forward, inputs = facing_inputs(take.positions, skeleton)
    backward, swapped = facing_inputs(take.swapped().positions, skeleton)
    np.testing.assert_allclose(backward, -forward, atol=1e-12)
    np.testing.assert_allclose(swapped, -inputs, atol=1e-12)
    assert np.mean(inputs @ FACING_WEIGHTS > 0.0) > 0.95


@every_skeleton
def test_missing_limbs_tell_nothing(skeleton: Skeleton) -> None:
    take = performed("walk", skeleton)
    positions = take.positions.copy()
    knees, wrists = skeleton.sides("Knee"), skeleton.sides("Wrist")
    positions[:, [knees[0], *wrists]] = np.nan
    _, inputs = facing_inputs(positions, skeleton)
    _, known = facing_inputs(take.positions, skeleton)
    gone = [2, 3, 4, 5, 7]  # of wrists, knees, and below the knees
    assert not inputs[:, gone].any()
    others = np.setdiff1d(np.arange(8), gone)
    np.testing.assert_array_equal(inputs[:, others], known[:, others])


def test_people_count_alike_however_many_frames_they_have() -> None:
    rng, weights = np.random.default_rng(0), np.array([3.0, -1.0, 0.5])
    lessons = []
    for person, frames in (("a", 400), ("b", 4000)):
        inputs = rng.normal(size=(frames, 3)) * [1.0, 0.1, 10.0]
        odds = inputs @ weights + rng.logistic(size=frames)
        lessons.append(Lesson(person, inputs, np.sign(odds)))
    found = learn(lessons)
    assert found[0] / found[2] == pytest.approx(weights[0] / weights[2], rel=0.1)
    worse = lessons[1]._replace(right=-lessons[1].right)
    both = learn([lessons[0], worse])
    assert 0.0 > both[0] > -found[0]  # the square roots of frames count, 20 and 63


@captured
@pytest.mark.parametrize("name", ["08_01", "12_02", "35_01", "49_10"])
def test_people_before_a_virtual_kinect_face_the_way_they_do(name: str) -> None:
    (lesson,) = lessons_in(CMU / f"{name}.bvh.gz")
    assert np.mean(np.sign(lesson.inputs @ FACING_WEIGHTS) == lesson.right) > 0.88


@paired
def test_recorded_people_face_the_way_they_do() -> None:
    told = [
        np.sign(lesson.inputs @ FACING_WEIGHTS) == lesson.right
        for lesson in lessons_in(PAIRS / "s08.npz")
    ]
    assert np.concatenate(told).mean() > 0.97
