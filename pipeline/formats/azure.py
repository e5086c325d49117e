"""Azure Kinect: bodies as JSON, as Microsoft's sample ``offline_processor`` writes it.

Layout (microsoft/Azure-Kinect-Samples, body-tracking-samples/offline_processor):
``joint_names``, ``bone_list`` and ``frames``, each with ``timestamp_usec`` and
``bodies``, each with ``body_id``, ``joint_positions`` (32 times x, y, z in mm) and
``joint_orientations``. Programs derived from the sample add confidence levels
(k4abt_joint_confidence_level_t) to a body: 32 numbers, named ``...confidence...``.

The 32 joints are converted to the 25 of Kinect v2, on which everything else is based:
bodies, database, reliability, failures. Eyes, ears and nose show where the face looks.
Clavicles add nothing to the body. Orientations are not read: Microsoft defines their
axes only in a figure, and those of hands are reported to turn at random
(microsoft/Azure-Kinect-Sensor-SDK, issues 1414 and 1528).
"""

import re
from dataclasses import replace
from typing import Any

import numpy as np

from kinefilter.characters import KINECT_V2, InputError, State, Take
from kinefilter.characters.arrays import Array
from kinefilter.characters.motion import check_order
from kinefilter.characters.rotations import wrapped
from kinefilter.retarget import find_yaw

from .files import array_of, list_in, number_in, read_json
from .recording import Recording, Sighting, check_length, takes_of_people
from .rows import LARGEST_NUMBER

_LARGEST = 2**29  # bytes: an hour without spaces, ten minutes of two people with spaces
_TOOL = "offline_processor"

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
    "SpineBase": ("PELVIS", "PELVIS"),
    "SpineMid": ("SPINE_NAVEL", "SPINE_CHEST"),
    "SpineShoulder": ("CLAVICLE_LEFT", "CLAVICLE_RIGHT"),
    "Neck": ("NECK", "NECK"),
    "Head": ("EAR_LEFT", "EAR_RIGHT"),
}
"""Joints of Kinect v2 that differ from Azure Kinect's of similar name: each is at the
mean of these. Kinect v2 has the middle of the spine between navel and chest, its upper
end between the shoulders, and the head in the middle of the skull, not at its base."""


def _sources(joint: str) -> list[int]:
    """Return the two joints whose mean is a joint of Kinect v2, or one joint twice."""
    limb = re.sub("(Left|Right)$", r"_\1", joint).upper()
    return [JOINTS.index(name) for name in _TRUNK.get(joint, (limb, limb))]


_PAIRS = np.array([_sources(joint) for joint in KINECT_V2.joints])
_FRONT, _BACK = (
    [JOINTS.index(name) for name in names]
    for names in (("NOSE", "EYE_LEFT", "EYE_RIGHT"), ("EAR_LEFT", "EAR_RIGHT"))
)
_DEPTH = (0.03, 0.25)  # m from the ears to the face, which is 0.1 m. A guess
_ASIDE = np.radians(60.0)
"""Median angle between face and chest beyond which the face is not believed: people
turn their heads by up to 80 degrees, but not for most of a take. A guess."""
_METERS = np.array([-1e-3, -1e-3, 1e-3])
"""From millimeters to meters, from x right to x left and from y down to y up: after
this half turn about z, a person faces the sensor as in takes of Kinect v2."""


