"""The stages that make the target: the motion before physics."""

from collections.abc import Sequence
from functools import partial

import numpy as np

from kinefilter.characters import Body, positions_from_rotations
from kinefilter.characters.arrays import Array, Flags, chunks
from kinefilter.characters.gaps import parts_of
from kinefilter.characters.rotations import unit
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.draft import Draft
from kinefilter.pipeline.formats.sheets import read_contacts
from kinefilter.pipeline.progress import Progress
from kinefilter.pipeline.stages import CHUNK, Stage
from kinefilter.retarget import BoneLengths

from . import feet, floor, planting
from .foot_pitch import PitchTracker, flat_angle, foot_pitches
from .possible_postures import even_turns, possible_joints, possible_knees
from .smooth import smooth, smooth_by_speed, travel_of, weights_of_outliers
from .smooth_live import LiveSmoother
from .stance_odds import legs_of

_LEAST_WEIGHT = 0.1  # of an invented joint in the smoother; a measured one has 1
_LEAST_BONE_WEIGHT = 0.3  # bone weight of an invented joint; a measured one has 1
# Hz of the moves of joints, as lengths are wrong for longer than joints tremble, and of
# all above the knees as one, and how easily that moves afterwards. If it were as quick
# as the joints, walkers' hips would drop at each step. Chosen on s02 to s04 and on
# people 02, 05, 06, 07, 10, 16, 29 and 32 of CMU.
_BONES_CUTOFF, _BODY_CUTOFF, _BODY_FOLLOWS = 3.0, 1.0, 0.03
_LANDINGS = 8  # times that joints are raised to the floor and put back on their bones
_LET_GO = 0.05  # s in which a stepping foot joins its measured path
# m by which a live foot is held: where its toes are farther from their place it steps,
# and its heel rises. Chosen, as planting.HELD, on p00, p04 and p06 of two-kinects.
_REACH = 0.08


class Ranges(Stage):
    """Stage that keeps trunks, knees and arms from postures that nobody can take."""

    name = "ranges"
    local = True

    def step(self, draft: Draft) -> None:
        """Put the joints of the next frame where bodies can have them."""
        draft.positions = possible_joints(draft.positions[None], draft.body)[0]

    def whole(self, draft: Draft, progress: Progress) -> None:
        """Put the joints of a take where bodies can have them."""
        positions = even_turns(draft.positions, draft.body, draft.time)
        draft.positions = possible_joints(positions, draft.body)


class Smooth(Stage):
    """Stage that smooths joints, slow ones more strongly; whole takes without lag."""

    name = "smooth"

    def __init__(self, config: CleanConfig) -> None:
        self._cutoff = config.cutoff

    def start(self, body: Body) -> None:
        """Reset the state for a new motion."""
        self._smoother = LiveSmoother(body.skeleton)

    def step(self, draft: Draft) -> None:
        """Smooth the next frame."""
        if self._cutoff > 0.0:
            draft.positions = self._smoother.step(draft.positions, float(draft.time))

    def whole(self, draft: Draft, progress: Progress) -> None:
        """Smooth a take."""
        if self._cutoff > 0.0:
            weights = np.maximum(draft.weights, _LEAST_WEIGHT)
            weights = weights * weights_of_outliers(draft.time, draft.positions)
            paths = draft.time, draft.positions, weights
            travel = travel_of(draft.time, draft.positions, draft.skeleton)
            draft.positions = smooth_by_speed(
                *paths, cutoff=self._cutoff, travel=travel
            )


class Feet(Stage):
    """Stage that holds planted feet in place and lifts stepping ones.

    Contacts (CONTACTS), shape (T, 4), replace those that the config asks for.
    """

    name = "feet"
    in_parts = False  # given contacts are those of the whole take

    def __init__(self, config: CleanConfig, contacts: Flags | None = None) -> None:
        self._feet, self._file, self.given = config.feet, config.contacts, contacts

    def start(self, body: Body) -> None:
        """Reset the state for a new motion."""
        ankles, toes = feet.ankles_and_toes(body.skeleton)
        self._parts, self._stance = np.transpose([ankles, toes]), feet.StanceTracker()
        self._pitches, self._legs = PitchTracker(body), legs_of(body.skeleton)
        flat = np.full(2, feet.flat_height(body, toes[0]))
        self._heights = np.stack([flat, body.radii[toes]], axis=1)
        self._moved = np.zeros((2, 2, 3))  # by foot, ankle and toes
        self._places, self._ahead = np.zeros((2, 2, 2))  # by foot, x and z
        self._planted = np.zeros(2, dtype=np.bool_)

    def step(self, draft: Draft) -> None:
        """Hold, release or lift the feet of the next frame."""
        positions, weights = draft.positions.copy(), draft.weights.copy()
        _, toes = self._parts.T
        elapsed, level, toe = draft.elapsed, [0, 2], toes[0]
        now, shown = float(draft.time), _shown(draft, toes)
        stands = self._stance.step(now, positions[self._legs])
        pitch = self._pitches.step(now, positions, shown, stands)
        below = flat_angle(draft.body) - pitch
        path = planting.pointed(positions[self._parts], below, draft.body.lengths[toe])
        rest = partial(planting.standing_feet, below=below, body=draft.body, toe=toe)
        away = rest(self._places, self._ahead) - path
        stepped = np.linalg.norm(away[:, 1, level], axis=1) > _REACH
        stands = self._stance.let_go(self._planted & stepped)
        lands = stands & ~self._planted
        if lands.any():
            ahead = unit((path[:, 1] - path[:, 0])[:, level])
            place = (path + self._moved - rest(np.zeros(2), ahead))[:, 0, level]
            self._places[lands], self._ahead[lands] = place[lands], ahead[lands]
            away = rest(self._places, self._ahead) - path
        self._moved *= np.exp(-elapsed / _LET_GO)
        far = np.linalg.norm(away, axis=2, keepdims=True)
        self._moved[stands] = (away * np.minimum(_REACH / (far + 1e-9), 1.0))[stands]
        path += self._moved
        above = (path[..., 1] - self._heights).min(axis=1)
        path[..., 1] += self._stance.lift(path[:, 1], above, elapsed)[:, None]
        positions[self._parts], weights[self._parts[stands]] = path, planting.HELD
        self._planted = stands
        draft.positions, draft.bone_weights, draft.stands = positions, weights, stands

    def whole(self, draft: Draft, progress: Progress) -> None:
        """Hold and lift the feet of a take."""
        time, positions, weights = draft.time, draft.positions, draft.weights
        stands, contacts = draft.stands, self.given
        ankles, toes = feet.ankles_and_toes(draft.skeleton)
        shown = _shown(draft, toes)
        if self._feet != "auto":
            stands = np.full_like(stands, self._feet == "always")
        if contacts is None and self._file is not None:
            contacts = read_contacts(self._file, time)
        if contacts is not None:
            stands = feet.planted_feet(contacts)
        planted, found = np.empty_like(positions), np.empty((len(time), 4), dtype=bool)
        for k in parts_of(time):
            frames = time[k], positions[k]
            pitch = foot_pitches(*frames, shown[k], stands[k], draft.body)
            if contacts is not None:
                pitch[contacts[k, ::2]] = np.maximum(pitch[contacts[k, ::2]], 0.0)
                pitch[contacts[k, 1::2]] = np.minimum(pitch[contacts[k, 1::2]], 0.0)
            planted[k], found[k] = planting.plant_feet(
                *frames, weights[k], stands[k], pitch, draft.body
            )
        draft.positions, draft.contacts = planted, found
        draft.stands = feet.planted_feet(found)
        weights = np.maximum(weights, _LEAST_BONE_WEIGHT)
        least = planting.stepping_weights(planted[:, ankles, 1])
        for part in (ankles, toes):
            steps = np.maximum(weights[:, part], least)
            weights[:, part] = np.where(stands, planting.PLANTED, steps)
        draft.bone_weights = weights


