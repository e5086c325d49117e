"""Small recordings written by the published layouts of formats that none is at hand in.

Each writer takes one or several takes whose rows are the frames of one recording; a
frame in which all of a person's joints are missing has no body of that person.
"""

from __future__ import annotations

import datetime as dt
import json
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import KINECT_V1, KINECT_V2, State, Take
from kinefilter.pipeline.formats import azure, datasets, keypoints

Array = NDArray[np.float64]


def there(take: Take, frame: int) -> bool:
    return bool((take.state[frame] > State.NOT_TRACKED).any())


def ntu_text(takes: Sequence[Take], numbers: Sequence[int] = (7, 8, 9)) -> str:
    lines = [f"{len(takes[0])}"]
    for t in range(len(takes[0])):
        bodies = [k for k, take in enumerate(takes) if there(take, t)]
        lines.append(f"{len(bodies)}")
        for k in bodies:
            lines += [f"{numbers[k]} 0 1 1 1 1 0 0.011 -0.25 2", f"{len(KINECT_V2)}"]
            for place, state in zip(
                np.nan_to_num(takes[k].positions[t]), takes[k].state[t], strict=True
            ):
                x, y, z = place.tolist()
                lines.append(
                    f"{x!r} {y!r} {z!r} 277.4 191.9 1036.9 519.2 -0.2 0.03 0.97 -0.03 "
                    f"{state}"
                )
    return "\n".join(lines) + "\n"


def azure_positions(ours: Array) -> Array:
    """Return 32 joints [mm] in Azure Kinect's axes that mean Kinect v2's (J, 3) [m]."""
    theirs = np.zeros((len(azure.JOINTS), 3))
    index = azure.JOINTS.index
    pairs = {
        "PELVIS": "SpineBase",
        "SPINE_NAVEL": "SpineMid",
        "SPINE_CHEST": "SpineMid",
        "CLAVICLE_LEFT": "SpineShoulder",
        "CLAVICLE_RIGHT": "SpineShoulder",
        "NECK": "Neck",
        "EAR_LEFT": "Head",
        "EAR_RIGHT": "Head",
        "HEAD": "Head",
        "NOSE": "Head",
    }
    for side in ("Left", "Right"):
        for joint in KINECT_V2.joints:
            if joint.endswith(side):
                name = f"{joint.removesuffix(side)}_{side}".upper()
                pairs[name] = joint
    for name, joint in pairs.items():
        x, y, z = ours[KINECT_V2.index(joint)]
        theirs[index(name)] = [-1000.0 * x, -1000.0 * y, 1000.0 * z]
    # What is a mean here lies on both sides of it there.
    for one, other in (("EAR_LEFT", "EAR_RIGHT"), ("SPINE_NAVEL", "SPINE_CHEST")):
        theirs[index(one)] += [70.0, 3.0, -5.0]
        theirs[index(other)] -= [70.0, 3.0, -5.0]
    return theirs


def azure_json(
    takes: Sequence[Take], numbers: Sequence[int] = (1, 2, 3), *, levels: bool = False
) -> str:
    frames = []
    for t, seconds in enumerate(takes[0].time.tolist()):
        bodies: list[dict[str, Any]] = []
        for k, take in enumerate(takes):
            if not there(take, t):
                continue
            positions = azure_positions(np.nan_to_num(take.positions[t]))
            body: dict[str, Any] = {
                "body_id": numbers[k],
                "joint_positions": positions.tolist(),
                "joint_orientations": [[1.0, 0.0, 0.0, 0.0]] * len(azure.JOINTS),
            }
            if levels:
                body["confidence_level"] = [int(take.state[t].min())] * 32
            bodies.append(body)
        frames.append(
            {
                "timestamp_usec": 500_000 + round(seconds * 1e6),
                "frame_id": t,
                "num_bodies": len(bodies),
                "bodies": bodies,
            }
        )
    whole = {
        "k4abt_sdk_version": "1.1.2",
        "source_file": "take.mkv",
        "joint_names": list(azure.JOINTS),
        "bone_list": [["SPINE_CHEST", "SPINE_NAVEL"]],
        "frames": frames,
    }
    return json.dumps(whole, indent=4, sort_keys=True)


