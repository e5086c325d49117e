"""How far elbows and knees of clips bend from the axis that they have in mocap.

Reads CMU's mocap, in whose skeleton elbows and knees are hinges, and cleans it as it is
and as a virtual Kinect sees it. Prints the mean angle [degrees] between a limb's axis
in the mocap and in the clip, after both limbs are laid on each other: of clips, and of
the same joints with limbs that twist as the trunk. Rows are for how far the limb bends.

    python tests/twist_figures.py ../shared/data/mocap/cmu/{08_01,12_02,35_01}.bvh.gz
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kinefilter import Cleaner, read_take
from kinefilter.characters import KINECT_V2, Clip
from kinefilter.characters.rotations import about_y, between, inverse, rotate, unit
from kinefilter.pipeline.commands.terminal import out
from kinefilter.pipeline.formats.mocap import read_mocap
from kinefilter.pipeline.formats.recording import Mocap
from kinefilter.pipeline.lab.recorded_acts import mocap_act
from kinefilter.retarget import Hinges
from kinefilter.scenes.sensor import observe

_BENT = np.radians([0.0, 15.0, 40.0, 180.0])
_WELL_BENT = np.sin(np.radians(40.0))
_LIMBS = {
    f"{joint}{side}": [f"{side}{bone}" for bone in bones]
    for side in ("Left", "Right")
    for joint, bones in {
        "Elbow": ("Arm", "ForeArm", "Hand"),
        "Knee": ("UpLeg", "Leg", "Foot"),
    }.items()
}

Array = NDArray[np.float64]


class Truth(NamedTuple):
    """A limb in mocap, world frame: bone and axis of its upper segment, its bend."""

    bone: Array  # unit vectors, (T, 3)
    axis: Array  # unit vectors, (T, 3)
    bend: Array  # angle [rad], (T,)


def truths(mocap: Mocap, clip: Clip, since: Array) -> dict[str, Truth]:
    """Return the limbs of mocap in the frames of a clip [s] and with its heading."""
    frames = np.abs(mocap.stamps[:, None] - mocap.stamps[0] - since).argmin(axis=0)
    place, turn = {n: k for k, n in enumerate(mocap.names)}, mocap.rotations
    assert turn is not None
    joints = mocap.positions[frames]
    left, right = clip.body.skeleton.sides("Hip")
    headings = [
        np.exp(1j * np.arctan2(-line[:, 2], line[:, 0]))
        for line in (
            joints[:, place["LeftUpLeg"]] - joints[:, place["RightUpLeg"]],
            clip.positions[:, left] - clip.positions[:, right],
        )
    ]
    about, found = about_y(np.angle(np.vdot(*headings))), {}
    for joint, names in _LIMBS.items():
        start, middle, end = (joints[:, place[name]] for name in names)
        upper, lower = unit(middle - start), unit(end - middle)
        across, turns = np.cross(upper, lower), turn[frames, place[names[0]]]
        local = rotate(inverse(turns), across)
        bent = np.linalg.norm(across, axis=1) > _WELL_BENT
        if not bent.any():
            continue
        axis = rotate(turns, unit(local[bent].mean(axis=0)))
        bend = np.arccos(np.vecdot(upper, lower).clip(-1.0, 1.0))
        found[joint] = Truth(rotate(about, upper), rotate(about, axis), bend)
    return found


def away(rotations: Array, clip: Clip, joint: str, true: Truth) -> Array:
    """Return the angles between axes in a clip and in mocap [degrees], (T,)."""
    j = clip.body.skeleton.index(joint)
    turns, along = rotations[:, j], clip.body.directions[j]
    bends = np.array([0.0, 0.0, 1.0 if joint.startswith("Elbow") else -1.0])
    axis = rotate(turns, np.cross(along, bends))
    onto = between(rotate(turns, along), true.bone)
    cosine = np.vecdot(rotate(onto, axis), true.axis)
    return np.degrees(np.arccos(cosine.clip(-1.0, 1.0)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", type=Path, nargs="+")
    parser.add_argument("--seed", type=int, default=77)
    chosen = parser.parse_args()
    found: dict[tuple[str, str, int], list[Array]] = {}
    for file in chosen.files:
        act = mocap_act(file, KINECT_V2, 30.0)
        seen = observe(act, seed=chosen.seed, person=chosen.seed)
        for name, take in (("mocap", read_take(file)), ("Kinect", seen)):
            clip = Cleaner().clean(take).clip
            limbs = truths(read_mocap(file), clip, clip.time - take.time[0])
            plain = Hinges(clip.body).untwisted(clip.positions)
            for joint, true in limbs.items():
                both = plain, clip.rotations
                pair = [away(turns, clip, joint, true) for turns in both]
                rows = np.digitize(true.bend, _BENT[1:-1])
                for k in np.unique(rows).tolist():
                    values = np.stack(pair, axis=1)[rows == k]
                    found.setdefault(
                        (name, joint[: -4 if joint.endswith("Left") else -5], k), []
                    ).append(values)
    out.print("seen by, joint, bent [degrees], frames, as trunk, clip")
    for (name, joint, k), values in sorted(found.items()):
        low, high = np.degrees(_BENT[k : k + 2]).round().astype(int)
        rows = np.concatenate(values)
        means = (f"{value:5.1f}" for value in rows.mean(axis=0))
        out.print(f"{name:7s} {joint:5s} {low:3d}-{high:3d} {len(rows):6d}", *means)


if __name__ == "__main__":
    main()
