"""Azure Kinect: bodies as JSON, as Microsoft's sample ``offline_processor`` writes.

Layout (microsoft/Azure-Kinect-Samples, body-tracking-samples/offline_processor):
``joint_names``, ``bone_list`` and ``frames``, each with ``timestamp_usec`` and
``bodies``, each with ``body_id``, ``joint_positions`` (32 times x, y, z in mm) and
``joint_orientations``. Programs made from the sample add the joints' confidence levels
(k4abt_joint_confidence_level_t) to the body: 32 numbers under any name that has
``confidence`` in it.

The 32 joints become the 25 of Kinect v2, on which everything else stands: bodies,
database, reliability, failures. Face and clavicles tell nothing more about the body.
"""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from kinefilter.characters import KINECT_V2, InputError, State
from kinefilter.characters.motion import check_order

from .files import read_json
from .recording import Recording, Sighting, check_length, recording_of_people

_LARGEST = 2**29  # bytes: an hour without spaces, ten minutes of two people with

JOINTS = (
    *("PELVIS", "SPINE_NAVEL", "SPINE_CHEST", "NECK"),
    *("CLAVICLE_LEFT", "SHOULDER_LEFT", "ELBOW_LEFT", "WRIST_LEFT"),
    *("HAND_LEFT", "HANDTIP_LEFT", "THUMB_LEFT"),
    *("CLAVICLE_RIGHT", "SHOULDER_RIGHT", "ELBOW_RIGHT", "WRIST_RIGHT"),
    *("HAND_RIGHT", "HANDTIP_RIGHT", "THUMB_RIGHT"),
    *("HIP_LEFT", "KNEE_LEFT", "ANKLE_LEFT", "FOOT_LEFT"),
    *("HIP_RIGHT", "KNEE_RIGHT", "ANKLE_RIGHT", "FOOT_RIGHT"),
    *("HEAD", "NOSE", "EYE_LEFT", "EAR_LEFT", "EYE_RIGHT", "EAR_RIGHT"),
)
"""The joints of the body tracking SDK in its order (k4abt_joint_id_t)."""

_TRUNK = {
    "SpineBase": ("PELVIS",),
    "SpineMid": ("SPINE_NAVEL", "SPINE_CHEST"),
    "SpineShoulder": ("CLAVICLE_LEFT", "CLAVICLE_RIGHT"),
    "Neck": ("NECK",),
    "Head": ("EAR_LEFT", "EAR_RIGHT"),
}
"""Joints of Kinect v2 that lie elsewhere than Azure Kinect's of like name: at the mean
of these. Kinect v2 has the middle of the spine between navel and chest, its upper end
between the shoulders, and the head in the middle of the skull, Azure Kinect at its
base."""


def _sources(joint: str) -> list[int]:
    """Return the two joints whose mean a joint of Kinect v2 is, or twice the same."""
    limb = re.sub("(Left|Right)$", r"_\1", joint).upper()
    first, *other = _TRUNK.get(joint, (limb,))
    return [JOINTS.index(name) for name in (first, *(other or [first]))]


_PAIRS = np.array([_sources(joint) for joint in KINECT_V2.joints])
_TO_OURS = np.array([-1e-3, -1e-3, 1e-3])
"""Meters for millimeters, x to the camera's left for right, y up for down: half a turn
about z, after which a take faces the sensor as takes of Kinect v2 do."""


def read_azure(source: str) -> Recording:
    """Read a JSON file of bodies; raises InputError where it is malformed."""
    root = read_json(source, _LARGEST, _slim)
    frames = root.get("frames") if isinstance(root, dict) else None
    if not isinstance(frames, list):
        raise InputError(
            f"{source}: JSON without 'frames'; expected offline_processor's output"
        )
    names = root.get("joint_names")
    if names is not None:
        # The SDK's header spells it NAVEL, its documentation NAVAL.
        listed = names if isinstance(names, list) else []
        found = tuple(str(name).replace("NAVAL", "NAVEL") for name in listed)
        if found != JOINTS:
            raise InputError(
                f"{source}: 'joint_names' are {len(found)}, "
                f"{', '.join(found[:3])[:60]}, ..., expected the {len(JOINTS)} of "
                f"Azure Kinect in the SDK's order: {', '.join(JOINTS[:3])}, ..."
            )
    check_length(len(frames), source)
    sightings: list[Sighting] = []
    stamps = []
    for k, frame in enumerate(frames):
        where = f"{source}: frame {k + 1}"
        stamp = frame.get("timestamp_usec") if isinstance(frame, dict) else None
        if not isinstance(stamp, float) or not abs(stamp) < 1e18:
            raise InputError(f"{where} has no 'timestamp_usec', expected a number")
        stamps.append(stamp)
        bodies = frame.get("bodies")
        if not isinstance(bodies, list):
            raise InputError(f"{where} has no 'bodies', expected a list")
        sightings += [_sighting(k, body, where) for body in bodies]
    time = (np.array(stamps) - stamps[0]) * 1e-6
    check_order(time, lambda k: f"{source}: frame {k + 1}: 'timestamp_usec'", "frames")
    note = (
        "Azure Kinect: 32 joints taken for the 25 of Kinect v2, whose offsets they "
        "need not have; compare with --method local-pca"
    )
    return recording_of_people(
        time, sightings, KINECT_V2, source, "azure", unit="mm", notes=(note,)
    )


def _slim(value: dict[str, Any]) -> dict[str, Any]:
    """Return a JSON object without what is long and not read."""
    value.pop("joint_orientations", None)
    for key in value if "joint_positions" in value else ():
        if key == "joint_positions" or "confidence" in key:
            try:
                value[key] = np.array(value[key], dtype=np.float64)
            except (TypeError, ValueError):
                value[key] = None
    return value


def _sighting(frame: int, body: Any, where: str) -> Sighting:
    number = body.get("body_id") if isinstance(body, dict) else None
    if not isinstance(number, float) or not abs(number) < 2**53:
        raise InputError(f"{where} has a body without 'body_id', expected a number")
    positions = body.get("joint_positions")
    if np.shape(positions) != (len(JOINTS), 3) or np.isinf(positions).any():
        raise InputError(
            f"{where} has no 'joint_positions' of body {number:g}, expected "
            f"{len(JOINTS)} times three finite numbers in millimeters"
        )
    levels = [item for key, item in body.items() if "confidence" in key]
    # None, low (not observed), medium, high: both of the latter are tracked.
    level = levels[0] if levels else np.full(len(JOINTS), 3)
    if np.shape(level) != (len(JOINTS),) or not np.isin(level, range(4)).all():
        raise InputError(
            f"{where} has no {len(JOINTS)} confidence levels, expected 0 none, 1 low, "
            "2 medium or 3 high for each joint"
        )
    state = np.minimum(np.asarray(level, dtype=np.intp), State.TRACKED)
    places = positions[_PAIRS].mean(axis=1) * _TO_OURS
    state = state[_PAIRS].min(axis=1).astype(np.uint8)
    return Sighting(frame, int(number), places, state)
