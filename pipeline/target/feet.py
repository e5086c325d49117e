"""Stance detection.

Time stamps [s] increase strictly, (T,); joint positions [m] have y up, (T, J, 3);
confidence is (T, J); ``stands`` says whether each foot is planted, left and right,
(T, 2).
"""

import numpy as np

from kinefilter.characters import Body, Skeleton
from kinefilter.characters.anthropometry import GRAVITY
from kinefilter.characters.arrays import Array, Flags, runs

from .smooth import smooth
from .stance_odds import stance_odds

_CUTOFF = 3.0  # Hz: slower than Kinect's noise in the feet, faster than stances
_LEAST_WEIGHT = 0.1  # of an invented ankle in the smoother; a measured one has 1
# Log odds of being planted, by logistic regression on simulated takes (51 motions, of
# other people and seeds). On six recorded people the area under the ROC curve is 0.99.
_BASE_ODDS = 4.0
_PER_SPEED = 5.0  # per m/s of the ankle, also upwards: a jump lifts both ankles at once
_FASTEST = 1.3  # m/s: faster feet count as that fast. With 1, those of runners bear
_PER_LIFT = 15.0  # per m of the ankle above the other
_PER_HEIGHT = 12.0  # per m of both above what Kinect's errors in squats lift them by
_LOWER, _HIGHER = -0.1, 0.3  # m: heights are clipped to this range
_ERROR_OF_HEIGHT = 0.1  # m
# m of a resting foot over the floor: at most 0.11 in the half of the recorded takes
# that chose it, and 0.08 in the other half.
_OFF_FLOOR = 0.25
_STANDING = 20.0  # percentile of the ankles' heights that is taken for planted
_SWITCH = 4.0  # cost of a change in log odds: the hysteresis. A guess.
_DOUBT = 0.5
"""Log odds that a live change needs. Feet of s02, s03 and s04 and of CMU's 02, 05, 06,
07, 10, 16, 29 and 32 then change 70 times a minute, without it 92 times, and in mocap
81 times, by networks that learned from the other half of these people."""
# Log odds in one frame with which a live foot still stands in the next, so that one
# wrong frame lifts none. Steps of simulated people (seeds 0 to 3) are known no later.
_SURE = 2.0
# s of the shortest live step, without which feet that leave their place land at once,
# and m of an ankle above one that bears, at which it does not land. Chosen on the same
# people and on p00 to p08 of two-kinects; with 0.1 s, contacts flicker.
_SWING, _ABOVE = 0.15, 0.08
_RECENT = 0.8  # s of motion that is kept, twice as much as the odds need
_ROUNDING = 1e-9  # s: of time stamps
_RATE = 30.0  # Hz of the takes that the odds are for: a higher rate adds no evidence
_DRIFT = 0.15  # m: an ankle that moved farther has made a step that was not detected
# m that toes, and rad that the hips, turn in a step on the spot. With less, the feet of
# s02, s03 and s04 seem to step in more of the exercises in which they stand.
_SWUNG, _TURNED = 0.1, np.radians(40.0)
_FREE_FALL = -0.75 * GRAVITY
"""Least upward acceleration [m/s^2] of a smoothed trunk between two stances that tells
a jump: those of simulated people go below -0.78 g, of steps and turns mostly not below
-0.6 g (seeds 100 to 102)."""
_AT_REST = 0.08
"""Distance [m] of toes from their place up to which a foot bears. With 0.03, walkers
stand on neither foot, and hover, in 27 % of the frames of CMU's people 02, 05, 07, 16
and 29 before a virtual Kinect, where 13 % are right; with 0.15, more feet slide."""
_UNLOADING = 0.15  # s from the first rise of a foot to its leaving the floor
_STEP = 0.4  # s: duration of such a step, and of the shortest between two stances

LIFT_TIME = 0.1  # s to lift a foot by the clearance, and to set it down
SLIDE_SPEED = 0.15  # m/s: a foot that is faster is lifted
CLEARANCE = 0.065  # m under a moving sole. People walk with less, but seem to slide


