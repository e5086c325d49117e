"""The virtual Kinect: what it sees, what it makes of it, what it says."""

from __future__ import annotations

import csv
from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest
from numpy.typing import NDArray
from posed_people import BODY, EXACT, NO_ERRORS, index, posed, room_with
from skeletons import every_skeleton

from kinefilter.characters import KINECT_V1, KINECT_V2, Skeleton, State, standard_body
from kinefilter.pipeline.correct.posture_features import turned_away
from kinefilter.scenes.library import perform
from kinefilter.scenes.sensor import (
    SENSORS,
    Sensor,
    TrackerErrors,
    in_sensor_frame,
    in_world_frame,
    observe,
    sample_take,
)
from kinefilter.scenes.sensor.tracker_errors import (
    error_mixing,
    error_scales,
    joint_offsets,
)
from kinefilter.scenes.sensor.visibility import look

Array = NDArray[np.float64]


# The sensor --------------------------------------------------------------------


@pytest.mark.parametrize("sensor", SENSORS.values(), ids=SENSORS)
def test_the_sensors_frame_and_the_world_are_inverse(sensor: Sensor) -> None:
    placed = replace(sensor, azimuth=0.7, tilt=-0.3, height=1.4, distance=3.1)
    points = np.random.default_rng(0).normal(size=(50, 3))
    there = in_sensor_frame(points, placed)
    np.testing.assert_allclose(in_world_frame(there, placed), points, atol=1e-12)
    gaps = np.linalg.norm(there[1:] - there[:-1], axis=-1)
    np.testing.assert_allclose(gaps, np.linalg.norm(np.diff(points, axis=0), axis=-1))


def test_a_sensor_that_looks_up_sees_what_is_level_lower() -> None:
    ahead = np.array([0.0, 1.0, 0.0])
    level, up = (in_sensor_frame(ahead, Sensor(tilt=t)) for t in (0.0, 0.1))
    np.testing.assert_allclose(level, [0.0, 0.0, 2.7], atol=1e-12)
    assert up[1] == pytest.approx(-2.7 * np.sin(0.1))


def test_azimuth_turns_the_performer_to_its_left() -> None:
    left = np.array([0.0, 1.0, 1.0])  # a meter before a person who faces the sensor
    turned = in_sensor_frame(left, Sensor(azimuth=np.pi / 2))
    np.testing.assert_allclose(turned, [-1.0, 0.0, 2.7], atol=1e-12)


def test_out_of_view_or_range_is_not_tracked() -> None:
    act = posed(5)
    low = replace(EXACT, height=1.5, distance=1.5)
    take = observe(act, seed=0, sensor=low)
    inside = low.in_view(in_sensor_frame(act.positions, low))
    assert not inside[:, index("FootLeft")].any()
    assert inside[:, index("Head")].all()
    np.testing.assert_array_equal(take.state == State.NOT_TRACKED, ~inside)
    np.testing.assert_array_equal(np.isnan(take.positions).any(axis=-1), ~inside)
    far = observe(act, seed=0, sensor=replace(EXACT, distance=9.0))
    assert (far.state == State.NOT_TRACKED).all()


@pytest.mark.parametrize("name", SENSORS)
def test_noise_grows_with_distance(name: str) -> None:
    act = posed(200)
    sensor = replace(SENSORS[name], dropped_share=0.0)
    errors = replace(NO_ERRORS, grain=5.0)
    spread = []
    for distance in (1.6, 2.4, 3.2):
        placed = replace(sensor, distance=distance)
        take = observe(act, seed=0, sensor=placed, errors=errors)
        spread.append(np.nanstd(take.positions[:, index("Spine"), 2]))
    assert spread[0] < 0.8 * spread[1] < 0.64 * spread[2]


# What the tracker makes of it ---------------------------------------------------


@every_skeleton
def test_without_errors_the_take_is_the_truth(skeleton: Skeleton) -> None:
    act = perform("squat", standard_body(skeleton), seed=0)
    take = observe(act, seed=0, sensor=EXACT, errors=NO_ERRORS)
    assert (take.state != State.NOT_TRACKED).all()
    truth = in_sensor_frame(act.positions, EXACT)
    np.testing.assert_allclose(take.positions, truth, atol=1e-12)
    np.testing.assert_allclose(take.time, act.time)