def msr_action3d_text(take: Take, confidence: float = 1.0) -> str:
    order = [KINECT_V1.index(joint) for joint in datasets.MSR_JOINTS]
    rows = np.nan_to_num(take.positions[:, order]).reshape(-1, 3).tolist()
    return "".join(f"{x!r} {y!r} {z!r} {confidence}\n" for x, y, z in rows)


def msrc_12_text(take: Take, state: Array | None = None, split: str = " ") -> str:
    state = np.ones(take.state.shape) if state is None else state
    values = np.concatenate([np.nan_to_num(take.positions), state[..., None]], axis=2)
    lines = []
    for seconds, row in zip(take.time.tolist(), values, strict=True):
        stamp = 643_642_669 + round(seconds * 1e6)
        lines.append(split.join([str(stamp), *map(repr, row.ravel().tolist())]))
    return "\n".join(lines) + "\n"


# Landmarks that trackers of camera images find

MEDIAPIPE = (
    *("nose", "left_eye_inner", "left_eye", "left_eye_outer"),
    *("right_eye_inner", "right_eye", "right_eye_outer", "left_ear", "right_ear"),
    *("mouth_left", "mouth_right", "left_shoulder", "right_shoulder", "left_elbow"),
    *("right_elbow", "left_wrist", "right_wrist", "left_pinky", "right_pinky"),
    *("left_index", "right_index", "left_thumb", "right_thumb", "left_hip"),
    *("right_hip", "left_knee", "right_knee", "left_ankle", "right_ankle"),
    *("left_heel", "right_heel", "left_foot_index", "right_foot_index"),
)
"""The landmarks of MediaPipe's pose, as its documentation numbers and names them."""
POSE2SIM = (
    *("RHip", "RKnee", "RAnkle", "RBigToe", "RSmallToe", "RHeel"),
    *("LHip", "LKnee", "LAnkle", "LBigToe", "LSmallToe", "LHeel"),
    *("Neck", "Head", "Nose", "RShoulder", "RElbow", "RWrist"),
    *("LShoulder", "LElbow", "LWrist"),
)
"""The markers of Pose2Sim's demonstration, HALPE_26 without eyes and ears."""
OPENCAP = (
    *("Neck", "RShoulder", "RElbow", "RWrist", "LShoulder", "LElbow", "LWrist"),
    *("midHip", "RHip", "RKnee", "RAnkle", "LHip", "LKnee", "LAnkle", "LBigToe"),
    *("LSmallToe", "LHeel", "RBigToe", "RSmallToe", "RHeel", "r.ASIS_study"),
    *("L.ASIS_study", "r_shoulder_study", "C7_study"),
)
"""OpenCap's: no head, and bony landmarks that it adds."""


def landmarks(take: Take, names: Sequence[str]) -> Array:
    """Return landmarks by those of ``keypoints`` [m] that mean a take of Kinect v2's.

    Those of the face lie around the head, what nothing stands for at the hips' middle;
    (T, N, 3).
    """
    places = np.empty((len(take), len(names), 3))
    for n, name in enumerate(names):
        places[:, n] = take.positions[:, KINECT_V2.index(_meant(name))]
        if name in _BESIDE:
            places[:, n] += _BESIDE[name]
    return places


