"""Joints found in depth images: the images, the forest, the proposals, the states."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from posed_people import BODY, EXACT, NO_ERRORS, index, posed, room_with

from kinefilter.characters import KINECT_V1, KINECT_V2, InputError, Motion, State
from kinefilter.characters.humanoid import to_mujoco
from kinefilter.characters.rotations import IDENTITY
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.formats import read_take
from kinefilter.pipeline.lab import teach_depth
from kinefilter.pipeline.lab.studies import Options, reproduce
from kinefilter.pipeline.lab.studies.tracker_studies import error_figures
from kinefilter.scenes.library import perform
from kinefilter.scenes.sensor import SENSORS, Sensor, in_sensor_frame, observe
from kinefilter.scenes.sensor.depth_tracker import (
    BACKGROUND,
    BODY_PARTS,
    BodyPartForest,
    DepthCamera,
    DepthImage,
    depth_differences,
    hold_inferred,
    nearest_joints,
    parts_of_joints,
    propose,
    shipped_forest,
    with_noise,
)
from kinefilter.scenes.sensor.visibility import PosedBody

Array = NDArray[np.float64]
CMU = Path("../shared/data/mocap/cmu")
NONE = -1


def image_of(act: Motion, sensor: Sensor = EXACT) -> DepthImage:
    camera = DepthCamera(PosedBody(act.body), sensor)
    return camera.take(act.positions[0], act.rotations[0])


def flat_image(depth: float, half: float, focal: float = 200.0) -> DepthImage:
    """Somebody who is a square of 2 half m across the view, in its middle."""
    there = np.abs(np.arange(201) - 100) <= half * focal / depth
    square = there[:, None] & there
    return DepthImage(
        np.where(square, depth, BACKGROUND), np.where(square, 0, NONE), focal
    )


# The image -----------------------------------------------------------------------


def test_every_pixel_lies_on_the_capsule_that_it_shows() -> None:
    act = posed(ElbowLeft=[0.3, -0.5, 0.8])
    image, joints = image_of(act), in_sensor_frame(act.positions[0], EXACT)
    limbs = [KINECT_V1.index(j) for j in ("ElbowLeft", "WristRight", "KneeLeft")]
    for j in limbs:
        rows, columns = np.nonzero(image.segments == j)
        points = image.points(rows, columns)
        start, bone = joints[KINECT_V1.parents[j]], np.zeros(3)
        bone = joints[j] - start
        share = np.clip((points - start) @ bone / (bone @ bone), 0.0, 1.0)
        away = np.linalg.norm(points - start - share[:, None] * bone, axis=1)
        assert len(points) > 30
        np.testing.assert_allclose(away, BODY.radii[j], atol=1e-6)


def test_a_head_is_as_near_and_as_wide_as_its_sphere() -> None:
    head, radius = index("Head"), BODY.radii[index("Head")]
    act = posed()
    level = replace(EXACT, height=float(act.positions[0, head, 1]))
    image = image_of(act, level)
    rows, columns = np.nonzero(image.segments == head)
    away = float(in_sensor_frame(act.positions[0, head], level)[2])
    assert image.depth[rows, columns].min() == pytest.approx(away - radius, abs=1e-3)
    width = 2.0 * image.focal * np.tan(np.arcsin(radius / away))
    assert np.ptp(columns) + 1 == pytest.approx(width, abs=1.0)


def test_the_view_is_that_of_the_sensor_and_nobody_is_mirrored() -> None:
    image = image_of(posed())
    columns = 0.5 * SENSORS["v2"].resolution[0]
    half = np.arctan(0.5 * columns / image.focal)
    assert 2.0 * half == pytest.approx(SENSORS["v2"].field_of_view[0])
    left = np.nonzero(image.segments == index("WristLeft"))[1]
    assert left.min() > 0.5 * columns  # of who faces the sensor
    below = np.nonzero(image.segments == index("KneeLeft"))[0]
    assert below.min() > np.nonzero(image.segments == index("Head"))[0].max()


def test_what_hides_a_limb_and_what_is_out_of_range_shows_nobody() -> None:
    act = posed()
    scene = room_with("box", (0.1, 0.8, 0.3))
    camera = DepthCamera(PosedBody(act.body, scene, ("box",)), EXACT)
    pose = np.concatenate([to_mujoco(np.array([0.0, 0.3, 0.8])), IDENTITY])
    image = camera.take(act.positions[0], act.rotations[0], [pose])
    assert not np.isin(image.segments, [index("AnkleLeft"), index("FootRight")]).any()
    assert (image.segments == index("Head")).any()
    far = image_of(act, replace(EXACT, distance=6.0))
    assert (far.depth == BACKGROUND).all()


def test_noise_is_in_whole_steps_and_edges_are_lost() -> None:
    rng = np.random.default_rng(0)
    image = flat_image(2.0, 0.5)
    noisy = with_noise(image, SENSORS["v2"], rng)
    inner = noisy.depth[60:140, 60:140]
    assert inner.std() == pytest.approx(SENSORS["v2"].depth_noise.at(2.0), rel=0.1)
    np.testing.assert_allclose(1000.0 * inner, np.rint(1000.0 * inner), atol=1e-6)
    border = noisy.depth[50, 50:151] == BACKGROUND
    assert 0.2 < border.mean() < 0.8
    exact = replace(SENSORS["v1"], depth_noise=EXACT.depth_noise)
    steps = with_noise(flat_image(3.0, 0.5), exact, rng)
    assert abs(steps.depth[100, 100] - 3.0) < 0.5 * 0.0027 * 9.0


def test_skin_belongs_to_the_nearest_joint_of_its_segment() -> None:
    act = posed()
    image, joints = image_of(act), in_sensor_frame(act.positions[0], EXACT)
    rows, columns = np.nonzero(image.segments == index("ElbowLeft"))
    points = image.points(rows, columns)
    found = nearest_joints(points, image.segments[rows, columns], joints, BODY)
    ends = joints[[index("ShoulderLeft"), index("ElbowLeft")], 0]
    along = np.abs(points[:, 0, None] - ends)
    reach = 0.04 * BODY.height
    wanted = np.where(along[:, 0] < along[:, 1], index("ShoulderLeft"), found.max())
    np.testing.assert_array_equal(found, np.where(along.min(1) < reach, wanted, NONE))
    assert set(found) == {index("ShoulderLeft"), index("ElbowLeft"), NONE}


# Features and trees --------------------------------------------------------------


@pytest.mark.parametrize("away", [0.15, 0.45])
def test_differences_of_depth_are_the_same_near_and_far(away: float) -> None:
    """The same place of a body: from the middle, on somebody 0.3 m to each side."""
    offsets = np.array([[[0.0, away], [0.0, 0.0]]])
    middle = np.array([100])
    seen = [
        float(depth_differences(flat_image(d, 0.3), middle, middle, offsets)[0] + d)
        for d in (1.0, 2.0, 4.0)
    ]
    wanted = [1.0, 2.0, 4.0] if away < 0.3 else [BACKGROUND] * 3
    np.testing.assert_allclose(seen, wanted, rtol=1e-6)


def test_trees_give_what_scikit_learns_give() -> None:
    from sklearn.ensemble import RandomForestClassifier

    rng = np.random.default_rng(1)
    depth = rng.uniform(1.0, 3.0, (60, 80))
    image = DepthImage(depth, np.zeros((60, 80), dtype=np.intp), 100.0)
    rows, columns = (one.ravel() for one in np.indices(depth.shape))
    offsets = teach_depth.features(12)
    told = np.stack(
        [
            depth_differences(
                image, rows, columns, np.broadcast_to(o, (len(rows), 2, 2))
            )
            for o in offsets
        ],
        axis=1,
    )
    shown = rng.integers(3, 9, len(rows)) + (told[:, 0] > 0.0)
    learned = RandomForestClassifier(3, max_depth=7, random_state=0).fit(told, shown)
    forest = teach_depth.converted(learned.estimators_, learned.classes_, offsets)
    shares = forest.shares(image, rows, columns)
    wanted = np.zeros_like(shares)
    wanted[:, learned.classes_] = learned.predict_proba(told)
    np.testing.assert_allclose(shares, wanted, atol=0.01)  # leaves are bytes
    assert shares[:, learned.classes_].std(axis=0).min() > 0.02


def test_a_forest_comes_back_from_its_file(tmp_path: Path) -> None:
    forest = shipped_forest()
    forest.save(tmp_path / "forest.npz")
    again = BodyPartForest.load(tmp_path / "forest.npz")
    np.testing.assert_array_equal(again.children, forest.children)
    np.testing.assert_array_equal(again.leaves, forest.leaves)
    assert (tmp_path / "forest.npz").stat().st_size < 3_000_000


def test_body_parts_are_joints_of_either_kinect() -> None:
    both = parts_of_joints(KINECT_V2)
    np.testing.assert_array_equal(both, np.eye(26, 25, dtype=bool))
    of_v1 = parts_of_joints(KINECT_V1)
    assert (of_v1.sum(axis=1) == [*[1] * 25, 0]).all()
    hand = [BODY_PARTS[p] for p in np.flatnonzero(of_v1[:, index("HandLeft")])]
    assert set(hand) == {"HandLeft", "HandTipLeft", "ThumbLeft"}


# Proposals, takes and states -----------------------------------------------------


def test_skin_is_found_on_the_body_and_nobody_has_none() -> None:
    act = posed(WristLeft=[0.0, 1.0, 0.0])
    image = image_of(act)
    found = propose(image, shipped_forest(), KINECT_V1)
    joints = in_sensor_frame(act.positions[0], EXACT)
    head = found.skin[index("Head")] - joints[index("Head")]
    assert np.linalg.norm(head) < 2.0 * BODY.radii[index("Head")]
    # All the skin that is seen, of a person of 1.75 m: half of what faces the sensor.
    assert 0.1 < found.area.sum() < 0.9
    empty = propose(flat_image(2.0, -1.0), shipped_forest(), KINECT_V1)
    assert np.isnan(empty.skin).all()
    assert not empty.area.any()


def brief(monkeypatch: pytest.MonkeyPatch, module: str) -> None:
    """Let people perform for a second only: images of bodies take their time."""

    def performed(*words: Any, **options: Any) -> Motion:
        return perform(*words, **options).at(slice(50, 80))

    monkeypatch.setattr(f"kinefilter.pipeline.lab.{module}.perform", performed)


def test_simulate_finds_the_joints_of_who_faces_the_sensor(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    brief(monkeypatch, "simulation")
    out, truth = tmp_path / "take.csv", tmp_path / "truth.csv"
    command = ["simulate", "basic", "--motion", "raise_arms", "-o", str(out)]
    command += ["--skeleton", "kinect_v1", "--seed", "7", "--truth", str(truth)]
    assert main([*command, "--tracker", "depth"]) == 0
    take, real = read_take(out), read_take(truth)
    away = np.linalg.norm(take.positions - real.positions, axis=2)
    sure = take.state == State.TRACKED
    assert sure.mean() > 0.7
    middle = {j: np.median(away[sure[:, k], k]) for k, j in enumerate(KINECT_V1.joints)}
    for joint in ("Head", "ShoulderCenter", "ShoulderLeft", "KneeRight", "WristLeft"):
        assert middle[joint] < 0.1, joint
    assert np.median(away[sure]) < 0.06
    assert np.median(away[sure]) > 0.01  # it is a tracker, not the truth


def test_what_is_hidden_is_not_tracked_and_stays_where_it_was() -> None:
    act = posed(6)
    scene = room_with("box", (0.1, 0.8, 0.3))
    aside, before = np.array([0.0, 0.3, -3.0]), np.array([0.0, 0.3, 0.8])
    place = np.stack([aside, aside, before, before, before, before])
    poses = {"box": np.concatenate([to_mujoco(place), np.tile(IDENTITY, (6, 1))], 1)}
    take = observe(
        act, seed=0, sensor=EXACT, scene=scene, prop_poses=poses, tracker="depth"
    )
    ankle = index("AnkleLeft")
    assert (take.state[:2, ankle] == State.TRACKED).all()
    assert (take.state[2:, ankle] == State.INFERRED).all()
    assert np.ptp(take.positions[1:, ankle], axis=0).max() < 0.1
    assert (take.state[:, index("Head")] == State.TRACKED).all()


def test_a_joint_too_far_from_its_parent_is_taken_for_anothers() -> None:
    act = posed(5)
    places = in_sensor_frame(act.positions, EXACT)
    state = np.full(places.shape[:2], State.TRACKED, dtype=np.uint8)
    wrist = index("WristLeft")
    places[2, wrist] = places[2, index("AnkleRight")]
    held = hold_inferred(places, state, KINECT_V1, EXACT)
    assert state[2, wrist] == State.INFERRED
    assert (state == State.INFERRED).sum() == 1
    np.testing.assert_allclose(held[2], held[1], atol=1e-9)
    np.testing.assert_allclose(held[3:], places[3:], atol=1e-9)


def test_what_goes_out_of_view_is_lost() -> None:
    places = in_sensor_frame(posed(3).positions, EXACT)
    places[2] += [0.0, 0.0, 3.0]
    state = np.full(places.shape[:2], State.TRACKED, dtype=np.uint8)
    held = hold_inferred(places, state, KINECT_V1, EXACT)
    assert (state[:2] == State.TRACKED).all()
    assert (state[2] == State.NOT_TRACKED).all()
    assert np.isnan(held[2]).all()


def test_of_two_places_the_one_nearer_to_the_last_is_taken() -> None:
    """Both hands are told to be the right one: where it was decides."""
    act = posed()
    image, forest = image_of(act), shipped_forest()
    right, left = index("HandRight"), index("HandLeft")
    parts = forest.leaves.copy()
    pair = [BODY_PARTS.index("HandRight"), BODY_PARTS.index("HandLeft")]
    parts[:, pair[0]] = parts[:, pair].max(axis=1)
    either = replace(forest, leaves=parts)
    joints = in_sensor_frame(act.positions[0], EXACT)
    for hand in (right, left):
        before = joints.copy()
        before[right] = joints[hand]
        found = propose(image, either, KINECT_V1, before).skin[right]
        assert np.linalg.norm(found - joints[hand]) < 0.15


def test_who_is_out_of_range_is_not_tracked() -> None:
    far = replace(EXACT, distance=7.0)
    take = observe(posed(2), seed=0, sensor=far, tracker="depth")
    assert (take.state == State.NOT_TRACKED).all()
    assert np.isnan(take.positions).all()


def test_the_same_seed_gives_the_same_take() -> None:
    takes = [observe(posed(2), seed=s, tracker="depth").positions for s in (1, 1, 2)]
    np.testing.assert_array_equal(takes[0], takes[1])
    assert np.nanmax(np.abs(takes[2] - takes[0])) > 0.0
    # Whose errors the model has makes no difference: it is not asked.
    modeled = observe(posed(2), seed=1, errors=NO_ERRORS, person=5, tracker="depth")
    np.testing.assert_array_equal(modeled.positions, takes[0])


def test_unknown_trackers_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(InputError, match=r"unknown tracker 'rays'.*model, depth"):
        observe(posed(), seed=0, tracker="rays")  # type: ignore[arg-type]
    out = tmp_path / "take.csv"
    with pytest.raises(SystemExit, match="2"):
        main(["simulate", "basic", "-o", str(out), "--tracker", "rays"])
    assert "rays" in capsys.readouterr().err
    assert not out.exists()


# Teaching and measuring ----------------------------------------------------------


def test_a_forest_is_taught_by_mocap_and_says_what_it_is_worth(tmp_path: Path) -> None:
    if not CMU.is_dir():
        pytest.skip("recordings are not here")
    for name in ("05_01", "07_01", "02_01"):
        (tmp_path / f"{name}.bvh.gz").symlink_to((CMU / f"{name}.bvh.gz").resolve())
    out = tmp_path / "forest.npz"
    sizes = teach_depth.Sizes(people=3, images=4, leaves=200, features=30)
    said = list(teach_depth.teach_depth(tmp_path, out, sizes, checked=2))
    forest = BodyPartForest.load(out)
    share = float(said[1].split()[3].rstrip("%:"))
    assert share > 25.0  # of 25 parts, by chance 4
    assert (forest.push[:, BODY_PARTS.index("SpineMid")] > 0.03).all()
    assert any(line.split()[0] == "Head" for line in said)
    with pytest.raises(InputError, match="no BVH"):
        list(teach_depth.teach_depth(tmp_path / "none", out, sizes))


def test_figures_of_errors_are_those_of_errors_that_are_known() -> None:
    rng = np.random.default_rng(0)
    kept = np.exp(-1.0 / 6.0)  # forgotten in 6 frames
    noise = rng.normal(size=(4000, 2, 3))
    for t in range(1, len(noise)):
        noise[t] = kept * noise[t - 1] + np.sqrt(1.0 - kept**2) * noise[t]
    noise -= noise.mean(axis=0)
    error = 0.03 * noise + np.array([0.0, 0.04, 0.03])
    offset, moving, time, tail, alike = error_figures([error], [-2.0 * error])
    assert offset == pytest.approx(5.0)
    assert moving == pytest.approx(100.0 * 0.03 * np.sqrt(3.0), rel=0.05)
    assert time == pytest.approx(7.0 / 30.0, abs=1.1 / 30.0)
    assert tail == pytest.approx(
        100.0 * (np.linalg.norm(0.03 * noise, axis=2) > 0.07).mean()
    )
    assert alike == pytest.approx(-1.0)


def test_without_recordings_scripted_motions_are_looked_at(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    brief(monkeypatch, "studies.tracker_studies")
    study = reproduce("tracker-errors", Options(), quick=True)
    figures = {str(row[0]): row[1:] for row in study.rows}
    assert set(figures) >= {"wrists, model", "wrists, depth", "all, depth"}
    assert not any(name.endswith("recorded") for name in figures)
    offset, moving, *_, alike, inferred = figures["all, depth"]
    assert 1.0 < float(offset or 0.0) < 20.0
    assert 1.0 < float(moving or 0.0) < 30.0
    assert alike is None
    assert 0.0 < float(inferred or 0.0) < 60.0
