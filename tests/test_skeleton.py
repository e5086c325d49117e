"""Skeletons of the sensors, and the types that carry motion on them."""

from __future__ import annotations

import warnings
from dataclasses import FrozenInstanceError, fields
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray
from skeletons import every_skeleton

from kinefilter.characters import (
    CONTACTS,
    KINECT_V1,
    KINECT_V2,
    SKELETONS,
    Clip,
    InputError,
    Skeleton,
    State,
    Take,
    skeleton_named,
    standard_body,
)

Array = NDArray[np.float64]

SDK_V1 = [
    "HipCenter",
    "Spine",
    "ShoulderCenter",
    "Head",
    "ShoulderLeft",
    "ElbowLeft",
    "WristLeft",
    "HandLeft",
    "ShoulderRight",
    "ElbowRight",
    "WristRight",
    "HandRight",
    "HipLeft",
    "KneeLeft",
    "AnkleLeft",
    "FootLeft",
    "HipRight",
    "KneeRight",
    "AnkleRight",
    "FootRight",
]
SDK_V2 = [
    "SpineBase",
    "SpineMid",
    "Neck",
    "Head",
    "ShoulderLeft",
    "ElbowLeft",
    "WristLeft",
    "HandLeft",
    "ShoulderRight",
    "ElbowRight",
    "WristRight",
    "HandRight",
    "HipLeft",
    "KneeLeft",
    "AnkleLeft",
    "FootLeft",
    "HipRight",
    "KneeRight",
    "AnkleRight",
    "FootRight",
    "SpineShoulder",
    "HandTipLeft",
    "ThumbLeft",
    "HandTipRight",
    "ThumbRight",
]


# Skeletons


@pytest.mark.parametrize(
    ("skeleton", "names"), [(KINECT_V1, SDK_V1), (KINECT_V2, SDK_V2)]
)
def test_joints_are_those_of_the_sdk_in_its_order(
    skeleton: Skeleton, names: list[str]
) -> None:
    assert list(skeleton.joints) == names
    assert [skeleton.index(name) for name in names] == list(range(len(names)))


@pytest.mark.parametrize(("skeleton", "joints"), [(KINECT_V1, 20), (KINECT_V2, 25)])
def test_there_is_one_segment_less_than_joints(skeleton: Skeleton, joints: int) -> None:
    assert len(skeleton) == joints
    assert len(skeleton.segments) == len(skeleton.segment_parents) == joints - 1
    assert sorted([skeleton.root, *skeleton.segments]) == list(range(joints))


@every_skeleton
def test_every_parent_comes_before_its_children(skeleton: Skeleton) -> None:
    for order in (skeleton.order, (skeleton.root, *skeleton.segments)):
        place = {joint: k for k, joint in enumerate(order)}
        assert len(place) == len(skeleton)
        assert order[0] == skeleton.root
        for joint, parent in enumerate(skeleton.parents):
            assert parent == -1 or place[parent] < place[joint]


@every_skeleton
def test_children_and_parents_say_the_same(skeleton: Skeleton) -> None:
    pairs = {(p, c) for c, p in enumerate(skeleton.parents) if p >= 0}
    assert pairs == {(p, c) for p in range(len(skeleton)) for c in skeleton.children[p]}
    ends, starts = skeleton.segments.tolist(), skeleton.segment_parents.tolist()
    assert pairs == set(zip(starts, ends, strict=True))
    assert skeleton.parents.count(-1) == 1


@every_skeleton
def test_mirror_is_an_involution_that_keeps_the_hierarchy(skeleton: Skeleton) -> None:
    mirror = skeleton.mirror
    np.testing.assert_array_equal(mirror[mirror], np.arange(len(skeleton)))
    for joint, name in enumerate(skeleton.joints):
        partner = skeleton.joints[mirror[joint]]
        swapped = name.replace("Left", "?").replace("Right", "Left")
        assert partner == swapped.replace("?", "Right")
        if skeleton.parents[joint] >= 0:
            parent = int(mirror[skeleton.parents[joint]])
            assert skeleton.parents[mirror[joint]] == parent


