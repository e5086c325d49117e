"""What is given in Python is taken as it was meant, or refused by name.

Every public function gets every kind of value that nobody should give it.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from known_motions import standing

import kinefilter
from kinefilter import Avatar, CleanConfig, Cleaner, Clip, Export, Take
from kinefilter.characters import (
    KINECT_V1,
    InputError,
    Prop,
    Shape,
    Skeleton,
    Tracking,
    skeleton_named,
    standard_body,
)
from kinefilter.pipeline.pairs import PairedTake
from kinefilter.scenes.library import random_body

QUICK = CleanConfig(method="none", physics=False)
BODY = standard_body(KINECT_V1)
COUNT = 12
TIME = np.arange(COUNT) / 30.0
PLACES = standing(COUNT) + np.array([0.0, -0.8, 2.5])
STATES = np.full((COUNT, 20), 2, dtype=np.uint8)
TAKE = Take(TIME, PLACES, STATES, KINECT_V1)

NO_VALUES: dict[str, Any] = {
    "text": "abc",
    "bytes": b"1",
    "dict": {"a": 1},
    "complex": 1j,
    "ragged": [[1], [1, 2]],
    "nothing": np.array([None] * 3),
    "texts": np.array(["1", "2"]),
    "objects": [object()],
    "function": len,
    "400 digits": 10**400,
    "5000 digits": 10**5000,
    "dates": np.zeros(3, "datetime64[s]"),
}
"""What is neither a number, an array of the right shape, nor anything of ours."""


def misfits(array: Any) -> Iterator[tuple[str, Any]]:
    """Yield what an array of numbers must not be."""
    yield from NO_VALUES.items()
    yield "none", None
    yield "truth", True
    yield "number", 3.0
    yield "empty list", []
    yield "one row more", np.concatenate([array, array[:1]])
    yield "a dimension more", array[None]
    yield "as text", array.astype(str)
    yield "as complex", array.astype(complex)


def same_numbers(array: Any) -> Iterator[tuple[str, Any]]:
    """Yield the same numbers in other arrays."""
    whole = np.asarray(array)
    yield "list", whole.tolist()
    yield "tuple", tuple(whole.tolist())
    yield "objects", whole.astype(object)
    yield "single", whole.astype(np.float32)
    yield "strides", np.repeat(whole, 2, axis=0)[::2]
    yield "columns", np.asfortranarray(whole)
    yield "masked", np.ma.masked_array(whole, mask=np.zeros(whole.shape, dtype=bool))
    fixed = whole.copy()
    fixed.flags.writeable = False
    yield "read-only", fixed


def with_one(array: Any, value: float) -> Any:
    changed = np.array(array, dtype=float)
    changed.reshape(-1)[-1] = value
    return changed


def refused(make: Callable[[Any], object], values: Iterator[tuple[str, Any]]) -> None:
    """Assert that each value gives an InputError of one short line."""
    for name, value in values:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            with pytest.raises(InputError) as caught:
                pytest.fail(f"{name}: gave {str(make(value))[:80]}")
        assert 5 < len(str(caught.value)) < 400, name
        assert "\n" not in str(caught.value), name


def numbers(*values: float) -> Iterator[tuple[str, Any]]:
    yield from ((f"{value:g}", value) for value in values)


def wrong_numbers(*more: float) -> Iterator[tuple[str, Any]]:
    yield from NO_VALUES.items()
    yield from {"list": [1.0], "truth": True}.items()
    yield from numbers(np.nan, np.inf, *more)


def taken(**other: Any) -> Take:
    given = {"time": TIME, "positions": PLACES, "state": STATES, "skeleton": KINECT_V1}
    return Take(**given | other)


NAMES = ("time", "positions", "state")


@pytest.mark.parametrize("name", NAMES)
def test_arrays_of_a_take_that_are_none_are_refused(name: str) -> None:
    refused(lambda value: taken(**{name: value}), misfits(getattr(TAKE, name)))


@pytest.mark.parametrize("name", NAMES)
def test_the_same_take_in_other_arrays_is_the_same(name: str) -> None:
    wanted = kinefilter.clean(taken(time=TIME.astype(np.float32)), QUICK).clip
    for form, same in same_numbers(getattr(taken(), name)):
        rest = {} if name == "time" else {"time": TIME.astype(np.float32)}
        exact = form != "single" or name != "positions"
        found = kinefilter.clean(taken(**rest | {name: same}), QUICK).clip
        off = np.abs(found.positions - wanted.positions).max()
        assert off < (1e-9 if exact and name != "time" else 1e-3), form
    whole = np.round(PLACES).astype(int)
    np.testing.assert_array_equal(taken(positions=whole).positions, whole)


def test_states_are_0_1_or_2() -> None:
    values = ((f"{v}", with_one(STATES, v)) for v in (7, -1, 0.5, 256, np.nan, np.inf))
    refused(lambda state: taken(state=state), values)
    assert taken(state=STATES.astype(float)).state.dtype == np.uint8


def test_what_is_no_coordinate_is_a_missing_joint() -> None:
    for value in (np.nan, np.inf, -np.inf):
        take = taken(positions=with_one(PLACES, value))
        assert np.isnan(take.positions[-1, -1]).all()
        assert np.isfinite(take.positions[:-1]).all()
        assert np.isfinite(kinefilter.clean(take, QUICK).clip.positions).all()
    masked = np.ma.masked_array(PLACES, mask=PLACES < -100.0)
    masked[3, 5, 1] = np.ma.masked
    assert np.isnan(taken(positions=masked).positions[3, 5]).all()


def test_a_joint_that_is_not_tracked_is_missing_wherever_it_is() -> None:
    state, positions = STATES.copy(), PLACES
    state[6:10, 7] = 0
    missing = np.where(state[..., None] == 0, np.nan, positions)
    positions = np.where(np.isnan(missing), 5.0, positions)
    given, known = (Take(TIME, p, state, KINECT_V1) for p in (positions, missing))
    np.testing.assert_array_equal(given.positions, known.positions)
    one, other = Avatar(BODY), Avatar(BODY)
    for k in range(COUNT):
        np.testing.assert_array_equal(
            one.step(positions[k], TIME[k], state[k]).positions,
            other.step(missing[k], TIME[k], state[k]).positions,
        )


def test_takes_that_are_no_recording_are_refused() -> None:
    other = Skeleton("own", ("HipCenter", "Spine"), (-1, 0))
    half = {"positions": PLACES[:, :2], "state": STATES[:, :2]}
    for wrong in (
        {"time": with_one(TIME, 1e300)},
        {"time": with_one(TIME, np.nan)},
        {"positions": np.full_like(PLACES, 1e300)},
        {"positions": PLACES * 100.0},
        {"positions": np.full_like(PLACES, np.inf)},
        {"time": TIME * 1e-9},
        {"time": np.zeros(COUNT)},
        {"time": [0.0, 5e-324], "positions": PLACES[:2], "state": STATES[:2]},
        {"time": [0.0], "positions": PLACES[:1], "state": STATES[:1]},
        {"time": [], "positions": np.zeros((0, 20, 3)), "state": np.zeros((0, 20))},
        {"skeleton": other, **half},
        *({"skeleton": value} for value in ("kinect_v1", None, *NO_VALUES.values())),
        {"source": 3},
    ):
        refused(lambda w: kinefilter.clean(taken(**w), QUICK), iter([("", wrong)]))


def test_skeletons_are_trees_of_joints_with_a_name_each() -> None:
    joints, parents = KINECT_V1.joints, KINECT_V1.parents
    for wrong in (
        (joints[:-1] + joints[:1], parents),
        (joints, parents[:-1]),
        (joints, (-1,) * 20),
        (joints, (0, *parents[1:])),
        (joints, (-1, 2, 1, *parents[3:])),
        (joints, (*parents[:-1], 99)),
        (joints, (*parents[:-1], -2)),
        (joints, tuple(map(float, parents))),
        ((), ()),
        *((value, parents) for value in (None, *NO_VALUES.values())),
        *((joints, value) for value in (None, *NO_VALUES.values())),
    ):
        refused(lambda w: Skeleton("own", *w), iter([("", wrong)]))


AVATAR = Avatar(BODY)


@pytest.mark.parametrize("step", ["avatar", "cleaner"])
def test_frames_that_are_none_are_refused(step: str) -> None:
    cleaner = Cleaner(QUICK)
    refused(lambda place: cleaner.step(place, 0.0), iter([("no body", PLACES[0])]))
    cleaner.start(BODY)
    AVATAR.start()
    follows: Any = AVATAR if step == "avatar" else cleaner
    first = follows.step(PLACES[0], 0.0)
    refused(lambda places: follows.step(places, 1.0), misfits(PLACES[0]))
    later = wrong_numbers(0.0, -1.0, 1e300)
    refused(lambda time: follows.step(PLACES[1], time), later)
    refused(lambda time: follows.step(PLACES[1], time), iter([("none", None)]))
    states = [value for value in misfits(STATES[0]) if value[0] != "none"]
    states += [(str(v), with_one(STATES[0], v)) for v in (7, -1, 0.5, np.nan, 256)]
    refused(lambda state: follows.step(PLACES[1], 1.0, state), iter(states))
    for k, (_, same) in enumerate(same_numbers(PLACES[0]), start=1):
        pose = follows.step(same, np.float32(k / 32), STATES[0].tolist())
        np.testing.assert_allclose(pose.positions, first.positions, atol=0.05)
    for k, value in enumerate((np.nan, np.inf, 1e300, -1e30), start=1):
        pose = follows.step(with_one(PLACES[0], value), np.array(k + 1))
        np.testing.assert_allclose(pose.positions, first.positions, atol=0.15)


def test_pushes_that_are_none_are_refused() -> None:
    force = np.array([0.0, 0.0, 1.0])
    refused(lambda value: AVATAR.push("Head", value, 0.1), misfits(force))
    wrong = ((str(v), with_one(force, v)) for v in (np.nan, np.inf, -np.inf))
    refused(lambda value: AVATAR.push("Head", value, 0.1), wrong)
    refused(lambda value: AVATAR.push("Head", force, value), wrong_numbers(-1.0))
    refused(lambda value: AVATAR.push(value, force, 0.1), iter(NO_VALUES.items()))
    AVATAR.push("Head", [0, 0, 1], 1)


def test_what_a_cleaner_is_made_of_is_refused_by_name() -> None:
    given = [("number", 3), ("list", []), *NO_VALUES.items()]
    makers: list[Callable[[Any], object]] = [
        kinefilter.clean,
        lambda value: kinefilter.clean(TAKE, value),
        lambda value: Cleaner(QUICK, tracking=value),
        lambda value: Cleaner(QUICK, corrector=value),
        Cleaner(QUICK).start,
        Cleaner(QUICK).whole,
        Cleaner(QUICK).replaced,
        Cleaner(QUICK).without,
        Cleaner(QUICK).until,
        Avatar,
        lambda value: Avatar(BODY, tracking=value),
        lambda value: Avatar(BODY, corrector=value),
        lambda value: Avatar(BODY, floor=value),
        lambda value: Avatar(BODY, value),
        standard_body,
        skeleton_named,
        KINECT_V1.index,
        lambda value: random_body(KINECT_V1, value),
        lambda value: kinefilter.write_clip(value, "x.bvh"),
    ]
    for make in makers:
        refused(make, ((n, v) for n, v in given if (make, n) != (makers[12], "number")))


def test_settings_that_mean_nothing_are_refused() -> None:
    for kind in (CleanConfig, Export):
        for field in fields(kind):
            make: Any = lambda value, k=kind, name=field.name: k(**{name: value})  # noqa: E731
            free = ("model", "person", "database", "scene", "character", "rig")
            free += ("contacts", "edits", "target", "blender")
            allowed = {"text"} if field.name in free else {}
            allowed = {"400 digits", "5000 digits"} if field.name == "seed" else allowed
            refused(make, ((n, v) for n, v in NO_VALUES.items() if n not in allowed))
    for name in ("cutoff", "tilt", "floor"):
        refused(lambda v, n=name: CleanConfig(**{n: v}), numbers(np.nan, np.inf))
    refused(lambda v: Export(fps=v), numbers(np.nan, np.inf, -1, 0, 1e300))
    refused(lambda value: CleanConfig(seed=value), numbers(-1, 1.5))
    assert CleanConfig(model="m.npz").model == Path("m.npz")
    assert CleanConfig(cutoff=np.float32(4)).cutoff == 4.0
    assert CleanConfig(same_person=["a.csv"]).same_person == (Path("a.csv"),)


def test_bodies_that_nobody_has_are_refused() -> None:
    for name in ("height", "mass"):
        refused(lambda v, n=name: replace(BODY, **{n: v}), wrong_numbers(0, -1, 1e300))
        body: Any = lambda v, n=name: standard_body(KINECT_V1, **{n: v})  # noqa: E731
        refused(body, wrong_numbers(0, -1, 1e300))
    for name in ("lengths", "directions"):
        array = getattr(BODY, name)
        refused(lambda v, n=name: replace(BODY, **{n: v}), misfits(array))
        for value in (np.nan, np.inf, 1e300):
            wrong = iter([(str(value), with_one(array, value))])
            refused(lambda v, n=name: replace(BODY, **{n: v}), wrong)
    same = replace(BODY, height=np.float32(1.75), lengths=BODY.lengths.tolist())
    np.testing.assert_array_equal(same.rest_positions, BODY.rest_positions)
    for field in fields(Tracking):
        refused(lambda v, n=field.name: Tracking(**{n: v}), wrong_numbers(0, -1))


@pytest.fixture(scope="module")
def clip() -> Clip:
    return kinefilter.clean(TAKE, QUICK).clip


def test_arrays_of_a_clip_that_are_none_are_refused(clip: Clip) -> None:
    for field in fields(Clip):
        array, name = getattr(clip, field.name), field.name
        if isinstance(array, np.ndarray):
            refused(lambda v, n=name: replace(clip, **{n: v}), misfits(array))
            bad = [np.inf, -np.inf] if array.ndim > 1 else []
            wrong = iter([(str(v), with_one(array, v)) for v in bad])
            refused(lambda v, n=name: replace(clip, **{n: v}), wrong)
        else:
            wrong = iter([("number", 3j)])
            refused(lambda v, n=name: replace(clip, **{n: v}), wrong)
    refused(lambda v: replace(clip, root=v), iter([("nan", clip.root * np.nan)]))


def test_a_clip_of_lists_is_the_same_clip(clip: Clip, tmp_path: Path) -> None:
    arrays = {
        f.name: getattr(clip, f.name).tolist()
        for f in fields(Clip)
        if isinstance(getattr(clip, f.name), np.ndarray)
    }
    for name, some in (("a", clip), ("b", replace(clip, **arrays))):
        kinefilter.write_clip(some, tmp_path / f"{name}.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_props_that_are_none_are_refused() -> None:
    given: dict[str, Any] = {
        "kind": "mesh",
        "size": np.ones(3),
        "position": np.zeros(3),
        "rotation": np.array([1.0, 0.0, 0.0, 0.0]),
        "color": np.ones(3),
        "points": np.eye(3),
        "triangles": np.array([[0, 1, 2]]),
    }
    shape = Shape(**given)
    prop = Prop("a", (shape,), np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0, 0.0]]))
    for thing in (shape, prop):
        for field in fields(thing):
            array, name = getattr(thing, field.name), field.name
            values = list(misfits(array)) if isinstance(array, np.ndarray) else []
            free = {"points": "one row more", "triangles": "one row more"}
            values = [v for v in values if v[0] != free.get(name)]
            if isinstance(array, np.ndarray):
                values += [(str(v), with_one(array, v)) for v in (np.nan, np.inf)]
            else:
                values = [("number", 3), ("none", None)]
            if (name, thing) == ("positions", prop):
                values.append(("two", np.zeros((2, 3))))
            refused(lambda v, t=thing, n=name: replace(t, **{n: v}), iter(values))
    for corner in (7, -1, 0.5):
        wrong = iter([(str(corner), with_one(given["triangles"], corner))])
        refused(lambda v: replace(shape, triangles=v), wrong)


def test_names_of_files_that_are_none_are_refused(clip: Clip, tmp_path: Path) -> None:
    no_names = {"none": None, "number": 3, "folder": tmp_path, "empty": ""}
    no_names |= {"nul": "a\0b", "long": "x" * 5000, "deep": "a/" * 3000 + "a.csv"}
    wrong = [*NO_VALUES.items(), *no_names.items()]
    reads = (kinefilter.read_take, kinefilter.read_takes, kinefilter.read_clip)
    for reads_or_writes in (*reads, lambda path: kinefilter.write_clip(clip, path)):
        refused(reads_or_writes, iter(wrong))
    kinefilter.write_clip(clip, tmp_path / "a.csv")
    read = kinefilter.read_take
    refused(lambda v: read(tmp_path / "a.csv", format=v), iter(NO_VALUES.items()))
    bodies = [*NO_VALUES.items(), *numbers(0, 2, np.nan)]
    refused(lambda v: read(tmp_path / "a.csv", body=v), iter(bodies))
    refused(lambda v: kinefilter.write_clip(clip, "a.bvh", v), iter(NO_VALUES.items()))


def test_evaluate_refuses_what_are_no_pairs() -> None:
    def pair(**other: Any) -> PairedTake:
        given = {"take": TAKE, "truth": PLACES, "subject": "a", "clip": "m_e01"}
        return PairedTake(**given | other)

    refused(lambda value: pair(truth=value), misfits(PLACES))
    refused(lambda value: pair(truth=value), iter([("inf", with_one(PLACES, np.inf))]))
    for name in ("take", "subject", "clip"):
        values = ((n, v) for n, v in NO_VALUES.items() if n != "text" or name == "take")
        refused(lambda value, n=name: pair(**{n: value}), values)
    evaluate: Any = kinefilter.evaluate
    people = [pair(), pair(subject="b")]
    given = {"train": people, "test": [], "methods": ["none"], "physics": False}
    for name in ("train", "test", "methods", "protocol", "database"):
        values = iter(NO_VALUES.items())
        refused(lambda value, n=name: evaluate(**given | {n: value}), values)
    refused(lambda v: evaluate(**given | {"methods": [v]}), iter(NO_VALUES.items()))
