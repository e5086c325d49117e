"""The stage that fills hidden limbs, of whole takes and frame by frame."""

from dataclasses import dataclass
from functools import cache

import numpy as np

from kinefilter.characters import Body, InputError, Skeleton, State, Take
from kinefilter.characters.arrays import Array, Codes, Flags
from kinefilter.characters.motion import distinct_stamps, values_at
from kinefilter.characters.rotations import between, rotate, unit
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.draft import Draft
from kinefilter.pipeline.formats.takes import read_take
from kinefilter.pipeline.progress import Progress
from kinefilter.pipeline.stages import Stage
from kinefilter.pipeline.target.floor import leveled
from kinefilter.retarget import HeadingFrame, find_yaw
from kinefilter.retarget.limbs import smooth_step

from .continuity import planted_height
from .hidden_limbs import PAUSE, fill_hidden, fill_unseen, fill_walking, point_unseen
from .prior import MotionPrior, default_prior, standing_height
from .recall import Recall, learn
from .unseen_root import unseen_root, upright_places, with_root
from .unseen_steps import (
    GAIT_TIMES,
    Steps,
    both_legs,
    gait,
    lifts,
    put_feet,
)
from .windows import BridgedMotion, Limb, Stretches, in_limbs, limb_of, limbs, with_tips

_MEMORY = 1800  # frames to learn from: a minute at 30 Hz
_LEARNS = 0.1  # s for which a limb is hidden before the recent frames are learned from
# Longest time [s] in which a limb that is seen again returns to the measurement, and
# the factor on the time for which it was lost. 1 is better where joints of s06, s07 and
# s08 are missing at random, but worse before a virtual Kinect, where 3 is no better.
_JOINS, _AS_LONG = 0.2, 2.0
_SETTLES = 0.2  # s: time constant of the directions of a limb that was never seen
_FADES = 0.1  # s in which what was learned fades in
_STRETCH = 1.5  # s: length of the stretches to learn from
_NEW = 0.03  # weight of a frame in the mean angle of a hand: about a second
# s by which an unseen foot steps ahead of the posture, at the speed of the last frames,
# and the time over which that is measured. Chosen as those in ``unseen_steps``.
_AHEAD, _SPEED_TIME = 0.15, 0.3
_RATE = 30.0  # Hz, until the stream shows its own


@dataclass(eq=False)
class _Gap:
    """A limb that is hidden now."""

    limb: Limb
    start: int
    time: float
    floor: float
    standing: float
    recall: Recall | None = None
    learned: float | None = None


