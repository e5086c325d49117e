"""What people mostly do with a hidden limb, as learned from recordings."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from kinefilter.characters import KINECT_V1, KINECT_V2, Skeleton, standard_body
from kinefilter.characters.rotations import unit
from kinefilter.pipeline.formats.npz import write_arrays
from kinefilter.pipeline.lab import limb_lessons
from kinefilter.pipeline.lab.limb_lessons import (
    Lesson,
    joined,
    joint_error,
    read_lessons,
    relative_errors,
    train_prior,
)
from kinefilter.pipeline.lab.recorded_acts import NamedTake
from kinefilter.pipeline.lab.simulation import simulated_pairs
from kinefilter.pipeline.reconstruct import MotionPrior
from kinefilter.pipeline.reconstruct.hidden_limbs import bridged_motion
from kinefilter.pipeline.reconstruct.prior import (
    default_prior,
    inputs_of,
    standing_height,
)
from kinefilter.pipeline.reconstruct.windows import (
    BridgedMotion,
    Limb,
    Stretches,
    describe,
    limb_of,
    limbs,
)
from kinefilter.pipeline.workers import workers

Array = NDArray[np.float64]
START, LENGTH = np.array([20]), 40
AT = np.arange(LENGTH)[None]
MIRROR = np.array([-1.0, 1.0, 1.0])


def moving(skeleton: Skeleton, seed: int, count: int = 80) -> BridgedMotion:
    """Return somebody every joint of whom goes to and fro by itself."""
    rng = np.random.default_rng(seed)
    time = np.arange(count) / 30.0
    phase, rate, far = rng.uniform(0.0, 6.0, (3, len(skeleton), 3))
    swing = 0.01 * far * np.sin(rate * time[:, None, None] + phase)
    return bridged_motion(
        time, standard_body(skeleton).rest_positions + swing, skeleton
    )


def mirrored(seen: BridgedMotion) -> BridgedMotion:
    """Return the mirror image."""
    positions = seen.heading.restore(seen.positions)[:, seen.skeleton.mirror] * MIRROR
    return bridged_motion(np.arange(len(positions)) / 30.0, positions, seen.skeleton)


def hidden(seen: BridgedMotion, which: int, *others: int) -> Limb:
    """Return a limb of ``limbs`` that is hidden, and others with it."""
    known = np.ones(len(seen.skeleton))
    for limb in (which, *others):
        known[list(limbs(seen.skeleton)[limb][1:])] = 0.0
    found = limb_of(seen.skeleton, limbs(seen.skeleton)[which], known)
    assert found is not None
    return found


def stretch(seen: BridgedMotion, limb: Limb, *, ahead: bool) -> Stretches:
    """Return the middle of the motion, in which a limb is hidden."""
    return Stretches(seen, limb, START, LENGTH, AT, ahead)


@pytest.mark.parametrize("skeleton", [KINECT_V1, KINECT_V2], ids=lambda s: s.name)
@pytest.mark.parametrize("ahead", [False, True], ids=["before", "between"])
@pytest.mark.parametrize("which", [0, 1], ids=["arm", "leg"])
def test_right_limbs_go_on_as_the_mirror_images_of_left_ones(
    which: int, skeleton: Skeleton, *, ahead: bool
) -> None:
    seen, prior = moving(skeleton, seed=which), default_prior()
    left = hidden(seen, which)
    around = mirrored(seen)
    right = hidden(around, which + 2)
    base = prior.describe(stretch(seen, left, ahead=ahead)).base
    image = prior.describe(stretch(around, right, ahead=ahead)).base
    np.testing.assert_allclose(image * MIRROR, base, atol=1e-9)
    plain = describe(stretch(seen, left, ahead=ahead)).base
    assert np.linalg.norm(base - plain, axis=-1).max() > 0.01
    # Next to what was seen, a limb is where it goes on.
    ends = [0, -1] if ahead else [0]
    nearby = np.linalg.norm(base - plain, axis=-1)[:, ends].max()
    assert nearby < 0.2 * np.linalg.norm(base - plain, axis=-1).max()


def test_without_networks_limbs_go_on_as_they_went() -> None:
    seen = moving(KINECT_V1, seed=3)
    arm = hidden(seen, 0)
    hiding = stretch(seen, arm, ahead=True)
    found, plain = MotionPrior({}).describe(hiding), describe(hiding)
    np.testing.assert_array_equal(found.base, plain.base)


def test_what_is_hidden_as_well_does_not_count() -> None:
    seen = moving(KINECT_V1, seed=4)
    arms = hidden(seen, 0, 2)

    def told(limb: Limb) -> Array:
        hiding = stretch(seen, limb, ahead=True)
        return inputs_of(hiding, describe(hiding))

    before, alone = told(arms), told(hidden(seen, 0))
    inside = slice(int(START[0]), int(START[0]) + LENGTH)
    seen.positions[inside, list(limbs(KINECT_V1)[2][1:])] += 0.3
    np.testing.assert_allclose(told(arms), before, atol=1e-9)
    assert np.abs(told(hidden(seen, 0)) - alone).max() > 0.1


@pytest.mark.parametrize("which", [0, 1], ids=["forearm", "shin"])
def test_the_upper_part_of_a_limb_counts_when_it_is_seen(which: int) -> None:
    seen, joints = moving(KINECT_V1, seed=5), limbs(KINECT_V1)[which]
    known = np.ones(len(KINECT_V1))
    known[joints[2]] = 0.0
    limb = limb_of(KINECT_V1, joints, known)
    assert limb is not None
    assert limb.hidden == joints[2:]

    def told() -> Array:
        hiding = stretch(seen, limb, ahead=True)
        return inputs_of(hiding, describe(hiding))

    before = told()
    inside = slice(int(START[0]), int(START[0]) + LENGTH)
    seen.positions[inside, joints[1]] += 0.3
    assert np.abs(told() - before).max() > 0.1


def test_a_limb_hidden_for_long_is_where_its_posture_has_it() -> None:
    """The legs of a person who stays excepted: they stand where they stood."""
    seen, prior, last = moving(KINECT_V1, seed=6, count=1900), default_prior(), 1890
    bones = seen.positions - seen.positions[:, list(KINECT_V1.parents)]
    without = MotionPrior({k: n for k, n in prior.networks.items() if "before" in k})
    for which, alike in ((0, True), (1, False)):
        limb = hidden(seen, which)
        at = np.array([[last - int(START[0])]])
        hiding = Stretches(seen, limb, START, 1875, at, ahead=False)
        shown = bones[last].copy()
        shown[list(limb.hidden)] = np.nan
        lower = seen.heading.root[last, 1] - standing_height(seen.heading.root[:, 1])
        likely = prior.unseen(KINECT_V1, limb.hidden, shown, np.asarray(lower))
        base = prior.describe(hiding).base[0, 0]
        assert np.allclose(base, likely, atol=1e-6) == alike
        assert np.allclose(base, without.describe(hiding).base, atol=1e-3) != alike


def test_the_error_of_joints_has_the_gradient_of_its_differences() -> None:
    rng, lengths = np.random.default_rng(0), np.array([0.28, 0.25])
    base, truth = unit(rng.normal(size=(2, 5, 2, 3)))
    outputs, step = rng.normal(scale=0.3, size=(5, 6)), 1e-6
    error, gradient = joint_error(outputs, base, truth, lengths)
    for k, change in enumerate(step * np.eye(6)):
        more, _ = joint_error(outputs + change, base, truth, lengths)
        less, _ = joint_error(outputs - change, base, truth, lengths)
        np.testing.assert_allclose(
            gradient[:, k], (more - less) / (2 * step), atol=1e-7
        )
    assert (joint_error(np.zeros((5, 6)), truth, truth, lengths)[0] < error).all()


def test_networks_learn_what_a_limb_does_and_read_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(limb_lessons, "workers", partial(workers, 1))
    pairs = list(simulated_pairs("kinect_v1", people=4))
    lessons = read_lessons(map(NamedTake.of, pairs), ("between",))
    people = sorted({lesson.person for lesson in lessons})

    def rows(some: list[str]) -> list[Lesson]:
        return [lesson for lesson in lessons if lesson.person in some]

    prior = train_prior(joined(rows(people)))
    found = relative_errors(prior, joined(rows(people)))
    assert found["arm_between"] < 90.0
    assert found["leg_between"] < 95.0
    write_arrays(tmp_path / "weights.npz", prior.arrays())
    again = relative_errors(
        MotionPrior.load(tmp_path / "weights.npz"), joined(rows(people))
    )
    assert again == pytest.approx(found, abs=0.5)
