"""A body of given height and mass: segment lengths, masses and radii.

Sources:
    Lengths: Drillis & Contini 1966, body segment parameters, as drawn in Winter 2009,
        Biomechanics and Motor Control of Human Movement, figure 4.1 (fractions of
        stature). Where Kinect's joints are no anatomical landmarks (spine, head, hand,
        foot), the fraction is the median of Kinect skeletons of standing people.
    Masses: de Leva 1996, J. Biomech. 29(9), table 4, men (fractions of body mass).
    Radii: a cylinder of the segment's mass at tissue density, under its capsule's caps.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .arrays import Array, as_number, check_arrays, freeze, read_only
from .errors import InputError
from .skeleton import KINECT_V1, KINECT_V2, Skeleton, check_skeleton

GRAVITY = 9.81
"""Standard gravity [m/s^2], rounded as MuJoCo rounds it."""

STANDARD_HEIGHT = 1.75
"""Stature [m] of the standard body that postures are compared on."""

STATURES = (0.3, 3.0)
"""Statures [m] between which a body may be: anything else is a wrong unit."""

_MEASURES = {"height": (*STATURES, "m", "meters"), "mass": (2, 500, "kg", "kilograms")}
"""What a whole body measures: between what, in which unit."""
_LONGEST = 100.0  # m, of a segment: beyond, a number is damaged
_UNITS = {"millimeters": 1000.0, "centimeters": 100.0, "inches": 39.37, "feet": 3.281}
_PEOPLE = (1.2, 2.3)  # m: statures and spans, each in one of these units alone

_UNIT = 1e-3  # by which a direction may be longer than 1: single precision, and room
_DENSITY = 1050.0  # kg/m^3, whole-body tissue average (Winter 2009, section 4.1.1)
_BODY_MASS_INDEX = 22.0  # kg/m^2, middle of the WHO's normal range, if no mass is given
_FOOT_RADIUS = 0.018  # of stature: half the malleolus height of 0.039 (Winter)
_THICKEST, _THICKEST_HAND = 0.065, 0.018  # of stature

# Segment -> (length as a fraction of stature, mass as a fraction of body mass, rest
# direction, how far [degrees] it turns against its parent from there at most, twist
# included). T-pose facing +z: left is +x. Trunk masses split de Leva's upper, middle
# and lower part over the segments and the root, which share them. Ranges are those of
# motion (Norkin & White 2016, Measurement of Joint Motion, appendix B) from where the
# T-pose has the joint, and room for where Kinect's joints lie in the body: in marker
# mocap seen as Kinect joints, 1 % of the frames turn farther.
_Row = tuple[float, float, tuple[float, float, float], float]
_LIMBS: dict[str, _Row] = {
    "Shoulder": (0.110, 0.0300, (1.0, 0.0, 0.0), 50.0),
    "Elbow": (0.186, 0.0271, (1.0, 0.0, 0.0), 160.0),
    "Wrist": (0.146, 0.0162, (1.0, 0.0, 0.0), 165.0),
    "Hand": (0.046, 0.0061, (1.0, 0.0, 0.0), 100.0),
    "Hip": (0.050, 0.0300, (1.0, 0.0, 0.0), 60.0),
    "Knee": (0.245, 0.1416, (0.0, -1.0, 0.0), 140.0),
    "Ankle": (0.246, 0.0433, (0.0, -1.0, 0.0), 150.0),
    "Foot": (0.070, 0.0137, (0.0, -0.30, 0.954), 80.0),
}
_V1_TRUNK: dict[str, _Row] = {
    "Spine": (0.170, 0.1633, (0.0, 1.0, 0.0), 80.0),
    "ShoulderCenter": (0.130, 0.0996, (0.0, 1.0, 0.0), 45.0),
    "Head": (0.115, 0.0694, (0.0, 1.0, 0.0), 75.0),
}
_V2_TRUNK: dict[str, _Row] = {
    "SpineMid": (0.170, 0.1633, (0.0, 1.0, 0.0), 50.0),
    "SpineShoulder": (0.130, 0.0996, (0.0, 1.0, 0.0), 45.0),
    "Neck": (0.042, 0.0194, (0.0, 1.0, 0.0), 45.0),
    "Head": (0.075, 0.0500, (0.0, 1.0, 0.0), 75.0),
}
_V2_HANDS: dict[str, _Row] = {
    "Hand": (0.046, 0.0041, (1.0, 0.0, 0.0), 100.0),
    "HandTip": (0.040, 0.0010, (1.0, 0.0, 0.0), 90.0),
    "Thumb": (0.030, 0.0010, (0.6, 0.0, 0.8), 90.0),
}


def joint_range(name: str) -> float:
    """Return how far [rad] the segment that ends at a joint turns from the T-pose."""
    stem = name.removesuffix("Left").removesuffix("Right")
    return float(np.radians((_V1_TRUNK | _V2_TRUNK | _LIMBS | _V2_HANDS)[stem][3]))


def _table(skeleton: Skeleton) -> dict[str, _Row]:
    """Return the rows of a skeleton by joint name."""
    check_skeleton(skeleton, "a body")
    trunk, limbs = {
        KINECT_V1.name: (_V1_TRUNK, _LIMBS),
        KINECT_V2.name: (_V2_TRUNK, {**_LIMBS, **_V2_HANDS}),
    }[skeleton.name]
    root: _Row = (0.0, 0.0, (0.0, 0.0, 0.0), 0.0)
    table = {skeleton.joints[skeleton.root]: root, **trunk}
    for limb, (length, mass, (x, y, z), most) in limbs.items():
        table[f"{limb}Left"] = (length, mass, (x, y, z), most)
        table[f"{limb}Right"] = (length, mass, (-x, y, z), most)
    return table


def _measure(name: str, value: object) -> float:
    """Return the height or mass of a body, or raise an InputError."""
    least, most, unit, words = _MEASURES[name]
    number = as_number(value, f"body {name}")
    if not least < number < most:
        raise InputError(
            f"body {name} {number:g} {unit} is outside {least:g} to {most:g} {unit}; "
            f"give the {name} in {words}"
        )
    return number


def _check_segments(body: Body) -> None:
    """Raise an InputError for lengths and directions that no body has."""
    skeleton = body.skeleton
    count, ends = len(skeleton), skeleton.segments
    shapes = {"lengths": (count,), "directions": (count, 3)}
    check_arrays(body, "a body", shapes, f" for {skeleton.name}")
    lengths = body.lengths[ends]
    with np.errstate(over="ignore"):  # of a damaged file
        norms = np.linalg.norm(body.directions[ends], axis=1)
    for values, good, words in (
        (lengths, (lengths > 0.0) & (lengths < _LONGEST), "is {:g} m long"),
        (norms, np.abs(norms - 1.0) < _UNIT, "points along a vector of length {:g}"),
    ):
        if not good.all():
            k = int(np.argmin(good))
            raise InputError(
                f"the segment to {skeleton.joints[ends[k]]} {words.format(values[k])}; "
                "give lengths above 0 and unit directions"
            )


def unit_hint(size: float) -> str:
    """Return what to try where a person measures that many "meters"."""
    for unit, per_meter in _UNITS.items():
        if _PEOPLE[0] < size / per_meter < _PEOPLE[1]:
            return f"they look like {unit}: divide the positions by {per_meter:g}"
    return "are the positions in meters?"


@dataclass(frozen=True, eq=False)
class Body:
    """A body on a skeleton: what its segments measure and weigh; read-only arrays."""

    skeleton: Skeleton
    """The joints, in the order of the arrays."""
    height: float
    """Stature [m]."""
    mass: float
    """Body mass [kg]."""
    lengths: Array
    """Length [m] of the segment that ends at each joint, shape (J,), root 0."""
    directions: Array
    """Unit vector from each joint's parent to it in the T-pose, facing +z, shape
    (J, 3), root 0. Sensors differ in where trunk, hips and shoulders are."""

    def __post_init__(self) -> None:
        check_skeleton(self.skeleton, "a body")
        for name in _MEASURES:
            object.__setattr__(self, name, _measure(name, getattr(self, name)))
        _check_segments(self)
        freeze(self)

    @cached_property
    def rest_offsets(self) -> Array:
        """Vector [m] from each joint's parent to it in the T-pose, shape (J, 3)."""
        return read_only(self.directions * self.lengths[:, None])

    @cached_property
    def rest_positions(self) -> Array:
        """T-pose [m], facing +z, root above the origin, soles on y = 0, (J, 3)."""
        positions = np.zeros((len(self.skeleton), 3))
        for j in self.skeleton.segments:
            positions[j] = positions[self.skeleton.parents[j]] + self.rest_offsets[j]
        positions[:, 1] -= (positions[:, 1] - self.radii).min()
        return read_only(positions)

    @cached_property
    def masses(self) -> Array:
        """Mass [kg] of the segment that ends at each joint, root: the pelvis, (J,)."""
        table = _table(self.skeleton)
        shares = np.array([table[j][1] for j in self.skeleton.joints])
        shares[self.skeleton.root] = 1.0 - shares.sum()
        return read_only(shares * self.mass)

    @cached_property
    def radii(self) -> Array:
        """Capsule radius [m] of each segment, root: of the pelvis sphere, (J,)."""
        joints = self.skeleton.joints
        lengths = np.where(self.lengths > 0, self.lengths, np.inf)
        radii = np.sqrt(self.masses / (_DENSITY * np.pi * lengths))
        root = self.skeleton.root
        radii[root] = (self.masses[root] * 0.75 / (_DENSITY * np.pi)) ** (1 / 3)
        # Short segments are no fat discs. How thick they may be is a guess.
        radii = np.minimum(radii, _THICKEST * self.height)
        for j, joint in enumerate(joints):
            if joint.startswith("Foot"):
                radii[j] = _FOOT_RADIUS * self.height
            elif self.skeleton.hands[j]:
                radii[j] = min(radii[j], _THICKEST_HAND * self.height)
        return read_only(radii)


