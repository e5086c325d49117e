"""The flesh of a body in the T-pose: shapes around its bones that the skin encloses.

Each shape is a capsule that may taper and be flattened along the axes of the T-pose.
Where two meet, the surface blends smoothly from one to the other. Girths follow the
radii of the humanoid's segments and proportions the stature; the rest is by eye, with
the breadths of chest and hips in Winter 2009, figure 4.1, in mind.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .anthropometry import Body
from .arrays import Array, Indices

_LIMBS = 5  # the trunk, two arms, two legs
# Size of the blend in the crease between two shapes, as a share of the thinner radius:
# along the trunk, along a limb, and where they meet. Guesses by eye.
_TRUNK, _LIMB, _LIMB_ON_TRUNK = 0.6, 0.15, 0.6
_FAR = 1.0  # m: value of the field far from all shapes
_CLOSE = 0.1  # m beyond a shape's surface, more than any blend reaches
_WIDTH = 0.06  # of stature: half the depth of the chest of a body of average build
_SLENDER = 0.2  # of the trunk's length, if that is less
_SLIM, _STOUT = 0.8, 1.3  # times that, at most
_PONDERAL = 12.6  # kg/m^3, average: mass over cubed stature


@dataclass(frozen=True, eq=False)
class Flesh:
    """C tapered and flattened capsules (or spheres) in the T-pose."""

    starts: Array  # start points [m], shape (C, 3)
    ends: Array  # end points [m], shape (C, 3)
    radii: Array  # radii at starts and ends [m], before flattening, shape (C, 2)
    scales: Array  # factors on the thickness along x, y and z, shape (C, 3)
    segments: Indices
    """Segment that each moves with (by the joint at which it ends; the root is the
    pelvis), shape (C,)."""
    limbs: Indices  # 0 for the trunk, 1 to 4 for arms and legs, shape (C,)

    @property
    def reaches(self) -> Array:
        """Distance [m] of the surface from each bone along x, y and z, (C, 3)."""
        return np.asarray(self.radii.max(axis=1)[:, None] * self.scales)

    def distances(self, points: Array, which: int) -> tuple[Array, Array]:
        """Return approximate distances [m] to a shape, negative inside, and its radii.

        Points [m] are (..., 3); both results, in the same unit, are (...).
        """
        scale = self.scales[which]
        ends = self.starts[which] / scale, self.ends[which] / scale
        share, away = along_bone(points / scale, *ends)
        start, end = self.radii[which]
        radius = start + share * (end - start)
        return away - radius, radius

    def close_to(self, points: Array) -> list[Indices]:
        """Return for each shape the indices of the points (P, 3) close to it."""
        middles = 0.5 * (self.starts + self.ends)
        reach = 0.5 * np.linalg.norm(self.ends - self.starts, axis=1)
        reach += self.reaches.max(axis=1) + _CLOSE
        squares = [np.vecdot(points - m, points - m) for m in middles]
        return [np.flatnonzero(s < r * r) for s, r in zip(squares, reach, strict=True)]

    def field(self, points: Array, parts: Sequence[Any]) -> Array:
        """Return the approximate distance to the blended shapes, negative inside.

        Arms and legs blend with the trunk, but not with one another. Points [m] are
        (..., 3); ``parts`` selects those close to each shape.
        """
        limbs = np.full((_LIMBS, *points.shape[:-1]), _FAR)
        for c, (k, part) in enumerate(zip(self.limbs, parts, strict=True)):
            blend = (_LIMB if k else _TRUNK) * self.radii[c].min()
            distances = self.distances(points[part], c)[0]
            limbs[k][part] = _smooth_minimum(limbs[k][part], distances, blend)
        whole: Array = limbs[0]
        for k in range(1, _LIMBS):
            blend = _LIMB_ON_TRUNK * self.radii[self.limbs == k].max()
            whole = np.minimum(whole, _smooth_minimum(limbs[0], limbs[k], blend))
        return whole


def along_bone(points: Array, start: Array, end: Array) -> tuple[Array, Array]:
    """Return the nearest places on a bone (0 start, 1 end) and the distances [m]."""
    bone = end - start
    away = points - start
    share = np.clip(away @ bone / max(float(bone @ bone), 1e-12), 0.0, 1.0)
    away -= share[..., None] * bone
    return share, np.sqrt(np.vecdot(away, away))


def _smooth_minimum(a: Array, b: Array, blend: float) -> Array:
    """Return the smooth minimum of two distances (Quilez, quadratic polynomial)."""
    near = np.maximum(blend - np.abs(a - b), 0.0)
    return np.minimum(a, b) - near * near / (4.0 * blend)


@dataclass(eq=False)
class _Sculptor:
    """Collects the shapes of a body."""

    body: Body
    thinnest: float
    rows: list[tuple[Any, ...]] = field(default_factory=list)

    def add(
        self,
        segment: int,
        start: Array,
        end: Array,
        radii: tuple[float, float],
        scale: tuple[float, float, float] = (1.0, 1.0, 1.0),
    ) -> None:
        """Add a shape between two points [m], with radii [m], to a segment."""
        thinnest = self.thinnest / min(scale)
        first, last = (max(radius, thinnest) for radius in radii)
        self.rows.append((start, end, (first, last), np.array(scale), segment))

    def at(self, joint: int, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Array:
        """Return a point beside a joint, by shares of the stature."""
        offset = np.array([x, y, z]) * self.body.height
        return np.asarray(self.body.rest_positions[joint] + offset)


def girth_of(body: Body) -> float:
    """Return the girth of a body for its stature, relative to one of average build."""
    index = body.mass / body.height**3
    return float(np.clip(np.sqrt(index / _PONDERAL), _SLIM, _STOUT))


def flesh_of(body: Body, thinnest: float) -> Flesh:
    """Return the shapes of a body, none of which is thinner than twice ``thinnest``."""
    clay, skeleton = _Sculptor(body, thinnest), body.skeleton
    _add_trunk(clay)
    _add_head(clay)
    for side, sign in enumerate((1.0, -1.0)):
        _add_arm(clay, side, sign)
        _add_leg(clay, side, sign)
    # The limb of each segment: 0 for the trunk, 1 to 4 for arms and legs.
    limbs = np.zeros(len(skeleton), dtype=np.int64)
    for k, joint in enumerate([*skeleton.sides("Elbow"), *skeleton.sides("Knee")], 1):
        limbs[[joint, *skeleton.descendants(joint)]] = k
    starts, ends, radii, scales, segments = map(np.array, zip(*clay.rows, strict=True))
    return Flesh(starts, ends, radii, scales, segments, limbs[segments])


def _add_trunk(clay: _Sculptor) -> None:
    body, skeleton, at = clay.body, clay.body.skeleton, clay.at
    root, girdle = skeleton.root, skeleton.girdle
    spine = skeleton.parents[girdle]
    hips, shoulders = skeleton.hips, skeleton.sides("Shoulder")
    trunk = at(girdle) - at(root)
    # Sensors see some trunks shorter than they are: no round belly is to fill them.
    slender = _SLENDER * float(np.linalg.norm(trunk))
    wide = girth_of(body) * min(_WIDTH * body.height, slender)
    # The segments to the hips lie within the pelvis and move with it.
    clay.add(root, at(hips[0], y=0.012), at(hips[1], y=0.012), (0.74 * wide,) * 2)
    for hip, sign in zip(hips, (1.0, -1.0), strict=True):
        seat = at(hip, x=-0.006 * sign, y=-0.012, z=-0.022)
        clay.add(root, seat, seat, (0.7 * wide,) * 2)
    flat = (1.32, 1.0, 0.88)
    # By shares of the trunk, as some sensors have the spine's joint near the pelvis.
    waist = at(root) + 0.13 * trunk, at(root) + 0.47 * trunk
    clay.add(spine, *waist, (0.98 * wide, 0.9 * wide), flat)
    chest = at(root, z=0.004) + 0.63 * trunk, at(root, z=-0.002) + 0.88 * trunk
    clay.add(girdle, *chest, (1.02 * wide, 0.96 * wide), (1.42, 1.0, 0.92))
    for shoulder, sign in zip(shoulders, (1.0, -1.0), strict=True):
        breast = at(girdle, x=0.04 * sign, y=-0.036, z=0.027)
        clay.add(girdle, breast, breast, (0.62 * wide,) * 2, (1.2, 0.95, 0.62))
        # Collarbone and shoulder blade, and the muscle from there to the neck.
        inner = at(girdle, x=0.02 * sign, y=-0.012)
        outer = at(shoulder, x=-0.012 * sign, y=-0.006)
        radii = 0.5 * wide, 1.05 * body.radii[shoulder]
        clay.add(shoulder, inner, outer, radii)
        slope = at(girdle, y=0.034, z=-0.006), at(shoulder, x=-0.03 * sign, z=-0.004)
        clay.add(girdle, *slope, (0.32 * wide, 0.34 * wide))


def _add_head(clay: _Sculptor) -> None:
    skeleton, at = clay.body.skeleton, clay.at
    head, girdle, height = skeleton.index("Head"), skeleton.girdle, clay.body.height
    neck = skeleton.index("Neck") if "Neck" in skeleton.joints else head
    throat = at(girdle, z=-0.004), at(head, y=-0.03, z=-0.006)
    clay.add(neck, *throat, (0.032 * height,) * 2)
    skull = at(head, y=0.004, z=-0.006)
    clay.add(head, skull, skull, (0.052 * height,) * 2, (0.84, 1.0, 1.04))
    jaw = at(head, y=-0.018, z=0.008), at(head, y=-0.045, z=0.028)
    clay.add(head, *jaw, (0.038 * height, 0.021 * height), (0.96, 1.0, 1.0))
    nose = at(head, y=0.006, z=0.044), at(head, y=-0.014, z=0.05)
    clay.add(head, *nose, (0.008 * height, 0.010 * height))


def _add_arm(clay: _Sculptor, side: int, sign: float) -> None:
    body, skeleton, at = clay.body, clay.body.skeleton, clay.at
    parts = "Shoulder", "Elbow", "Wrist", "Hand"
    shoulder, elbow, wrist, hand = (skeleton.sides(part)[side] for part in parts)
    upper, lower, height = body.radii[elbow], body.radii[wrist], body.height
    bend = 0.5 * (upper + lower)
    middle = at(shoulder) + 0.5 * (at(elbow) - at(shoulder))
    clay.add(elbow, at(shoulder), middle, (1.3 * upper, 1.16 * upper))
    clay.add(elbow, middle, at(elbow), (1.16 * upper, 0.9 * bend))
    thick = at(elbow) + 0.28 * (at(wrist) - at(elbow))
    clay.add(wrist, at(elbow), thick, (0.9 * bend, 1.14 * lower))
    clay.add(wrist, thick, at(wrist), (1.14 * lower, 0.74 * lower))
    # Palms face down, thumbs ahead; fingers are a little bent, as they are at rest.
    palm, flat = 0.022 * height, (1.0, 0.42, 1.0)
    back = at(wrist, x=0.016 * sign), at(wrist, x=0.042 * sign)
    clay.add(hand, *back, (0.9 * palm, palm), flat)
    names = skeleton.joints
    tip = skeleton.sides("HandTip")[side] if "HandTipLeft" in names else hand
    knuckles, second = at(wrist, x=0.05 * sign), at(wrist, x=0.07 * sign, y=-0.006)
    ends, flat = at(wrist, x=0.086 * sign, y=-0.016), (1.0, 0.46, 1.0)
    clay.add(tip, knuckles, second, (0.92 * palm, 0.83 * palm), flat)
    clay.add(tip, second, ends, (0.83 * palm, 0.7 * palm), flat)
    thumb = skeleton.sides("Thumb")[side] if "ThumbLeft" in names else hand
    ball, end = at(wrist, x=0.012 * sign, z=0.012), at(wrist, x=0.042 * sign, z=0.032)
    clay.add(thumb, ball, end, (0.011 * height, 0.0095 * height))


def _add_leg(clay: _Sculptor, side: int, sign: float) -> None:
    body, skeleton, at = clay.body, clay.body.skeleton, clay.at
    names = "Hip", "Knee", "Ankle", "Foot"
    hip, knee, ankle, foot = (skeleton.sides(name)[side] for name in names)
    hips, height = body.rest_positions[skeleton.hips], body.height
    # Legs stay apart, however near to each other the hips are.
    widest = 0.42 * float(np.linalg.norm(hips[0] - hips[1]))
    thigh = min(body.radii[knee], widest)
    calf = min(1.2 * body.radii[ankle], widest)
    bend = 0.72 * thigh
    top = at(hip, x=0.006 * sign, y=-0.01)
    clay.add(knee, top, at(knee), (1.04 * thigh, bend), (1.0, 1.0, 1.12))
    thick = at(knee) + 0.27 * (at(ankle) - at(knee))
    back = thick + np.array([0.0, 0.0, -0.35]) * calf
    clay.add(ankle, at(knee), back, (0.96 * bend, calf))
    clay.add(ankle, back, at(ankle, z=-0.004), (calf, 0.62 * calf))
    clay.add(ankle, thick, at(ankle, y=0.02, z=-0.002), (0.7 * calf, 0.5 * calf))
    # Soles are on the floor.
    heel, ball, toes = 0.021 * height, 0.0265 * height, 0.022 * height
    flat, below = (1.0, 0.62, 1.0), np.array([1.0, 0.0, 1.0])
    at_heel = at(ankle, z=-0.012) * below + [0.0, heel, 0.0]
    at_ball = at(foot, z=-0.008) * below + [0.0, flat[1] * ball, 0.0]
    at_toes = at(foot, z=0.004) * below + [0.0, flat[1] * toes, 0.0]
    clay.add(foot, at_heel, at_heel, (heel,) * 2)
    clay.add(foot, at_heel, at_ball, (0.9 * heel, ball), flat)
    clay.add(foot, at(ankle, y=-0.004), at_ball, (0.95 * heel, 0.5 * ball))
    clay.add(foot, at_ball, at_toes, (ball, toes), flat)