_JOINTS = dict.fromkeys(("nose", "head", "neckbase"), "Head") | {
    "spine": "SpineMid",
    "thorax": "SpineShoulder",
    "neck": "SpineShoulder",
}
_PARTS = dict.fromkeys(("index", "pinky"), "Hand") | {
    **dict.fromkeys(("footindex", "bigtoe", "smalltoe"), "Foot"),
    **dict.fromkeys(("ear", "eye"), "Head"),
    **{p.lower(): p for p in ("Shoulder", "Elbow", "Wrist", "Hip", "Knee", "Ankle")},
}
_BESIDE = {  # m, in pairs about the joint
    "lear": np.array([0.07, 0.01, -0.02]),
    "rear": np.array([-0.07, -0.01, 0.02]),
    "head": np.array([0.0, 0.1, 0.02]),
    "nose": np.array([0.0, -0.1, -0.02]),
    "neckbase": np.array([0.0, -0.1, -0.02]),
    **{f"{s}bigtoe": np.array([0.03, 0.0, 0.0]) for s in "lr"},
    **{f"{s}smalltoe": np.array([-0.03, 0.0, 0.0]) for s in "lr"},
    **{f"{s}index": np.array([0.0, 0.03, 0.0]) for s in "lr"},
    **{f"{s}pinky": np.array([0.0, -0.03, 0.0]) for s in "lr"},
}


def _meant(name: str) -> str:
    if name in _JOINTS:
        return _JOINTS[name]
    part = _PARTS.get(name[1:])
    if name == "lfoot" or name == "rfoot":
        part = "Ankle"
    if part is None:
        return "SpineBase"
    return part if part == "Head" else part + ("Left" if name[0] == "l" else "Right")


def z_up(places: Array) -> Array:
    """Return places as they are where z points up: a quarter turn about x."""
    x, y, z = np.moveaxis(places, -1, 0)
    return np.stack([x, -z, y], axis=-1)


def y_down(places: Array) -> Array:
    """Return places in a camera's axes: half a turn about z."""
    return places * [-1.0, -1.0, 1.0]


def freemocap_csv(take: Take, start: str | None = None) -> str:
    """Write FreeMoCap's trajectories [mm], z up, with date and time if it has those."""
    columns = [f"body_{name}_{axis}" for name in MEDIAPIPE for axis in "xyz"]
    rows = 1000.0 * z_up(landmarks(take, keypoints.BLAZEPOSE)).reshape(len(take), -1)
    lines = [",".join(["timestamp", "timestamp_by_camera", *columns])]
    for seconds, row in zip(take.time.tolist(), rows.tolist(), strict=True):
        stamp = ""
        if start is not None:
            began = dt.datetime.fromisoformat(start)
            stamp = str(began + dt.timedelta(seconds=seconds))
        cells = ["" if value != value else repr(value) for value in row]
        lines.append(",".join([stamp, "\"{'a': 1, 'b': 2}\"", *cells]))
    return "\n".join(lines) + "\n"


def openpose_frames(
    takes: Sequence[Take], confidence: Array | None = None
) -> list[dict[str, Any]]:
    """Return what OpenPose writes with --3d for each frame: mm, y down; c is 1 or 0."""
    count = len(keypoints.BODY_25)
    frames = []
    for t in range(len(takes[0])):
        people = []
        for take in takes:
            if not there(take, t):
                continue
            places = 1000.0 * y_down(landmarks(take, keypoints.BODY_25))[t]
            sure = np.ones(count) if confidence is None else confidence[t]
            rows = np.concatenate([np.nan_to_num(places), sure[:, None]], axis=1)
            people.append(
                {
                    "person_id": [-1],
                    "pose_keypoints_2d": [],
                    "pose_keypoints_3d": rows.ravel().tolist(),
                    "hand_left_keypoints_3d": [],
                }
            )
        frames.append({"version": 1.3, "people": people})
    return frames


def mmpose_json(takes: Sequence[Take], *, named: bool = False) -> str:
    """Write what MMPose's 3D lifters predict: z up, the lowest landmark at 0."""
    names = keypoints.HUMAN_36M
    frames = []
    for t in range(len(takes[0])):
        bodies = []
        for take in takes:
            if there(take, t):
                places = z_up(landmarks(take, names))[t]
                places[:, 2] -= places[:, 2].min()
                scores = [0.9] * len(names)
                bodies.append({"keypoints": places.tolist(), "keypoint_scores": scores})
        frames.append({"frame_id": t + 1, "instances": bodies})
    if not named:
        return json.dumps(frames)
    table = {str(k): name for k, name in enumerate(names)}
    return json.dumps(
        {"meta_info": {"keypoint_id2name": table}, "instance_info": frames}
    )
