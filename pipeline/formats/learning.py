"""Joint motions for learning and robots, SMPL's as in AMASS: z up, meters, even frames.

AMASS: Mahmood et al., AMASS: Archive of Motion Capture as Surface Shapes, ICCV 2019.
"""

from typing import Any

import numpy as np

from kinefilter.characters import Clip
from kinefilter.characters.rotations import about_x, multiply, rotate, rotation_vector

from .export import Export
from .files import AnyPath
from .npz import write_arrays
from .rig import RigMotion

_TO_Z_UP = about_x(np.pi / 2.0)
_JOINTS = {"smpl": 52, "smplx": 55}
"""Number of joints of SMPL-H, whose layout AMASS uses for SMPL, and of SMPL-X. Fingers
and face follow those of the body, and are at rest."""
_BODY = 22
_PARTS = {"root_orient": (0, 1), "pose_body": (1, 22)}
_PARTS_X = {"pose_jaw": (22, 23), "pose_eye": (23, 25), "pose_hand": (25, 55)}
_BETAS = 16  # as many as in AMASS; zeros are the average body


def write_joints(clip: Clip, motion: RigMotion, path: AnyPath, export: Export) -> None:
    """Write the world positions and orientations of a rig's joints as npz.

    For SMPL and SMPL-X also the arrays of AMASS; CONVENTIONS.md lists all of them.
    Raises InputError if the file cannot be written.
    """
    rig, rate = motion.rig, export.fps or clip.fps
    turns = motion.rotations
    world = turns if rig.axes is None else multiply(turns, rig.axes)
    places = rotate(_TO_Z_UP, motion.positions)
    arrays: dict[str, Any] = {
        "global_joint_positions": places,
        "global_joint_orientations": multiply(_TO_Z_UP, world),
        "joint_names": np.array(rig.names),
        "parents": np.array(rig.parents),
        "fps": rate,
        "height": clip.body.height,
    }
    if export.rig in _JOINTS:
        poses = np.zeros((len(turns), _JOINTS[export.rig], 3))
        local = rig.local_rotations(turns)[:, :_BODY]
        local[:, 0] = multiply(_TO_Z_UP, local[:, 0])
        poses[:, :_BODY] = rotation_vector(local)
        parts = _PARTS | (_PARTS_X if export.rig == "smplx" else {})
        for name, (first, end) in parts.items():
            arrays[name] = poses[:, first:end].reshape(len(poses), -1)
        arrays |= {
            "poses": poses.reshape(len(poses), -1),
            "trans": places[:, 0],
            "betas": np.zeros(_BETAS),
            "num_betas": _BETAS,
            "gender": "neutral",
            "surface_model_type": "smplx" if export.rig == "smplx" else "smplh",
            "mocap_framerate": rate,  # the name in files of SMPL-H
            "mocap_frame_rate": rate,  # the name in files of SMPL-X
        }
    write_arrays(path, arrays)
