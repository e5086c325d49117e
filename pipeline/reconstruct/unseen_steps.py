"""Steps of legs that are never seen, such as those of people behind a desk.

A foot stays in place until it is too far from where the posture has it. Of people who
walk forward, trunk, arms and head show which foot swings: a linear map, learned from
recordings in which legs were seen (``pipeline.lab.limb_lessons``), gives the cycle.
"""

import numpy as np
from scipy.ndimage import gaussian_filter1d

from kinefilter.characters import Body, Skeleton
from kinefilter.characters.arrays import Array, Flags, chunks, runs
from kinefilter.characters.motion import nominal_step, values_at
from kinefilter.retarget import HeadingFrame
from kinefilter.retarget.limbs import smooth_step

from .continuity import middle_joint
from .prior import Mode, MotionPrior, network_name

_AROUND = np.linspace(-0.8, 0.8, 17)
GAIT_TIMES: dict[Mode, Array] = {"between": _AROUND, "before": _AROUND[:9]}
"""Times [s] of the frames that show the gait, relative to its own: with later frames,
and without."""
PACE = 6.0
"""Rate [rad/s] by which the speed of legs is divided: about that of a walk."""
# The following were chosen on CMU's 02, 05, 07, 16, 29 and 32, on p00 to p08 of
# two-kinects, on a gesture, and on a quarter of PRECOG 2016's fights.
WALKS = 0.4  # m/s: people who move forward faster than that walk, in training
_WALKS = 0.3  # the same where the gait is predicted
_SWINGS = {"between": 0.08, "before": 0.25}  # m: least predicted amplitude of a walk
_BOTH = 0.1  # share of a step for which both feet are on the floor
_AHEAD = 0.2  # s: a foot steps to where the posture has it after that
_REACH = 0.15  # m from there at which it steps
_NEAR = 0.1  # the same for the foot that swings in a walk
_ALTERNATES = 0.6  # share of the other foot's distance at which the next foot steps
_STEP, _QUICKEST = 0.4, 0.2  # s of a step while nobody walks, and of the fastest
# s: least duration of a gap whose legs step; of the return to filled legs at its ends;
# and over which a walk begins and ends there.
_LEAST, _FADES, _RAMP = 0.5, 1.0, 0.3
_PER_SPEED, _LIFTS = 0.16, (0.04, 0.2)  # highest lift: m per m/s, and its range [m]


def gait_inputs(motion: Array, skeleton: Skeleton) -> tuple[Array, Array, Array]:
    """Return what shows the gait, (N, 6 L), and how people go.

    The motion is joint positions [m] at GAIT_TIMES, shape (N, L, J, 3). People face a
    direction (x and z, a unit vector, (N, 2)) and go some distance [m] that way, (N,).
    Mirrored motion has inputs of the opposite sign.
    """
    level = motion[..., [0, 2]]
    shoulders, elbows, wrists = (
        skeleton.sides(part) for part in ("Shoulder", "Elbow", "Wrist")
    )
    line = motion[..., shoulders[0], :] - motion[..., shoulders[1], :]
    yaw = np.unwrap(np.arctan2(-line[..., 2], line[..., 0]), axis=1)
    mean = yaw.mean(axis=1)
    left = np.stack([np.cos(mean), -np.sin(mean)], axis=1)
    ahead = np.stack([np.sin(mean), np.cos(mean)], axis=1)
    middle = level[..., shoulders, :].mean(axis=-2)

    def along(vectors: Array, axis: Array) -> Array:
        return np.asarray(np.einsum("nlc,nc->nl", vectors, axis))

    signals = np.stack(
        [
            yaw,
            along(middle, left),
            along(level[..., wrists[0], :] - level[..., wrists[1], :], ahead),
            along(level[..., elbows[0], :] - level[..., elbows[1], :], ahead),
            along(level[..., skeleton.index("Head"), :] - middle, left),
            line[..., 1],
        ],
        axis=2,
    )
    signals -= signals.mean(axis=1, keepdims=True)
    slope = np.linspace(-1.0, 1.0, signals.shape[1])[:, None]
    trend = np.sum(slope * signals, axis=1, keepdims=True) / np.sum(slope**2)
    way = np.sum((middle[:, -1] - middle[:, 0]) * ahead, axis=1)
    return (signals - trend * slope).reshape(len(motion), -1), ahead, way


