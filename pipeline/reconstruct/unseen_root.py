"""Where the root is while the sensor sees other joints, as of people who come near.

It keeps its place, in the heading frame, relative to the lowest joints of the trunk
that are seen, or else relative to knees or elbows.
"""

import numpy as np

from kinefilter.characters import Body, Skeleton
from kinefilter.characters.arrays import Array
from kinefilter.retarget import HeadingFrame, find_yaw


def upright_places(body: Body) -> Array:
    """Return where joints are relative to the root of an upright body, (J, 3)."""
    rest = body.rest_positions - body.rest_positions[body.skeleton.root]
    return np.asarray(rest * [1.0, 1.0, 0.0])


def unseen_root(
    positions: Array, yaw: Array, places: Array, skeleton: Skeleton
) -> Array:
    """Return the root of a frame [m], (3,), NaN if no joint shows it.

    Joint positions (J, 3) have y up, NaN where missing; the heading is in radians, and
    ``places`` are those of joints relative to the root in the heading frame, (J, 3).
    """
    heading = HeadingFrame(np.zeros(3), yaw)
    shown = _marks(heading.remove(positions), skeleton) - _marks(places, skeleton)
    return np.asarray(heading.restore(_first_seen(shown)[None])[0])


def with_root(time: Array, positions: Array, body: Body) -> Array:
    """Return joints [m], (T, J, 3), with a root wherever another joint shows it.

    Places relative to the root are interpolated. Time stamps [s] increase strictly,
    and positions have y up, NaN where missing.
    """
    skeleton = body.skeleton
    gone = np.isnan(positions[:, skeleton.root, 0])
    if not gone.any():
        return positions
    yaw = interpolated_yaw(positions, skeleton)
    heading = HeadingFrame(np.zeros((len(time), 3)), yaw)
    marks = _marks(heading.remove(positions), skeleton)
    places = marks - heading.remove(positions[:, [skeleton.root]])
    for k, usual in enumerate(_marks(upright_places(body), skeleton)):
        known = ~np.isnan(places[:, k, 0])
        seen, there = time[known], places[known, k]
        for axis in range(3):
            between = (
                np.interp(time, seen, there[:, axis]) if len(seen) else usual[axis]
            )
            places[:, k, axis] = between
    rooted = positions.copy()
    roots = heading.restore(_first_seen(marks - places)[:, None])[:, 0]
    rooted[gone, skeleton.root] = roots[gone]
    return rooted


def interpolated_yaw(positions: Array, skeleton: Skeleton) -> Array:
    """Return the headings of frames [rad], (T,), interpolated where unknown.

    They are 0 if no frame shows one. Positions [m] (T, J, 3) have y up.
    """
    yaw, frames = find_yaw(positions, skeleton), np.arange(len(positions))
    known = ~np.isnan(yaw)
    if not known.any():
        return np.zeros(len(yaw))
    return np.interp(frames, frames[known], np.unwrap(yaw[known]))


def _marks(placed: Array, skeleton: Skeleton) -> Array:
    """Return what shows the root, the best first, shape (..., K, 3).

    These are the middles of hips, the spine's joints, the middle of shoulders, the
    head, and the middles of knees and of elbows.
    """
    hips, shoulders, knees, elbows = (
        list(skeleton.sides(part)) for part in ("Hip", "Shoulder", "Knee", "Elbow")
    )
    spine = [[j] for j in reversed(skeleton.ancestors(skeleton.girdle))]
    head = [skeleton.index("Head")]
    marks = [hips, *spine, shoulders, head, knees, elbows]
    return np.stack([placed[..., joints, :].mean(axis=-2) for joints in marks], -2)


def _first_seen(roots: Array) -> Array:
    """Return the root by the first mark that is seen, (..., 3), of (..., K, 3)."""
    seen = ~np.isnan(roots[..., 0])
    first = np.argmax(seen, axis=-1)[..., None, None]
    return np.take_along_axis(roots, first, axis=-2)[..., 0, :]
