"""When feet stand: closed forms, symmetries, performances, recorded people."""

from __future__ import annotations

import warnings
from itertools import pairwise, product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from known_motions import noisy, stamps, standing, toes_rest
from numpy.typing import NDArray
from real_data import PAIRS, paired
from skeletons import every_skeleton

from kinefilter.characters import KINECT_V1, Skeleton, standard_body
from kinefilter.characters.arrays import runs
from kinefilter.characters.rotations import about_y, rotate
from kinefilter.characters.skeleton import SIDES
from kinefilter.pipeline.pairs import read_pairs
from kinefilter.pipeline.target import feet
from kinefilter.pipeline.target.feet import ankles_and_toes, find_stance, planted_feet
from kinefilter.scenes.library import perform

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

BODY = standard_body(KINECT_V1)
LEFT, RIGHT = ([KINECT_V1.index(p + s) for p in ("Ankle", "Foot")] for s in SIDES)
UNLOADING = 0.15  # s that a stance is shorter at an end within the take


def stance_of(time: Array, positions: Array) -> Flags:
    return find_stance(time, positions, np.ones(positions.shape[:2]), KINECT_V1)


def stepping(
    time: Array,
    start: float,
    end: float,
    feet: list[int],
    *,
    length: float = 0.3,
    height: float = 0.12,
) -> Array:
    """Return a standing body of which one foot goes forward between two times."""
    share = np.clip((time - start) / (end - start), 0.0, 1.0)
    path = standing(len(time))
    path[:, feet, 2] += (length * share**2 * (3.0 - 2.0 * share))[:, None]
    path[:, feet, 1] += (height * np.sin(np.pi * share) ** 2)[:, None]
    return path


# Closed forms


@every_skeleton
@pytest.mark.parametrize("fps", [15.0, 30.0, 120.0])
def test_feet_at_rest_stand_throughout_however_they_tremble(
    skeleton: Skeleton, fps: float
) -> None:
    time = stamps(int(6 * fps), fps)
    path = standing(len(time), skeleton)
    path += np.random.default_rng(1).normal(0.0, 0.015, path.shape)
    stands = find_stance(time, path, np.ones(path.shape[:2]), skeleton)
    assert stands.shape == (len(time), 2)
    assert stands.dtype == np.bool_
    assert stands.all()


@pytest.mark.parametrize("fps", [15.0, 30.0, 120.0])
@pytest.mark.parametrize("foot", [0, 1])
def test_a_foot_that_steps_is_found_stepping_and_stands_before_and_after(
    foot: int, fps: float
) -> None:
    time = stamps(int(4 * fps), fps)
    path = stepping(time, 1.8, 2.3, (LEFT, RIGHT)[foot])
    path += np.random.default_rng(2).normal(0.0, 0.004, path.shape)
    stands = stance_of(time, path)
    assert stands[:, 1 - foot].all()
    before, after = runs(stands[:, foot])
    assert before.start == 0
    assert after.stop == len(time)
    leaves, arrives = time[before.stop - 1], time[after.start]
    # The foot is unloaded before it rises and loaded after it has landed.
    assert 1.8 - 2.5 * UNLOADING < leaves < 1.8 + 0.5 * UNLOADING
    assert 2.3 - 0.5 * UNLOADING < arrives < 2.3 + 2.5 * UNLOADING


@pytest.mark.parametrize("rises", [1.5, 1.45, 1.4])
def test_a_foot_bears_until_the_other_has_landed(rises: float) -> None:
    time = stamps(120)
    path = stepping(time, 1.0, 1.5, LEFT) + stepping(time, rises, rises + 0.5, RIGHT)
    stands = stance_of(time, path - standing(120))
    assert stands.any(axis=1).all()
    for foot, begins in enumerate((1.0, rises)):
        (step,) = runs(~stands[:, foot])
        assert time[step.start] == pytest.approx(begins, abs=UNLOADING)
        assert time[step.stop - 1] == pytest.approx(begins + 0.5, abs=UNLOADING)


