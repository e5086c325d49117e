"""Where the root is while the sensor sees other joints, as of people who come near.

It keeps its place, in the heading frame, relative to the lowest joints of the trunk
that are seen, or else relative to knees or elbows.
"""

import numpy as np

from kinefilter.characters import Body, Skeleton
from kinefilter.characters.arrays import Array
from kinefilter.retarget import HeadingFrame, find_yaw


class RootTracker:
    """Places the root of each frame; until it is seen, below the trunk as at rest."""

    def __init__(self, body: Body) -> None:
        self._skeleton, self._offsets = body.skeleton, _usual_offsets(body)

    def step(self, positions: Array, yaw: Array) -> Array:
        """Return the root of the next frame [m], (3,), NaN if no mark is seen.

        Joint positions (J, 3) have y up, NaN where missing; the heading is in radians.
        """
        heading = HeadingFrame(np.zeros(3), yaw)
        marks, offsets = _marks(heading.remove(positions), self._skeleton)
        self._offsets = np.where(np.isnan(offsets), self._offsets, offsets)
        root = positions[self._skeleton.root]
        if np.isnan(root[0]):
            root = heading.restore(_first_seen(marks + self._offsets)[None])[0]
        return np.asarray(root)


def with_root(time: Array, positions: Array, body: Body) -> Array:
    """Return joints [m], (T, J, 3), with a root wherever one of its marks is seen.

    Its place relative to them is interpolated. Time stamps [s] increase strictly,
    and positions have y up, NaN where missing.
    """
    skeleton = body.skeleton
    gone = np.isnan(positions[:, skeleton.root, 0])
    if not gone.any():
        return positions
    yaw = find_yaw(positions, skeleton)
    facing = ~np.isnan(yaw)
    turns = np.unwrap(yaw[facing]) if facing.any() else np.zeros(1)
    yaw = np.interp(time, time[facing] if facing.any() else time[:1], turns)
    heading = HeadingFrame(np.zeros((len(time), 3)), yaw)
    marks, offsets = _marks(heading.remove(positions), skeleton)
    for k, usual in enumerate(_usual_offsets(body)):
        known = ~np.isnan(offsets[:, k, 0])
        if not known.any():
            offsets[:, k] = usual
            continue
        ends = time[known], offsets[known, k]
        offsets[:, k] = np.stack([np.interp(time, ends[0], x) for x in ends[1].T], 1)
    rooted = positions.copy()
    roots = heading.restore(_first_seen(marks + offsets)[:, None])[:, 0]
    rooted[gone, skeleton.root] = roots[gone]
    return rooted


def _marks(placed: Array, skeleton: Skeleton) -> tuple[Array, Array]:
    """Return what shows the root, the best first, and the root's offsets from it.

    These are the middles of hips, the spine's joints, the middle of shoulders, the
    head, and the middles of knees and of elbows; both have shape (..., K, 3).
    """
    hips, shoulders, knees, elbows = (
        list(skeleton.sides(part)) for part in ("Hip", "Shoulder", "Knee", "Elbow")
    )
    spine = [[j] for j in reversed(skeleton.ancestors(skeleton.girdle))]
    head = [skeleton.index("Head")]
    marks = [hips, *spine, shoulders, head, knees, elbows]
    places = np.stack([placed[..., joints, :].mean(axis=-2) for joints in marks], -2)
    return places, placed[..., [skeleton.root], :] - places


def _usual_offsets(body: Body) -> Array:
    """Return the offsets of an upright trunk, shape (K, 3)."""
    _, offsets = _marks(body.rest_positions, body.skeleton)
    return offsets * [0.0, 1.0, 0.0]


def _first_seen(roots: Array) -> Array:
    """Return the root by the first mark that is seen, (..., 3), of (..., K, 3)."""
    seen = ~np.isnan(roots[..., 0])
    first = np.argmax(seen, axis=-1)[..., None, None]
    return np.take_along_axis(roots, first, axis=-2)[..., 0, :]
