"""Segment lengths, masses and radii of a body of a given height and mass.

Sources:
    Lengths: Drillis & Contini 1966, body segment parameters, as drawn in Winter 2009,
        Biomechanics and Motor Control of Human Movement, figure 4.1 (fractions of
        stature). Where Kinect's joints are not anatomical landmarks (spine, head, hand,
        foot), the fraction is the median of Kinect skeletons of standing people.
    Masses: de Leva 1996, J. Biomech. 29(9), table 4, men (fractions of body mass).
    Radii: a cylinder of the segment's mass and tissue density, plus the capsule's caps.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .arrays import Array, as_number, check_arrays, freeze, read_only
from .errors import InputError
from .rotations import rotate, slerp, unit
from .skeleton import KINECT_V1, KINECT_V2, Skeleton, check_skeleton

GRAVITY = 9.81  # standard gravity [m/s^2], rounded as MuJoCo rounds it

STANDARD_HEIGHT = 1.75
"""Stature [m] of the standard body, on which postures are compared."""

STATURES = (0.3, 3.0)
"""Smallest and largest stature of a body [m]; anything else is in a wrong unit."""

_LIMITS = {"height": (*STATURES, "m", "meters"), "mass": (1, 500, "kg", "kilograms")}
_LONGEST = 100.0  # m: a longer segment comes from a damaged file
_UNITS = {"millimeters": 1000.0, "centimeters": 100.0, "inches": 39.37, "feet": 3.281}
_PEOPLE = (1.2, 2.3)  # m: statures and arm spans; only one of the units fits a number

_UNIT = 1e-3  # tolerance for the length of directions in single precision
_DENSITY = 1050.0  # kg/m^3, whole-body tissue average (Winter 2009, section 4.1.1)
_BODY_MASS_INDEX = 22.0  # kg/m^2, middle of the WHO's normal range, if no mass is given
_FOOT_RADIUS = 0.018  # of stature: half the malleolus height of 0.039 (Winter)
_LARGEST_RADIUS, _LARGEST_HAND_RADIUS = 0.065, 0.018  # of stature. Guesses.

# Segment -> (length as a fraction of stature, mass as a fraction of body mass, rest
# direction, largest angle [degrees] to its parent, measured from there and including
# twist). The T-pose faces +z, so left is +x. The trunk's segments and the root share
# the masses of de Leva's upper, middle and lower trunk. Angles are ranges of motion
# (Norkin & White 2016, Measurement of Joint Motion, appendix B) relative to the T-pose,
# plus a margin for where Kinect's joints lie in the body: in marker mocap converted to
# Kinect joints, 1 % of the frames exceed them. Wrists have what people use of theirs
# (``retarget.Palms``), or contact with the body would bend them to their limits.
_Row = tuple[float, float, tuple[float, float, float], float]
_LIMBS: dict[str, _Row] = {
    "Shoulder": (0.110, 0.0300, (1.0, 0.0, 0.0), 50.0),
    "Elbow": (0.186, 0.0271, (1.0, 0.0, 0.0), 160.0),
    "Wrist": (0.146, 0.0162, (1.0, 0.0, 0.0), 165.0),
    "Hand": (0.046, 0.0061, (1.0, 0.0, 0.0), 56.0),
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
    "Hand": (0.046, 0.0041, (1.0, 0.0, 0.0), 56.0),
    "HandTip": (0.040, 0.0010, (1.0, 0.0, 0.0), 90.0),
    "Thumb": (0.030, 0.0010, (0.6, 0.0, 0.8), 90.0),
}


def joint_range(name: str) -> float:
    """Return the largest angle [rad] of a joint's segment from its T-pose."""
    stem = name.removesuffix("Left").removesuffix("Right")
    return float(np.radians((_V1_TRUNK | _V2_TRUNK | _LIMBS | _V2_HANDS)[stem][3]))


def _table(skeleton: Skeleton) -> dict[str, _Row]:
    check_skeleton(skeleton, "a body")
    trunk, limbs = {
        KINECT_V1.name: (_V1_TRUNK, _LIMBS),
        KINECT_V2.name: (_V2_TRUNK, {**_LIMBS, **_V2_HANDS}),
    }[skeleton.name]
    root: _Row = (0.0, 0.0, (0.0, 0.0, 0.0), 0.0)
    table = {skeleton.joints[skeleton.root]: root, **trunk}
    for limb, (length, mass, (x, y, z), angle) in limbs.items():
        table[f"{limb}Left"] = (length, mass, (x, y, z), angle)
        table[f"{limb}Right"] = (length, mass, (-x, y, z), angle)
    return table


def _checked_size(name: str, value: object) -> float:
    """Return the height or mass of a body, or raise an InputError."""
    least, most, unit, words = _LIMITS[name]
    number = as_number(value, f"body {name}")
    if not least <= number <= most:
        raise InputError(
            f"body {name} {number:g} {unit} is outside {least:g} to {most:g} {unit}; "
            f"give the {name} in {words}"
        )
    return number


def unit_hint(size: float) -> str:
    """Return advice for a person whose size is implausible in meters."""
    for name, per_meter in _UNITS.items():
        if _PEOPLE[0] < size / per_meter < _PEOPLE[1]:
            return f"they look like {name}: divide the positions by {per_meter:g}"
    return "are the positions in meters?"