@pytest.mark.parametrize("motion", ["carry", "sit", "turn"])
def test_same_seed_same_bytes_and_another_seed_another_take(motion: str) -> None:
    act = perform(motion, BODY, seed=0)
    one, two = (observe(act, seed=3) for _ in range(2))
    assert one.positions.tobytes() == two.positions.tobytes()
    assert one.state.tobytes() == two.state.tobytes()
    assert one.time.tobytes() == two.time.tobytes()
    other = observe(act, seed=4)
    frames = min(len(one), len(other))
    gap = np.abs(one.positions[:frames] - other.positions[:frames])
    assert np.nanmedian(gap) > 0.001


def test_takes_of_one_person_share_their_misplacement() -> None:
    act = perform("stand_idle", BODY, seed=0)
    offsets = {}
    for person in (1, 2):
        for seed in (5, 6):
            sensor = replace(Sensor(), dropped_share=0.0)
            take = observe(act, seed=seed, sensor=sensor, person=person)
            away = take.positions - in_sensor_frame(act.positions, sensor)
            offsets[person, seed] = np.nanmedian(away, axis=0)
    same = np.linalg.norm(offsets[1, 5] - offsets[1, 6], axis=-1).mean()
    other = np.linalg.norm(offsets[1, 5] - offsets[2, 5], axis=-1).mean()
    assert same < 0.4 * other


def test_states_follow_what_is_seen() -> None:
    act = perform("stand_idle", BODY, seed=1)
    sure = replace(TrackerErrors(), doubt=0.0, merging=0.0, fast=0.0)
    turned = replace(EXACT, azimuth=np.pi / 2)
    take = observe(act, seed=0, sensor=turned, errors=sure)
    sight = look(act, turned)
    for side in ("Left", "Right"):
        j = index(f"Wrist{side}")
        share = sight.visible[:, j]
        assert (take.state[share > 0.95, j] == State.TRACKED).all()
        assert (take.state[share < 0.2, j] == State.INFERRED).all()
    assert (take.state == State.INFERRED).any()


def test_doubt_makes_hidden_joints_likelier_inferred_than_seen_ones() -> None:
    act = perform("stand_idle", BODY, seed=1)
    arm = [index(f"{part}Left") for part in ("Elbow", "Wrist", "Hand")]
    shares = []
    for azimuth in (0.0, np.pi / 2):
        take = observe(act, seed=0, sensor=Sensor(azimuth=azimuth))
        shares.append(np.mean(take.state[:, arm] != State.TRACKED))
    assert shares[1] > shares[0] + 0.2


def test_a_guess_starts_where_the_joint_was_and_ends_hanging() -> None:
    act = posed(90)
    poses = np.tile([1.0, 0.6, 1.4, 1.0, 0.0, 0.0, 0.0], (90, 1))
    poses[:30, 1] = 9.0
    scene = room_with("board", (0.02, 0.4, 0.3))
    errors = replace(NO_ERRORS, guess=1.0, guess_time=0.3, trust=0.0)
    scenery = {"scene": scene, "prop_poses": {"board": poses}}
    take = observe(act, seed=0, sensor=EXACT, errors=errors, **scenery)
    wrist = index("WristLeft")
    assert (take.state[:30, wrist] == State.TRACKED).all()
    assert (take.state[30:, wrist] == State.INFERRED).all()
    away = in_world_frame(take.positions, EXACT) - act.positions
    distance = np.linalg.norm(away[:, wrist], axis=-1)
    np.testing.assert_allclose(distance[:30], 0.0, atol=1e-12)
    assert distance[30] < 0.12
    assert distance[89] > 0.3
    assert (np.diff(distance[30:]) > -1e-9).all()
    bone = in_world_frame(take.positions, EXACT)[:, [wrist, index("ElbowLeft")]]
    length = np.linalg.norm(bone[:, 0] - bone[:, 1], axis=-1)
    np.testing.assert_allclose(length, BODY.lengths[wrist], rtol=1e-9)


def test_a_person_seen_from_behind_is_mirrored() -> None:
    act = posed(yaw=np.pi)
    take = observe(
        act, seed=0, sensor=EXACT, errors=replace(NO_ERRORS, mirrored_beyond=2.0)
    )
    truth = in_sensor_frame(act.positions, EXACT)
    np.testing.assert_allclose(take.positions, truth[:, KINECT_V1.mirror], atol=1e-12)


