"""Bodies where nobody gets so fast, of sizes that nobody has; arms over the head."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from skeletons import every_skeleton

from kinefilter import Avatar, CleanConfig, Pose, clean
from kinefilter.characters import (
    KINECT_V1,
    InputError,
    Skeleton,
    State,
    Take,
    standard_body,
)
from kinefilter.pipeline.failures import FailureKind, find_failures
from kinefilter.pipeline.summary import as_json
from kinefilter.scenes.library import perform

Array = NDArray[np.float64]
QUICK = CleanConfig(method="none", physics=False)


def act(motion: str, skeleton: Skeleton = KINECT_V1) -> Take:
    done = perform(motion, standard_body(skeleton), seed=1)
    state = np.full(done.positions.shape[:2], State.TRACKED, dtype=np.uint8)
    return Take(done.time, done.positions, state, skeleton, motion)


def moved(take: Take, frames: slice, by: float) -> Take:
    positions = take.positions.copy()
    positions[frames] += [by, 0.0, 0.0]
    return replace(take, positions=positions)


def scaled(take: Take, frames: slice, factor: float) -> Take:
    positions = take.positions.copy()
    roots = positions[frames, :1]
    positions[frames] = roots + factor * (positions[frames] - roots)
    return replace(take, positions=positions)


def bodies(take: Take) -> list[tuple[FailureKind, int, int]]:
    return [(f.kind, f.first, f.last) for f in find_failures(take) if f.part == "body"]


@pytest.mark.parametrize("motion", ["run", "wave"])
@pytest.mark.parametrize(
    "frames", [slice(40, 41), slice(40, 90), slice(0, 3), slice(100, None, None)]
)
def test_a_body_kilometers_away_is_taken_out_and_told(
    motion: str, frames: slice
) -> None:
    take = act(motion)
    if frames.stop is None:
        frames = slice(len(take) - 20, len(take))
    wrong = moved(take, frames, 3000.0)
    kind = FailureKind.ELSEWHERE
    assert bodies(wrong) == [(kind, frames.start, frames.stop - 1)]
    positions = clean(wrong, QUICK).clip.positions
    assert np.ptp(positions[..., 0]) < 20.0
    if frames.stop - frames.start < 5:
        usual = clean(take, QUICK).clip.positions
        assert abs(positions - usual).max() < 0.5


def test_frames_that_go_away_and_back_are_all_found() -> None:
    wrong = act("wave")
    for k in range(30, 60, 2):
        wrong = moved(wrong, slice(k, k + 1), 1300.0)
    assert [first for _, first, _ in bodies(wrong)] == list(range(30, 60, 2))


def test_a_person_who_is_somewhere_else_from_now_on_is_kept_and_told() -> None:
    take = act("wave")
    wrong = moved(take, slice(60, None), 3.0)
    assert bodies(wrong) == [(FailureKind.JUMPING, 59, 60)]
    assert (clean(wrong, QUICK).clip.positions[70:, 0, 0] > 2.0).all()


@pytest.mark.parametrize("factor", [23.0, 0.023, 0.5])
def test_a_body_of_another_size_is_taken_out_and_told(factor: float) -> None:
    take = act("wave")
    wrong = scaled(take, slice(40, 60), factor)
    assert bodies(wrong) == [(FailureKind.ODD_SIZE, 40, 59)]
    result = clean(wrong, QUICK)
    usual = clean(take, QUICK).clip.positions
    assert abs(result.clip.positions[:, 0] - usual[:, 0]).max() < 0.1
    told = [f for f in as_json(result)["failures"] if f["kind"] == "odd_size"]
    assert [f["start_s"] for f in told] == [pytest.approx(take.time[40])]
    assert "filled" in told[0]["done"]


@pytest.mark.parametrize("rows", [True, False])
@pytest.mark.parametrize(
    ("lost", "kept"), [(15, 8), (15, 1), (6, 8), (15, 0), (15, 24)]
)
def test_what_a_sensor_shows_of_a_body_before_losing_it_is_taken_out_and_told(
    lost: int, kept: int, *, rows: bool
) -> None:
    take, last = act("wave"), 49
    positions, apart = take.positions.copy(), slice(last + 1 - kept, last + 1)
    noise = np.random.default_rng(1).normal(0.0, 0.1, positions[apart].shape)
    positions[apart] += noise
    gone = slice(last + 1, last + 1 + lost)
    positions[gone] = np.nan
    wrong = replace(take, positions=positions)
    if rows:  # or else there are no frames
        wrong = wrong.at(np.delete(np.arange(len(take)), gone))
    told = [(FailureKind.FALLEN_APART, apart.start, last)]
    if kept < 18:
        assert bodies(wrong) == (told if kept and lost > 9 else [])
    else:  # it may be seen from the side
        kinds = {kind for kind, *_ in bodies(wrong)}
        assert FailureKind.FALLEN_APART not in kinds


@pytest.mark.parametrize("joint", ["HipCenter", "Spine", "KneeLeft", "HandRight"])
def test_one_wrong_cell_changes_nothing_but_that_joint_and_is_told(joint: str) -> None:
    """It used to throw the body through the air, and changed the person's size."""
    take = act("wave")
    positions = take.positions.copy()
    positions[50, KINECT_V1.index(joint), 0] = 50.0
    result = clean(replace(take, positions=positions), QUICK)
    usual = clean(take, QUICK).clip
    assert abs(result.clip.positions - usual.positions).max() < 0.03
    assert result.clip.body.height == pytest.approx(usual.body.height, abs=0.01)
    told = [f for f in as_json(result)["failures"] if f["kind"] == "stray"]
    assert [(f["part"], f["start_s"]) for f in told] == [
        (joint, pytest.approx(take.time[50]))
    ]


