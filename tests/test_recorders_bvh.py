"""BVH of recorders with skeletons of their own: Rokoko Studio, iPi, Brekel."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_keypoints import SURE, apart, scripted
from text_files import write_text

from kinefilter.characters import KINECT_V2, Take
from kinefilter.pipeline.formats import read_recording
from kinefilter.pipeline.formats.mocap import read_mocap

# Name, name of the parent, joint of Kinect v2 at which it is.
ROKOKO = """
Hips - SpineBase
Spine1 Hips SpineBase
Spine2 Spine1 SpineMid
Spine3 Spine2 SpineMid
Spine4 Spine3 SpineMid
Neck Spine4 Neck
Head Neck Head
LeftShoulder Spine4 SpineShoulder
LeftArm LeftShoulder ShoulderLeft
LeftForeArm LeftArm ElbowLeft
LeftHand LeftForeArm WristLeft
RightShoulder Spine4 SpineShoulder
RightArm RightShoulder ShoulderRight
RightForeArm RightArm ElbowRight
RightHand RightForeArm WristRight
LeftThigh Hips HipLeft
LeftShin LeftThigh KneeLeft
LeftFoot LeftShin AnkleLeft
LeftToe LeftFoot FootLeft
RightThigh Hips HipRight
RightShin RightThigh KneeRight
RightFoot RightShin AnkleRight
RightToe RightFoot FootRight
"""
IPI = """
Hip - SpineBase
LowerSpine Hip SpineBase
MiddleSpine LowerSpine SpineMid
Chest MiddleSpine SpineMid
Neck Chest Neck
Head Neck Head
RClavicle Chest SpineShoulder
RShoulder RClavicle ShoulderRight
RForearm RShoulder ElbowRight
RHand RForearm WristRight
LClavicle Chest SpineShoulder
LShoulder LClavicle ShoulderLeft
LForearm LShoulder ElbowLeft
LHand LForearm WristLeft
RThigh Hip HipRight
RShin RThigh KneeRight
RFoot RShin AnkleRight
RToe RFoot FootRight
LThigh Hip HipLeft
LShin LThigh KneeLeft
LFoot LShin AnkleLeft
LToe LFoot FootLeft
"""
BREKEL = """
Hips - SpineBase
LeftUpLeg Hips HipLeft
LeftLeg LeftUpLeg KneeLeft
LeftFoot LeftLeg AnkleLeft
RightUpLeg Hips HipRight
RightLeg RightUpLeg KneeRight
RightFoot RightLeg AnkleRight
Spine Hips SpineMid
Spine1 Spine SpineShoulder
LeftShoulder Spine1 SpineShoulder
LeftArm LeftShoulder ShoulderLeft
LeftForeArm LeftArm ElbowLeft
LeftHand LeftForeArm WristLeft
RightShoulder Spine1 SpineShoulder
RightArm RightShoulder ShoulderRight
RightForeArm RightArm ElbowRight
RightHand RightForeArm WristRight
Neck Spine1 Neck
Head Neck Head
"""
"""As Brekel Pro Body writes it, where every joint has a place of its own in each frame
and feet end without toes."""
LAFAN1 = f"{BREKEL}LeftToe LeftFoot FootLeft\nRightToe RightFoot FootRight\n"
TOES = 0.107  # m ahead of the ankle


def bvh(take: Take, tree: str) -> str:
    """Write a take in cm, y up, with a place for every joint."""
    rows = [line.split() for line in tree.split("\n") if line]
    children: dict[str, list[str]] = {name: [] for name, _, _ in rows}
    for name, parent, _ in rows[1:]:
        children[parent].append(name)
    order: list[str] = []
    lines = ["HIERARCHY"]

    def add(name: str, deep: int) -> None:
        order.append(name)
        pad = "  " * deep
        lines.append(f"{pad}{'JOINT' if deep else 'ROOT'} {name}\n{pad}{{")
        lines.append(f"{pad}  OFFSET 0 0 0")
        channels = "Xposition Yposition Zposition Zrotation Xrotation Yrotation"
        lines.append(f"{pad}  CHANNELS 6 {channels}")
        for child in children[name]:
            add(child, deep + 1)
        if not children[name]:
            end = f"0 0 {100 * TOES}"
            lines.append(f"{pad}  End Site\n{pad}  {{\n{pad}    OFFSET {end}")
            lines.append(f"{pad}  }}")
        lines.append(f"{pad}}}")

    add(rows[0][0], 0)
    lines += ["MOTION", f"Frames:\t{len(take)}", "Frame Time:\t0.033333"]
    meant = {name: KINECT_V2.index(joint) for name, _, joint in rows}
    above = {name: parent for name, parent, _ in rows}
    for places in 100.0 * take.positions:
        cells = []
        for name in order:
            place = places[meant[name]]
            if above[name] != "-":
                place = place - places[meant[above[name]]]
            cells.append("{:.5f} {:.5f} {:.5f} 0 0 0".format(*place))
        lines.append(" ".join(cells))
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize(
    "tree",
    [ROKOKO, IPI, BREKEL, LAFAN1],
    ids=["rokoko", "ipi", "brekel", "lafan1"],
)
def test_every_joint_is_on_its_side_under_the_names_of_a_recorder(
    tmp_path: Path, tree: str
) -> None:
    truth = scripted("walk")
    recording = read_recording(write_text(tmp_path / "a.bvh", bvh(truth, tree)))
    assert (recording.format, recording.unit) == ("bvh", "cm")
    (found,) = recording.takes
    assert found.skeleton.name == "kinect_v1"
    moved = np.full_like(truth.positions, np.nan)
    for j, joint in enumerate(found.skeleton.joints):
        name = {"HipCenter": "SpineBase", "Spine": "SpineMid"}.get(joint, joint)
        if name in KINECT_V2.joints:
            moved[:, KINECT_V2.index(name)] = found.positions[:, j]
    again = Take(truth.time, moved, truth.state, KINECT_V2)
    assert apart(again, truth, [*SURE, "Head", "SpineMid"]) < 1e-6
    feet = KINECT_V2.sides("Foot")
    wanted = truth.positions[:, feet]
    if tree is BREKEL:
        wanted = truth.positions[:, KINECT_V2.sides("Ankle")] + [0.0, 0.0, TOES]
    np.testing.assert_allclose(again.positions[:, feet], wanted, atol=1e-6)
    assert not found.by_kinect


@pytest.mark.parametrize(
    ("raised", "left_out"),
    [((0.5,), 1), ((0.5, -0.5), 2), ((0.5, 0.5), 0), ((0.5, -0.5, 0.5), 0)],
)
def test_rest_postures_that_leap_away_at_the_start_are_left_out(
    tmp_path: Path, raised: tuple[float, ...], left_out: int
) -> None:
    truth = scripted("walk")
    positions, wrists = truth.positions.copy(), KINECT_V2.sides("Wrist")
    for frame, height in enumerate(raised):
        positions[frame, wrists] += [[0.6, height, 0.0], [-0.6, height, 0.0]]
    truth = replace(truth, positions=positions)
    path = write_text(tmp_path / "a.bvh", bvh(truth, ROKOKO))
    recording = read_recording(path)
    (found,) = recording.takes
    assert len(found) == len(read_mocap(path).positions) == len(truth) - left_out
    assert sum("rest posture" in note for note in recording.notes) == bool(left_out)
