"""Force and moment of a motion that contact with the floor cannot explain.

A motion needs external forces that change its linear and angular momentum and carry its
weight. The floor exerts them on soles and other parts that touch it: it pushes but does
not pull, within the friction cone. What no such forces explain are the residual force
and moment of inverse dynamics (Hicks et al. 2015, Is my model good enough?, J. Biomech.
Eng. 137(2)), here from joint positions alone. Props such as chairs carry nothing.
"""

import numpy as np

from kinefilter.characters import Body
from kinefilter.characters.anthropometry import GRAVITY, joint_masses
from kinefilter.characters.arrays import Array, Flags, chunks, runs
from kinefilter.characters.gaps import parts_of
from kinefilter.characters.rotations import cross

from .feet import ankles_and_toes
from .floor import clearances
from .resting_foot import flat_height
from .smooth import smooth

_MU = 1.0  # of friction: tangential over normal force at most, as in the simulation
_CUTOFF = 6.0  # Hz, zero lag, as for markers in gait (Winter 2009, section 3.4.4)
_NEAR = 0.03  # m above its resting height up to which a part is in contact. A guess.
# Extent of a foot from its ankle, relative to stature: a quarter of its length of 0.152
# is behind; half its breadth of 0.055 is on each side (Winter 2009, figure 4.1).
_BACK, _AHEAD, _ASIDE = 0.038, 0.114, 0.0275
# Edges of the friction cone: a pyramid, as in the simulation.
_EDGES = np.array([[1, 0, 0], [-1, 0, 0], [0, 0, 1], [0, 0, -1]]) * _MU + [0, 1, 0]
_CHUNK = 4096  # frames at a time, to bound the memory


def unexplained(time: Array, positions: Array, body: Body) -> tuple[Array, Array]:
    """Return the magnitudes of the unexplained force and moment of each frame.

    The force is in body weights and the moment about the center of mass in body weights
    times m, shape (T,). They are what is left after fitting forces inside friction
    cones, at the corners of soles and at other joints on the floor, by least squares of
    both; a meter, about the height of the center of mass, makes them comparable. NaN
    where a joint is missing, and in the frames next to these and to long gaps.

    Time stamps [s] increase strictly; positions [m], (T, J, 3), have the floor at 0.
    """
    from scipy.optimize import nnls  # slow to import, and live motion needs none

    residuals = np.full((len(time), 2, 3), np.nan)
    whole = np.asarray(np.isfinite(positions).all(axis=(1, 2)))
    for part in parts_of(time):
        for run in runs(whole[part], 3):
            path, inner = positions[part][run], residuals[part][run][1:-1]
            center, wrench = required_wrench(time[part][run], path, body)
            for some in chunks(len(center), _CHUNK):
                cones, down = _contacts(path[1:-1][some], center[some], body)
                left = wrench[some]
                for k in np.flatnonzero(down.any(axis=1)):
                    edges = cones[k, down[k]].reshape(-1, 6).T
                    left[k] -= edges @ nnls(edges, left[k])[0]
                inner[some] = left.reshape(-1, 2, 3)
    force, moment = np.linalg.norm(residuals, axis=2).T
    return force, moment


def required_wrench(time: Array, positions: Array, body: Body) -> tuple[Array, Array]:
    """Return center of mass and external wrench in every frame but the first and last.

    Half of each segment's mass is at each of its ends (``joint_masses``), and second
    differences are smoothed at 6 Hz. No joint may be missing. The center of mass is in
    m, shape (T - 2, 3); a wrench is the force [body weights] followed by the moment
    about that center [body weights times m], shape (T - 2, 6).
    """
    shares = joint_masses(body) / body.mass
    steps = np.diff(time)[:, None]
    center = shares @ positions
    momenta = np.zeros((len(steps), 2, 3))
    momenta[:, 0] = np.diff(center, axis=0) / steps
    for j, share in enumerate(shares):
        arm = positions[:, j] - center
        between = 0.5 * (arm[1:] + arm[:-1])
        momenta[:, 1] += share * cross(between, np.diff(arm, axis=0) / steps)
    rates = np.diff(momenta, axis=0) / (0.5 * (steps[1:] + steps[:-1]))[..., None]
    rates = smooth(time[1:-1], rates, np.ones(rates.shape[:2]), cutoff=_CUTOFF)
    rates[:, 0, 1] += GRAVITY
    return center[1:-1], rates.reshape(-1, 6) / GRAVITY


def _contacts(positions: Array, center: Array, body: Body) -> tuple[Array, Flags]:
    """Return friction cones at K points (T, K, 4, 6), and which are down, (T, K)."""
    ankles, toes = ankles_and_toes(body.skeleton)
    others = np.setdiff1d(np.arange(len(body.skeleton)), [*ankles, *toes])
    points = [positions[:, others] - clearances(body)[others, None] * [0.0, 1.0, 0.0]]
    for ankle, toe in zip(ankles, toes, strict=True):
        heel, tip = positions[:, ankle].copy(), positions[:, toe].copy()
        ahead = (tip - heel) * [1.0, 0.0, 1.0]
        ahead /= np.maximum(np.linalg.norm(ahead, axis=1), 1e-6)[:, None]
        aside = ahead[:, [2, 1, 0]] * [body.height * _ASIDE, 0.0, -body.height * _ASIDE]
        tip[:, [0, 2]] = (heel + body.height * _AHEAD * ahead)[:, [0, 2]]
        heel -= body.height * _BACK * ahead
        heel[:, 1] -= flat_height(body, toe)
        tip[:, 1] -= body.radii[toe]
        corners = heel - aside, heel + aside, tip - aside, tip + aside
        points.append(np.stack(corners, axis=1))
    contacts = np.concatenate(points, axis=1)
    moments = cross((contacts - center[:, None])[:, :, None], _EDGES)
    forces = np.broadcast_to(_EDGES, moments.shape)
    cones = np.concatenate([forces, moments], axis=3)
    return cones, np.asarray(contacts[..., 1] < _NEAR)
