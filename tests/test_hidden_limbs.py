"""Limbs hidden in takes, and what is told about them."""

from __future__ import annotations

from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from real_data import PAIRS, paired

from kinefilter.characters import KINECT_V1, InputError, State, Take
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.lab import hidden_limb_evaluation as hidden_limbs
from kinefilter.pipeline.lab import limb_lessons
from kinefilter.pipeline.lab.hidden_limb_evaluation import (
    HiddenLimbs,
    measure_hidden,
    summarize,
)
from kinefilter.pipeline.lab.limb_guesses import hide, simple_guesses
from kinefilter.pipeline.lab.limb_lessons import Lesson, Lessons, joined
from kinefilter.pipeline.lab.recorded_acts import NamedTake
from kinefilter.pipeline.lab.simulation import simulate
from kinefilter.pipeline.pairs import PairedTake, read_pairs
from kinefilter.pipeline.workers import workers
from kinefilter.retarget import HeadingFrame

ARM = [KINECT_V1.index(joint) for joint in ("ElbowLeft", "WristLeft", "HandLeft")]
ELBOW, WRIST, _ = ARM
SPAN = slice(20, 60)


@pytest.fixture(scope="module")
def pair() -> PairedTake:
    """Return a simulated gesture whose name tells movement and repetition."""
    made = simulate("basic", "wave", sensor="v1", seed=2)
    few = slice(0, 80)
    take = made.take
    take = Take(take.time[few], take.positions[few], take.state[few], take.skeleton)
    return PairedTake(take, made.truth[few], "s01", "m01_s01_e01")


@pytest.fixture
def pairs_file(pair: PairedTake, tmp_path: Path) -> Path:
    """Write pairs of one clip."""
    file = tmp_path / "pairs.npz"
    np.savez(
        file,
        joints=np.array(KINECT_V1.joints),
        fps=30.0,
        subject="s01",
        kinect=pair.take.positions,
        mocap=pair.truth,
        clip=np.array(["a clip"]),
        start=[0],
        stop=[80],
    )
    return file


def _turning(pair: PairedTake) -> tuple[np.ndarray, HeadingFrame]:
    """Return a person whose limbs stay, walking in a curve, and where they are."""
    still = pair.truth[0] - pair.truth[0, KINECT_V1.root]
    time = np.arange(80) / 30.0
    path = np.stack([np.sin(time), 0.9 + 0.0 * time, time], axis=1)
    frame = HeadingFrame(path, 0.5 * time)
    return frame.restore(np.tile(still, (80, 1, 1))), frame


@pytest.mark.parametrize("guess", ["none", "drift", "hang", "jitter"])
def test_exactly_the_limb_in_the_gap_is_hidden(pair: PairedTake, guess: str) -> None:
    hidden = hide(pair.take, ARM, SPAN, guess, seed=1)  # type: ignore[arg-type]
    changed = np.zeros(pair.take.state.shape, dtype=bool)
    changed[SPAN, ARM] = True
    same = (hidden.positions == pair.take.positions).all(axis=2)
    np.testing.assert_array_equal(
        ~same & ~np.isnan(pair.take.positions[..., 0]), changed
    )
    expected = State.NOT_TRACKED if guess == "none" else State.INFERRED
    assert (hidden.state[changed] == expected).all()
    np.testing.assert_array_equal(hidden.state[~changed], pair.take.state[~changed])
    assert np.isnan(hidden.positions[changed]).all() == (guess == "none")
    if guess == "hang":
        below = hidden.positions[SPAN, WRIST] - hidden.positions[SPAN, ELBOW]
        np.testing.assert_allclose(below[:, [0, 2]], 0.0, atol=1e-12)
    if guess == "drift":  # 20 cm/s from where it was, the hand as far as the elbow
        parent = KINECT_V1.parents[ELBOW]
        away = hidden.positions[SPAN, ARM[:2]] - hidden.positions[SPAN, parent, None]
        first = pair.take.positions[19, ARM[:2]] - pair.take.positions[19, parent]
        far = np.linalg.norm(away - first, axis=2)
        np.testing.assert_allclose(far[0], 0.2 / 30.0, rtol=0.1)
        assert (far <= 0.21 * (np.arange(40)[:, None] + 1.0) / 30.0).all()


def test_holding_a_limb_that_does_not_move_is_right(pair: PairedTake) -> None:
    motion, _ = _turning(pair)
    for guessed in simple_guesses(motion, KINECT_V1, ARM, SPAN).values():
        np.testing.assert_allclose(guessed, motion, atol=1e-9)


