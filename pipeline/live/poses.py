"""Poses as messages: a line of JSON each, after one that names the joints.

The first line says what the others mean::

    {"skeleton": "kinect_v2", "joints": ["SpineBase", ...], "parents": [-1, ...]}

Then comes a line a pose: ``time`` is the stamp of its frame [s] and ``body`` the
sender's id; ``root`` is the position of the root joint and ``positions`` those of all
joints, in that order [m], world frame: right-handed, y up, floor at y = 0.
``rotations`` are world rotations wxyz of the segment that ends at each joint, identity
in T-pose facing +z. ``stands`` says whether the left and the right foot stand,
``external_force`` what pulls the body beside muscles and floor [body weights],
``latency`` how long the frame has been here [ms]. Who is gone is told once:
``{"body": "1", "gone": true}``.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

from kinefilter.characters import Body, Skeleton
from kinefilter.pipeline.avatar import Pose

_DECIMALS = 5  # 0.01 mm


@dataclass(frozen=True, eq=False)
class LivePose:
    """The character of one person after a frame."""

    id: str
    """What the sender calls the person."""
    slot: int
    """The lowest number, from 0, that nobody else had when the person came."""
    time: float
    """The frame's stamp [s]."""
    body: Body
    """The person's body."""
    pose: Pose
    """The pose."""
    latency: float
    """Time since the frame came in [s]."""


def skeleton_line(skeleton: Skeleton) -> str:
    """Return the line that names the joints."""
    return _line(
        {
            "skeleton": skeleton.name,
            "joints": skeleton.joints,
            "parents": skeleton.parents,
        }
    )


def pose_line(live: LivePose) -> str:
    """Return the line of a pose."""
    pose = live.pose
    positions = pose.positions.round(_DECIMALS).tolist()
    return _line(
        {
            "time": live.time,
            "body": live.id,
            "root": positions[live.body.skeleton.root],
            "positions": positions,
            "rotations": pose.rotations.round(_DECIMALS).tolist(),
            "stands": pose.stands.tolist(),
            "external_force": round(pose.external_force, 3),
            "latency": round(live.latency * 1e3, 2),
        }
    )


def gone_line(body: str) -> str:
    """Return the line that says that somebody is gone."""
    return _line({"body": body, "gone": True})


def _line(data: dict[str, Any]) -> str:
    return json.dumps(data, separators=(",", ":"), allow_nan=False)