@pytest.mark.parametrize(("aside", "mirrored"), [(1.0, True), (-1.0, False)])
def test_behind_is_where_the_sensor_is_not_and_not_a_direction_of_the_room(
    aside: float, mirrored: bool
) -> None:
    # Turned by 70 degrees to the left: on the left of the room from the sensor, which
    # is 22 degrees off then, on the right towards it.
    act = posed(yaw=np.radians(70.0))
    act = replace(act, root=act.root + np.array([aside, 0, 0]))
    errors = replace(NO_ERRORS, mirrored_beyond=np.radians(74.0))
    take = observe(act, seed=0, sensor=EXACT, errors=errors)
    truth = in_sensor_frame(act.positions, EXACT)
    tracked = take.state == State.TRACKED
    assert tracked.sum() > 10
    expected = truth[:, KINECT_V1.mirror] if mirrored else truth
    np.testing.assert_allclose(take.positions[tracked], expected[tracked], atol=1e-12)


@pytest.mark.parametrize("degrees", [0, 10, 40, 75, -40, 90, 140, -140, 170])
@pytest.mark.parametrize("skeleton", [KINECT_V1, KINECT_V2], ids=["v1", "v2"])
def test_kinect_v2_shows_trunks_turned_toward_itself(
    skeleton: Skeleton, degrees: int
) -> None:
    act = posed(body=standard_body(skeleton), yaw=np.radians(degrees))
    take = observe(act, seed=0, sensor=EXACT, errors=replace(NO_ERRORS, trunk_turn=0.4))
    hips, shoulders = (
        np.subtract(*take.positions[0, skeleton.sides(part)[::-1]])
        for part in ("Hip", "Shoulder")
    )
    shown = np.arctan2(-hips[2], hips[0])  # +x is to the right of who faces it
    assert np.arctan2(-shoulders[2], shoulders[0]) == pytest.approx(shown)
    beyond = turned_away(np.array([-np.sin(shown), np.cos(shown)]))
    added = 0.0 if skeleton == KINECT_V1 or abs(degrees) == 90 else 0.4 * beyond
    assert np.degrees(shown + added) == pytest.approx(degrees, abs=1e-9)


def test_limbs_that_cross_in_the_image_are_swapped_now_and_then() -> None:
    down = posed(300, yaw=np.pi / 2, ElbowLeft=[0, -1, 0], ElbowRight=[0, -1, 0])
    errors = replace(NO_ERRORS, swap_rate=2.0, swap_time=0.3)
    take = observe(down, seed=0, sensor=EXACT, errors=errors)
    away = np.abs(in_world_frame(take.positions, EXACT) - down.positions).max(axis=-1)
    swapped = away[:, index("WristLeft")] > 0.1
    assert 0.05 < swapped.mean() < 0.95
    np.testing.assert_array_equal(swapped, away[:, index("WristRight")] > 0.1)
    np.testing.assert_allclose(away[:, index("Head")], 0.0, atol=1e-12)


def test_what_moves_is_seen_where_it_was() -> None:
    act = perform("swing", BODY, seed=0)
    late = replace(NO_ERRORS, blur=0.01)
    take = observe(act, seed=0, sensor=EXACT, errors=late)
    away = in_world_frame(take.positions, EXACT) - act.positions
    velocity = np.gradient(act.positions, 1.0 / 30.0, axis=0)
    behind = np.sum(away * velocity) / np.sum(velocity**2)
    assert behind == pytest.approx(-0.01, abs=0.004)


def test_a_joint_that_moves_wobbles_more_than_one_at_rest() -> None:
    act = perform("wave", BODY, seed=0)
    errors = replace(NO_ERRORS, wobble=0.03, wobble_time=0.1, stirring_speed=0.5)
    take = observe(act, seed=0, sensor=EXACT, errors=errors)
    away = in_world_frame(take.positions, EXACT) - act.positions
    speed = np.linalg.norm(np.gradient(act.positions, 1 / 30.0, axis=0), axis=-1)
    error = np.linalg.norm(away, axis=-1)
    wrists = [index("WristLeft"), index("WristRight")]
    fast, slow = speed[:, wrists] > 0.8, speed[:, wrists] < 0.05
    assert fast.sum() > 20
    assert slow.sum() > 20
    assert error[:, wrists][fast].mean() > 3.0 * error[:, wrists][slow].mean()