def read_azure(source: str) -> Recording:
    """Read a JSON file of bodies; raises InputError if it is malformed."""
    root = read_json(source, _LARGEST, _slim)
    frames = list_in(root, "frames", source, _TOOL)
    names = root.get("joint_names")
    if names is not None:
        # The SDK's header spells it NAVEL, its documentation NAVAL.
        listed = names if isinstance(names, list) else []
        found = tuple(str(name).replace("NAVAL", "NAVEL") for name in listed)
        if found != JOINTS:
            raise InputError(
                f"{source}: 'joint_names' are {len(found)} names, "
                f"{', '.join(found[:3])[:60]}, ..., expected the {len(JOINTS)} of "
                f"Azure Kinect in the SDK's order: {', '.join(JOINTS[:3])}, ..."
            )
    check_length(len(frames), source)
    sightings: list[Sighting] = []
    stamps = []
    for k, frame in enumerate(frames):
        where = f"{source}: frame {k + 1}"
        stamps.append(number_in(frame, "timestamp_usec", where, 1e18))
        bodies = list_in(frame, "bodies", where, _TOOL)
        sightings += [_sighting(k, body, where) for body in bodies]
    time = (np.array(stamps) - stamps[0]) * 1e-6
    check_order(time, lambda k: f"{source}: frame {k + 1}: 'timestamp_usec'", "frames")
    note = (
        "Azure Kinect: its 32 joints are converted to the 25 of Kinect v2, but may be "
        "offset differently; compare with --method local-pca"
    )
    takes, notes = takes_of_people(time, sightings, KINECT_V2, source)
    odd = [take for take in takes if not _faces_ahead(take)]
    notes += tuple(
        f"{take.source}: eyes, ears and nose do not fit the body, so the head does not "
        "follow the face"
        for take in odd
    )
    takes = tuple(replace(take, face=None) if take in odd else take for take in takes)
    return Recording(takes, unit="mm", notes=(note, *notes))


def _face(places: Array, level: Array) -> Array:
    """Return the unit vector (3,) from the ears to nose and eyes, NaN where unsure."""
    ahead: Array = places[_FRONT].mean(axis=0) - places[_BACK].mean(axis=0)
    length = np.linalg.norm(ahead)
    seen = level[_FRONT + _BACK].min() >= State.TRACKED
    sure = seen and _DEPTH[0] < length < _DEPTH[1]
    return ahead / length if sure else np.full(3, np.nan)


def _faces_ahead(take: Take) -> bool:
    """Return whether the face looks where the chest faces in most frames, if known."""
    if take.face is None:
        return True
    yaw = find_yaw(take.positions, take.skeleton)
    apart = np.arctan2(take.face[:, 0], take.face[:, 2]) - yaw
    known = np.abs(wrapped(apart[np.isfinite(apart)]))
    return not len(known) or float(np.median(known)) < _ASIDE


def _slim(value: dict[str, Any]) -> dict[str, Any]:
    """Compact a JSON object: drop what is long and unused, make arrays of the rest."""
    value.pop("joint_orientations", None)
    for key in value if "joint_positions" in value else ():
        if key == "joint_positions" or "confidence" in key:
            value[key] = array_of(value[key])
    return value


def _sighting(frame: int, body: Any, where: str) -> Sighting:
    number = number_in(body, "body_id", f"{where}: a body", 2**53)
    positions = body.get("joint_positions")
    shaped = np.shape(positions) == (len(JOINTS), 3)
    if not shaped or (np.abs(positions) > LARGEST_NUMBER).any():
        raise InputError(
            f"{where}: body {number:g} has no valid 'joint_positions', expected "
            f"{len(JOINTS)} times three finite numbers in millimeters"
        )
    levels = [item for key, item in body.items() if "confidence" in key]
    # None, low (not observed), medium, high: the last two are tracked.
    level = levels[0] if levels else np.full(len(JOINTS), 3)
    if np.shape(level) != (len(JOINTS),) or not np.isin(level, range(4)).all():
        raise InputError(
            f"{where}: body {number:g} has no valid confidence levels, expected "
            f"{len(JOINTS)} numbers: 0 none, 1 low, 2 medium or 3 high"
        )
    state = np.minimum(np.asarray(level, dtype=np.intp), State.TRACKED)
    face = _face(positions * _METERS, np.asarray(level))
    places = positions[_PAIRS].mean(axis=1) * _METERS
    state = state[_PAIRS].min(axis=1).astype(np.uint8)
    return Sighting(frame, int(number), places, state, face)
