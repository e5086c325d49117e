"""The definitions of all quality metrics that kinefilter prints.

Time stamps [s] have shape (T,). Joint positions [m] have shape (T, J, 3), NaN where
missing, in the world frame with the floor at y = 0. ``stands`` flags the planted feet
(left, right), shape (T, 2); the body has lengths, capsules and masses. A metric with
nothing to measure, such as the jitter of a take without four evenly spaced frames, is
NaN: null in JSON, a dash in tables. No metric looks across a long gap.
"""

from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from kinefilter.characters import Body
from kinefilter.characters.anthropometry import GRAVITY, joint_masses
from kinefilter.characters.arrays import Array, Flags, chunks, runs
from kinefilter.characters.gaps import LONG_GAP, parts_of
from kinefilter.characters.motion import nominal_step
from kinefilter.characters.rotations import cross

from .target.feet import ankles_and_toes, flat_height
from .target.floor import clearances
from .target.smooth import smooth

SKATE_HEIGHT = 0.05  # m above its standing height, below which no foot should slide
SKATE_SPEED = 0.2  # speed [m/s] above which a foot on the floor visibly skates

_SHORTEST_FLIGHT = 5  # frames to fit a parabola to


def _metric(meaning: str) -> Any:
    return field(metadata={"meaning": meaning})


@dataclass(frozen=True)
class Quality:
    """Quality metrics of one motion; ``METRICS`` has the meaning of each."""

    skate_mm_per_frame: float = _metric("slide of feet on the floor, mm per frame")
    skate_share_over_0p2: float = _metric("share of such frames over 0.2 m/s")
    skate_max_m_per_s: float = _metric("fastest slide of a foot on the floor, m/s")
    float_mm: float = _metric("height of planted soles over the floor, mm")
    penetration_mm: float = _metric("deepest point under the floor, mm")
    penetration_mean_mm: float = _metric("mean depth of the lowest point, mm")
    lowest_point_mm: float = _metric("height of the lowest point, mm")
    bone_length_cv: float = _metric("bone-length variation, share of the length")
    jitter: float = _metric("jitter, m/s³")
    amplitude_kept: float = _metric("amplitude kept, share of raw")
    peak_hand_speed: float = _metric("speed of hands in the fastest 1% of frames, m/s")
    flight_error: float = _metric("acceleration in flight minus gravity, m/s²")
    unexplained_force: float = _metric("force no contact explains, body weights")
    unexplained_moment: float = _metric("moment no contact explains, body weights · m")
    moved_cm: float = _metric("mean distance from raw, cm")


METRICS = {"skate": "slide of feet on the floor, m per frame"} | {
    metric.name: metric.metadata["meaning"] for metric in fields(Quality)
}
"""Meanings of the metrics by name: the names of ``clean --json``, and ``skate``."""


def bone_length_cv(positions: Array, body: Body) -> float:
    """Return the mean coefficient of variation of measured segment lengths."""
    skeleton, variations = body.skeleton, []
    for j, p in zip(skeleton.segments, skeleton.segment_parents, strict=True):
        lengths = _known(np.linalg.norm(positions[:, j] - positions[:, p], axis=1))
        if len(lengths) > 1 and lengths.any():
            variations.append(lengths.std() / lengths.mean())
    return _mean(np.array(variations))


def jitter(time: Array, positions: Array) -> float:
    """Return the mean magnitude of the third difference over dt^3 [m/s^3].

    Only runs of four frames with the joint count, evenly spaced within half a step.
    """
    third, nominal = even_differences(time, positions, 3)
    return _mean(third.T) / nominal**3


def even_differences(time: Array, positions: Array, order: int) -> tuple[Array, float]:
    """Return magnitudes of the differences of an order >= 1 [m], and the nominal step.

    The magnitudes (T - order, J), empty for too short a motion, are NaN where a step is
    off the nominal one [s] by half of it or more, or the joint is missing in a frame.
    """
    count, joints = max(len(time) - order, 0), positions.shape[1]
    steps, nominal = np.diff(time), nominal_step(time)
    even = np.abs(steps - nominal) < 0.5 * nominal
    sizes = np.full((count, joints), np.nan)
    whole = np.all([even[k : k + count] for k in range(order)], axis=0)
    for j in range(joints if count else 0):
        size = np.linalg.norm(np.diff(positions[:, j], n=order, axis=0), axis=1)
        sizes[whole, j] = size[whole]
    return sizes, nominal


def lowest_point(positions: Array, body: Body) -> Array:
    """Return the height [m] of the body's lowest point, NaN without joints, (T,).

    Segments are capsules, so their lowest point is below one of their ends.
    """
    skeleton = body.skeleton
    ends = np.concatenate([skeleton.segments, skeleton.segment_parents])
    radii = np.tile(body.radii[skeleton.segments], 2)
    return np.asarray(np.fmin.reduce(positions[:, ends, 1] - radii, axis=1))


def skate(time: Array, positions: Array, body: Body) -> tuple[float, float, float]:
    """Return how feet slide while they should be planted.

    A foot should be planted between two frames if its joint is less than 5 cm above its
    standing height in both. Returns the mean horizontal movement [mm per nominal
    frame], the share of such frames over 0.2 m/s and the top speed [m/s], or else NaN.
    """
    steps, speeds = _steps(time), []
    for foot in body.skeleton.sides("Foot"):
        height = positions[:, foot, 1] - body.radii[foot]
        low = height < SKATE_HEIGHT
        moved = np.linalg.norm(np.diff(positions[:, foot][:, [0, 2]], axis=0), axis=1)
        speeds.append((moved / steps)[low[1:] & low[:-1]])
    speed = _known(np.concatenate(speeds))
    if len(speed) == 0:
        return float("nan"), float("nan"), float("nan")
    share = float(np.mean(speed > SKATE_SPEED))
    return float(speed.mean() * nominal_step(time) * 1e3), share, float(speed.max())