def ankles_and_toes(skeleton: Skeleton) -> tuple[list[int], list[int]]:
    """Return the indices of the ankles and of the toes, left and right."""
    return skeleton.sides("Ankle"), skeleton.sides("Foot")


def flat_height(body: Body, toe: int) -> float:
    """Return the height [m] of the ankle of a foot that is flat on the floor."""
    ankle = float(body.rest_positions[body.skeleton.parents[toe], 1])
    return min(ankle, float(body.radii[toe] + body.lengths[toe]))


def find_stance(
    time: Array, positions: Array, confidence: Array, skeleton: Skeleton
) -> Flags:
    """Return the frames in which each foot is planted, (T, 2), left and right.

    A foot is planted while its ankle rests and is no higher than the other. Viterbi's
    algorithm finds the most probable sequence; every change has a cost, which makes it
    a hysteresis that looks ahead. Between stances, feet hand the body over.
    """
    (ankles, toes), hips = ankles_and_toes(skeleton), list(skeleton.hips)
    paths = _smoothed(time, positions, confidence, ankles)
    speed, step, height = np.zeros(paths.shape[:2]), 1.0 / _RATE, paths[..., 1]
    if len(time) > 1:
        speed = np.linalg.norm(np.gradient(paths, time, axis=0), axis=2)
        step = float(np.median(np.diff(time)))
    above = height - np.percentile(height, _STANDING) - _ERROR_OF_HEIGHT
    stands = _most_probable(_RATE * step * _odds(speed, height, above))
    tips = _smoothed(time, positions, confidence, toes)
    left, right = np.moveaxis(_smoothed(time, positions, confidence, hips), 1, 0)
    yaw = np.unwrap(np.arctan2((left - right)[:, 2], (left - right)[:, 0]))
    anything = np.ones(len(time), dtype=np.bool_)
    for foot in range(2):
        own, other = stands[:, foot], stands[:, 1 - foot]
        # Whoever turns on the spot hardly moves the ankles, but the toes.
        for stance in runs(own):
            if np.ptp(yaw[stance]) > _TURNED:
                _split(time, tips[:, foot, ::2], own, stance, _SWUNG, other)
        for stance in runs(own):
            _split(time, paths[:, foot, ::2], own, stance, _DRIFT, anything)
    return _handed_over(time, positions, confidence, _unloaded(time, stands), skeleton)


def _smoothed(
    time: Array, positions: Array, confidence: Array, joints: list[int]
) -> Array:
    weights = np.maximum(confidence[:, joints], _LEAST_WEIGHT)
    return smooth(time, positions[:, joints], weights, cutoff=_CUTOFF)


def on_floor(positions: Array, stands: Flags, body: Body) -> Flags:
    """Return the stances on the floor, which is at y = 0, (T, 2).

    Feet may also rest high above it: of people who hang from a bar or lie on a bed.
    """
    (ankles, toes), low = ankles_and_toes(body.skeleton), stands.copy()
    for foot, (ankle, toe) in enumerate(zip(ankles, toes, strict=True)):
        most = flat_height(body, toe) + _OFF_FLOOR
        for stance in runs(stands[:, foot]):
            low[stance, foot] = np.median(positions[stance, ankle, 1]) <= most
    return low


def planted_feet(contacts: Flags) -> Flags:
    """Return whether each foot is planted, (T, 2), from contacts (CONTACTS), (T, 4)."""
    return np.asarray(contacts.reshape(-1, 2, 2).any(axis=2))


def _odds(speed: Array, height: Array, above: Array) -> Array:
    """Return the log odds of being planted, shape (..., 2)."""
    odds = _BASE_ODDS - _PER_SPEED * np.minimum(speed, _FASTEST)
    odds -= _PER_LIFT * (height - height[..., ::-1]).clip(_LOWER, _HIGHER)
    odds -= _PER_HEIGHT * above.clip(0.0, _HIGHER)
    return np.asarray(odds)


