"""The flesh of a body: capsules that taper from joint to joint, smoothly united."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .anthropometry import Body
from .arrays import Array
from .skeleton import Skeleton

Box = tuple[slice, ...]

_LIMBS = 5  # the trunk, two arms, two legs

# How far the crease between two capsules is filled, as a share of the thinner radius:
# along the trunk, along a limb, and where a limb leaves the trunk. Guesses by eye.
_TRUNK, _LIMB, _LIMB_ON_TRUNK = 0.5, 0.2, 0.6
_NECK = 0.62  # of the head's radius, a guess by eye
_APART = 0.42  # of the distance between the hips: a thigh's radius, so that none touch
_THINNEST = 0.009  # of stature: a cell of the skin, or a thumb is lost between them
_FAR = 1.0  # m from any capsule: what the field says where nothing is near


@dataclass(frozen=True, eq=False)
class Flesh:
    """Tapered capsules in the T-pose, C of them."""

    starts: Array
    """One end of each [m], shape (C, 3)."""
    ends: Array
    """The other end, the same for a sphere [m], shape (C, 3)."""
    radii: Array
    """Radius at start and end [m], shape (C, 2)."""
    segments: NDArray[np.int64]
    """Index of the segment that each moves with, the root: pelvis, (C,)."""
    limbs: NDArray[np.int64]
    """0 for what is part of the trunk, 1 to 4 for arms and legs, shape (C,)."""

    def __len__(self) -> int:
        return len(self.starts)

    def distances(self, points: Array, which: int) -> tuple[Array, Array]:
        """Return distances [m] from a capsule, negative inside, and its radii [m].

        Both are beside points [m] (..., 3) and of shape (...).
        """
        share = nearest_on_line(points, self.starts[which], self.ends[which])
        near, far = self.radii[which]
        radius = near + share * (far - near)
        bone = self.ends[which] - self.starts[which]
        away = points - self.starts[which] - share[..., None] * bone
        return np.linalg.norm(away, axis=-1) - radius, radius

    def field(self, points: Array, boxes: list[Box] | None = None) -> Array:
        """Return the distance, about, from the united capsules, negative inside.

        Only what hangs together is rounded: arms and legs with the trunk, not with one
        another. Points [m] are (..., 3), those near a capsule in its box, if given.
        """
        limbs = np.full((_LIMBS, *points.shape[:-1]), _FAR)
        for c, k in enumerate(self.limbs):
            box = ... if boxes is None else boxes[c]
            rounding = (_LIMB if k else _TRUNK) * self.radii[c].min()
            there = self.distances(points[box], c)[0]
            limbs[k][box] = _smaller(limbs[k][box], there, rounding)
        whole: Array = limbs[0]
        for k in range(1, _LIMBS):
            rounding = _LIMB_ON_TRUNK * self.radii[self.limbs == k].max()
            whole = np.minimum(whole, _smaller(limbs[0], limbs[k], rounding))
        return whole

    def slope(self, points: Array, step: float) -> Array:
        """Return the field's gradient (P, 3) by differences over ``step`` [m]."""
        rise = [
            self.field(points + s) - self.field(points - s) for s in step * np.eye(3)
        ]
        return np.stack(rise, axis=-1) / (2.0 * step)


def nearest_on_line(points: Array, start: Array, end: Array) -> Array:
    """Return where on a line each point (..., 3) is nearest: 0 at start, 1 at end."""
    bone = end - start
    share = (points - start) @ bone / max(float(bone @ bone), 1e-12)
    return np.asarray(np.clip(share, 0.0, 1.0))


def flesh_of(body: Body) -> Flesh:
    """Return a body's capsules: pelvis, segments, a head, and a heel for each foot."""
    skeleton, rest, root = body.skeleton, body.rest_positions, body.skeleton.root
    radii = _radii(body)
    # Along a limb, the body is as thick at a joint as the mean of what meets there.
    thick = radii.copy()
    for j, children in enumerate(skeleton.children):
        if len(children) == 1:
            thick[j] = np.sqrt(radii[j] * radii[children[0]])
    rows = [(rest[root], rest[root], (thick[root], thick[root]), root)]
    for j, p in zip(skeleton.segments, skeleton.segment_parents, strict=True):
        if skeleton.joints[j] == "Head":
            neck = _NECK * radii[j]
            rows.append((rest[p], rest[j], (neck, neck), j))
            rows.append((rest[j], rest[j], (radii[j], radii[j]), j))
            continue
        # From the middle to a hip there is nothing but pelvis.
        part = root if skeleton.joints[j].startswith("Hip") else j
        rows.append((rest[p], rest[j], (thick[p], thick[j]), part))
        if skeleton.joints[j].startswith("Foot"):
            heel = np.array([rest[p, 0], radii[j], rest[p, 2]])
            rows.append((heel, rest[j], (radii[j], radii[j]), j))
    starts, ends, pairs, segments = (np.array(c) for c in zip(*rows, strict=True))
    return Flesh(starts, ends, pairs, segments, _limbs(skeleton)[segments])


def _radii(body: Body) -> Array:
    """Return the radius of each segment [m], thighs apart, shape (J,)."""
    skeleton, radii = body.skeleton, body.radii.copy()
    hips = body.rest_positions[skeleton.hips]
    widest = _APART * float(np.linalg.norm(hips[0] - hips[1]))
    legs = [j for j, n in enumerate(skeleton.joints) if n.startswith(("Knee", "Ankle"))]
    radii[legs] = np.minimum(radii[legs], widest)
    if "Neck" in skeleton.joints:
        radii[skeleton.index("Neck")] = _NECK * radii[skeleton.index("Head")]
    return np.asarray(np.maximum(radii, _THINNEST * body.height))


def _limbs(skeleton: Skeleton) -> NDArray[np.int64]:
    """Return which limb each segment is part of, 0 for the trunk, shape (J,)."""
    starts = ["ElbowLeft", "ElbowRight", "KneeLeft", "KneeRight"]
    limbs = np.zeros(len(skeleton), dtype=np.int64)
    for j, p in zip(skeleton.segments, skeleton.segment_parents, strict=True):
        name = skeleton.joints[j]
        limbs[j] = starts.index(name) + 1 if name in starts else limbs[p]
    return limbs


def _smaller(a: Array, b: Array, rounding: float) -> Array:
    """Return the smaller of two distances, rounded where they are about equal.

    Source: Quilez, smooth minimum, quadratic polynomial.
    """
    near = np.maximum(rounding - np.abs(a - b), 0.0)
    return np.minimum(a, b) - near * near / (4.0 * rounding)
