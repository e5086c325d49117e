"""What of a motion the floor could bear, from the positions of joints alone.

A motion needs forces from outside: what changes its linear and angular momentum, and
what carries its weight. The floor gives them through soles and other parts that are on
it, pushing but not pulling, and no farther aslant than friction lets it. What no such
forces explain comes from nowhere: the residual force and moment of inverse dynamics
(Hicks et al. 2015, Is my model good enough?, J. Biomech. Eng. 137(2)). Things such as
chairs are not known here, and bear nothing.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import nnls

from kinefilter.characters import Body
from kinefilter.characters.anthropometry import GRAVITY, joint_masses
from kinefilter.characters.arrays import Array, Flags, chunks, runs
from kinefilter.characters.gaps import parts_of

from .feet import ankles_and_toes, flat_height
from .floor import clearances
from .smooth import smooth

FRICTION = 1.0
"""Tangential over normal force that the floor gives at most, as in the simulation."""
_CUTOFF = 6.0  # Hz, zero lag, as for markers in gait (Winter 2009, section 3.4.4)
_NEAR = 0.03  # m over where it rests that a part is on the floor. A guess.
# How far a foot reaches from its ankle, in shares of stature: of its length of 0.152
# a quarter is behind; half its breadth of 0.055 (Winter 2009, figure 4.1).
_BACK, _AHEAD, _ASIDE = 0.038, 0.114, 0.0275
# Of the friction cone: a pyramid, as in the simulation.
_EDGES = np.array([[1, 0, 0], [-1, 0, 0], [0, 0, 1], [0, 0, -1]]) * FRICTION + [0, 1, 0]
_CHUNK = 4096  # frames at a time, to bound the memory


def unexplained(time: Array, positions: Array, body: Body) -> tuple[Array, Array]:
    """Return the force and the moment that no contact with the floor explains.

    Their magnitudes [body weights] and [body weights times m], the moment about the
    center of mass, shape (T,). Forces inside friction cones, at the corners of soles
    and at other joints on the floor, leave the least sum of both squared: a meter,
    about as high as the center of mass, makes them comparable. NaN where a joint is
    missing, and in the first and last frame before and after that and long gaps.

    Args:
        time: Time stamps [s], strictly increasing, shape (T,).
        positions: Joint positions [m], the floor at y = 0, shape (T, J, 3).
        body: The person.
    """
    found = np.full((len(time), 2), np.nan)
    seen = np.asarray(np.isfinite(positions).all(axis=(1, 2)))
    for part in parts_of(time):
        for run in runs(seen[part], 3):
            span, path = time[part][run], positions[part][run]
            center, wrench = required_wrench(span, path, body)
            inner, left = path[1:-1], found[part][run][1:-1]
            for some in chunks(len(inner), _CHUNK):
                cones, down = _contacts(inner[some], center[some], body)
                for k, needed in enumerate(wrench[some]):
                    edges = cones[k, np.flatnonzero(down[k])].reshape(-1, 6).T
                    if edges.size:
                        needed = needed - edges @ nnls(edges, needed)[0]
                    left[some][k] = np.linalg.norm(needed.reshape(2, 3), axis=1)
    return found[:, 0], found[:, 1]


def required_wrench(time: Array, positions: Array, body: Body) -> tuple[Array, Array]:
    """Return what a motion needs from outside in each frame but the first and last.

    Half of each segment's mass is at each of its ends (``joint_masses``), and second
    differences are smoothed at 6 Hz. Next to MuJoCo's capsules that changes moments by
    less than the smoothing does.

    Args:
        time: Time stamps [s], strictly increasing, shape (T,).
        positions: Joint positions [m], none missing, shape (T, J, 3).
        body: The person.

    Returns:
        The center of mass [m], shape (T - 2, 3), and force [body weights] and moment
        about it [body weights times m], one after the other, shape (T - 2, 6).
    """
    shares = joint_masses(body) / body.mass
    steps = np.diff(time)[:, None]
    center = shares @ positions
    momenta = np.zeros((len(steps), 2, 3))
    momenta[:, 0] = np.diff(center, axis=0) / steps
    for j, share in enumerate(shares):
        arm = positions[:, j] - center
        between = 0.5 * (arm[1:] + arm[:-1])
        momenta[:, 1] += share * np.cross(between, np.diff(arm, axis=0) / steps)
    rates = np.diff(momenta, axis=0) / (0.5 * (steps[1:] + steps[:-1]))[..., None]
    rates = smooth(time[1:-1], rates, np.ones(rates.shape[:2]), cutoff=_CUTOFF)
    rates[:, 0, 1] += GRAVITY
    return center[1:-1], rates.reshape(-1, 6) / GRAVITY


def _contacts(positions: Array, center: Array, body: Body) -> tuple[Array, Flags]:
    """Return the edges of the friction cones where the body may touch the floor.

    As wrenches about the center of mass, shape (T, K, 4, 6), and which of the places
    are on the floor, shape (T, K).
    """
    ankles, toes = ankles_and_toes(body.skeleton)
    others = np.setdiff1d(np.arange(len(body.skeleton)), [*ankles, *toes])
    places = [positions[:, others] - clearances(body)[others, None] * [0.0, 1.0, 0.0]]
    for ankle, toe in zip(ankles, toes, strict=True):
        heel, tip = positions[:, ankle].copy(), positions[:, toe].copy()
        ahead = (tip - heel) * [1.0, 0.0, 1.0]
        ahead /= np.maximum(np.linalg.norm(ahead, axis=1), 1e-6)[:, None]
        aside = ahead[:, [2, 1, 0]] * [body.height * _ASIDE, 0.0, -body.height * _ASIDE]
        tip[:, [0, 2]] = (heel + body.height * _AHEAD * ahead)[:, [0, 2]]
        heel -= body.height * _BACK * ahead
        heel[:, 1] -= flat_height(body, toe)
        tip[:, 1] -= body.radii[toe]
        places.append(
            np.stack([heel - aside, heel + aside, tip - aside, tip + aside], axis=1)
        )
    found = np.concatenate(places, axis=1)
    arms = np.broadcast_to(
        (found - center[:, None])[:, :, None], (*found.shape[:2], 4, 3)
    )
    cones = np.concatenate(
        [np.broadcast_to(_EDGES, arms.shape), np.cross(arms, _EDGES)], axis=3
    )
    return cones, np.asarray(found[..., 1] < _NEAR)