def test_errors_of_a_posture_come_back_with_the_posture() -> None:
    act = perform("squat", BODY, seed=0)
    errors = replace(NO_ERRORS, posture_error=0.02, posture_scale=1.0)
    one, two = (
        observe(act, seed=s, sensor=EXACT, errors=errors, person=1) for s in (1, 2)
    )
    np.testing.assert_array_equal(one.positions, two.positions)
    away = in_world_frame(one.positions, EXACT) - act.positions
    assert 0.005 < away.std() < 0.05


# Tables ------------------------------------------------------------------------


@every_skeleton
def test_joint_offsets_mirror(skeleton: Skeleton) -> None:
    offsets = joint_offsets(skeleton)
    mirrored = offsets[:, skeleton.mirror] * np.array([-1.0, 1.0, 1.0])
    np.testing.assert_allclose(mirrored, offsets, atol=1e-12)
    np.testing.assert_array_equal(
        error_scales(skeleton), error_scales(skeleton)[skeleton.mirror]
    )


@every_skeleton
def test_error_mixing_keeps_the_variance_of_every_joint(skeleton: Skeleton) -> None:
    mix = error_mixing(skeleton)
    np.testing.assert_allclose(np.sum(mix**2, axis=1), 1.0)
    shared = mix @ mix.T
    foot, ankle = skeleton.index("FootLeft"), skeleton.index("AnkleLeft")
    assert shared[foot, ankle] == pytest.approx(0.78)


def test_kinects_ankles_are_too_high_in_a_take_of_a_standing_person() -> None:
    act = perform("stand_idle", BODY, seed=0)
    ankle = index("AnkleLeft")
    takes = [observe(act, seed=seed, sensor=EXACT) for seed in range(4)]
    heights = [np.nanmedian(take.positions[:, ankle, 1]) for take in takes]
    truth = np.median(in_sensor_frame(act.positions, EXACT)[:, ankle, 1])
    assert 0.02 < np.mean(heights) - truth < 0.1


# Takes --------------------------------------------------------------------------


def test_a_person_facing_the_sensor_faces_minus_z_with_its_left_at_minus_x() -> None:
    take = observe(perform("stand_idle", BODY, seed=0), seed=0)
    middle = np.nanmedian(take.positions, axis=0)
    i = KINECT_V1.index
    assert middle[i("ShoulderLeft"), 0] < middle[i("ShoulderRight"), 0] - 0.3
    assert middle[i("FootLeft"), 2] < middle[i("AnkleLeft"), 2] - 0.01
    assert middle[i("HipCenter"), 2] == pytest.approx(2.7, abs=0.1)
    assert middle[i("FootLeft"), 1] == pytest.approx(-0.97, abs=0.08)


@every_skeleton
def test_bone_lengths_of_an_observed_take_vary_as_a_kinects(skeleton: Skeleton) -> None:
    body = standard_body(skeleton)
    take = observe(perform("stand_idle", body, seed=0), seed=0)
    tracked = take.state[..., None] == State.TRACKED
    positions = np.where(tracked, take.positions, np.nan)
    long = skeleton.segments[body.lengths[skeleton.segments] > 0.15]
    parents = np.array([skeleton.parents[j] for j in long])
    lengths = np.linalg.norm(positions[:, long] - positions[:, parents], axis=-1)
    variation = np.nanstd(lengths, axis=0) / np.nanmean(lengths, axis=0)
    assert 0.02 < np.median(variation) < 0.08


def test_missing_joints_are_nan_and_time_never_goes_back() -> None:
    take = sample_take()
    missing = take.state == State.NOT_TRACKED
    assert missing.any()
    np.testing.assert_array_equal(np.isnan(take.positions).all(axis=-1), missing)
    assert np.isfinite(take.positions[~missing]).all()
    assert (np.diff(take.time) >= 0).all()
    assert take.time[0] == 0.0


def test_the_sample_take_is_the_shipped_file() -> None:
    path = files("kinefilter.scenes") / "takes" / "wave_punch_bend.csv"
    with path.open(newline="") as file:
        header, *rows = csv.reader(file)
    take = sample_take()
    fields = [f"{j}.{f}" for j in KINECT_V1.joints for f in ("x", "y", "z", "state")]
    assert header == ["time", *fields]
    table = np.array([[float(cell or "nan") for cell in row] for row in rows])
    cells = table[:, 1:].reshape(len(table), len(KINECT_V1), 4)
    np.testing.assert_allclose(table[:, 0], take.time, atol=6e-5)
    np.testing.assert_allclose(cells[..., :3], take.positions, atol=6e-5)
    np.testing.assert_array_equal(cells[..., 3], take.state)