def test_a_foot_that_crept_elsewhere_has_stepped_unseen() -> None:
    time = stamps(150)
    path = standing(150)
    path[:, LEFT, 0] += np.interp(time, [2.0, 3.5], [0.0, 0.3])[:, None]
    found = runs(stance_of(time, path)[:, 0])
    assert len(found) >= 2
    for stance in found:
        assert np.ptp(path[stance, LEFT[0], 0]) < 0.2


def test_a_step_that_nobody_saw_takes_as_long_as_a_step() -> None:
    path, stands = np.zeros((120, 2)), np.ones(120, dtype=np.bool_)
    path[60:, 0] = 0.3
    anywhere = np.ones(120, dtype=np.bool_)
    feet._split(stamps(120), path, stands, slice(0, 120), 0.15, anywhere)
    # Four tenths of a second about the 60th frame.
    assert runs(~stands) == [slice(54, 66)]


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), reach=st.floats(0.0, 1.5))
def test_no_stance_strays_by_twice_the_drift(seed: int, reach: float) -> None:
    rng, time = np.random.default_rng(seed), stamps(120)
    knots = rng.uniform(-reach, reach, (5, 2))
    path = standing(120)
    for axis, column in ((0, 0), (2, 1)):
        path[:, LEFT, axis] += np.interp(time, np.linspace(0, 4, 5), knots[:, column])[
            :, None
        ]
    for stance in runs(stance_of(time, path)[:, 0]):
        if stance.stop - stance.start > 3:
            # Smoothing rounds the corners of the path.
            away = np.ptp(path[stance, LEFT[0]][:, [0, 2]], axis=0).max()
            assert away < 2.0 * feet._DRIFT + 0.02


def test_who_leaves_the_floor_with_both_feet_does_not_stand() -> None:
    time = stamps(120)
    flight = np.clip(time - 1.8, 0.0, 0.6)
    path = standing(120)
    path[:, :, 1] += (4.905 * flight * (0.6 - flight))[:, None]
    stands = stance_of(time, path)
    np.testing.assert_array_equal(stands[:, 0], stands[:, 1])
    before, after = runs(stands[:, 0])
    assert time[before.stop - 1] < 1.85
    assert time[after.start] > 2.35


def test_who_sits_down_and_gets_up_stands_on_feet_that_tremble_up_and_down() -> None:
    act = perform("sit_to_stand", BODY, seed=3)
    path = noisy(act, 0.005)
    # The sensor takes the feet of who sits to be higher than they are.
    low = act.positions[:, 0, 1].max() - act.positions[:, 0, 1]
    path[:, [*LEFT, *RIGHT], 1] += 0.25 * low[:, None]
    assert stance_of(act.time, path).mean() > 0.95


def test_a_short_stance_keeps_its_half_in_the_middle() -> None:
    stands = np.zeros((60, 2), dtype=np.bool_)
    stands[20:26] = True
    shorter = feet._unloaded(stamps(60), stands)
    assert runs(shorter[:, 0]) == runs(shorter[:, 1]) == [slice(22, 24)]


@settings(max_examples=150, deadline=None)
@given(
    odds=st.lists(
        st.tuples(st.floats(-9.0, 9.0), st.floats(-9.0, 9.0)), min_size=1, max_size=9
    )
)
def test_the_sequence_is_the_most_probable_of_all(
    odds: list[tuple[float, float]],
) -> None:
    log_odds = np.array(odds)
    every = np.array(list(product([False, True], repeat=len(odds))))
    found = feet._most_probable(log_odds)
    changes = np.abs(np.diff(every.astype(int), axis=1)).sum(axis=1)
    for foot in range(2):
        scores = every @ log_odds[:, foot] - feet._SWITCH * changes
        chosen = int(np.flatnonzero((every == found[:, foot]).all(axis=1))[0])
        assert scores[chosen] == pytest.approx(scores.max(), abs=1e-9)