def test_a_body_that_falls_through_the_floor_stays_where_it_was() -> None:
    """As trackers let it when somebody else walks in front; then nobody is seen."""
    take = act("stand_idle").at(slice(90))
    positions, state = take.positions.copy(), take.state.copy()
    positions[36:40, :, 1] -= [[0.3], [0.5], [1.2], [1.2]]
    state[40:60] = State.NOT_TRACKED
    fallen = replace(take, positions=positions, state=state)
    assert FailureKind.SUNKEN in [kind for kind, *_ in bodies(fallen)]
    cleaned, usual = (clean(t, QUICK).clip.positions for t in (fallen, take))
    assert abs(cleaned - usual).max() < 0.1


@pytest.mark.parametrize("motion", ["squat", "pick_up", "jump", "sit", "lie"])
def test_who_goes_down_on_purpose_is_above_the_floor(motion: str) -> None:
    take = act("wave" if motion == "lie" else motion)
    if motion == "lie":
        take = replace(take, positions=take.positions[..., [0, 2, 1]])
    assert bodies(take) == []


def test_gaps_and_missing_joints_are_no_jumps() -> None:
    take = act("run")
    kept = np.ones(len(take), dtype=bool)
    kept[30:50] = False
    positions = take.positions.copy()
    positions[60:70] = np.nan
    take = replace(take, positions=positions)
    some = Take(take.time[kept], take.positions[kept], take.state[kept], take.skeleton)
    assert bodies(some) == []


@pytest.mark.parametrize(
    ("per_meter", "unit"), [(1000.0, "millimeters"), (100.0, "centimeters")]
)
@pytest.mark.parametrize("height", [None, 1.8])
def test_takes_in_other_units_are_refused_with_what_to_divide_by(
    per_meter: float, unit: str, height: float | None
) -> None:
    take = act("wave")
    wrong = replace(take, positions=per_meter * take.positions)
    with pytest.raises(InputError, match=f"{unit}: divide .* by {per_meter:g}"):
        clean(wrong, replace(QUICK, height=height))


def test_a_body_of_4_centimeters_is_refused() -> None:
    take = act("wave")
    with pytest.raises(InputError, match="stature of 0"):
        clean(
            replace(take, positions=0.023 * take.positions), replace(QUICK, height=1.8)
        )


