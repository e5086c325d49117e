"""Live stances, as they are learned from mocap."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from known_motions import Array, noisy, stamps, standing
from real_data import CMU, PAIRS, captured, paired

from kinefilter.characters import KINECT_V1, KINECT_V2
from kinefilter.pipeline.formats.npz import write_arrays
from kinefilter.pipeline.lab import stance_lessons
from kinefilter.pipeline.lab.stance_lessons import Lesson, learn, lessons_in, planted
from kinefilter.pipeline.networks import network_arrays, read_networks
from kinefilter.pipeline.target.stance_odds import (
    described,
    legs_of,
    stance_network,
    stance_odds,
)
from kinefilter.scenes.library import perform, random_body


def wrong(lesson: Lesson) -> float:
    """Return the share of feet [%] that the shipped network tells wrong."""
    told = stance_network()(lesson.inputs)[..., 0] > 0.0
    return 100.0 * float((told != lesson.planted)[lesson.known].mean())


def test_right_feet_are_described_as_mirror_images_of_left_ones() -> None:
    act = perform("walk", random_body(KINECT_V1, np.random.default_rng(0)), seed=2)
    legs = noisy(act)[:, legs_of(KINECT_V1)]
    inputs = described(act.time, legs, act.time)
    mirrored = legs[:, [1, 0, 3, 2]] * [-1.0, 1.0, 1.0]
    found = described(act.time, mirrored, act.time)
    np.testing.assert_allclose(found, inputs[:, ::-1], atol=1e-5)


def test_only_the_last_four_tenths_of_a_second_count() -> None:
    legs = standing(60)[:, legs_of(KINECT_V1)]
    moved = legs.copy()
    moved[:40, 2] += [0.5, 0.2, 0.0]
    time = stamps(60)
    np.testing.assert_array_equal(stance_odds(time, moved), stance_odds(time, legs))
    moved[56] += [0.0, 0.1, 0.0]
    assert (stance_odds(time, moved) != stance_odds(time, legs)).any()


def test_a_foot_is_planted_while_its_heel_or_its_toes_are_slow_and_low() -> None:
    time, truth = stamps(90), standing(90, KINECT_V2)
    ankle, toes = KINECT_V2.index("AnkleLeft"), KINECT_V2.index("FootLeft")
    truth[30:, ankle, 1] += 0.1  # the heel rises
    truth[60:, toes, 1] += 0.1  # the toes follow
    truth[1:, KINECT_V2.index("FootRight")] = np.nan
    found, known = planted(time, truth, KINECT_V2, 0.3, 0.05)
    assert found[:59, 0].all()
    assert not found[60:, 0].any()
    assert known[:, 0].all()
    assert not known[:, 1].any()


def lessons(seed: int = 0) -> list[Lesson]:
    """Return people whose feet are planted while they are low."""
    rng, made = np.random.default_rng(seed), []
    for person in ("a", "b"):
        inputs = rng.normal(size=(2000, 2, 5)).astype(np.float32)
        known = rng.random((2000, 2)) < 0.9
        flags = np.where(known, inputs[..., 2] < 0.3, True)
        made.append(Lesson(person, inputs, flags, known))
    return made


def test_what_is_learned_survives_a_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stance_lessons, "_DRAWN", 15_000)  # enough for so simple a rule
    network = learn(lessons())
    test = lessons(seed=1)[0]
    odds = network(test.inputs)[..., 0]
    assert np.mean((odds > 0.0) == (test.inputs[..., 2] < 0.3)) > 0.97
    write_arrays(tmp_path / "weights.npz", network_arrays({"live": network}))
    again = read_networks(tmp_path / "weights.npz", "weights")["live"]
    np.testing.assert_allclose(again(test.inputs)[..., 0], odds, rtol=0.02, atol=0.1)
    missing: Array = np.full(5, np.nan)
    np.testing.assert_allclose(again(missing), again(again.mean), atol=1e-6)


@captured
@pytest.mark.parametrize(("name", "most"), [("08_01", 30.0), ("35_01", 25.0)])
def test_feet_of_walkers_before_a_virtual_kinect_are_told(
    name: str, most: float
) -> None:
    (lesson,) = lessons_in(CMU / f"{name}.bvh.gz")
    always = 100.0 * (~lesson.planted)[lesson.known].mean()
    assert wrong(lesson) < min(most, always)


@paired
def test_feet_of_recorded_people_are_told() -> None:
    some = lessons_in(PAIRS / "s08.npz", every=24)
    assert np.mean([wrong(lesson) for lesson in some]) < 2.0