class HiddenLimbTracker:
    """Fills the hidden joints of each frame from the frames before.

    A limb continues its motion and comes to rest, a planted foot stays in place, and
    what the last minute shows of the limb's motion is added. Until it is seen first, it
    is where people mostly have it. When the limb is seen again, it returns to the
    measurement within a fifth of a second.
    """

    def __init__(self, body: Body, prior: MotionPrior | None = None) -> None:
        self._prior = prior or default_prior()
        self._body, self._limbs = body, limbs(body.skeleton)
        self._parents = np.array(body.skeleton.parents)
        self._middles_and_ends = [j for _, *joints in self._limbs for j in joints]
        self._hands = [j for j in body.skeleton.order if body.skeleton.hands[j]]
        self.start()

    def start(self) -> None:
        """Reset the state for a new motion."""
        rows, n = 2 * _MEMORY, len(self._body.skeleton)
        self._count, self._gaps = 0, dict[int, _Gap]()
        self._places = upright_places(self._body)
        self._times, self._yaw = np.zeros((2, rows))
        self._root = np.zeros((rows, 3))
        self._positions, self._directions = np.zeros((2, rows, n, 3))
        self._known = np.zeros((rows, n), dtype=np.bool_)
        self._joined = np.zeros(rows, dtype=np.bool_)
        self._bent, self._offset = np.zeros((2, n, 3))
        self._since, self._gone = np.full(n, np.inf), np.zeros(n)
        self._filled, self._ever = np.zeros((2, n), dtype=np.bool_)
        self._learned = -np.inf
        self._steps: Steps | None = None

    def step(self, positions: Array, hidden: Flags, time: float) -> tuple[Array, Flags]:
        """Return the next frame's joint positions [m], and flags of filled joints.

        Positions are in the sensor frame with y up, shape (J, 3), and the time stamp
        [s] is later than the last. Hands, feet and joints of the trunk that were never
        seen stay as they are, except the root.
        """
        skeleton, k = self._body.skeleton, self._remember(time)
        hidden = with_tips(hidden, skeleton)
        there = ~hidden
        yaw = find_yaw(positions, skeleton, there.astype(float))
        if np.isnan(yaw):
            yaw = self._yaw[k - 1]
        root, yaw = positions[skeleton.root], np.asarray(yaw)
        if gone := bool(hidden[skeleton.root] or np.isnan(root[0])):
            root = unseen_root(positions, yaw, self._places, skeleton)
            there[skeleton.root] = not np.isnan(root[0])
            root = root if there[skeleton.root] else self._root[k - 1]
        self._root[k], self._yaw[k] = root, yaw
        heading = HeadingFrame(root, yaw)
        placed = heading.remove(positions)
        placed[skeleton.root] = 0.0
        if not gone:
            self._places[there] = placed[there]
        known = there & there[self._parents]
        known[skeleton.root] = True
        directions = unit(placed - placed[self._parents])
        last = self._directions[k - 1] if k else self._body.directions
        directions[~known] = last[~known]
        self._ever |= there
        pointed = np.zeros_like(there)
        if not self._ever[self._middles_and_ends].all():
            bones = self._body.lengths[:, None] * directions
            lower = root[1] - standing_height(self._root[: k + 1, 1])
            pointed = point_unseen(bones, ~self._ever, lower, self._body, self._prior)
            if k:
                share = min((time - self._times[k - 1]) / _SETTLES, 1.0)
                likely = unit(bones[pointed])
                bones[pointed] = last[pointed] + share * (likely - last[pointed])
            directions[pointed] = unit(bones[pointed])
        seen = known & skeleton.hands
        bent = directions[seen] - directions[self._parents[seen]]
        self._bent[seen] += _NEW * (bent - self._bent[seen])
        for j in self._hands:
            if not known[j]:
                directions[j] = unit(directions[self._parents[j]] + self._bent[j])
        self._known[k], self._directions[k] = known, directions
        self._positions[k] = self._placed(placed, there, directions)
        for limb, joints in enumerate(self._limbs):
            if (hidden & self._ever)[list(joints[1:])].any() and k:
                self._continue(limb, joints, k)
            else:
                self._gaps.pop(limb, None)
        filled = self._placed(placed, there, self._directions[k])
        if both_legs(pointed, skeleton):
            self._step_feet(filled, heading, k)
            pointed[skeleton.hips] = True  # which the legs hang on
        else:
            self._steps = None
        self._positions[k] = self._join(filled, hidden, time - self._times[k - 1])
        self._count, placeable = k + 1, self._ever | pointed
        found = heading.restore(self._positions[k])
        return np.where(placeable[:, None], found, positions), hidden & placeable

    def _remember(self, time: float) -> int:
        """Make room for the next frame and return its row."""
        if self._count == 2 * _MEMORY:
            log = (self._times, self._root, self._yaw, self._positions)
            for array in (*log, self._directions, self._known, self._joined):
                array[:_MEMORY] = array[_MEMORY:]
            self._count = _MEMORY
            for gap in self._gaps.values():
                gap.start = max(gap.start - _MEMORY, 1)
        k = self._count
        self._times[k] = time
        self._joined[k] = k == 0 or time - self._times[k - 1] < PAUSE
        return k

    def _placed(self, placed: Array, there: Flags, directions: Array) -> Array:
        """Return a frame with its hidden joints on their segments, (J, 3)."""
        found = placed.copy()
        for j in self._body.skeleton.order[1:]:
            if not there[j]:
                bone = self._body.lengths[j] * directions[j]
                found[j] = found[self._parents[j]] + bone
        return found

    def _step_feet(self, placed: Array, heading: HeadingFrame, k: int) -> None:
        """Let unseen legs step in the frame of row k, in place (J, 3)."""
        skeleton, time = self._body.skeleton, self._times[: k + 1]
        homes = heading.restore(placed)[skeleton.sides("Ankle")]
        first = int(np.searchsorted(time, time[k] + GAIT_TIMES["before"][0]))
        some = slice(max(first - 1, 0), k + 1)
        frames = HeadingFrame(self._root[some], self._yaw[some])
        motion = frames.restore(self._positions[some])
        shown = time[some], motion, time[[k]]
        cycle, speed = gait(*shown, "before", self._prior, skeleton)
        if self._steps is None:
            self._steps = Steps(homes)
        recent = values_at(time[some], self._root[some], time[k] - _SPEED_TIME)
        way = (self._root[k] - recent) * [1.0, 0.0, 1.0]
        goals = homes + _AHEAD / _SPEED_TIME * way
        elapsed = float(time[k] - time[k - 1]) if k else 0.0
        ankles, shares = self._steps.step(elapsed, goals, float(cycle[0]))
        ankles[:, 1] = homes[:, 1] + lifts(shares, speed[0])
        put_feet(placed, heading.remove(ankles), self._body)

    def _continue(self, key: int, joints: tuple[int, int, int], k: int) -> None:
        """Continue the motion of a hidden limb in the frame of row k."""
        skeleton, directions = self._body.skeleton, self._directions[k]
        limb = limb_of(skeleton, joints, self._known[k].astype(float))
        if limb is None:
            return
        time, gap = float(self._times[k]), self._gaps.get(key)
        if gap is None or gap.limb != limb:
            fewer = gap is None or len(gap.limb.hidden) < len(limb.hidden)
            since = (k, time) if gap is None or fewer else (gap.start, gap.time)
            ankles = skeleton.sides("Ankle")
            heights = self._positions[:k, ankles, 1] + self._root[:k, 1, None]
            standing = standing_height(self._root[: k + 1, 1])
            gap = _Gap(limb, *since, planted_height(heights), standing)
            self._gaps[key] = gap
        seen = self._motion_so_far(k + 1, gap)
        start, at = np.array([gap.start]), np.array([[k - gap.start]])
        stretch = Stretches(seen, limb, start, k - gap.start + 1, at, ahead=False)
        found = self._prior.describe(stretch)
        continued = found.base[0]
        if gap.learned is None and time - gap.time >= _LEARNS and time > self._learned:
            self._learned = time  # at most one limb per frame, which bounds the time
            frames = round(_STRETCH * seen.rate)
            gap.recall = learn(seen, limb, frames, None, self._prior, ahead=False)
            gap.learned = time
        if gap.recall is not None and gap.learned is not None:
            share = smooth_step((time - gap.learned) / _FADES)
            continued = unit(continued + share * (gap.recall(found)[0] - continued))
        before, end = directions.copy(), limb.hidden[-1]
        directions[list(limb.hidden)] = continued[0]
        if limb.leg is None:
            turn = between(before[end], directions[end])
            for j in skeleton.descendants(end):
                if not self._known[k, j]:
                    directions[j] = rotate(turn, before[j])

    def _motion_so_far(self, count: int, gap: _Gap) -> BridgedMotion:
        steps = np.diff(self._times[max(count - 30, 0) : count])
        rate = 1.0 / float(np.median(steps)) if len(steps) else _RATE
        heading = HeadingFrame(self._root[:count], self._yaw[:count])
        skeleton, lengths = self._body.skeleton, self._body.lengths
        positions, directions = self._positions[:count], self._directions[:count]
        flags = (self._known[:count], self._joined[:count], np.zeros(count, np.bool_))
        arrays = (positions, directions, *flags, lengths)
        return BridgedMotion(skeleton, rate, heading, *arrays, gap.floor, gap.standing)

    def _join(self, filled: Array, hidden: Flags, elapsed: float) -> Array:
        """Return a frame in which limbs that are seen again return smoothly."""
        k, back = self._count, self._filled & ~hidden
        elapsed = elapsed if k else 0.0
        self._gone[hidden & ~self._filled] = 0.0
        self._gone[hidden] += elapsed
        self._offset[back] = self._positions[k - 1][back] - filled[back]
        self._since[back] = 0.0
        self._filled = hidden.copy()
        self._since += elapsed
        # A limb that is lost for a frame every now and then would lag all the time.
        needed = np.minimum(_AS_LONG * self._gone, _JOINS)
        joining = (self._since < needed) & ~hidden
        if joining.any():
            left = 1.0 - smooth_step(self._since[joining] / needed[joining])
            filled[joining] += left[:, None] * self._offset[joining]
        return filled


