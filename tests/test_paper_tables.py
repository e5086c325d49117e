"""The tables of the papers, ours beside theirs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kinefilter.characters import KINECT_V1
from kinefilter.pipeline.lab.simulate import simulate
from kinefilter.pipeline.lab.studies import papers, reproduce
from kinefilter.pipeline.lab.studies.study import Options


def test_a_spread_is_that_of_closed_forms_take_by_take() -> None:
    pair = simulate("basic", "wave", sensor="v1")
    still = np.zeros((40, len(KINECT_V1), 3))
    swings, hidden = still.copy(), still + 5.0
    angle = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
    for side in ("Left", "Right"):
        swings[:, KINECT_V1.index(f"Wrist{side}"), 0] = 0.1 * np.sin(angle)
        hidden[:, KINECT_V1.index(f"Ankle{side}")] = np.nan
    frames, arms, legs = papers._spread([pair, pair], [swings, hidden])
    assert frames == 80
    # Wrists alone move, in one of two takes, as one in three joints of the arms.
    assert arms == pytest.approx(10.0 / np.sqrt(2.0) / 3 / 2)
    assert legs == 0.0


def test_everybody_who_learned_is_nearer_than_kinect_on_known_people() -> None:
    study = reproduce("liu-table-3", Options(), quick=True)
    known = next(row for row in study.rows if row[1] == "known")
    assert max(known[3:]) < known[2]
    assert study.rows[2] == ("cross_arms", "paper", 12.5, 9.8, 7.2, 7.9, 7.4)


def test_errors_joint_by_joint_are_those_of_the_arms() -> None:
    study = reproduce("chiang-tables-2-3", Options(), quick=True)
    for name, samples, people, raw, _, chiang, *by_joint in study.rows:
        assert chiang < raw
        if people != "paper":
            assert np.mean(by_joint) == pytest.approx(chiang, rel=0.05)
        else:
            assert name == "deep_breathing"
            assert raw == {"all": 10.22, "unreliable": 13.82}[samples]


def test_frames_are_unreliable_as_chiang_has_it() -> None:
    pair = simulate("basic", "wave", sensor="v1")
    positions, wrist = pair.take.positions.copy(), KINECT_V1.index("WristLeft")
    positions[100, wrist] += 0.5  # and back, within a frame
    found = papers._unreliable(
        replace(pair, take=replace(pair.take, positions=positions)), KINECT_V1
    )
    before = papers._unreliable(pair, KINECT_V1)
    assert found[100]
    assert (found != before)[[*range(99), *range(104, len(found))]].sum() == 0


def test_recovery_ends_for_takes_of_every_length() -> None:
    study = reproduce("wang-table-1", Options(), quick=True)
    assert [row[0] for row in study.rows] == [241, 463]
    assert all(row[3] == "True" for row in study.rows)
    values = study.panels[1].series[0].y
    assert values[0] == 1.0
    assert np.all(np.diff(values) <= 0.0)