def _most_probable(log_odds: Array) -> Flags:
    """Return the most probable sequence of two states; each change costs _SWITCH."""
    # Only the lead of one state over the other counts. The cost of a change caps it,
    # and which cap it hits says where the best sequence came from.
    lead = log_odds.copy()
    for k in range(1, len(lead)):
        lead[k] += lead[k - 1].clip(-_SWITCH, _SWITCH)
    stands = lead > 0.0
    for k in range(len(lead) - 2, -1, -1):
        stands[k] = np.where(stands[k + 1], lead[k] > -_SWITCH, lead[k] > _SWITCH)
    return stands


class StanceTracker:
    """Stance detector for live motion, without look-ahead.

    A change needs log odds of ``_DOUBT``. A foot that moved away from where it landed
    no longer stands.
    """

    def __init__(self) -> None:
        self._time, self._legs = np.empty(0), np.empty((0, 4, 3))
        self._places, self._lifted = np.zeros((2, 2)), np.zeros(2)
        self._toes, self._left = np.full((2, 3), np.nan), np.full(2, -np.inf)
        self._stands, self._odds = np.ones(2, dtype=np.bool_), np.zeros(2)
        self._strays = ~self._stands

    def step(self, time: float, legs: Array) -> Flags:
        """Return whether each foot is planted in the next frame, shape (2,).

        ``legs`` are those of ``stance_odds`` in that frame, shape (4, 3).
        """
        places = legs[2:, [0, 2]]
        if not len(self._time):
            self._places = places
        recent = self._time > time - _RECENT
        self._time = np.append(self._time[recent], time)
        self._legs = np.concatenate([self._legs[recent], legs[None]])
        odds = stance_odds(self._time, self._legs)
        away = np.linalg.norm(places - self._places, axis=1)
        # One frame may be wrong: no foot lets go that stood for certain in the last.
        stood, stays = self._stands, (odds > -_DOUBT) | (self._odds > _SURE)
        strays = away > _DRIFT
        stays &= ~(strays & self._strays)
        self._odds, self._strays = odds, strays
        above = legs[2:, 1] - legs[:1:-1, 1]
        lands = (odds > _DOUBT) & (time >= self._left + _SWING)
        lands &= ~(self._stands[::-1] & (above > _ABOVE))
        self._stands = np.where(stood, stays, lands)
        self._left = np.where(stood & ~self._stands, time, self._left)
        self._places = np.where(stood[:, None], self._places, places)
        return self._stands

    def let_go(self, feet: Flags) -> Flags:
        """Return the planted feet after some, shape (2,), have begun to step."""
        self._left = np.where(self._stands & feet, self._time[-1], self._left)
        self._stands = self._stands & ~feet
        return self._stands

    def lift(self, toes: Array, heights: Array, dt: float) -> Array:
        """Return by how much to lift each foot [m] so that none slides, shape (2,).

        To be called after ``step`` with the positions of the toes [m], shape (2, 3),
        and the heights of the soles above the floor, shape (2,).
        """
        speed = np.linalg.norm((toes - self._toes)[:, [0, 2]], axis=1) / dt
        self._toes = toes.copy()
        most = CLEARANCE / LIFT_TIME * dt
        needed = np.where(~self._stands & (speed > SLIDE_SPEED), CLEARANCE, 0.0)
        self._lifted = self._lifted + (needed - self._lifted).clip(-most, most)
        above = np.where(self._stands, 0.0, heights)
        return np.maximum(self._lifted - above, 0.0)


def _unloaded(time: Array, stands: Flags) -> Flags:
    """Return stances shortened by the time to set the foot down and to lift it."""
    shorter = stands.copy()
    for foot in range(2):
        for stance in runs(stands[:, foot]):
            now = time[stance]
            margin = min(_UNLOADING, 0.25 * (now[-1] - now[0]))
            if stance.start > 0:
                shorter[stance, foot] &= now >= now[0] + margin - _ROUNDING
            if stance.stop < len(time):
                shorter[stance, foot] &= now < now[-1] - margin + _ROUNDING
    return shorter


