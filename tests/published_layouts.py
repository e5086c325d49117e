"""Small recordings written by the published layouts of formats that none is at hand in.

Each writer takes one or several takes whose rows are the frames of one recording; a
frame in which all of a person's joints are missing has no body of that person.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import KINECT_V1, KINECT_V2, State, Take
from kinefilter.pipeline.formats import azure, datasets

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
