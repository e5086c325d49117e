"""The stages a frame passes, and the one call that runs them all.

1. Failures of the tracker that go on for many frames, left and right exchanged, a leg
   bent backwards, an arm in the head or out of its range, a limb that leaps, are found,
   mended where that helps, and told (``failures``).
2. Reliability of every joint (Shum et al. 2013): vibration, segment lengths and the
   sensor's tracking state, the smallest of the three, averaged over the last six frames
   (``reliability.shum``; others beside it).
3. Correction (``correct``): every joint is moved by where in the body this kind of
   sensor sees it, as learned on simulated people (``default``). Then the five database
   postures nearest to the reliable joints span a posture space; the posture of least
   energy in it (control, style, segment lengths, continuity) moves the unreliable
   joints. Reliable joints stay where they are. Where the database does not hold the
   posture, the measurement is kept, and the summary says so. A database of recorded
   mocap also takes back what no posture does: how the postures around it vary tells
   error from movement.
4. Target (``target``): smoothed without lag, the more the slower a joint is; set on the
   floor, leveled if somebody walks before a tilted sensor; on the person's own bones,
   measured again after correction. Feet that stand are found (the most probable
   sequence of standing and stepping), stay where they stand, and are lifted where they
   step (``target.contacts``, ``target.planting``).
5. Physics (``physics``): each joint is pulled by a bounded PD force that knows the
   target's velocity and acceleration, each segment turned by a bounded torque; MuJoCo
   keeps lengths, joints and their ranges, gravity, friction, and flesh out of flesh.
   Standing feet press on the floor with the body's weight, so the floor carries; what
   is left over is told frame by frame as external force. With a scene the character
   sits on chairs and holds things between its hands.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .config import CleanConfig
from .database import PostureDatabase
from .formats import Export, read_clip, read_take, read_takes, write_clip

if TYPE_CHECKING:
    from .avatar import Avatar, Pose
    from .run import CleanResult, clean

__all__ = [
    "Avatar",
    "CleanConfig",
    "CleanResult",
    "Export",
    "Pose",
    "PostureDatabase",
    "clean",
    "read_clip",
    "read_take",
    "read_takes",
    "write_clip",
]


def __getattr__(name: str) -> Any:
    """Return what loads MuJoCo and scikit-learn only when it is asked for."""
    if name in ("Avatar", "Pose"):
        from . import avatar

        return getattr(avatar, name)
    if name in ("CleanResult", "clean"):
        from . import run

        return getattr(run, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