def _handed_over(
    time: Array, positions: Array, confidence: Array, stands: Flags, skeleton: Skeleton
) -> Flags:
    """Return stances extended so that each foot hands the body over to the other.

    Who does not jump always has a foot on the floor: one bears until the other does,
    where toes are nearest to these places. No foot bears farther than ``_AT_REST``
    from its place, nor where less than a step (``_STEP``) of its own would remain.
    """
    longer, (_, toes) = stands.copy(), ankles_and_toes(skeleton)
    if len(time) < 2:
        return longer
    trunk = positions[:, [skeleton.root, skeleton.girdle]].mean(axis=1, keepdims=True)
    height = smooth(time, trunk, np.ones(trunk.shape[:2]), cutoff=_CUTOFF)[:, 0, 1]
    acceleration = np.gradient(np.gradient(height, time), time)
    paths = _smoothed(time, positions, confidence, toes)
    for gap in runs(np.asarray(~stands.any(axis=1))):
        inside = gap.start > 0 and gap.stop < len(time)
        if inside and acceleration[gap].min() > _FREE_FALL:
            feet = np.flatnonzero(stands[gap.start - 1] & stands[gap.stop, ::-1])
            options = [_hand_over(time, paths, longer, gap, k) for k in feet.tolist()]
            if options:
                longer[gap] = min(options, key=lambda option: option[0])[1]
    return longer


def _hand_over(
    time: Array, paths: Array, stands: Flags, gap: slice, foot: int
) -> tuple[float, Flags]:
    """Return a cost, and the stances of a gap, (N, 2), where a foot hands over.

    The cost is how far the toes that bear are from their place, summed over frames [m].
    """
    before, after, other = gap.start - 1, gap.stop, 1 - foot
    around = time[before] - _STEP, time[after] + _STEP
    earliest, latest = np.searchsorted(time, around)
    again = time[after:latest][stands[after:latest, foot]].min(initial=np.inf)
    left = time[earliest:after][stands[earliest:after, other]].max(initial=-np.inf)
    moved = np.linalg.norm(paths[gap, foot] - paths[before, foot], axis=1)
    to_go = np.linalg.norm(paths[gap, other] - paths[after, other], axis=1)
    bears = (moved < _AT_REST) & (time[gap] <= again - _STEP + _ROUNDING)
    landed = (to_go < _AT_REST) & (time[gap] >= left + _STEP - _ROUNDING)
    bears = np.logical_and.accumulate(bears)
    landed = np.logical_and.accumulate(landed[::-1])[::-1]
    cost = np.zeros(len(moved) + 1)  # of the hand-over before each frame, or after all
    cost[1:] += np.cumsum(np.where(bears, moved, _AT_REST))
    cost[:-1] += np.cumsum(np.where(landed, to_go, _AT_REST)[::-1])[::-1]
    k, best = int(cost.argmin()), np.zeros((len(moved), 2), dtype=np.bool_)
    best[:k, foot], best[k:, other] = bears[:k], landed[k:]
    return float(cost[k]), best


def _split(
    time: Array, path: Array, stands: Flags, stance: slice, drift: float, where: Flags
) -> None:
    """Split a stance (in place) whose foot moved farther than a drift [m].

    ``where`` are the frames in which it may step, shape (T,).
    """
    points, count = path[stance], stance.stop - stance.start
    if count < 4:
        return
    away = np.linalg.norm(points - np.median(points, axis=0), axis=1)
    if away.max() < drift:
        return
    # The frame that best splits the path into two resting places.
    sums = np.cumsum(points, axis=0)
    k = np.arange(1, count)[:, None]
    rest = sums[-1] - sums[:-1]
    gain = np.sum(sums[:-1] ** 2 / k + rest**2 / (count - k), axis=1)
    middle = time[stance.start + 1 + int(gain.argmax())]
    ends = middle + 0.5 * _STEP * np.array([-1.0, 1.0]) - _ROUNDING
    first, last = np.searchsorted(time, ends).clip(stance.start, stance.stop)
    if not where[first:last].all():
        return
    stands[first:last] = False
    for part in (slice(stance.start, first), slice(last, stance.stop)):
        _split(time, path, stands, part, drift, where)