def standard_body(
    skeleton: Skeleton, *, height: float = STANDARD_HEIGHT, mass: float | None = None
) -> Body:
    """Return the body of average proportions.

    Stature is in m, mass in kg, by default that of a body mass index of 22 kg/m^2.
    Raises an InputError where they are not a human's.
    """
    table = _table(skeleton)
    rows = [table[joint] for joint in skeleton.joints]
    height = _measure("height", height)
    if mass is None:
        mass = _BODY_MASS_INDEX * height**2
    directions = np.array([row[2] for row in rows])
    norms = np.linalg.norm(directions, axis=1, keepdims=True)
    directions /= np.where(norms > 0, norms, 1.0)
    lengths = np.array([row[0] for row in rows]) * height
    return Body(skeleton, height, mass, lengths, directions)


def joint_masses(body: Body) -> Array:
    """Return the mass [kg] that moves with each joint, shape (J,).

    Half of every segment that meets there: the two-point model of a rod. The masses
    sum to the body's.
    """
    skeleton = body.skeleton
    masses = np.zeros(len(skeleton))
    masses[skeleton.root] = body.masses[skeleton.root]
    np.add.at(masses, skeleton.segments, 0.5 * body.masses[skeleton.segments])
    np.add.at(masses, skeleton.segment_parents, 0.5 * body.masses[skeleton.segments])
    return masses