@dataclass(frozen=True, eq=False)
class Body:
    """Size and mass of a person's segments; arrays are read-only."""

    skeleton: Skeleton  # the joints, in the order of the arrays
    height: float  # stature [m]
    mass: float  # body mass [kg]
    lengths: Array
    """Length [m] of the segment that ends at each joint, shape (J,), root 0."""
    directions: Array
    """Unit vector to each joint from its parent in the T-pose facing +z, shape (J, 3),
    root 0. Sensors differ in where they place trunk, hips and shoulders."""

    def __post_init__(self) -> None:
        check_skeleton(self.skeleton, "a body")
        for name in _LIMITS:
            object.__setattr__(self, name, _checked_size(name, getattr(self, name)))
        _check_segments(self)
        freeze(self)

    @cached_property
    def rest_offsets(self) -> Array:
        """Vector [m] to each joint from its parent in the T-pose, shape (J, 3)."""
        return read_only(self.directions * self.lengths[:, None])

    @cached_property
    def rest_positions(self) -> Array:
        """T-pose [m] facing +z, root above the origin, soles at y = 0, shape (J, 3)."""
        positions = np.zeros((len(self.skeleton), 3))
        for j in self.skeleton.segments:
            positions[j] = positions[self.skeleton.parents[j]] + self.rest_offsets[j]
        positions[:, 1] -= (positions[:, 1] - self.radii).min()
        return read_only(positions)

    @cached_property
    def masses(self) -> Array:
        """Mass [kg] of each segment, shape (J,); the root's row is the pelvis."""
        table = _table(self.skeleton)
        shares = np.array([table[j][1] for j in self.skeleton.joints])
        shares[self.skeleton.root] = 1.0 - shares.sum()
        return read_only(shares * self.mass)

    @cached_property
    def radii(self) -> Array:
        """Capsule radius [m] of each segment, shape (J,); the pelvis is a sphere."""
        skeleton, root = self.skeleton, self.skeleton.root
        lengths = np.where(self.lengths > 0, self.lengths, np.inf)
        radii = np.sqrt(self.masses / (_DENSITY * np.pi * lengths))
        radii[root] = (self.masses[root] * 0.75 / (_DENSITY * np.pi)) ** (1 / 3)
        # A bound on the radius keeps short segments from becoming thick discs.
        bounds = np.where(skeleton.hands, _LARGEST_HAND_RADIUS, _LARGEST_RADIUS)
        radii = np.minimum(radii, bounds * self.height)
        radii[skeleton.sides("Foot")] = _FOOT_RADIUS * self.height
        return read_only(radii)


def _check_segments(body: Body) -> None:
    skeleton = body.skeleton
    count, ends = len(skeleton), skeleton.segments
    shapes = {"lengths": (count,), "directions": (count, 3)}
    check_arrays(body, "a body", shapes, f" for {skeleton.name}")
    lengths = body.lengths[ends]
    with np.errstate(over="ignore"):  # damaged files hold huge numbers
        norms = np.linalg.norm(body.directions[ends], axis=1)
    for values, valid, words in (
        (lengths, (lengths > 0.0) & (lengths < _LONGEST), "is {:g} m long"),
        (norms, np.abs(norms - 1.0) < _UNIT, "points along a vector of length {:g}"),
    ):
        if not valid.all():
            k = int(np.argmin(valid))
            raise InputError(
                f"the segment to {skeleton.joints[ends[k]]} {words.format(values[k])}; "
                "give lengths above 0 and unit directions"
            )


def standard_body(
    skeleton: Skeleton, *, height: float = STANDARD_HEIGHT, mass: float | None = None
) -> Body:
    """Return a body of average proportions.

    Stature is in m, mass in kg; by default, the body mass index is 22 kg/m^2. Raises an
    InputError if they are not those of a human.
    """
    table = _table(skeleton)
    rows = [table[joint] for joint in skeleton.joints]
    height = _checked_size("height", height)
    if mass is None:
        mass = _BODY_MASS_INDEX * height**2
    directions = unit(np.array([row[2] for row in rows]))
    lengths = np.array([row[0] for row in rows]) * height
    return Body(skeleton, height, mass, lengths, directions)


def joint_masses(body: Body) -> Array:
    """Return the mass [kg] at each joint, (J,): half of every segment at each end."""
    skeleton = body.skeleton
    halves, masses = 0.5 * body.masses[skeleton.segments], body.masses.copy()
    masses[skeleton.segments] = halves
    np.add.at(masses, skeleton.segment_parents, halves)
    return masses


def positions_from_rotations(rotations: Array, root: Array, body: Body) -> Array:
    """Return joint positions [m] of a body, world frame, shape (..., J, 3).

    Rotations are those of segments in the world, unit quaternions wxyz, identity in the
    T-pose, shape (..., J, 4); ``root`` is the position of the root joint [m], (..., 3).
    """
    bones = rotate(rotations, body.rest_offsets)
    positions = np.empty_like(bones)
    skeleton = body.skeleton
    positions[..., skeleton.root, :] = root
    for j, p in zip(skeleton.segments, skeleton.segment_parents, strict=True):
        positions[..., j, :] = positions[..., p, :] + bones[..., j, :]
    return positions


def within_ranges(rotations: Array, skeleton: Skeleton) -> Array:
    """Return rotations (..., J, 4) with no joint beyond its ``joint_range``.

    They are those of segments in the world, unit quaternions wxyz. From the root
    outward, segments turn back the short way and no farther than they must; those
    beyond keep their rotations if their own ranges allow it.
    """
    found = rotations.copy()
    for j, p in zip(skeleton.segments, skeleton.segment_parents, strict=True):
        start, end = found[..., p, :], found[..., j, :]
        most = joint_range(skeleton.joints[j])
        angle = 2.0 * np.arccos(np.minimum(np.abs(np.vecdot(start, end)), 1.0))
        if (beyond := angle > most).any():
            found[beyond, j] = slerp(start[beyond], end[beyond], most / angle[beyond])
    return found
