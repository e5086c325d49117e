"""Where the postures of a database come from: scripted motions and mocap."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from real_data import CMU, captured
from skeletons import every_skeleton
from text_files import write_text
from threadpoolctl import threadpool_limits

from kinefilter import PostureDatabase
from kinefilter.characters import (
    KINECT_V1,
    KINECT_V2,
    Clip,
    InputError,
    Skeleton,
    standard_body,
)
from kinefilter.characters.rotations import inverse, rotate
from kinefilter.pipeline.database import builtin_database
from kinefilter.pipeline.formats import write_clip
from kinefilter.pipeline.lab.database_build import (
    BUILTIN_POSTURES,
    database_from_mocap,
    scripted_database,
)
from kinefilter.retarget import Hinges, find_yaw
from kinefilter.scenes.library import MOTIONS

Array = NDArray[np.float64]


# Scripted motions


@pytest.fixture(params=[KINECT_V1, KINECT_V2], ids=lambda skeleton: skeleton.name)
def shipped(request: pytest.FixtureRequest) -> PostureDatabase:
    return builtin_database(request.param)


def assert_standard(base: PostureDatabase, *, atol: float = 1e-5) -> None:
    """Assert that postures are on the standard body, in its view."""
    skeleton, body = base.skeleton, standard_body(base.skeleton)
    ends = skeleton.segments
    bones = base.positions[:, ends] - base.positions[:, skeleton.segment_parents]
    lengths = np.linalg.norm(bones, axis=-1)
    expected = np.broadcast_to(body.lengths[ends], lengths.shape)
    np.testing.assert_allclose(lengths, expected, atol=atol)
    np.testing.assert_array_equal(base.positions[:, skeleton.root], 0.0)


def test_the_shipped_database_is_what_the_scripted_motions_give() -> None:
    shipped = builtin_database(KINECT_V2)
    # Two BLAS threads on busy cores wait for each other ten times as long as they work.
    with threadpool_limits(1, "blas"):
        scripted = scripted_database(shipped.skeleton)
    # Processors differ in the last bit.
    one, other = shipped.positions, scripted.positions
    np.testing.assert_allclose(one, other, rtol=0.0, atol=1e-12)
    np.testing.assert_array_equal(shipped.labels, scripted.labels)
    assert scripted.source == "built-in"


def test_the_scripted_database_holds_almost_every_motion(
    shipped: PostureDatabase,
) -> None:
    """Turning on the spot may be nothing but postures that others hold."""
    held = set(shipped.labels.tolist())
    assert held <= set(MOTIONS)
    assert len(set(MOTIONS) - held) <= 2
    assert 0.95 <= len(shipped) / BUILTIN_POSTURES <= 1.05


def test_scripted_postures_are_on_the_standard_body_facing_forward(
    shipped: PostureDatabase,
) -> None:
    assert_standard(shipped)
    yaw = find_yaw(shipped.positions, shipped.skeleton)
    # Their yaw is found on their own body, where hips and shoulders differ in width.
    np.testing.assert_allclose(yaw, 0.0, atol=0.02)


def test_scripted_knees_bend_the_right_way(shipped: PostureDatabase) -> None:
    assert knee_bend(shipped).min() > -1.0


def test_the_scripted_database_survives_its_file(
    shipped: PostureDatabase, tmp_path: Path
) -> None:
    shipped.save(tmp_path / "a.npz")
    again = PostureDatabase.load(tmp_path / "a.npz")
    np.testing.assert_array_equal(again.positions, shipped.positions)
    assert again.summary == shipped.summary


def knee_bend(base: PostureDatabase) -> Array:
    """Return how far shanks are bent backwards in the frame of the thigh [deg]."""
    bends = []
    rotations = Hinges(standard_body(base.skeleton)).untwisted(base.positions)
    for side in ("Left", "Right"):
        knee, ankle = (base.skeleton.index(p + side) for p in ("Knee", "Ankle"))
        shank = base.positions[:, ankle] - base.positions[:, knee]
        local = rotate(inverse(rotations[:, knee]), shank)
        bends.append(np.degrees(np.arctan2(-local[:, 2], -local[:, 1])))
    return np.concatenate(bends)


CMU_NAMES = {
    "Wrist": "Hand",
    "Elbow": "ForeArm",
    "Hand": "HandIndex1",
    "Hip": "UpLeg",
    "Knee": "Leg",
    "Ankle": "Foot",
    "Foot": "ToeBase",
}


# Motion capture


def small_bvh(unit: float = 1.0) -> str:
    """Return a BVH of arms that rise and knees that bend, first frame a T-pose."""
    body = standard_body(KINECT_V1, height=1.6)
    offsets, index = body.rest_offsets, KINECT_V1.index
    nodes = [("Spine", "Hips", offsets[index("Spine")])]
    girdle = offsets[index("ShoulderCenter")]
    nodes.append(("Spine1", "Spine", 0.5 * girdle))
    nodes.append(("Neck1", "Spine1", 0.6 * girdle))
    head = offsets[index("Head")] - 0.1 * girdle
    nodes.append(("Head", "Neck1", head))
    for side in ("Left", "Right"):
        shoulder = offsets[index(f"Shoulder{side}")]
        nodes.append((f"{side}Shoulder", "Spine1", 0.5 * girdle))
        nodes.append((f"{side}Arm", f"{side}Shoulder", shoulder))
        for part, parent in (
            ("Elbow", "Arm"),
            ("Wrist", "ForeArm"),
            ("Hand", "Hand"),
            ("Hip", ""),
            ("Knee", "UpLeg"),
            ("Ankle", "Leg"),
            ("Foot", "Foot"),
        ):
            above = side + parent if parent else "Hips"
            nodes.append((side + CMU_NAMES[part], above, offsets[index(part + side)]))
    return bvh_text([(n, p, unit * o) for n, p, o in nodes], unit)


def bvh_text(nodes: list[tuple[str, str, Array]], unit: float) -> str:
    lines, names = ["HIERARCHY"], []

    def write(name: str, offset: Array) -> None:
        x, y, z = offset
        place = "Xposition Yposition Zposition " if name == "Hips" else ""
        channels = f"{6 if place else 3} {place}Zrotation Yrotation Xrotation"
        names.append(name)
        lines.append(f"{'JOINT' if names[1:] else 'ROOT'} {name}")
        lines.extend(["{", f"OFFSET {x:.9f} {y:.9f} {z:.9f}", f"CHANNELS {channels}"])
        for child, parent, below in nodes:
            if parent == name:
                write(child, below)
        lines.append("}")

    write("Hips", np.zeros(3))
    frames = 40
    lines.extend(["MOTION", f"Frames: {frames}", "Frame Time: 0.0333333"])
    for k in range(frames):
        turns = np.zeros((len(names), 3))
        turns[names.index("LeftArm"), 0] = 2.0 * k
        turns[names.index("RightForeArm"), 1] = 1.5 * k
        for side in ("Left", "Right"):
            turns[names.index(f"{side}UpLeg"), 2] = -1.0 * k
            turns[names.index(f"{side}Leg"), 2] = 2.0 * k
        turns[names.index("Hips"), 1] = 3.0 * k
        root = unit * np.array([0.1, 0.9, 0.01 * k])
        lines.append(" ".join(f"{v:.9f}" for v in [*root, *turns.ravel()]))
    return "\n".join(lines) + "\n"


@every_skeleton
def test_a_database_from_mocap_is_on_the_standard_body(
    tmp_path: Path, skeleton: Skeleton
) -> None:
    path = write_text(tmp_path / "arms.up.bvh", small_bvh())
    base = database_from_mocap([path], skeleton)
    assert len(base) == 40
    assert set(base.labels.tolist()) == {"arms"}
    assert_standard(base)
    np.testing.assert_allclose(knee_bend(base)[:40], 2.0 * np.arange(40), atol=0.01)


@every_skeleton
@pytest.mark.parametrize("unit", [100.0, 39.37, 0.001])
def test_the_unit_of_a_bvh_does_not_matter(
    tmp_path: Path, skeleton: Skeleton, unit: float
) -> None:
    meters = write_text(tmp_path / "a.bvh", small_bvh())
    other = write_text(tmp_path / "b.bvh", small_bvh(unit))
    a, b = (database_from_mocap([path], skeleton) for path in (meters, other))
    tolerance = 1e-5 if unit > 1.0 else 1e-4
    np.testing.assert_allclose(a.positions, b.positions, atol=tolerance)


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_joints_at_the_same_place_are_no_reason_to_warn(tmp_path: Path) -> None:
    toes = rf"(JOINT Left{CMU_NAMES['Foot']}\n.*\n\s*OFFSET) .*"
    text, found = re.subn(toes, r"\1 0 0 0", small_bvh())
    assert found == 1
    base = database_from_mocap([write_text(tmp_path / "a.bvh", text)], KINECT_V1)
    assert np.isfinite(base.positions).all()


def test_the_heading_of_a_bvh_does_not_stay(tmp_path: Path) -> None:
    base = database_from_mocap([write_text(tmp_path / "a.bvh", small_bvh())], KINECT_V1)
    yaw = find_yaw(base.positions, KINECT_V1)
    np.testing.assert_allclose(yaw, 0.0, atol=1e-5)


def test_files_are_named_to_the_progress_bar_and_counted(tmp_path: Path) -> None:
    paths = [write_text(tmp_path / f"{n}.bvh", small_bvh()) for n in "abc"]
    seen: list[tuple[str, int]] = []

    def progress(stage: str, total: int) -> range:
        seen.append((stage, total))
        return range(total)

    base = database_from_mocap(paths, KINECT_V1, count=50, progress=progress)
    assert seen == [("read", 3)]
    # The same motion three times is kept once.
    assert set(base.labels.tolist()) == {"a"}
    assert len(base) <= 40
    assert "3 mocap files" in base.source


def test_no_files_and_files_that_do_not_fit_are_refused(
    tmp_path: Path, make_clip: Any
) -> None:
    with pytest.raises(InputError, match="no BVH, AMC, C3D or TRC files"):
        database_from_mocap([], KINECT_V1)
    text = small_bvh().replace("LeftToeBase", "LeftPaw")
    path = write_text(tmp_path / "paw.bvh", text)
    with pytest.raises(InputError, match=r"paw\.bvh.*'LeftToeBase'.*CMU"):
        database_from_mocap([path], KINECT_V1)
    clip: Clip = make_clip(3)
    write_clip(clip, tmp_path / "clip.csv")
    with pytest.raises(InputError, match=r"clip\.csv: not mocap: expected BVH"):
        database_from_mocap([tmp_path / "clip.csv"], KINECT_V1)
    with pytest.raises(InputError, match="none"):
        database_from_mocap([tmp_path / "none.bvh"], KINECT_V1)


@captured
@every_skeleton
def test_a_database_from_motion_capture_has_standard_segments(
    skeleton: Skeleton,
) -> None:
    files = [CMU / f"{name}.bvh.gz" for name in ("35_26", "07_01", "02_01")]
    base = database_from_mocap(files, skeleton, count=150)
    assert 147 <= len(base) <= 153
    assert set(base.labels.tolist()) == {"35_26", "07_01", "02_01"}
    # Left and right share their mean length, and Kinect's spine lies between joints
    # of the file. A hand ends elsewhere in each.
    ends = np.array([j for j in skeleton.segments if "Hand" not in skeleton.joints[j]])
    parents = [skeleton.parents[j] for j in ends]
    lengths = np.linalg.norm(
        base.positions[:, ends] - base.positions[:, parents], axis=2
    )
    expected = np.broadcast_to(standard_body(skeleton).lengths[ends], lengths.shape)
    np.testing.assert_allclose(lengths, expected, rtol=0.06)


@captured
@every_skeleton
def test_knees_from_motion_capture_bend_the_right_way(skeleton: Skeleton) -> None:
    files = [CMU / f"{name}.bvh.gz" for name in ("35_26", "02_01")]
    bend = knee_bend(database_from_mocap(files, skeleton, count=100))
    assert np.quantile(bend, 0.02) > -10.0
    assert np.quantile(bend, 0.95) > 40.0


@captured
def test_a_recorded_walk_is_nearest_to_motions_that_walk(
    shipped: PostureDatabase,
) -> None:
    base = database_from_mocap([CMU / "02_01.bvh.gz"], shipped.skeleton, count=40)
    weights = np.array(["Hand" not in j for j in shipped.skeleton.joints], float)
    found = [shipped.neighbors(posture, weights, 1) for posture in base.positions]
    away = np.sqrt([distance[0] / weights.sum() for _, distance in found])
    assert np.median(away) < 0.13
    nearest = [str(shipped.labels[index[0]]) for index, _ in found]
    assert np.mean(np.isin(nearest, ["walk", "carry", "run", "march"])) > 0.7
