"""Skeletons, bodies, motions and the MuJoCo humanoid."""

from .anthropometry import (
    STANDARD_HEIGHT,
    Body,
    positions_from_rotations,
    standard_body,
)
from .errors import InputError, KinefilterError
from .motion import CONTACTS, Clip, Motion, Origin, State, Take, Term
from .props import Prop, Shape, ShapeKind
from .skeleton import KINECT_V1, KINECT_V2, SKELETONS, Skeleton, skeleton_named
from .tracking import TRACKINGS, Tracking, TrackingName

__all__ = [
    "CONTACTS",
    "KINECT_V1",
    "KINECT_V2",
    "SKELETONS",
    "STANDARD_HEIGHT",
    "TRACKINGS",
    "Body",
    "Clip",
    "InputError",
    "KinefilterError",
    "Motion",
    "Origin",
    "Prop",
    "Shape",
    "ShapeKind",
    "Skeleton",
    "State",
    "Take",
    "Term",
    "Tracking",
    "TrackingName",
    "positions_from_rotations",
    "skeleton_named",
    "standard_body",
]
