"""Which way people face, by how they bend."""

from __future__ import annotations

import numpy as np
import pytest
from known_motions import performed
from numpy.typing import NDArray
from real_data import CMU, PAIRS, captured, paired
from skeletons import every_skeleton

from kinefilter.characters import Skeleton
from kinefilter.pipeline.failures.sides import FACING_WEIGHTS, facing_inputs
from kinefilter.pipeline.lab.facing_lessons import Lesson, learn, lessons_in

Array = NDArray[np.float64]


@every_skeleton
def test_swapped_sides_change_the_sign_of_all_inputs(skeleton: Skeleton) -> None:
    take = performed("walk", skeleton)
    forward, inputs = facing_inputs(take.positions, skeleton)
    backward, swapped = facing_inputs(take.swapped().positions, skeleton)
    np.testing.assert_allclose(backward, -forward, atol=1e-12)
    np.testing.assert_allclose(swapped, -inputs, atol=1e-12)
    assert np.mean(inputs @ FACING_WEIGHTS > 0.0) > 0.95


@every_skeleton
def test_limbs_with_a_missing_joint_do_not_count(skeleton: Skeleton) -> None:
    take = performed("walk", skeleton)

    def inputs(*missing: str) -> Array:
        positions = take.positions.copy()
        positions[:, [skeleton.index(joint) for joint in missing]] = np.nan
        return facing_inputs(positions, skeleton)[1]

    left, right = inputs("KneeLeft", "WristLeft"), inputs("AnkleRight", "ElbowRight")
    np.testing.assert_allclose(left + right, inputs(), atol=1e-12)
    assert np.abs(left).max(axis=0).min() > 0.0
    assert not inputs("WristLeft", "ElbowRight")[:, :4].any()


def test_people_count_as_the_square_roots_of_their_frames() -> None:
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
    assert 0.0 > both[0] > -found[0]  # 20 against 63


@captured
@pytest.mark.parametrize("name", ["08_01", "12_02", "35_01", "49_10"])
def test_people_before_a_virtual_kinect_face_the_way_they_do(name: str) -> None:
    (lesson,) = lessons_in(CMU / f"{name}.bvh.gz")
    assert np.mean(np.sign(lesson.inputs @ FACING_WEIGHTS) == lesson.right) > 0.85


@paired
def test_recorded_people_face_the_way_they_do() -> None:
    told = [
        np.sign(lesson.inputs @ FACING_WEIGHTS) == lesson.right
        for lesson in lessons_in(PAIRS / "s08.npz")
    ]
    assert np.concatenate(told).mean() > 0.97