def _shown(draft: Draft, toes: Sequence[int]) -> Array:
    """Return how far toes are shown, 0 to 1, (..., 2): a Kinect's are mostly wrong."""
    weights = draft.weights[..., toes]
    return np.zeros_like(weights) if draft.by_kinect else weights


class Bones(Stage):
    """Stage that restores the person's bone lengths, above the floor."""

    name = "bones"
    local = True

    def start(self, body: Body) -> None:
        """Reset the state for a new motion."""
        self._bones = BoneLengths(body)
        self._last_bones = BoneLengths(body, together=_BODY_FOLLOWS)
        self._moved = np.empty(0)

    def step(self, draft: Draft) -> None:
        """Restore the lengths of the next frame; the moves are smoothed here, too."""
        positions, weights = draft.positions[None], draft.bone_weights[None]
        moved = self._bones.project(positions, weights) - positions
        together = moved[:, draft.skeleton.hips].mean(axis=1, keepdims=True)
        together = self._bones.above[:, None] * together
        moves = np.stack([moved - together, together])
        if len(self._moved):
            cutoffs = np.reshape([_BONES_CUTOFF, _BODY_CUTOFF], (2, 1, 1, 1))
            share = 1.0 - np.exp(-2.0 * np.pi * cutoffs * draft.elapsed)
            moves = self._moved + share * (moves - self._moved)
        self._moved = moves
        there = self._last_bones.project(positions + moves.sum(axis=0), weights)
        draft.positions = floor.put_on_floor(there, draft.body)[0]

    def whole(self, draft: Draft, progress: Progress) -> None:
        """Restore the lengths of a take without making it less smooth.

        The moves that restore the lengths tremble with the noise of neighboring joints.
        They are smoothed, and then the lengths, now nearly right, are restored again.
        """
        body, weights = draft.body, draft.bone_weights
        positions, bones = floor.put_on_floor(draft.positions, body), BoneLengths(body)
        # A lifted foot shortens its leg, and a straight knee would bend either way.
        positions = possible_knees(positions, body.skeleton)
        moved = bones.project(positions, weights) - positions
        hips, above = body.skeleton.hips, bones.above[:, None]
        together = moved[:, hips].mean(axis=1, keepdims=True)
        seen = weights[:, hips].min(axis=1, keepdims=True).clip(_LEAST_WEIGHT, 1.0)
        slow = smooth(draft.time, together, seen, cutoff=_BODY_CUTOFF)
        moved -= above * seen[..., None] * (together - slow)
        # A foot that stands is not drawn along by the step before or after.
        firm = np.maximum(weights, 1.0)
        there = positions + smooth(draft.time, moved, firm, cutoff=_BONES_CUTOFF)
        bones = BoneLengths(body, together=_BODY_FOLLOWS)
        # Raised toes lengthen the legs, and the body has to follow: several rounds.
        for _ in range(_LANDINGS):
            there = possible_knees(there, body.skeleton)
            there = floor.put_on_floor(bones.project(there, weights), body)
        draft.positions = there


def posed(draft: Draft) -> Array:
    """Return joint positions [m] by a take's rotations, above the floor, (T, J, 3)."""
    roots, body = draft.positions[:, draft.skeleton.root], draft.body
    joints = np.empty_like(draft.positions)
    for k in chunks(len(roots), CHUNK):
        joints[k] = positions_from_rotations(draft.rotations[k], roots[k], body)
    heights = joints[..., 1]
    heights += floor.floor_penetration(heights, floor.clearances(body))[:, None]
    return joints
