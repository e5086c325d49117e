"""The studies of README's figures: what they count, on motions made for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from real_data import DATA, paired, recorded

from kinefilter.characters import KINECT_V1, Take
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.lab.hidden_limb_evaluation import middle
from kinefilter.pipeline.lab.simulation import simulate, truth_of
from kinefilter.pipeline.lab.studies import study_takes as takes
from kinefilter.pipeline.lab.studies.cleaned_takes import (
    _figures_held,
    _mean_and_worst,
    cleaned_in,
    count_dribbles,
)
from kinefilter.pipeline.lab.studies.detection import _near
from kinefilter.pipeline.lab.studies.method_comparison import _means, _raw, _study
from kinefilter.pipeline.lab.studies.study import Options

WRIST = KINECT_V1.index("WristLeft")


@pytest.mark.parametrize(("frames", "off", "near"), [(9, 0.21, 0), (8, 0.9, 1)])
def test_a_clip_is_near_unless_a_joint_is_far_off_for_long(
    frames: int, off: float, near: int
) -> None:
    (pair,) = takes.study_takes("a", Options(), count=1)
    away = pair.truth.copy()
    away[20 : 20 + frames, WRIST, 1] += off
    moved = replace(pair.take, positions=away + np.array([3.0, 0.0, 1.0]))
    assert _near(replace(pair, take=moved)) is bool(near)


def test_a_box_rises_only_if_it_is_held() -> None:
    pair = simulate("box", "lift_box", seed=3)
    take = replace(pair.take, positions=pair.truth)
    results = (cleaned_in("box", take, rival) for rival in (None, "not held"))
    held, left = (_figures_held(result, (0.0, 0.25))["peak"] for result in results)
    assert held > 0.6
    assert left < 0.3


def test_dribbles_are_bounces_from_hand_to_hand() -> None:
    take = truth_of(simulate("basketball", "dribble", seed=8))
    held, left = (cleaned_in("basketball", take, r) for r in (None, "not held"))
    assert count_dribbles(held) >= 5
    assert count_dribbles(left) == 0


def test_errors_are_means_over_people_and_the_worst_person_counts_too() -> None:
    def errors(value: float) -> dict[str, float]:
        return {"E": value, "E_std": 1.0, "E_var": 2.0}

    raw = {"one": errors(4.0), "two": errors(8.0)}
    found = {"one": errors(4.4), "two": errors(4.0)}
    rows = _study("Made up", {"raw": raw, "method": found}).rows
    columns = _study("Made up", {"raw": raw}).columns
    row = dict(zip(columns, rows[1], strict=True))
    assert row["E_cm"] == pytest.approx(4.2)
    assert row["E_change_percent"] == pytest.approx(-30.0)
    assert row["E_worst_person_percent"] == pytest.approx(10.0)
    assert row["E_std_change_percent"] == 0.0


def test_the_worst_take_is_at_the_end_that_is_worse() -> None:
    slide, kept = "feet slide, mm a frame", "amplitude, after over before physics"
    takes = [0.1, 0.3, np.nan]
    assert _mean_and_worst(slide, takes) == (pytest.approx(0.2), 0.3)
    assert _mean_and_worst(kept, takes) == (pytest.approx(0.2), 0.1)
    assert _mean_and_worst(slide, []) == (None, None)


def test_who_stands_in_for_recorded_people_repeats_movements(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(takes, "_REPETITIONS", 2)
    first, second = takes.recorded_people(None)[:2]
    clips = takes.clips_of([first], 1, Options())
    assert [pair.clip for pair in clips] == ["m01_s01_e01", "m01_s01_e02"]
    assert {pair.subject for pair in clips} == {first}
    again = takes.clips_of([first], 1, Options())[1]
    np.testing.assert_array_equal(again.take.positions, clips[1].take.positions)
    assert first != second


def test_errors_in_doubt_are_of_what_is_hidden_where_it_is_hidden(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of the first clip the right arm is hidden, of the second the left one."""
    monkeypatch.setattr(takes, "_REPETITIONS", 2)
    (name,) = takes.recorded_people(None)[:1]
    clips = takes.clips_of([name], 1, Options())
    truth = {len(pair.take): pair.truth for pair in clips}

    def known(take: Take) -> tuple[Array, tuple[float, float]]:
        return truth[len(take)], (0.0, 0.0)

    def off(take: Take) -> tuple[Array, tuple[float, float]]:
        moved, span = truth[len(take)].copy(), middle(take, "55%")
        assert span is not None
        side = "Right" if len(take) == len(clips[0].take) else "Left"
        moved[span, take.skeleton.index(f"Wrist{side}")] += [0.0, 0.3, 0.0]
        return moved, (0.0, 0.0)

    assert len(truth) == 2
    assert max(_means(clips, known).values()) < 1e-9
    found = _means(clips, off)
    for guess in ("drifting", "leaping", "missing"):  # elbow and wrist; 12 joints
        assert found[guess] == pytest.approx(15.0)
        assert found[f"{guess}, all joints"] == pytest.approx(2.5)
    assert 1.0 < found["seen"] < 1.7  # 55 % of the frames
    raw = _means(clips, _raw)
    assert raw["leaping"] > raw["seen"] + 5.0
    assert raw["drifting"] > raw["seen"] + 5.0


@recorded
@paired
def test_the_first_movements_of_a_recorded_person_are_read() -> None:
    clips = takes.clips_of(takes.recorded_people(DATA)[:1], 1, Options(data=DATA))
    assert {pair.clip[:3] for pair in clips} == {"m01"}
    assert len(takes.recorded_takes(DATA)) > 90