def test_joints_that_nobody_saw_are_not_guessed(pair: PairedTake) -> None:
    """UI-PRMD has no hands; its arms are hidden all the same."""
    motion, _ = _turning(pair)
    hand = KINECT_V1.index("HandRight")
    motion[:, hand] = np.nan
    for guessed in simple_guesses(motion, KINECT_V1, [*ARM, hand], SPAN).values():
        np.testing.assert_allclose(guessed, motion, atol=1e-9)


def test_an_arm_that_swings_evenly_is_found_by_both_ends(pair: PairedTake) -> None:
    motion, frame = _turning(pair)
    facing = frame.remove(motion)
    angle = 2.0 * np.arange(80) / 80
    forearm = np.stack([0.0 * angle, np.cos(angle), np.sin(angle)], axis=1) * 0.25
    facing[:, WRIST] = facing[:, ELBOW] + forearm
    motion = frame.restore(facing)
    guessed = simple_guesses(motion, KINECT_V1, [WRIST], SPAN)
    far = {
        name: np.linalg.norm((limb - motion)[:, WRIST], axis=1).max()
        for name, limb in guessed.items()
    }
    assert far["slerp"] < 1e-9
    assert far["spline"] < 0.02
    assert 0.2 < far["hold"] < 0.25


@pytest.mark.parametrize("live", [False, True])
def test_where_nothing_is_hidden_nothing_is_wrong(
    pair: PairedTake, live: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    options = HiddenLimbs(("arms",), live=live, physics=not live)
    (wrong,), skipped = measure_hidden([pair], ["none"], options)
    assert skipped == 0
    assert wrong["unhidden"]["none"] > 0.5
    assert wrong["unhidden"]["seen"] == 0.0 < wrong["mocap"]["seen"]
    monkeypatch.setattr(hidden_limbs, "hide", lambda take, *_: take)
    (right,), _ = measure_hidden([pair], ["none"], options)
    assert right["unhidden"]["none"] == 0.0
    assert right["mocap"]["none"] == right["mocap"]["seen"]
    assert right["unhidden"]["hold"] == wrong["unhidden"]["hold"]


@paired
def test_cleaned_limbs_that_were_hidden_are_much_nearer_than_held_ones() -> None:
    """Of one of the people who taught the prior; frames beside gaps were once lost."""
    pairs = read_pairs(PAIRS / "s08.npz")[::24]
    options = HiddenLimbs(("legs", "arms"), physics=False)
    records, _ = measure_hidden(pairs, ["none"], options)
    for limb in options.limbs:
        errors = [record["unhidden"] for record in records if record["limb"] == limb]
        found, held = (np.mean([e[row] for e in errors]) for row in ("none", "hold"))
        assert found < 0.45 * held


def test_what_learns_is_taught_by_other_people(
    pair: PairedTake, monkeypatch: pytest.MonkeyPatch
) -> None:
    taught: list[list[str]] = []

    class Watched(hidden_limbs.CorrectorFactory):
        def __init__(self, train: list[PairedTake], *of: Any, **rest: Any) -> None:
            taught.append([one.subject for one in train])
            super().__init__(train, *of, **rest)

    monkeypatch.setattr(hidden_limbs, "CorrectorFactory", Watched)
    pairs = [pair, *(replace(pair, subject=name) for name in ("s02", "s03"))]
    options = HiddenLimbs(("left-arm",), guess="drift", physics=False)
    presets = ["shen-2012:neighbors=3", "wang-low-rank"]
    records, _ = measure_hidden(pairs, ["none"], options, presets=presets)
    assert taught == [["s02", "s03"], ["s01", "s03"], ["s01", "s02"]]
    found = {(r["person"], r["method"]) for r in records}
    assert found == {
        (person, name)
        for person in ("s01", "s02", "s03")
        for name in ("none", *presets)
    }
    with pytest.raises(InputError, match="learns from other people"):
        measure_hidden([pair], [], options, presets=presets[:1])


def test_limbs_of_recordings_and_of_other_people_teach_what_limbs_do(
    pair: PairedTake, monkeypatch: pytest.MonkeyPatch
) -> None:
    taught: list[list[str]] = []

    def noted(lessons: Iterable[Lesson]) -> Lessons:
        some = [*lessons]
        taught.append([lesson.person for lesson in some])
        return joined(some[:1])

    monkeypatch.setattr(hidden_limbs, "joined", noted)
    # Processes take long to start: one for training, none for reading.
    monkeypatch.setattr(hidden_limbs, "workers", partial(workers, 1))
    monkeypatch.setattr(limb_lessons, "workers", partial(ThreadPoolExecutor, 1))
    recording = NamedTake("elsewhere", "walk", "take", pair.take)
    monkeypatch.setattr(hidden_limbs, "recordings_in", lambda _: [recording])
    pairs = [pair, replace(pair, subject="s02")]
    options = HiddenLimbs(("left-arm",), ("1",), physics=False)
    found, _ = measure_hidden(pairs, ["none"], options, recordings=[Path("take.csv")])
    assert taught == [["elsewhere", "s02"], ["elsewhere", "s01"]]
    # A movement that is not repeated hides nothing.
    twice = [
        replace(pair, subject=name, clip=f"{clip}_{name}_e{k}")
        for name in ("s01", "s02")
        for clip, k in (("m01", 1), ("m01", 2), ("m02", 1))
    ]
    among = replace(options, context="repetitions")
    again, _ = measure_hidden(twice, [], among, presets=["shen-2012:neighbors=3"])
    assert [record["clip"] for record in again] == ["m01_s01_e2", "m01_s02_e2"]
    shipped, _ = measure_hidden(pairs[:1], ["none"], options)
    errors = [record["unhidden"]["none"] for record in (found[0], *shipped)]
    assert errors[0] != errors[1]


def test_every_third_repetition_is_hidden_and_the_others_are_seen(
    pair: PairedTake, monkeypatch: pytest.MonkeyPatch
) -> None:
    cleaned: list[Take] = []

    def raw(take: Take, *_: object) -> tuple[np.ndarray, None, tuple[float, float]]:
        cleaned.append(take)
        return take.positions, None, (0.0, 0.0)

    monkeypatch.setattr(hidden_limbs, "_cleaned", raw)
    pairs = [replace(pair, clip=f"m01_s01_e{k:02}") for k in (2, 1, 3, 4, 5)]
    options = HiddenLimbs(("left-arm",), ("0.3", "1", "5"), context="repetitions")
    records, skipped = measure_hidden(pairs, ["none"], options)
    assert [(r["clip"], r["gap"]) for r in records] == [
        (f"m01_s01_e{k:02}", gap) for gap in ("0.3", "1") for k in (2, 5)
    ]
    assert skipped == 2
    _, short, drawn, *_ = cleaned
    assert len(short) == 400
    hidden = short.state[:, ELBOW] != np.tile(pair.take.state[:, ELBOW], 5)
    middles = {80 * clip + k for clip in (1, 4) for k in range(35, 44)}
    assert {*np.flatnonzero(hidden).tolist()} == middles
    # The spline is drawn into the take, before it is cleaned.
    there = np.concatenate([pair.take.positions] * 5)
    away = np.abs(drawn.positions[:, ELBOW] - there[:, ELBOW]).max(axis=1)
    elsewhere = away > 1e-6
    assert {*np.flatnonzero(elsewhere).tolist()} == middles
    np.testing.assert_array_equal(drawn.state, cleaned[0].state)
    np.testing.assert_allclose(np.diff(short.time)[79::80], 2.0)
    rows = {(r["part"], r["row"]): r for r in summarize(records, "gap")}
    assert rows["0.3", "hold"]["clips"] == 2
    assert rows["0.3", "hold"]["percent_of_hold"] == 100.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--hide", "tail"], "unknown limb 'tail'"),
        (["--hide", "arms", "--gap", "soon"], "gap 'soon'"),
        (["--hide", "arms", "--gap", "120%"], "gap '120%'"),
        (["--hide", "arms", "--gap", "99"], "fits into no clip"),
        (["--hide", "arms", "--methods", "best"], "unknown method 'best'"),
        (["--hide", "arms", "--every", "0"], "--every 0"),
        (["--hide", "arms", "--context", "repetitions"], "contains no repetition"),
        (["--hide", "arms", "--protocol", "movements"], "--protocol does not apply"),
        (["--by", "gap"], "--by does not apply to evaluate without --hide"),
        (["--hide", "arms", "--views", "."], "--hide does not apply to --views"),
        ([], "PAIRS are for --hide"),
    ],
)
def test_what_cannot_be_hidden_is_refused(
    pairs_file: Path,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    message: str,
) -> None:
    assert main(["evaluate", str(pairs_file), *arguments]) == 2
    assert message in capsys.readouterr().err


def test_limbs_and_gaps_may_be_listed_with_commas_and_names_are_whole(
    pairs_file: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    words = ["--hide", "left-arm,right-hand", "--gap", "0.5,30%", "--by", "gap"]
    assert main(["evaluate", str(pairs_file), *words, "--methods", "none"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "hidden for 0.5 s, 30%" in lines[0]
    table = [line for line in lines if "│" in line]
    rows = {(*map(str.strip, line.split("│")[1:4]),) for line in table}
    assert {("left-arm", "0.5", "spline"), ("right-hand", "30%", "none")} <= rows
    assert max(map(len, table)) <= 80


def test_hiding_needs_pairs(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["evaluate", "--hide", "arms", "pairs.npz"]) == 2
    assert "--hide needs pairs files; put them first" in capsys.readouterr().err