@pytest.mark.parametrize(
    ("skeleton", "chain"),
    [
        (KINECT_V1, "HandRight WristRight ElbowRight ShoulderRight ShoulderCenter"),
        (KINECT_V1, "FootLeft AnkleLeft KneeLeft HipLeft HipCenter"),
        (KINECT_V1, "Head ShoulderCenter Spine HipCenter"),
        (KINECT_V2, "Head Neck SpineShoulder SpineMid SpineBase"),
        (KINECT_V2, "HandTipLeft HandLeft WristLeft ElbowLeft ShoulderLeft"),
        (KINECT_V2, "ThumbRight WristRight"),
        (KINECT_V2, "ShoulderLeft SpineShoulder"),
        (KINECT_V2, "FootRight AnkleRight KneeRight HipRight SpineBase"),
    ],
)
def test_limbs_hang_together_as_on_a_human(skeleton: Skeleton, chain: str) -> None:
    names = chain.split()
    for child, parent in pairwise(names):
        assert skeleton.parents[skeleton.index(child)] == skeleton.index(parent)


def test_unknown_names_are_refused_with_the_known_ones() -> None:
    with pytest.raises(InputError, match=r"kinect_v1.*'Tail'.*HipCenter, Spine"):
        KINECT_V1.index("Tail")
    with pytest.raises(InputError, match=r"'octopus'.*kinect_v1, kinect_v2"):
        skeleton_named("octopus")


def test_skeletons_are_found_by_their_names() -> None:
    assert {name: s.name for name, s in SKELETONS.items()} == {
        name: name for name in SKELETONS
    }
    for name, skeleton in SKELETONS.items():
        assert skeleton_named(name) is skeleton


# Takes and clips


def take_fields(frames: int = 4, skeleton: Skeleton = KINECT_V1) -> dict[str, Any]:
    joints = len(skeleton)
    return {
        "time": np.arange(frames) / 30.0,
        "positions": np.full((frames, joints, 3), 0.5),
        "state": np.full((frames, joints), int(State.TRACKED), dtype=np.uint8),
        "skeleton": skeleton,
        "source": "a.csv",
    }


def clip_fields(frames: int = 4, skeleton: Skeleton = KINECT_V1) -> dict[str, Any]:
    per_joint = (
        "reliability",
        "deciding_term",
        "origin",
        "moved_by_correction",
        "moved_by_physics",
        "uncertainty",
    )
    shape = (frames, len(skeleton))
    take = take_fields(frames, skeleton)
    return {
        **{name: take[name] for name in ("time", "state", "source")},
        "root": np.full((frames, 3), 0.5),
        "rotations": np.tile([1.0, 0.0, 0.0, 0.0], (*shape, 1)),
        "body": standard_body(skeleton),
        **{name: np.zeros(shape) for name in per_joint},
        "contacts": np.zeros((frames, len(CONTACTS)), dtype=np.bool_),
        "external_force": np.zeros(frames),
    }


def arrays_of(motion: Take | Clip) -> dict[str, Array]:
    values = {field.name: getattr(motion, field.name) for field in fields(motion)}
    return {k: v for k, v in values.items() if isinstance(v, np.ndarray)}


@pytest.mark.parametrize(
    ("motion", "count"),
    [(Take(**take_fields()), 3), (Clip(**clip_fields()), 12)],
    ids=["take", "clip"],
)
def test_arrays_of_a_motion_are_read_only(motion: Take | Clip, count: int) -> None:
    arrays = arrays_of(motion)
    assert len(arrays) == count
    for name, array in arrays.items():
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0
        with pytest.raises(FrozenInstanceError):
            setattr(motion, name, array)


@pytest.mark.parametrize(
    ("kind", "make"), [(Take, take_fields), (Clip, clip_fields)], ids=["take", "clip"]
)
def test_making_a_motion_leaves_the_arguments_writable_and_unchanged(
    kind: Any, make: Any
) -> None:
    arguments = make()
    before = {k: np.copy(v) for k, v in make().items() if isinstance(v, np.ndarray)}
    kind(**arguments)
    assert before
    for name, array in before.items():
        np.testing.assert_array_equal(arguments[name], array)
        assert arguments[name].flags.writeable