@settings(max_examples=50, deadline=None)
@given(flags=st.lists(st.booleans(), max_size=30), shortest=st.integers(1, 4))
def test_runs_are_the_maximal_spans_of_truth(flags: list[bool], shortest: int) -> None:
    spans = runs(np.array(flags, dtype=np.bool_))
    long = [span for span in spans if span.stop - span.start >= shortest]
    assert runs(np.array(flags, dtype=np.bool_), shortest) == long
    again = np.zeros(len(flags), dtype=np.bool_)
    for span in spans:
        assert span.start < span.stop
        again[span] = True
    assert again.tolist() == flags
    for one, other in pairwise(spans):
        assert one.stop < other.start


def test_a_foot_stands_where_its_heel_or_its_toes_do() -> None:
    parts = np.array(list(product([False, True], repeat=4)))
    feet = planted_feet(parts)
    np.testing.assert_array_equal(feet[:, 0], parts[:, 0] | parts[:, 1])
    np.testing.assert_array_equal(feet[:, 1], parts[:, 2] | parts[:, 3])


# Symmetries


@pytest.mark.parametrize("motion", ["walk", "kick", "dance", "step_over"])
def test_stances_do_not_depend_on_place_heading_side_or_the_clock(motion: str) -> None:
    act = perform(motion, BODY, seed=4)
    path = noisy(act, 0.006)
    stands = stance_of(act.time, path)
    assert 0.1 < stands.mean() < 1.0
    moved = path + np.array([3.0, -1.2, 2.0])
    np.testing.assert_array_equal(stance_of(act.time + 1e4, moved), stands)
    quarter = path[..., [2, 1, 0]] * [1.0, 1.0, -1.0]
    np.testing.assert_array_equal(stance_of(act.time, quarter), stands)
    turned = rotate(about_y(0.7), path)
    assert np.mean(stance_of(act.time, turned) == stands) > 0.99
    mirrored = path[:, KINECT_V1.mirror] * [-1.0, 1.0, 1.0]
    np.testing.assert_array_equal(stance_of(act.time, mirrored), stands[:, ::-1])