def gait(
    time: Array,
    positions: Array,
    at: Array,
    mode: Mode,
    prior: MotionPrior,
    skeleton: Skeleton,
) -> tuple[Array, Array]:
    """Return the cycle and the speed [m/s] of a walk at some times [s], each (N,).

    In the cycle, the left foot swings from -1 to 0 and the right one from 0 to 1; it is
    NaN where nobody walks.
    """
    around, parts = GAIT_TIMES[mode], []
    for some in chunks(len(at)):  # which bounds the memory
        motion = values_at(time, positions, at[some, None] + around)
        parts.append(gait_inputs(motion, skeleton)[::2])
    inputs, way = (np.concatenate(part) for part in zip(*parts, strict=True))
    speed = way / (around[-1] - around[0])
    if (name := network_name("gait", mode)) not in prior.networks:
        return np.full(len(at), np.nan), speed
    apart, faster = prior.change(name, inputs).T
    walks = (np.hypot(apart, faster) > _SWINGS[mode]) & (speed > _WALKS)
    cycle = np.arctan2(-faster, apart) / np.pi
    return np.where(walks, cycle, np.nan), speed


class Steps:
    """Steps of two feet, frame by frame, from where the ankles are at first, (2, 3)."""

    def __init__(self, ankles: Array) -> None:
        self._places, self._from = ankles.copy(), ankles.copy()
        self._foot, self._last, self._share = -1, 1, 0.0

    def step(self, elapsed: float, goals: Array, cycle: float) -> tuple[Array, Array]:
        """Return ankles [m], (2, 3), and which part of its step each has made, (2,).

        It is NaN for a foot that stands. The goals (2, 3) are where the posture has the
        ankles, ``cycle`` is as in ``gait``, and ``elapsed`` the time since the previous
        frame [s].
        """
        side = int(cycle >= 0.0)
        made = (cycle % 1.0 - _BOTH) / (1.0 - _BOTH)
        walks = not np.isnan(cycle)
        if self._foot >= 0:
            quick = self._share + elapsed / _QUICKEST
            if not walks:
                self._share += elapsed / _STEP
            elif side == self._foot:
                self._share = max(self._share, min(made, quick))
            else:
                self._share = quick
            if self._share >= 1.0:
                self._places[self._foot] = goals[self._foot]
                self._last, self._foot = self._foot, -1
        if self._foot < 0:
            self._foot = self._next(goals, side if walks else -1, made)
            self._share = max(made, 0.0) if walks else elapsed / _STEP
            self._share = min(self._share, elapsed / _QUICKEST)
            self._from = self._places.copy()
        ankles, shares = self._places.copy(), np.full(2, np.nan)
        if (foot := self._foot) >= 0:
            shares[foot] = self._share
            way = goals[foot] - self._from[foot]
            ankles[foot] = self._from[foot] + smooth_step(self._share) * way
        return ankles, shares

    def _next(self, goals: Array, side: int, made: float) -> int:
        """Return the foot that begins a step, -1 for none."""
        away = np.linalg.norm((goals - self._places)[:, [0, 2]], axis=1)
        if side >= 0:
            return side if 0.0 < made < 1.0 - _BOTH and away[side] > _NEAR else -1
        if away.max() < _REACH:
            return -1
        other = 1 - self._last
        return other if away[other] > _ALTERNATES * away.max() else self._last


def lifts(shares: Array, speed: Array) -> Array:
    """Return how high ankles are lifted [m], (..., 2), by ``Steps`` and speed (...)."""
    most = (_PER_SPEED * speed).clip(*_LIFTS)[..., None]
    made = np.nan_to_num(shares).clip(0.0, 1.0)
    return np.asarray(most * np.sin(np.pi * np.sqrt(made)))


def step_unseen(
    time: Array, placed: Array, heading: HeadingFrame, body: Body, prior: MotionPrior
) -> None:
    """Let legs step that a take never shows, in place.

    Joints [m] (T, J, 3) are in the heading frame, and legs as the posture has them.
    Time stamps [s] (T,) increase strictly. Feet stay in the mean place of each stance.
    """
    skeleton, positions = body.skeleton, heading.restore(placed)
    homes = positions[:, skeleton.sides("Ankle")]
    cycle, speed = gait(time, positions, time, "between", prior, skeleton)
    ankles = _stepping(time, homes, homes[0], cycle, speed)
    put_feet(placed, heading.remove(ankles), body)