@every_skeleton
@pytest.mark.parametrize("name", ["positions", "state"])
def test_a_take_of_the_wrong_shape_is_refused(skeleton: Skeleton, name: str) -> None:
    arguments = take_fields(4, skeleton)
    for wrong in (arguments[name][:, :-1], arguments[name][:-1]):
        expected = str(arguments[name].shape).replace("(", r"\(").replace(")", r"\)")
        with pytest.raises(InputError, match=f"a.csv: {name}.*{expected}.*kinect_v"):
            Take(**{**arguments, name: wrong})
    with pytest.raises(
        InputError, match=r"time is \['a', .*\.\.\., expected numbers of shape \(any,\)"
    ):
        Take(**{**arguments, "time": ["a"] * 20})
    with pytest.raises(InputError, match="time has shape"):
        Take(**{**arguments, "time": arguments["time"][:, None]})


@pytest.mark.parametrize(
    "name",
    [
        "root",
        "rotations",
        "state",
        "reliability",
        "deciding_term",
        "origin",
        "moved_by_correction",
        "moved_by_physics",
        "uncertainty",
        "contacts",
    ],
)
def test_a_clip_of_the_wrong_shape_is_refused(name: str) -> None:
    arguments = clip_fields()
    for wrong in (arguments[name][1:], arguments[name][:, 1:], arguments[name][..., 0]):
        with pytest.raises(InputError, match=f"a.csv: {name} has shape"):
            Clip(**{**arguments, name: wrong})


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("rotations", [0.0, 0.0, 0.0, 0.0], "length of the rotation must be 1, got 0"),
        ("rotations", [1.0, 0.1, 0.0, 0.0], "length of the rotation must be 1, got 1"),
        ("rotations", np.nan, "length of the rotation must be 1, got nan"),
        ("rotations", 1e200, "length of the rotation must be 1, got inf"),
        ("reliability", 7.0, "reliability must be .*, got 7"),
        ("reliability", -0.1, "reliability must be .*, got -0.1"),
        ("state", 3, "state must be .*, got 3"),
        ("deciding_term", 5, "deciding_term must be .*, got 5"),
        ("origin", 3, "origin must be .*, got 3"),
    ],
)
def test_values_that_no_clip_holds_are_refused_by_frame_and_joint(
    name: str, value: ArrayLike, words: str
) -> None:
    arguments = clip_fields()
    arguments[name] = arguments[name].copy()
    arguments[name][2, KINECT_V1.index("Head")] = value
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(InputError, match=rf"a\.csv: frame 3, Head: {words}"):
            Clip(**arguments)


def test_a_clip_need_not_know_how_reliable_it_is() -> None:
    arguments = clip_fields()
    Clip(**{**arguments, "reliability": np.full_like(arguments["reliability"], np.nan)})


def test_a_force_per_joint_is_refused() -> None:
    arguments = clip_fields()
    for wrong in (arguments["external_force"][1:], np.zeros((4, 3))):
        with pytest.raises(InputError, match=r"a\.csv: external_force"):
            Clip(**{**arguments, "external_force": wrong})


def test_time_that_goes_backwards_is_refused_naming_the_frame() -> None:
    arguments = take_fields()
    arguments["time"] = np.array([0.0, 0.1, 0.05, 0.01])
    with pytest.raises(
        InputError, match=r"a\.csv: frame 3: time .* \(0\.1000 s, then 0\.0500 s\)"
    ):
        Take(**arguments)


def test_repeated_stamps_and_gaps_are_normal_and_leave_the_rate() -> None:
    arguments = take_fields(6)
    arguments["time"] = np.array([0.0, 0.04, 0.04, 0.08, 0.12, 0.9])
    assert Take(**arguments).fps == pytest.approx(25.0)


def test_a_take_without_two_stamps_counts_as_thirty_frames_a_second() -> None:
    assert Take(**take_fields(1)).fps == 30.0
    arguments = take_fields(3)
    assert Take(**{**arguments, "time": np.full(3, 7.0)}).fps == 30.0


@pytest.mark.parametrize("fps", [15.0, 30.0, 120.0])
def test_takes_and_clips_agree_on_the_rate(fps: float) -> None:
    time = np.arange(4) / fps
    take = Take(**{**take_fields(), "time": time})
    clip = Clip(**{**clip_fields(), "time": time})
    assert take.fps == clip.fps == pytest.approx(fps)
    assert len(take) == len(clip) == 4
