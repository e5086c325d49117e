"""The tables of the papers, ours beside theirs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from real_data import DATA, paired, recorded
from short_takes import beginning

from kinefilter.characters import KINECT_V1, Take
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.lab.simulation import simulate
from kinefilter.pipeline.lab.studies import (
    chiang,
    liu,
    method_comparison,
    reproduce,
    shum,
    study_takes,
    wang,
)
from kinefilter.pipeline.lab.studies.study import Options
from kinefilter.pipeline.lab.systems import CorrectorFactory
from kinefilter.pipeline.methods import PRESETS
from kinefilter.pipeline.pairs import PairedTake


@pytest.fixture
def short_takes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let simulated people be recorded for four seconds."""
    performed = study_takes.performed_by

    def short(*who: Any, **how: Any) -> list[PairedTake]:
        return [beginning(pair, 120) for pair in performed(*who, **how)]

    monkeypatch.setattr(study_takes, "performed_by", short)


def test_a_spread_is_that_of_closed_forms_take_by_take() -> None:
    pair = simulate("basic", "wave", sensor="v1")
    still = np.zeros((40, len(KINECT_V1), 3))
    swings, hidden = still.copy(), still + 5.0
    angle = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
    for side in ("Left", "Right"):
        swings[:, KINECT_V1.index(f"Wrist{side}"), 0] = 0.1 * np.sin(angle)
        hidden[:, KINECT_V1.index(f"Ankle{side}")] = np.nan
    frames, arms, legs = shum._deviations([pair, pair], [swings, hidden])
    assert frames == 80
    # Wrists alone move, in one of two takes, as one in three joints of the arms.
    assert arms == pytest.approx(10.0 / np.sqrt(2.0) / 3 / 2)
    assert legs == 0.0


@pytest.mark.usefixtures("few_for_kernels", "short_takes")
def test_everybody_who_learned_is_nearer_than_kinect_on_known_people() -> None:
    study = reproduce("liu-table-3", Options(), quick=True)
    rows = {row[0]: row[1:] for row in study.rows}
    known = rows["cross_arms, known"]
    assert max(known[1:]) < known[0]
    assert rows["cross_arms, paper"] == (12.5, 9.8, 7.2, 7.9, 7.4)
    milliseconds, times = rows["ms a frame"], rows["times as long as offline"]
    assert times[3] == 1.0
    assert times[2] == pytest.approx(milliseconds[2] / milliseconds[3])


@pytest.mark.usefixtures("few_for_kernels")
def test_errors_joint_by_joint_are_those_of_the_arms() -> None:
    study = reproduce("chiang-tables-2-3", Options(), quick=True)
    counts = {}
    for name, frames, raw, _, chiangs, *by_joint in study.rows:
        exercise, people, samples = name.split(", ")
        # One person teaches little about another, but nothing wrong.
        assert chiangs < (1.02 if people == "new" else 1.0) * raw
        counts[people, samples] = frames
        if people != "paper":
            assert np.mean(by_joint) == pytest.approx(chiangs, rel=0.05)
        else:
            assert exercise == "deep_breathing"
            assert raw == {"all": 10.22, "unreliable": 13.82}[samples]
    assert set(counts) == {
        (people, samples)
        for people in ("new", "known", "paper")
        for samples in ("all", "unreliable")
    }
    for people in ("new", "known", "paper"):
        assert 0 < counts[people, "unreliable"] < counts[people, "all"]


def test_frames_are_unreliable_as_chiang_has_it() -> None:
    pair = simulate("basic", "wave", sensor="v1")
    positions, wrist = pair.take.positions.copy(), KINECT_V1.index("WristLeft")
    positions[100, wrist] += 0.5  # and back, within a frame
    moved = replace(pair, take=replace(pair.take, positions=positions))
    found, before = chiang._unreliable(moved), chiang._unreliable(pair)
    assert found[100]
    assert (found != before)[[*range(99), *range(104, len(found))]].sum() == 0


def test_recovery_ends_for_takes_of_every_length() -> None:
    study = reproduce("wang-table-1", Options(), quick=True)
    assert [row[0] for row in study.rows] == [241, 463]
    assert all(row[3] == "True" for row in study.rows)


def test_singular_values_are_those_of_joints_that_are_known() -> None:
    rng = np.random.default_rng(0)
    made = rng.normal(size=(90, 3)) @ rng.normal(size=(3, 7))  # of rank 3
    positions = np.full((30, 9, 3), np.nan)
    positions[:, :7] = made.reshape(30, 3, 7).transpose(0, 2, 1)
    values = wang._spectrum(positions)
    expected = np.linalg.svd(made, compute_uv=False)
    np.testing.assert_allclose(values, expected[:3] / expected[0])


def test_a_rank_is_of_one_per_cent_and_more() -> None:
    study = reproduce("wang-figure-1", Options(), quick=True)
    *values, (_, *ranks, paper) = study.rows
    assert paper == 5
    for k, rank in enumerate(ranks, 1):
        spectrum = [row[k] for row in values]
        assert spectrum[0] == 1.0
        assert sum(value >= 0.01 for value in spectrum) == min(rank, len(spectrum))