_MOSTLY_INFERRED = 0.3  # share of tracked frames up to which inferred legs are kept
_LATELY = 300  # frames over which that share is averaged in live motion
_BETWEEN = 2.0  # s between takes, so that no motion continues from one to the next


class Reconstruct(Stage):
    """Continues the motion of limbs that the sensor did not see, or only inferred."""

    name = "reconstruct"
    in_parts = False

    def __init__(self, config: CleanConfig, prior: MotionPrior | None = None) -> None:
        self._prior, self._files = prior, config.same_person
        self._others: list[Take] | None = None

    def start(self, body: Body) -> None:
        """Reset the state for a new motion."""
        self._tracker = HiddenLimbTracker(body, self._prior)
        self._tracked, self._frames = np.zeros(len(body.skeleton)), 0

    def step(self, draft: Draft) -> None:
        """Fill the hidden joints of the next frame."""
        now = draft.state == State.TRACKED
        self._frames = min(self._frames + 1, _LATELY)
        self._tracked = self._tracked + (now - self._tracked) / self._frames
        measured = draft.measured
        hidden = hidden_joints(measured, draft.state, draft.skeleton, self._tracked)
        time = float(draft.time)
        draft.filled, draft.hidden = self._tracker.step(measured, hidden, time)

    def whole(self, draft: Draft, progress: Progress) -> None:
        """Fill the hidden joints of a take."""
        if self._others is None:
            self._others = [read_take(file) for file in self._files]
        skeleton, time, positions = draft.skeleton, draft.time, draft.measured
        hidden = hidden_joints(positions, draft.state, skeleton)
        recorded, first = positions[:, skeleton.root], 0
        positions = with_root(time, positions, draft.body)
        placed = hidden[:, skeleton.root] & ~np.isnan(positions[:, skeleton.root, 0])
        hidden[placed, skeleton.root] = False
        for other in self._others:
            if other.skeleton != skeleton:
                raise InputError(
                    f"{other.source}: is a take of {other.skeleton.name}, but this one "
                    f"is of {skeleton.name}; --same-person needs the same sensor"
                )
            new = distinct_stamps(other.time)
            before = other.time[new] + time[0] - _BETWEEN - other.time[-1]
            seen = leveled(other.positions[new], draft.turn.tilt, draft.turn.roll)
            # A take must not learn from itself; its root is as it was recorded.
            roots, known = seen[:, skeleton.root], ~np.isnan(recorded[:, 0])
            if roots.shape == recorded.shape and (roots == recorded)[known].all():
                continue
            time = np.concatenate([before, time])
            positions = np.concatenate([seen, positions])
            blind = hidden_joints(other.positions[new], other.state[new], skeleton)
            hidden = np.concatenate([blind, hidden])
            first += int(new.sum())
        filled, which = fill_hidden(time, positions, hidden, skeleton, self._prior)
        which, prior = which[first:], self._prior or default_prior()
        own = fill_walking(draft.time, filled[first:], which, draft.body, prior)
        unseen = np.asarray(hidden.all(axis=0))
        found = fill_unseen(draft.time, own, unseen, draft.body, prior)
        draft.filled, draft.hidden = found[0], which | found[1]
        draft.hidden[:, skeleton.root] |= placed


@cache
def _least_tracked(skeleton: Skeleton) -> Array:
    """Return the share of tracked frames up to which joints are kept as guessed."""
    least = np.zeros(len(skeleton))
    for hip in skeleton.hips:
        least[skeleton.descendants(hip)] = _MOSTLY_INFERRED
    return least


def hidden_joints(
    positions: Array, state: Codes, skeleton: Skeleton, tracked: Array | None = None
) -> Flags:
    """Return True for joints that are missing, or of a limb and only inferred.

    Inferred joints of the trunk, of legs that are hardly ever tracked and of arms that
    never are, are not hidden: what the sensor infers is better there. ``tracked`` (J,)
    is the share of frames in which each joint is tracked; by default that of the take.
    """
    now = state == State.TRACKED
    share = now.mean(axis=0) if tracked is None else tracked
    often = share > _least_tracked(skeleton)
    return np.asarray(np.isnan(positions[..., 0]) | ~now & often & in_limbs(skeleton))
