"""What is in a file that kinefilter can read, before anything is done with it."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import (
    CONTACTS,
    KINECT_V1,
    Clip,
    InputError,
    Origin,
    Skeleton,
    State,
    Take,
)

from .database import PostureDatabase
from .failures import find_failures
from .formats import Recording, read_clip, read_recording
from .formats.contacts import claims_contacts, contact_table
from .formats.files import check_file
from .formats.mocap import Mocap, kinect_motion
from .formats.mocap_files import RIGS, read_mocap
from .formats.npz import array_names
from .formats.usd_reader import usd_contents
from .models import load_model
from .training import read_pairs

_GAP = 1.5
"""Time steps longer than this many usual ones hold frames that never arrived."""
_PARTS = {
    "left arm": ("Shoulder", "Elbow", "Wrist", "Hand", "HandTip", "Thumb"),
    "right arm": ("Shoulder", "Elbow", "Wrist", "Hand", "HandTip", "Thumb"),
    "left leg": ("Hip", "Knee", "Ankle", "Foot"),
    "right leg": ("Hip", "Knee", "Ankle", "Foot"),
}
_USD = (b"#usda", b"PXR-USDC")
_MOCAP = (".amc", ".c3d")


def contents_of(
    path: str | os.PathLike[str],
    *,
    format: str | None = None,  # noqa: A002 - the word that users know
) -> dict[str, Any]:
    """Return what a file holds, ready for ``json.dump``.

    Always ``file``, ``kind`` and ``format``; for takes ``unit``, ``notes`` and
    ``bodies``, for others what there is to say.

    Args:
        path: A take, a clip, mocap, contacts, a motion database, pairs or a model.
        format: One of the formats of ``read_take``, for takes, to not go by content.

    Raises:
        InputError: The file is missing, malformed or of no known kind.
    """
    file = check_file(path)
    with file.open("rb") as opened:
        start = opened.read(8)
    name = os.fspath(path)
    if format is None and start.startswith(_USD):
        return {"file": name, "kind": "clip", "format": "usd"} | usd_contents(name)
    if format is None and start.startswith(b"PK"):
        if file.suffix.lower() == ".usdz":
            return {"file": name, "kind": "clip", "format": "usd"} | usd_contents(name)
        return {"file": name} | _of_npz(name)
    if format is None and file.name.lower().removesuffix(".gz").endswith(_MOCAP):
        return {"file": name} | _of_mocap(read_mocap(file))
    if format is None and claims_contacts(file):
        return {"file": name} | _of_contacts(file)
    return {"file": name} | _of_recording(read_recording(path, format=format))


def _of_npz(name: str) -> dict[str, Any]:
    """Return what an npz holds: a clip, pairs, a model or a motion database."""
    arrays = array_names(name)
    kinds: dict[str, Callable[[str], dict[str, Any]]] = {
        "moved_by_physics": _of_clip,
        "mocap": _of_pairs,
        "trained_on": _of_model,
        "labels": _of_database,
    }
    for array, describe in kinds.items():
        if array in arrays:
            return describe(name)
    raise InputError(
        f"{name}: an npz of {', '.join(sorted(arrays)[:5])[:100] or 'nothing'}, which "
        "is no clip, pairs file, model or motion database of kinefilter"
    )


def _of_clip(name: str) -> dict[str, Any]:
    clip = read_clip(name)
    force = clip.external_force[np.isfinite(clip.external_force)]
    return {
        "kind": "clip",
        "format": "npz",
        "unit": "m",
        "source": clip.source,
        "skeleton": clip.skeleton.name,
        "joints": len(clip.skeleton),
        **_timing(clip.time),
        "height_m": clip.body.height,
        "mass_kg": clip.body.mass,
        "reliability": float(clip.reliability.mean()),
        "origin": {
            origin.name.lower(): float(np.mean(clip.origin == origin))
            for origin in Origin
        },
        "standing": {
            part: float(clip.contacts[:, k].mean()) for k, part in enumerate(CONTACTS)
        },
        "external_force_body_weights": float(force.mean()) if len(force) else None,
        "states": _states(clip, clip.skeleton),
    }


def _of_contacts(path: Path) -> dict[str, Any]:
    time, contacts = contact_table(path)
    return {
        "kind": "contacts",
        "format": "csv",
        "rows": len(time),
        "start_s": float(time[0]),
        "seconds": float(time[-1] - time[0]),
        "share_of_rows_on_the_floor": dict(
            zip(CONTACTS, contacts.mean(axis=0).tolist(), strict=True)
        ),
    }


def _of_pairs(name: str) -> dict[str, Any]:
    pairs = read_pairs(name)
    return {
        "kind": "pairs",
        "format": "npz",
        "skeleton": pairs[0].take.skeleton.name if pairs else None,
        "clips": len(pairs),
        "frames": sum(len(pair.take) for pair in pairs),
        "people": sorted({pair.subject for pair in pairs}),
    }


def _of_model(name: str) -> dict[str, Any]:
    from pathlib import Path

    model = load_model(Path(name))
    return {
        "kind": "model",
        "format": "npz",
        "skeleton": model.skeleton.name,
        "method": model.method,
        "learned_from": model.source,
    }


def _of_database(name: str) -> dict[str, Any]:
    from pathlib import Path

    base = PostureDatabase.load(Path(name))
    return {
        "kind": "database",
        "format": "npz",
        "skeleton": base.skeleton.name,
        "postures": len(base),
        "motions": len(set(base.labels.tolist())),
        "recorded": base.recorded,
    }


def _of_mocap(mocap: Mocap) -> dict[str, Any]:
    """Return what mocap for databases holds; its joints may be of no known rig."""
    time = np.arange(len(mocap.positions), dtype=np.float64) * mocap.frame_time
    contents = {
        "kind": "mocap",
        "format": "c3d" if mocap.rotations is None else "amc",
        "joints": len(mocap.names),
        "names": list(mocap.names),
        **_timing(time),
    }
    try:
        motion = kinect_motion(mocap, KINECT_V1, RIGS)
    except InputError as error:
        return contents | {"rig": None, "unit": None, "notes": [str(error)]}
    return contents | {"rig": motion.rig, "unit": motion.unit, "notes": []}


def _of_recording(recording: Recording) -> dict[str, Any]:
    return {
        "kind": "take",
        "format": recording.format,
        "unit": recording.unit,
        "notes": list(recording.notes),
        "bodies": [
            {"body": k + 1, "most_seen": k == recording.main} | contents_of_take(take)
            for k, take in enumerate(recording.takes)
        ],
    }


def contents_of_take(take: Take) -> dict[str, Any]:
    """Return what is in a take: time, states of parts of the body, failures."""
    seen = (take.state > State.NOT_TRACKED).any(axis=1)
    absent = (take.state == State.NOT_TRACKED).all(axis=0)
    moving = np.concatenate([[True], np.diff(take.time) > 0])
    distinct = replace(
        take,
        time=take.time[moving],
        positions=take.positions[moving],
        state=take.state[moving],
    )
    failures = find_failures(distinct) if len(distinct) > 1 else ()
    return {
        "skeleton": take.skeleton.name,
        "joints": len(take.skeleton),
        **_timing(take.time),
        "frames_without_anyone": int(np.sum(~seen)),
        "joints_never_seen": [
            joint
            for joint, gone in zip(take.skeleton.joints, absent, strict=True)
            if gone
        ],
        "states": _states(take, take.skeleton),
        "failures": [
            {
                "kind": failure.kind.name.lower(),
                "part": failure.part,
                "start_s": failure.start,
                "end_s": failure.end,
            }
            for failure in failures
        ],
    }


def _timing(time: NDArray[np.float64]) -> dict[str, Any]:
    """Return frames, duration, rate, and what is wrong with the time stamps [s]."""
    steps = np.diff(time)
    forward = steps[steps > 0]
    usual = float(np.median(forward)) if len(forward) else 0.0
    gaps = forward[forward > _GAP * usual]
    return {
        "frames": len(time),
        "start_s": float(time[0]) if len(time) else 0.0,
        "seconds": float(time[-1] - time[0]) if len(time) else 0.0,
        "fps": 1.0 / usual if usual > 0.0 else None,
        "repeated_frames": int(np.sum(steps == 0)),
        "dropped_frames": int(np.sum(np.round(gaps / usual) - 1)) if len(gaps) else 0,
        "longest_gap_s": float(gaps.max()) if len(gaps) else 0.0,
    }


def _states(motion: Take | Clip, skeleton: Skeleton) -> dict[str, dict[str, float]]:
    """Return the share of every tracking state in each part of the body."""
    limbs = {
        part: [
            skeleton.index(joint + side.capitalize())
            for joint in joints
            if joint + side.capitalize() in skeleton.joints
        ]
        for part, joints in _PARTS.items()
        for side in [part.split()[0]]
    }
    rest = set(range(len(skeleton))).difference(*limbs.values())
    return {
        part: {
            state.name.lower(): float(np.mean(motion.state[:, joints] == state))
            for state in State
        }
        for part, joints in {"trunk": sorted(rest), **limbs}.items()
    }