@pytest.mark.usefixtures("few_for_kernels")
def test_budgeting_keeps_fewer_frames_than_there_are(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(liu, "_LIU_2", {"tai_chi": (411, 650, 120)})
    monkeypatch.setattr(liu, "_WIDE", "clusters=2:samples=60:blended=1")
    study = reproduce("liu-table-2", Options(), quick=True)
    name, frames, kept, *errors, ours, zhou = study.rows[0]
    assert (name, frames, ours, zhou) == ("tai_chi", 120, 411, 650)
    assert 0 < kept < frames
    assert min(errors) > 0.0
    assert study.rows[-1][:3] == ("all", frames, kept)


def test_nobody_is_tested_by_those_whom_they_taught() -> None:
    new, known = study_takes.simulated(Options(), ["wave"], learners=2, share=2)
    taught = {pair.clip for pair in new.trainer._train}
    assert len(taught) == 2
    assert not taught & {pair.clip for pair in (*new.tests, *known.tests)}
    who = {pair.subject for pair in new.trainer._train}
    assert not who & {pair.subject for pair in new.tests}
    assert {pair.subject for pair in known.tests} <= who
    takes = [*new.tests, *new.trainer._train]
    for group, labels in liu._folds(takes, ["a", "b", "c"], Options()):
        (pair,), (label,) = group.tests, labels
        assert pair.subject not in {one.subject for one in group.trainer._train}
        assert label == "abc"[takes.index(pair)]


def test_frames_are_split_so_that_none_is_on_both_sides() -> None:
    clips = study_takes.simulated(Options(), ["wave"], learners=2)[0].trainer._train
    clips = [
        replace(pair, clip=f"m01_e{k}") for k, pair in zip((7, 8), clips, strict=True)
    ]
    found = chiang._splits(clips, clips[0].subject)
    (one, _), (tested,) = found["frames at random"]
    assert not np.isfinite(one.truth + tested.truth).any()
    both = np.where(np.isnan(one.truth), tested.truth, one.truth)
    np.testing.assert_array_equal(both, clips[0].truth)
    assert 0.15 < np.isfinite(tested.truth).mean() < 0.25
    assert found["new repetitions"] == ([clips[0]], [clips[1]])
    assert found["a new person"] == ([clips[1]], [clips[0]])


def test_errors_are_means_over_the_takes_of_everybody_tested() -> None:
    groups = study_takes.simulated(Options(), ["wave"], learners=2, share=2)
    found = study_takes.errors(groups, None)
    (pair,) = groups[0].tests
    away = groups[0].accuracy.distances(pair.take.positions, pair.truth)
    assert found["new"] == pytest.approx(100.0 * np.nanmean(away))
    assert set(found) == {"new", "known"}


@recorded
@paired
def test_recorded_people_are_left_out_in_turn() -> None:
    groups = list(study_takes.recorded(Options(data=DATA), every=60, count=2))
    assert [g.people for g in groups] == ["recorded, new"] * 2 + ["recorded, known"]
    for group in groups[:2]:
        (tested,) = {pair.subject for pair in group.tests}
        assert tested not in {pair.subject for pair in group.trainer._train}
    early = {pair.clip[-2:] for pair in groups[2].trainer._train}
    assert max(early - {"nc"}) <= "07"
    assert not list(study_takes.recorded(Options(), every=60))


def test_a_joint_is_followed_in_takes_of_both_groups(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pair = simulate("basic", "wave", sensor="v1")
    wrist = KINECT_V1.index("WristLeft")

    def off(_: Take) -> Array:
        moved = pair.truth.copy()
        moved[:, wrist, 1] += 0.1
        return moved

    def groups(*_: object, **__: object) -> list[study_takes.Group]:
        trainer = CorrectorFactory([pair])
        return [study_takes.Group(who, [pair], trainer) for who in ("new", "known")]

    def runners(
        _: study_takes.Group, presets: list[str]
    ) -> list[Callable[[Take], Array]]:
        assert presets == ["a preset"]
        return [lambda take: take.positions, off]

    monkeypatch.setattr(study_takes, "simulated", groups)
    monkeypatch.setattr(study_takes.Group, "runners", runners)
    trace = study_takes.Trace("wave", "WristLeft", {"kinect": 9.0, "a preset": 3.0})
    study = study_takes.trace_study(
        Options(), "Made up", [trace], people=4, sensor="v1"
    )
    raw, moved = study.rows
    assert moved[0] == "WristLeft, wave, a preset"
    assert moved[1:3] == (pytest.approx(10.0), pytest.approx(10.0))
    assert moved[3] < 0.5 * raw[3]  # the sensor trembles, the truth does not
    assert (raw[-1], moved[-1]) == (9.0, 3.0)
    assert len(study.panels[0].series[0].y) == len(pair.take)


def test_cuts_of_presets_are_those_of_known_people(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def made(_: Options, **asked: object) -> dict[str, dict[str, float]]:
        assert {*PRESETS} - {*asked["presets"]} == {"zhou-2014"}
        where = ("seen", "seen, known people", "drifting", "missing")
        return {
            "raw": dict(zip(where, (7.0, 8.0, 16.0, 10.0), strict=True)),
            "chiang-2017": dict(zip(where, (5.0, 2.0, 9.0, 9.0), strict=True)),
        }

    monkeypatch.setattr(method_comparison, "hidden_limb_errors", made)
    raw, chiangs = reproduce("presets", Options()).rows
    assert raw == ("raw", 7.0, 8.0, 16.0, 10.0, 0.0, None)
    assert chiangs == ("chiang-2017", 5.0, 2.0, 9.0, 9.0, 75.0, 74.7)
    rows = [row for (_, which), row in chiang._CHIANG_2_3.items() if which == "all"]
    kinect, _, theirs = np.mean([row[1:4] for row in rows], axis=0)
    assert chiangs[-1] == pytest.approx(100.0 * (1.0 - theirs / kinect), abs=0.05)