def floating(positions: Array, stands: Flags, body: Body) -> float:
    """Return the mean height of the soles of planted feet over the floor [m]."""
    _, toes = ankles_and_toes(body.skeleton)
    return _mean(np.maximum(positions[:, toes, 1] - body.radii[toes], 0.0)[stands])


def peak_speed(time: Array, positions: Array, joints: list[int]) -> float:
    """Return the speed [m/s] that joints exceed in 1 % of the frames."""
    moved = np.linalg.norm(np.diff(positions[:, joints], axis=0), axis=2)
    speed = _known(moved / _steps(time)[:, None])
    return float(np.percentile(speed, 99.0)) if len(speed) else float("nan")


def flight_error(time: Array, positions: Array, stands: Flags, body: Body) -> float:
    """Return how far the center of mass is from free fall in flight [m/s^2].

    A flight is five or more frames in which no foot is planted and no point of the body
    is lower than 5 cm. Its mean acceleration (of the best-fitting parabola) is compared
    with gravity; flights are averaged weighted by their frames. Zero means consistent
    momentum. A joint that is missing in a flight has no mass.
    """
    flying = ~stands.any(axis=1) & (lowest_point(positions, body) > SKATE_HEIGHT)
    masses = joint_masses(body)
    errors, frames = [], []
    for part, flight in ((p, run) for p in parts_of(time) for run in runs(flying[p])):
        span, path = time[part][flight], positions[part][flight]
        seen = ~np.isnan(path[..., 0]).any(axis=0)
        if len(span) < _SHORTEST_FLIGHT or (np.diff(span) <= 0).any() or not seen.any():
            continue
        center = np.average(path[:, seen], axis=1, weights=masses[seen])
        fit = np.polynomial.polynomial.polyfit(span - span.mean(), center, 2)
        errors.append(float(np.linalg.norm(2.0 * fit[2] + [0.0, GRAVITY, 0.0])))
        frames.append(len(span))
    return float(np.average(errors, weights=frames)) if errors else float("nan")


def amplitude(positions: Array, body: Body) -> Array:
    """Return rms distances [m] from mean places relative to the root, or NaN, (J,)."""
    relative = positions - positions[:, [body.skeleton.root]]
    moves = np.full(positions.shape[1], np.nan)
    for j in body.skeleton.segments:
        path = relative[:, j][~np.isnan(relative[:, j, 0])]
        if len(path) > 1:
            moves[j] = np.sqrt(np.mean(np.sum((path - path.mean(axis=0)) ** 2, axis=1)))
    return moves


def _steps(time: Array) -> Array:
    """Return time steps [s], NaN at repeated stamps and long gaps, (T - 1,)."""
    steps = np.diff(time)
    return np.where((steps > 0.0) & (steps <= LONG_GAP), steps, np.nan)


def _known(values: Array) -> Array:
    return values[~np.isnan(values)]


def _mean(values: Array) -> float:
    values = _known(values)
    return float(values.mean()) if len(values) else float("nan")


def distances(positions: Array, raw: Array) -> Array:
    """Return the distance [m] of every joint from its measurement, shape (T, J)."""
    # Joint by joint, as the differences of an hour's take would fill the memory.
    pairs = zip(positions.swapaxes(0, 1), raw.swapaxes(0, 1), strict=True)
    return np.stack([np.linalg.norm(a - b, axis=1) for a, b in pairs], axis=1)


def measure(
    time: Array, positions: Array, raw: Array, body: Body, stands: Flags
) -> Quality:
    """Return the quality of a motion, relative to the ``raw`` measurement."""
    slide, share, fastest = skate(time, positions, body)
    low = _known(lowest_point(positions, body))
    moves, raw_moves = amplitude(positions, body), amplitude(raw, body)
    moving = raw_moves > 1e-6
    kept = moves[moving].sum() / raw_moves[moving].sum() if moving.any() else np.nan
    force, moment = unexplained(time, positions, body)
    return Quality(
        bone_length_cv=bone_length_cv(positions, body),
        jitter=jitter(time, positions),
        skate_mm_per_frame=slide,
        skate_share_over_0p2=share,
        skate_max_m_per_s=fastest,
        penetration_mm=float(max(-low.min(), 0.0) * 1e3),
        penetration_mean_mm=float(np.mean(np.maximum(-low, 0.0)) * 1e3),
        float_mm=floating(positions, stands, body) * 1e3,
        amplitude_kept=float(kept),
        peak_hand_speed=peak_speed(time, positions, body.skeleton.sides("Wrist")),
        flight_error=flight_error(time, positions, stands, body),
        unexplained_force=_mean(force),
        unexplained_moment=_mean(moment),
        lowest_point_mm=float(low.min() * 1e3),
        moved_cm=float(np.nanmean(distances(positions, raw)) * 1e2),
    )


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
    """Return the force and moment that contact with the floor cannot explain.

    A motion needs external forces that change its linear and angular momentum and carry
    its weight. The floor pushes on soles and other parts that touch it, but does not
    pull. What no such forces explain are the residual force and moment of inverse
    dynamics (Hicks et al. 2015, Is my model good enough?, J. Biomech. Eng. 137(2)),
    here from joint positions alone. Props such as chairs carry nothing.

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
