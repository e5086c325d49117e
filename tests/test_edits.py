"""What somebody says of a take: joints that are wrong, sides that are exchanged."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from kinefilter import CleanConfig, Cleaner, clean, clean_session
from kinefilter.characters import KINECT_V2, InputError, Origin, Take
from kinefilter.characters.arrays import runs
from kinefilter.pipeline.clean_result import CleanResult
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.draft import Unedited
from kinefilter.pipeline.edits import FEET, LIMBS, Edit, EditsFile, read_edits
from kinefilter.pipeline.failures import FailureKind, gross
from kinefilter.pipeline.formats import write_take_csv
from kinefilter.pipeline.lab.simulation import simulate, simulate_session
from kinefilter.pipeline.pairs import PairedTake

ARM = [
    KINECT_V2.index(joint) for joint in LIMBS["right-arm"] if joint in KINECT_V2.joints
]
BEGIN, END = 2.0, 3.0


@pytest.fixture(scope="module")
def pair() -> PairedTake:
    """Return the first five seconds of a take, two more than the edits reach."""
    whole, some = simulate("basic", "wave", seed=5), slice(150)
    return replace(whole, take=whole.take.at(some), truth=whole.truth[some])


@pytest.fixture(scope="module")
def unedited(pair: PairedTake) -> Unedited:
    return Cleaner().unedited(pair.take)


@pytest.fixture(scope="module")
def before(pair: PairedTake, unedited: Unedited) -> CleanResult:
    return Cleaner().clean(pair.take, edits=(), before=unedited)


@pytest.fixture(scope="module")
def posed(pair: PairedTake) -> CleanResult:
    """Return the take cleaned without physics and edits."""
    return cleaned(pair.take)


def edited(folder: Path, text: str) -> Path:
    path = folder / "take.edits.toml"
    path.write_text(text, encoding="utf-8")
    return path


def table(kind: str, begin: float = BEGIN, end: float = END, joints: str = "") -> str:
    named = f"joints = [{joints}]\n" if joints else ""
    return f"[[{kind}]]\n{named}begin = {begin}\nend = {end}\n"


def cleaned(take: Take, edits: Path | None = None) -> CleanResult:
    return clean(take, CleanConfig(physics=False, edits=edits))


def during(take: Take, around: float = 0.0) -> NDArray[np.bool_]:
    since = take.time - take.time[0]
    return np.asarray((since >= BEGIN - around) & (since <= END + around))


def apart(one: CleanResult, other: CleanResult) -> NDArray[np.float64]:
    """Return how far apart joints are [m], shape (T, J)."""
    away = one.clip.positions - other.clip.positions
    return np.asarray(np.linalg.norm(away, axis=-1))


def test_a_limb_that_is_distrusted_goes_on_as_if_it_were_hidden(
    pair: PairedTake, tmp_path: Path
) -> None:
    take, inside = pair.take, during(pair.take)
    wrong = take.positions.copy()
    wrong[np.ix_(inside, ARM)] += [0.2, -0.1, 0.15]
    wrong = replace(take, positions=wrong)
    told = table("distrust", joints='"right-arm"')
    found = cleaned(wrong, edited(tmp_path, told))
    gone = take.positions.copy()
    gone[np.ix_(inside, ARM)] = np.nan
    hidden = cleaned(replace(take, positions=gone))
    assert apart(found, hidden)[inside].max() < 0.02  # but for how long segments are
    assert (found.clip.origin[np.ix_(inside, ARM)] == Origin.FILLED).all()
    assert "edited: right-arm distrusted from 2 to 3 s" in found.notes
    moment = Edit("distrust", 7.1, 7.1, ("Head",))
    assert moment.summary == "Head distrusted at 7.1 s"

    def error(result: CleanResult) -> float:
        away = result.clip.positions - result.clip.root[:, None]
        truth = pair.truth - pair.truth[:, :1]
        return float(np.linalg.norm((away - truth)[inside][:, ARM], axis=-1).mean())

    assert error(found) < 0.7 * error(cleaned(wrong))


@pytest.mark.parametrize(
    "told",
    [
        '[[distrust]]\njoints = ["right-arm"]\nbegin = 2.0\nend = 3.0',
        '[[distrust]]\njoints = ["left-leg"]\nbegin = 2.0\nend = 3.0',
        "[[exchange]]\nbegin = 2.0\nend = 3.0",
        '[[pin]]\njoint = "WristRight"\ntime = 2.5\nposition = [0.6, 1.9, 2.0]',
    ],
)
def test_nothing_moves_farther_off_than_half_a_second(
    pair: PairedTake,
    unedited: Unedited,
    before: CleanResult,
    tmp_path: Path,
    told: str,
) -> None:
    edits = read_edits(edited(tmp_path, told))
    found = Cleaner().clean(pair.take, edits=edits, before=unedited)
    moved, here = apart(found, before), during(pair.take, around=0.5)
    assert moved[~here].max() < 1e-9
    assert moved[during(pair.take)].max() > 0.005
    # Nor does it jump at the ends of that.
    edges = here & ~during(pair.take, around=0.45)
    assert moved[edges].max() < 0.002
    np.testing.assert_array_equal(
        found.clip.contacts[~here], before.clip.contacts[~here]
    )
    np.testing.assert_array_equal(found.clip.origin[~here], before.clip.origin[~here])
    np.testing.assert_array_equal(found.clip.body.lengths, before.clip.body.lengths)
    bones = (
        found.clip.positions[:, 1:]
        - found.clip.positions[:, pair.take.skeleton.parents[1:]]
    )
    assert np.ptp(np.linalg.norm(bones, axis=-1), axis=0).max() < 1e-9


def test_a_limb_alone_moves(
    pair: PairedTake, posed: CleanResult, tmp_path: Path
) -> None:
    told = table("distrust", joints='"right-arm"')
    found = cleaned(pair.take, edited(tmp_path, told))
    moved = apart(found, posed)
    assert moved[:, ARM].max() > 4 * np.delete(moved, ARM, axis=1).max()


def test_a_take_that_was_cleaned_before_is_edited_as_one_cleaned_at_once(
    pair: PairedTake, unedited: Unedited, before: CleanResult, tmp_path: Path
) -> None:
    path = edited(tmp_path, table("distrust", joints='"right-arm"'))
    at_once = clean(pair.take, CleanConfig(edits=path))
    again = Cleaner().clean(pair.take, edits=read_edits(path), before=unedited)
    np.testing.assert_array_equal(again.clip.positions, at_once.clip.positions)
    assert again.notes == at_once.notes
    # And without the edits it is as it was.
    undone, whole = before.clip.positions, clean(pair.take).clip.positions
    np.testing.assert_array_equal(undone, whole)


@pytest.mark.parametrize(
    "joint", ["WristRight", "HandLeft", "ElbowLeft", "KneeRight", "AnkleLeft", "Head"]
)
def test_a_pinned_joint_is_where_it_is_pinned_and_its_neighbors_follow(
    pair: PairedTake, unedited: Unedited, before: CleanResult, joint: str
) -> None:
    take = pair.take
    since, j = take.time - take.time[0], take.skeleton.index(joint)
    frame = int(np.abs(since - 2.5).argmin())  # a leg that stands there has to bend
    off = [0.04, 0.0, 0.0] if joint.startswith("Knee") else [0.03, 0.05, -0.04]
    places = [before.clip.positions[k, j] + off for k in (frame, frame + 8)]
    pins = [
        Edit("pin", since[k], since[k], (joint,), position=tuple(place.tolist()))
        for k, place in zip((frame, frame + 8), places, strict=True)
    ]
    found = Cleaner().clean(take, edits=pins, before=unedited)
    for k, place in zip((frame, frame + 8), places, strict=True):
        assert np.linalg.norm(found.clip.positions[k, j] - place) < 0.015
    assert found.notes[: len(pins)] == tuple(map(str, pins))
    moved = apart(found, before)
    assert moved[np.abs(since - since[frame]) > 0.5 + 8 / 30 + 0.02].max() < 1e-9
    jerk = np.abs(np.diff(moved[:, j], 3)).max()
    assert jerk < 0.02  # m: no frame stands out from its neighbors
    assert found.clip.origin[frame, j] != Origin.MEASURED
    if joint == "AnkleLeft":  # raised by 5 cm, with the foot
        assert before.clip.contacts[frame, :2].any()
        assert not found.clip.contacts[frame, :2].any()


def test_how_far_a_joint_is_from_a_pin_out_of_reach_is_told(
    pair: PairedTake, unedited: Unedited, before: CleanResult
) -> None:
    frame = int(np.abs(pair.take.time - pair.take.time[0] - 2.5).argmin())
    x, y, z = before.clip.positions[frame, ARM[0]].tolist()
    pin = Edit("pin", 2.5, 2.5, ("ElbowRight",), position=(x, y + 1.9, z))
    found = Cleaner().clean(pair.take, edits=[pin], before=unedited)
    assert 1.0 < y + 1.9 - found.clip.positions[frame, ARM[0], 1] < 1.9
    assert found.notes[0].startswith("edited: ElbowRight pinned at 2.5 s: 1.")
    assert found.notes[0].endswith(" m short; pin it where the body reaches")
    far = replace(pin, position=(x, y + 50.0, z), source="a.toml: pin 1")
    bare = replace(far, position=())
    wrong = {" .* pinned there already": [pin, far], " a pin needs": [bare]}
    for match, pins in (wrong | {r" ElbowRight is 50\.\d m": [far]}).items():
        with pytest.raises(InputError, match=f"a.toml: pin 1:{match}"):
            Cleaner().clean(pair.take, edits=pins, before=unedited)


@pytest.mark.parametrize("stands", [True, False])
def test_a_foot_stands_where_it_is_said_and_nothing_slides_for_that(
    tmp_path: Path, stands: bool
) -> None:
    take = simulate("basic", "walk", seed=3, stay_in_view=True).take
    positions, index = take.positions.copy(), take.skeleton.index
    foot = [index("AnkleLeft"), index("FootLeft")]
    # A foot is put aside while it stands, too little for a step.
    stances = runs(cleaned(take).clip.contacts[:, 0])
    aside = max((k.stop - k.start, (k.start + k.stop) // 2) for k in stances)[1]
    positions[aside:, foot, 0] += 0.08
    take = replace(take, positions=positions)
    plain = cleaned(take)
    others = runs(plain.clip.contacts[:, :2].any(axis=1) != stands, 6)
    first = others[len(others) // 2].start if stands else aside - 3
    begin, end = take.time[[first, first + 5]] - take.time[0]
    told = f'[[contact]]\npart = "left foot"\nstands = {str(stands).lower()}\n'
    told += f"begin = {begin}\nend = {end}\n"
    found = cleaned(take, edited(tmp_path, told))
    assert (found.clip.contacts[first : first + 6, :2] == stands).all()
    assert (found.clip.contacts[:, 2:] == plain.clip.contacts[:, 2:]).all()
    for stance in runs(found.clip.contacts[:, 1], 6):
        assert np.ptp(found.clip.positions[stance, foot[1]], axis=0).max() < 0.01
    # Nor does it move other steps if an arm is distrusted at the same time.
    told += table("distrust", begin, end, '"right-arm"')
    both = cleaned(take, edited(tmp_path, told))
    moved = [apart(one, plain).max(axis=1) > 1e-4 for one in (found, both)]
    assert (moved[1] & ~moved[0]).sum() < 10


def test_edits_of_several_sensors_move_nothing_else_either() -> None:
    views = simulate_session("basic", "walk", sensors=("v2", "v2"), seed=3)
    takes = [view.pair.take.at(slice(135)) for view in views]
    config = CleanConfig(physics=False)
    before, _ = clean_session(takes, config)
    told = [Edit("distrust", BEGIN, END, ("right-arm",))]
    found, merged = clean_session(takes, config, edits=told)
    inside = during(merged.take)
    assert (found.clip.origin[np.ix_(inside, ARM)] == Origin.FILLED).all()
    moved = apart(found, before)
    assert moved[during(merged.take, around=0.2)][:, ARM].max() > 0.01
    assert moved[~during(merged.take, around=0.5)].max() < 1e-9


@settings(deadline=None, max_examples=30)
@given(
    st.lists(
        st.one_of(
            st.builds(
                Edit,
                st.just("distrust"),
                st.floats(0, 1),
                st.floats(2, 3),
                st.lists(st.sampled_from([*LIMBS, "Head", 'a"b\\']), min_size=1).map(
                    tuple
                ),
            ),
            st.builds(Edit, st.just("exchange"), st.floats(0, 1), st.floats(2, 3)),
            st.builds(
                Edit,
                st.just("contact"),
                st.floats(0, 1),
                st.floats(2, 3),
                part=st.sampled_from(list(FEET)),
                stands=st.booleans(),
            ),
            st.floats(0, 9).flatmap(
                lambda t: st.builds(
                    Edit,
                    st.just("pin"),
                    st.just(t),
                    st.just(t),
                    st.just(("Head",)),
                    position=st.tuples(*[st.floats(-9, 9)] * 3),
                )
            ),
        ),
        min_size=1,
        max_size=6,
    )
)
def test_edits_are_read_as_they_were_written(edits: list[Edit]) -> None:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "take.edits.toml"
        EditsFile(path).write(edits)
        again = read_edits(path)
        assert sorted(map(repr, again)) == sorted(map(repr, edits))
        EditsFile(path).write(again)
        assert read_edits(path) == again


def test_sides_are_put_back_before_joints_are_named(
    pair: PairedTake, tmp_path: Path
) -> None:
    told = table("distrust", joints='"right-arm"')
    wanted = cleaned(pair.take, edited(tmp_path, told)).clip
    wrong = pair.take.swapped(during(pair.take))
    found = cleaned(wrong, edited(tmp_path, told)).clip
    moved = np.linalg.norm(found.positions - wanted.positions, axis=-1)
    assert moved[during(pair.take)].max() < 0.02


@pytest.mark.parametrize("finds", [False, True], ids=["missed", "wrongly-found"])
def test_exchanged_sides_are_the_other_way_than_without_the_edit(
    pair: PairedTake, posed: CleanResult, monkeypatch: pytest.MonkeyPatch, finds: bool
) -> None:
    """Whether cleaning missed a swap, or swapped sides that had been right."""
    inside = during(pair.take)
    both = np.repeat(inside[:, None] & finds, 2, axis=1)
    monkeypatch.setattr(gross, "swapped_frames", lambda _: both)
    take = pair.take if finds else pair.take.swapped(inside)
    wrong = cleaned(take)
    assert apart(wrong, posed)[inside].max() > 0.3
    edits = [Edit("exchange", BEGIN, END)]
    found = Cleaner(CleanConfig(physics=False)).clean(take, edits=edits)
    assert apart(found, posed)[inside].max() < 0.05
    kinds = [{failure.kind for failure in made.failures} for made in (wrong, found)]
    swaps = [FailureKind.MIRRORED in which for which in kinds]
    assert swaps == [finds, not finds]


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("distrust = 3", "unknown 'distrust'"),
        (table("blame"), "unknown 'blame'"),
        (table("distrust"), "expected joints, begin, end"),
        (table("contact"), "expected part, stands, begin, end"),
        (table("contact", joints='"Head"'), "expected part, stands"),
        ('[[contact]]\npart = "nose"\nstands = true\nbegin = 0\nend = 1', "'nose'"),
        ("[[contact]]\npart = []\nstands = true\nbegin = 0\nend = 1", "part = []"),
        ('[[contact]]\npart = "HeelLeft"\nstands = 1\nbegin = 0\nend = 1', "= 1: exp"),
        ("[[pin]]\njoint = 3\ntime = 1\nposition = [0, 0, 0]", "joint = 3"),
        ('[[pin]]\njoint = "Head"\ntime = 1\nposition = [0, nan, 0]', "three numbers"),
        ('[[pin]]\njoint = "Head"\ntime = -1\nposition = [0, 1, 0]', "times -1 to -1"),
        (table("exchange", joints='"Head"'), "expected begin, end"),
        (table("distrust", joints="3"), "joints = 3"),
        ("[[distrust]]\njoints = []\nbegin = 0\nend = 1", "name joints, or a limb"),
        ("[[exchange]]\nbegin = 0\nend = nan", "seconds after the first frame"),
        ("[[exchange]]\nbegin = true\nend = 2", "begin = True"),
        (table("exchange", 3.0, 2.0), "the end not before the beginning"),
        (table("exchange", -1.0, 2.0), "the end not before the beginning"),
        ("[[distrust]", "not TOML"),
    ],
)
def test_a_file_that_says_nothing_of_the_kind_is_refused(
    tmp_path: Path, text: str, told: str
) -> None:
    with pytest.raises(InputError, match="edits") as caught:
        read_edits(edited(tmp_path, text))
    assert told in str(caught.value)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (table("distrust", joints='"RightArm"'), "unknown joint 'RightArm'; known: "),
        (
            table("exchange", 99.0, 100.0),
            "edits.toml: exchange 1: no frame is from 99 to 100 s; the take is",
        ),
        (
            '[[pin]]\njoint = "arm"\ntime = 1\nposition = [0, 1, 0]',
            "unknown joint 'arm'",
        ),
        (
            '[[pin]]\njoint = "Head"\ntime = 99\nposition = [0, 1, 0]',
            "no frame is at 99 s",
        ),
        (
            table("distrust", 0.0, 1e6, ", ".join(f'"{j}"' for j in KINECT_V2.joints)),
            "distrust every joint",
        ),
    ],
)
def test_edits_that_a_take_does_not_fit_are_refused_and_nothing_is_written(
    pair: PairedTake,
    tmp_path: Path,
    text: str,
    told: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    take, edits = tmp_path / "take.csv", edited(tmp_path, text)
    write_take_csv(pair.take, take)
    words = ["clean", str(take), "-o", str(tmp_path / "clip.npz")]
    assert main([*words, "--edits", str(edits)]) == 2
    assert told in capsys.readouterr().err.replace("\n", " ")
    assert sorted(p.name for p in tmp_path.iterdir()) == [take.name, edits.name]