def step_hidden(
    time: Array,
    positions: Array,
    placed: Array,
    heading: HeadingFrame,
    gone: Flags,
    body: Body,
    prior: MotionPrior,
) -> Array:
    """Return joints [m] (T, J, 3) in which legs of walkers step while they are hidden.

    Both legs are ``gone`` in some frames, (T,). In ``positions`` they were filled, and
    stay so near the ends of gaps; ``placed`` has them as the posture has them, in the
    heading frame.
    """
    skeleton, rate = body.skeleton, 1.0 / nominal_step(time)
    ankles = skeleton.sides("Ankle")
    cycle, speed = gait(time, positions, time, "between", prior, skeleton)
    walks = gaussian_filter1d((~np.isnan(cycle)).astype(float), _RAMP * rate)
    homes, share = heading.restore(placed)[:, ankles], smooth_step(walks)
    steps = positions[:, ankles]
    near = np.zeros(len(time))
    for gap in runs(gone, max(round(_LEAST * rate), 1)):
        start = steps[gap.start - 1] if gap.start else homes[0]
        steps[gap] = _stepping(time[gap], homes[gap], start, cycle[gap], speed[gap])
        ends = (time[gap.start - 1 : gap.start], time[gap.stop : gap.stop + 1])
        away = [np.abs(time[gap] - end[0]) for end in ends if len(end)]
        near[gap] = np.min(away, axis=0)
    share *= smooth_step(near / _FADES)
    some, found = share > 0.0, positions.copy()
    frames = heading.at(some)
    filled, stepping = frames.remove(positions[some]), frames.remove(steps[some])
    way = share[some, None, None] * (stepping - filled[:, ankles])
    put_feet(filled, filled[:, ankles] + way, body)
    found[some] = frames.restore(filled)
    return found


def _stepping(
    time: Array, homes: Array, start: Array, cycle: Array, speed: Array
) -> Array:
    """Return ankles [m] (T, 2, 3) that step to where the posture has them (homes)."""
    goals = values_at(time, homes, time + _AHEAD)
    steps, elapsed = Steps(start), np.diff(time, prepend=time[0])
    frames = zip(elapsed.tolist(), goals, cycle.tolist(), strict=True)
    shares = np.array([steps.step(*frame)[1] for frame in frames])
    ankles = np.stack([_standing(homes[:, k], shares[:, k]) for k in range(2)], axis=1)
    ankles[..., 1] = homes[..., 1] + lifts(shares, speed)
    return ankles


def _standing(home: Array, share: Array) -> Array:
    """Return an ankle [m], (T, 3), that stands in the mean place of each stance."""
    ankle, swings = home.copy(), ~np.isnan(share)
    stances = runs(~swings)
    for stance in stances:
        ankle[stance] = home[stance].mean(axis=0)
    for swing in runs(swings):
        first = ankle[swing.start - 1] if swing.start else home[0]
        last = ankle[swing.stop] if swing.stop < len(home) else home[-1]
        way = smooth_step(share[swing])[:, None] * (last - first)
        ankle[swing] = first + way
    return ankle


def put_feet(placed: Array, ankles: Array, body: Body) -> None:
    """Put ankles [m] (..., 2, 3), and the knees between, in the heading frame."""
    skeleton, lengths = body.skeleton, body.lengths
    parts = (skeleton.sides(part) for part in ("Hip", "Knee", "Ankle"))
    for side, (hip, knee, ankle) in enumerate(zip(*parts, strict=True)):
        joints = placed[..., hip, :], placed[..., knee, :], ankles[..., side, :]
        bent = middle_joint(*joints, (lengths[knee], lengths[ankle]))
        placed[..., knee, :], placed[..., ankle, :] = bent


def both_legs(pointed: Flags, skeleton: Skeleton) -> bool:
    """Return True if all of both legs is among joints (J,)."""
    return bool(pointed[[*skeleton.sides("Knee"), *skeleton.sides("Ankle")]].all())
