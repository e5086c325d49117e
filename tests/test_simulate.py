"""Simulated takes and their truth, from the command line."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import MakeClip

from kinefilter import read_take, write_clip
from kinefilter.characters import (
    KINECT_V2,
    SKELETONS,
    InputError,
    Motion,
    State,
    standard_body,
)
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.lab.recorded_acts import mocap_act
from kinefilter.pipeline.lab.simulation import area_in_view, motion_for, simulate
from kinefilter.pipeline.pairs import read_pairs
from kinefilter.retarget import HeadingFrame, find_yaw
from kinefilter.scenes import SCENES
from kinefilter.scenes.library import perform, random_body
from kinefilter.scenes.sensor import SENSORS, in_sensor_frame

every_sensor = pytest.mark.parametrize("sensor", SENSORS)


@pytest.mark.parametrize("scene", SCENES)
def test_every_scene_is_recorded(scene: str) -> None:
    pair = simulate(scene, "wave", seed=1)
    assert pair.truth.shape == pair.take.positions.shape
    apart = np.linalg.norm(pair.take.positions - pair.truth, axis=2)
    assert 0.005 < np.nanmedian(apart) < 0.15


def test_a_box_hides_what_is_behind_it() -> None:
    bare, boxed = (simulate(scene, "lift_box", seed=2) for scene in ("basic", "box"))
    np.testing.assert_array_equal(bare.truth.shape[1:], boxed.truth.shape[1:])
    assert (boxed.take.state == 2).mean() < (bare.take.state == 2).mean()


def test_pairs_alone_are_written_but_not_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pairs = tmp_path / "pairs.npz"
    assert main(["simulate", "basic", "--motion", "wave", "--pairs", str(pairs)]) == 0
    assert f"wrote {pairs}: " in capsys.readouterr().out
    assert len(read_pairs(pairs)) == 1
    assert main(["simulate", "basic"]) == 2
    assert "-o, or --pairs" in capsys.readouterr().err


def test_files_read_back_and_the_same_seed_gives_the_same_bytes(
    tmp_path: Path,
) -> None:
    for name in ("a", "b"):
        arguments = ["simulate", "chair", "--motion", "sit", "--sensor", "v1"]
        arguments += ["--seed", "4", "-o", str(tmp_path / f"{name}.csv")]
        arguments += ["--truth", str(tmp_path / f"{name}_truth.csv")]
        arguments += ["--pairs", str(tmp_path / f"{name}.npz")]
        assert main(arguments) == 0
    for kind in (".csv", "_truth.csv"):
        one, two = (tmp_path / f"{name}{kind}" for name in ("a", "b"))
        assert one.read_bytes() == two.read_bytes()
    take, truth = (read_take(tmp_path / f"a{end}.csv") for end in ("", "_truth"))
    (pair,) = read_pairs(tmp_path / "a.npz")
    np.testing.assert_allclose(pair.take.positions, take.positions, atol=1e-8)
    np.testing.assert_allclose(pair.truth, truth.positions, atol=1e-8)
    np.testing.assert_array_equal(pair.take.state, take.state)


def test_unknown_names_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for scene, motion in (("moon", "walk"), ("basic", "fly")):
        with pytest.raises(InputError, match="unknown"):
            simulate(scene, motion)
        arguments = ["simulate", scene, "--motion", motion]
        assert main([*arguments, "-o", str(tmp_path / "t.csv")]) == 2
        assert "known:" in capsys.readouterr().err
    assert main(["simulate", "basic", "-o", str(tmp_path / "t.bvh")]) == 2
    assert list(tmp_path.iterdir()) == []


def test_a_person_keeps_their_bones_in_another_performance() -> None:
    one, other = (simulate("basic", "wave", seed=s, person=3) for s in (3, 4))
    skeleton = one.take.skeleton
    ends, starts = skeleton.segments, skeleton.segment_parents
    lengths = [
        np.linalg.norm(pair.truth[0, ends] - pair.truth[0, starts], axis=1)
        for pair in (one, other)
    ]
    np.testing.assert_allclose(lengths[0], lengths[1], atol=1e-9)
    assert one.subject == other.subject
    assert len(one.take) != len(other.take)
    np.testing.assert_array_equal(one.truth, simulate("basic", "wave", seed=3).truth)


# In view ------------------------------------------------------------------------


@every_sensor
@pytest.mark.parametrize("scene", SCENES)
def test_what_people_do_in_a_scene_by_default_is_in_view(
    scene: str, sensor: str
) -> None:
    pair = simulate(scene, motion_for(scene), sensor=sensor, seed=3, stay_in_view=True)
    inside = SENSORS[sensor].in_view(pair.truth)
    assert inside[:, pair.take.skeleton.root].all()
    assert inside.mean() > 0.95
    assert (pair.take.state != State.NOT_TRACKED).mean() > 0.95


def test_the_command_lets_people_do_what_fits_the_scene_and_stay_in_view(
    tmp_path: Path,
) -> None:
    path = tmp_path / "take.csv"
    assert main(["simulate", "box", "--sensor", "v1", "-o", str(path)]) == 0
    expected = simulate("box", "lift_box", sensor="v1").take
    np.testing.assert_allclose(read_take(path).positions, expected.positions, atol=1e-8)
    arguments = ["simulate", "basic", "--motion", "walk", "-o", str(path)]
    assert main(arguments) == 0
    take = read_take(path)
    seen = take.state[:, take.skeleton.root] != State.NOT_TRACKED
    assert seen.all()
    straight = simulate("basic", "walk").take
    assert not (straight.state[:, 0] != State.NOT_TRACKED).all()


def gaits_in_view(name: str, sensor: str) -> list[Motion]:
    skeleton = SKELETONS["kinect_v1" if sensor == "v1" else "kinect_v2"]
    bodies = [random_body(skeleton, np.random.default_rng(seed)) for seed in range(2)]
    return [
        perform(
            name, body, seed=seed, within=area_in_view(SENSORS[sensor], body.height)
        )
        for seed, body in enumerate(bodies)
    ]


@every_sensor
@pytest.mark.parametrize("name", ["walk", "run", "carry", "march"])
def test_gaits_turn_before_they_leave_the_view(name: str, sensor: str) -> None:
    for act in gaits_in_view(name, sensor):
        place = in_sensor_frame(act.positions, SENSORS[sensor])
        inside = SENSORS[sensor].in_view(place)
        assert inside[:, act.skeleton.root].all()
        assert inside.mean() > 0.95


def test_mocap_is_performed_before_sensors(make_clip: MakeClip, tmp_path: Path) -> None:
    """As it is, but in the middle of the room, and facing the first sensor."""
    act = perform("wave", standard_body(KINECT_V2), seed=2)
    made = make_clip(skeleton=KINECT_V2, time=act.time, body=act.body)
    turned = HeadingFrame(np.array([30.0, 1.0, -7.0]), np.array(1.3))
    path = tmp_path / "wave.bvh"
    root = turned.restore(act.root)
    turns = turned.restore_rotations(act.rotations)
    write_clip(replace(made, root=root, rotations=turns), path)
    found = mocap_act(path, KINECT_V2, 30.0)
    np.testing.assert_allclose(found.body.lengths, act.body.lengths, atol=0.01)
    hip = KINECT_V2.hips[0]
    postures = [x.positions - x.positions[:, [hip]] for x in (found, act)]
    facing = HeadingFrame(np.zeros(3), find_yaw(act.positions[0], KINECT_V2))
    away = np.linalg.norm(
        postures[0] - facing.remove(postures[1])[: len(found)], axis=2
    )
    assert np.median(away) < 0.01
    assert found.positions[..., 1].min() == pytest.approx(0.0, abs=0.1)
    assert np.abs(found.root[:, [0, 2]]).max() < 0.5
    pair = simulate("basic", str(path), seed=1)
    apart = np.linalg.norm(pair.take.positions - pair.truth, axis=2)
    assert 0.005 < np.nanmedian(apart) < 0.15