@pytest.mark.parametrize("motion", ["walk", "march", "kick", "jump"])
@pytest.mark.parametrize(("fps", "least"), [(15.0, 0.92), (120.0, 0.97)])
def test_stances_do_not_depend_on_the_frame_rate(
    motion: str, fps: float, least: float
) -> None:
    fast = perform(motion, BODY, seed=0, fps=120.0)
    every = int(120.0 / fps)
    reference = stance_of(fast.time[::4], fast.positions[::4])
    found = stance_of(fast.time[::every], fast.positions[::every])
    both = np.lcm(every, 4)
    same = found[:: both // every] == reference[:: both // 4]
    assert same.mean() > least


def test_arguments_are_not_modified() -> None:
    act = perform("walk", BODY, seed=0)
    time, path, confidence = (
        act.time.copy(),
        noisy(act, 0.01),
        np.full((len(act), 20), 0.5),
    )
    before = path.copy(), confidence.copy()
    find_stance(time, path, confidence, KINECT_V1)
    np.testing.assert_array_equal(time, act.time)
    np.testing.assert_array_equal(path, before[0])
    np.testing.assert_array_equal(confidence, before[1])


# Takes as they come


@pytest.mark.parametrize("frames", [1, 2, 3, 4])
def test_a_few_frames_of_somebody_who_stands_are_enough(frames: int) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert stance_of(stamps(frames), standing(frames)).all()


def test_dropped_frames_and_pauses_change_little() -> None:
    act = perform("kick", BODY, seed=2)
    stands = stance_of(act.time, act.positions)
    kept = np.sort(np.random.default_rng(0).permutation(len(act))[: 3 * len(act) // 4])
    found = stance_of(act.time[kept], act.positions[kept])
    assert np.mean(found == stands[kept]) > 0.95
    time = act.time + np.where(np.arange(len(act)) < len(act) // 2, 0.0, 3600.0)
    assert np.mean(stance_of(time, act.positions) == stands) > 0.95


def test_a_leap_of_an_invented_ankle_is_no_step() -> None:
    path, confidence = standing(90), np.ones((90, 20))
    path[40:44, LEFT] += [0.15, 0.1, 0.0]
    confidence[40:44, LEFT] = 0.0
    assert find_stance(stamps(90), path, confidence, KINECT_V1).all()


# Performances and people


@pytest.mark.parametrize("sigma", [0.0, 0.01])
@pytest.mark.parametrize(
    ("motion", "agreement", "rest"),
    [
        # A foot bears until the other does, also where its toes begin to move.
        ("walk", 0.9, 0.94),
        ("march", 0.9, 0.96),
        ("jump", 0.81, 0.88),
        ("kick", 0.95, 0.97),
        ("step_over", 0.95, 0.95),
        ("leg_raise", 0.93, 0.93),
        ("squat", 0.99, 0.99),
        ("stand_idle", 1.0, 1.0),
    ],
)
def test_feet_of_a_performance_stand_where_their_toes_rest(
    motion: str, agreement: float, rest: float, sigma: float
) -> None:
    for seed in range(3):
        act = perform(motion, BODY, seed=seed)
        truth = toes_rest(act.time, act.positions)
        stands = stance_of(act.time, noisy(act, sigma))
        assert np.mean(stands == truth) >= agreement
        assert np.mean(truth[stands]) >= rest


@pytest.mark.parametrize(
    ("motion", "least", "most"),
    [
        ("turn", 1.0, 1.0),
        ("lunge", 1.0, 1.0),
        ("march", 1.0, 1.0),
        ("walk", 1.0, 1.0),
        ("jump", 0.6, 0.95),
    ],
)
def test_only_who_jumps_often_stands_on_no_foot(
    motion: str, least: float, most: float
) -> None:
    for seed in range(3, 6):
        act = perform(motion, BODY, seed=seed)
        stands = stance_of(act.time, noisy(act, 0.01))
        assert least <= stands.any(axis=1).mean() <= most


@pytest.mark.parametrize("seed", range(4))
def test_who_marches_on_the_spot_lifts_the_feet_in_turn(seed: int) -> None:
    act = perform("march", BODY, seed=seed)
    truth = toes_rest(act.time, act.positions)
    stands = stance_of(act.time, noisy(act, 0.008))
    for foot in range(2):
        lifts = [s for s in runs(~truth[:, foot]) if s.stop - s.start > 8]
        missed = [s for s in lifts if stands[s, foot].all()]
        assert len(lifts) >= 3
        assert len(missed) <= len(lifts) // 4


@paired
@pytest.mark.parametrize("person", ["s03", "s06", "s07", "s08"])
def test_feet_of_recorded_people_stand_where_those_of_the_mocap_rest(
    person: str,
) -> None:
    same, resting = [], []
    for pair in read_pairs(PAIRS / f"{person}.npz")[::11]:
        path, seen = pair.take.positions, ~np.isnan(pair.take.positions[..., 0])
        path = np.where(seen[..., None], path, 0.0)
        _, toes = ankles_and_toes(KINECT_V1)
        if not seen[:, toes].all():
            continue
        stands = find_stance(pair.take.time, path, seen.astype(float), KINECT_V1)
        known = ~np.isnan(pair.truth[:, toes, 0])
        truth = toes_rest(pair.take.time, pair.truth)
        same.append((stands == truth)[known])
        resting.append(truth[stands & known])
    assert len(same) > 5
    assert np.mean(np.concatenate(same)) > 0.9
    assert np.mean(np.concatenate(resting)) > 0.95