def raised(skeleton: Skeleton, inward: float, back: float, apart: float) -> Take:
    """Return somebody with both arms over the head.

    The upper arms lean in and back by angles [degrees] from straight up, and the wrists
    are that far from the middle [m].
    """
    take, index = act("stand_idle", skeleton), skeleton.index
    positions = take.positions[:60].copy()
    lengths = standard_body(skeleton).lengths
    a, b = np.radians([inward, back])
    for side, x in (("Left", 1.0), ("Right", -1.0)):
        elbow, wrist = index("Elbow" + side), index("Wrist" + side)
        way = [-x * np.sin(a), np.cos(a) * np.cos(b), -np.cos(a) * np.sin(b)]
        positions[:, elbow] = positions[:, index("Shoulder" + side)]
        positions[:, elbow] += lengths[elbow] * np.array(way)
        there = positions[:, index("Head"), 0] + x * apart - positions[:, elbow, 0]
        most = 0.95 * lengths[wrist]
        there = np.clip(there, -most, most)
        up = np.sqrt(lengths[wrist] ** 2 - there**2)
        positions[:, wrist] = positions[:, elbow]
        positions[:, wrist, :2] += np.stack([there, up], axis=1)
    return Take(take.time[:60], positions, take.state[:60], skeleton)


@every_skeleton
@pytest.mark.parametrize("inward", [-15.0, 0.0, 20.0, 25.0])
def test_arms_over_the_head_are_no_failure(skeleton: Skeleton, inward: float) -> None:
    for back in (-15.0, 0.0, 20.0):
        for apart in (0.25, 0.05):
            assert find_failures(raised(skeleton, inward, back, apart)) == ()


def followed(take: Take) -> list[Pose]:
    avatar = Avatar(standard_body(KINECT_V1))
    frames = zip(take.positions, take.time, strict=True)
    return [avatar.step(frame, time) for frame, time in frames]


WAVING = act("wave").at(slice(60))


@pytest.fixture(scope="module")
def usual() -> list[Pose]:
    """Return how an avatar follows the take that others have impossible bodies in."""
    return followed(WAVING)


@pytest.mark.parametrize("first", [0, 30])
@pytest.mark.parametrize("what", ["elsewhere", "too large", "too small"])
def test_an_avatar_goes_on_without_impossible_bodies(
    usual: list[Pose], first: int, what: str
) -> None:
    take, wrong = WAVING, slice(first, first + 4)
    if what == "elsewhere":
        bad = moved(take, wrong, 3000.0)
    else:
        bad = scaled(take, wrong, 2.5 if what == "too large" else 0.3)
    found = followed(bad)
    assert not any(pose.impossible for pose in usual)
    told = [k for k, pose in enumerate(found) if pose.impossible]
    away = np.array(
        [
            abs(a.positions - b.positions).max()
            for a, b in zip(usual, found, strict=True)
        ]
    )
    if first or what != "elsewhere":
        assert told == list(range(first, first + 4))
        assert away[first + 10 :].max() < 0.3
    if not first:  # begins where the person then is
        assert away[8:].max() < 0.05
    assert away[50:].max() < 0.05


def test_an_avatar_goes_on_without_a_stray_joint(usual: list[Pose]) -> None:
    positions = WAVING.positions.copy()
    positions[30, KINECT_V1.index("Spine")] = 50.0
    found = followed(replace(WAVING, positions=positions))
    apart = [
        abs(a.positions - b.positions).max() for a, b in zip(usual, found, strict=True)
    ]
    assert max(apart) < 0.05


def test_an_avatar_believes_who_stays_elsewhere_after_half_a_second() -> None:
    take = act("stand_idle").at(slice(60))
    found = followed(moved(take, slice(20, None), 30.0))
    assert [k for k, pose in enumerate(found) if pose.impossible] == list(range(20, 35))
    assert abs(found[-1].positions[0, 0] - 30.0) < 1.0


def test_an_avatar_of_another_size_than_the_person_follows_all_the_same() -> None:
    take = act("stand_idle")
    take = Take(take.time[:30], take.positions[:30], take.state[:30], KINECT_V1)
    found = followed(scaled(take, slice(None), 0.55))
    assert sum(pose.impossible for pose in found) < 10
    assert not found[-1].impossible
