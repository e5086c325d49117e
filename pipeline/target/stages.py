"""The stages that make the target: what the simulated character is pulled through."""

from __future__ import annotations

from collections import deque
from statistics import median
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Body, positions_from_rotations
from kinefilter.characters.arrays import Array, Flags, chunks
from kinefilter.characters.gaps import parts_of
from kinefilter.characters.rotations import continuous, normalize
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.correct import Observation
from kinefilter.pipeline.correct.one_euro import OneEuro
from kinefilter.pipeline.draft import Draft
from kinefilter.pipeline.formats.sheets import read_contacts
from kinefilter.pipeline.progress import Progress
from kinefilter.pipeline.stages import CHUNK, Stage
from kinefilter.retarget import BoneLengths, Hands, rotations_from_positions

from .feet import (
    PLANTED,
    StanceTracker,
    ankles_and_toes,
    feet_of,
    find_stance,
    flat_height,
    plant_feet,
)
from .floor import clearances, floor_height, leveled, put_on_floor, sensor_tilt, sunk
from .smooth import smooth, smooth_by_speed
from .upright import Turn, find_turn

_LEAST_WEIGHT = 0.1  # of an invented joint in the smoother, against a measured one's 1
_LEAST_BONE_WEIGHT = 0.3  # of an invented joint where bones ask for a move: the same
_BONES_CUTOFF = 3.0  # Hz; lengths are wrong for longer than joints tremble
_LANDINGS = 8  # times that joints are put over the floor and back on their segments
_TWIST_CUTOFF = 3.0  # Hz; neighbors change from frame to frame, forearms do not
_LET_GO = 0.05  # s in which a foot that steps joins its measured path
_SHOWN = 64  # frames, two seconds, that show which way is up
_EARLY = (1, 2, 4, 8, 16, 32)  # frames after which that is judged before
_WATCHED = 20 * _SHOWN  # frames after which nothing changes it any more
_FEW = 1  # frames in which somebody has to stand, to begin with
_FLOOR_TIME = 2.0  # s in which most frames say where the floor about is
_FLOOR_NEAR = 0.5  # m: feet are off it by less, but for those of jumpers. A guess.
_FLOOR_FALLS, _FLOOR_RISES = 0.2, 0.01  # share a frame: feet sink rarely, lift often


class Upright(Stage):
    """Turns the frame of a sensor that was upside down or tilted far upright.

    Frame by frame, what the last seconds show is judged until it is sure.
    """

    name = "upright"

    def __init__(self, config: CleanConfig) -> None:
        self._given = config.tilt is not None

    def start(self, body: Body) -> None:  # noqa: ARG002
        """Forget all frames."""
        self._seen: deque[Array] = deque(maxlen=_SHOWN)
        self._frames, self._turn = 0, Turn()

    def step(self, draft: Draft) -> None:
        """Turn the next frame, as far as those before it show how."""
        if not self._given and self._frames < _WATCHED:
            self._seen.append(draft.measured)
            self._frames += 1
            # A while apart, as it takes as long as some stages do.
            if self._frames in _EARLY or self._frames % _SHOWN == 0:
                turn = find_turn(np.array(self._seen), draft.skeleton, _FEW)
                # Who leans in the first frames may be running.
                shows = abs(turn.roll) > np.pi / 2.0 or self._frames >= _SHOWN
                # What they do by now makes nothing of how they stood before.
                if shows and not (turn.doubt and self._turn.roll):
                    self._turn = turn
        self._apply(draft)

    def whole(self, draft: Draft, progress: Progress) -> None:  # noqa: ARG002
        """Turn a take."""
        if not self._given:
            before = draft.unedited
            turn = before.done.turn if before else None
            self._turn = turn or find_turn(draft.measured, draft.skeleton)
            self._apply(draft)

    def _apply(self, draft: Draft) -> None:
        turn = draft.turn = self._turn
        draft.measured = leveled(draft.measured, turn.tilt, turn.roll)


class Level(Stage):
    """Turns the sensor's frame so that the floor is level."""

    name = "level"
    in_parts = False

    def __init__(self, config: CleanConfig) -> None:
        self._tilt = None if config.tilt is None else float(np.radians(config.tilt))

    def step(self, draft: Draft) -> None:
        """Level the next frame, if the tilt is known."""
        draft.tilt = self._tilt or 0.0
        draft.positions = leveled(draft.positions, draft.tilt)

    def whole(self, draft: Draft, progress: Progress) -> None:  # noqa: ARG002
        """Find which feet stand, and from them the tilt, and level the take."""
        draft.stands = np.concatenate(
            [
                find_stance(part.time, part.positions, part.confidence, part.skeleton)
                for part in draft.parts
            ]
        )
        feet = draft.positions, draft.confidence, draft.stands, draft.body
        if draft.unedited is not None:
            draft.tilt = draft.unedited.planted.tilt
        else:
            draft.tilt = sensor_tilt(*feet) if self._tilt is None else self._tilt
        draft.positions = leveled(draft.positions, draft.tilt)


class Smooth(Stage):
    """Smooths joints, the more the slower they are; takes without any lag."""

    name = "smooth"

    def __init__(self, config: CleanConfig) -> None:
        self._cutoff = config.cutoff

    def start(self, body: Body) -> None:
        """Forget all frames."""
        self._filter = OneEuro(body.skeleton)

    def step(self, draft: Draft) -> None:
        """Smooth the next frame."""
        if self._cutoff > 0.0:
            seen = Observation(
                draft.positions, draft.reliability, draft.geometry, draft.time
            )
            draft.positions = self._filter.step(seen).positions

    def whole(self, draft: Draft, progress: Progress) -> None:  # noqa: ARG002
        """Smooth a take."""
        if self._cutoff > 0.0:
            weights = np.maximum(draft.weights, _LEAST_WEIGHT)
            draft.positions = smooth_by_speed(
                draft.time, draft.positions, weights, cutoff=self._cutoff
            )


class Floor(Stage):
    """Puts the floor at y = 0."""

    name = "floor"
    in_parts = False

    def __init__(self, config: CleanConfig) -> None:
        self._given = config.floor_height

    def start(self, body: Body) -> None:
        """Forget all frames."""
        self._ankles, toes = ankles_and_toes(body.skeleton)
        self._flat = flat_height(body, toes[0])
        self._height = self._given
        self._soles: deque[tuple[float, float]] = deque()
        self._turn = Turn()

    def step(self, draft: Draft) -> None:
        """Follow the floor under the lower foot, unless it is known.

        Only near to where that foot mostly was lately, whatever a burst of frames says.
        """
        if draft.turn != self._turn:
            self._turn, self._height = draft.turn, self._given
            self._soles.clear()
        if self._given is None:
            sole = float(draft.positions[self._ankles, 1].min() - self._flat)
            soles, now = self._soles, float(draft.time)
            soles.append((now, sole))
            while soles[0][0] < now - _FLOOR_TIME:
                soles.popleft()
            # The newest counts twice: of two, it is to be believed.
            mostly = median([sole, *(height for _, height in soles)])
            height = sole if self._height is None else self._height
            if abs(height - mostly) > _FLOOR_NEAR:
                height = mostly
            if abs(sole - mostly) <= _FLOOR_NEAR:
                away = sole - height
                height += away * (_FLOOR_FALLS if away < 0.0 else _FLOOR_RISES)
            self._height = height
        draft.floor = self._height or 0.0
        draft.positions = draft.positions - [0.0, draft.floor, 0.0]

    def whole(self, draft: Draft, progress: Progress) -> None:  # noqa: ARG002
        """Find the floor under the feet of a take, unless it is known."""
        feet = draft.positions, draft.confidence, draft.stands, draft.body
        if draft.unedited is not None:
            draft.floor = draft.unedited.planted.floor
        else:
            draft.floor = floor_height(*feet) if self._given is None else self._given
        draft.positions = draft.positions - [0.0, draft.floor, 0.0]


class Feet(Stage):
    """Keeps standing feet where they stand, and lifts them where they step.

    Args:
        config: Says when feet stand, or names a file that does.
        contacts: When they do instead (CONTACTS), shape (T, 4).
    """

    name = "feet"
    in_parts = False  # the contacts that are given are those of the whole take

    def __init__(self, config: CleanConfig, contacts: Flags | None = None) -> None:
        self._feet, self._file, self.given = config.feet, config.contacts, contacts

    def start(self, body: Body) -> None:
        """Forget all frames."""
        self._body, self._stance = body, StanceTracker()
        self._ankles, self._toes = ankles_and_toes(body.skeleton)
        self._flat = flat_height(body, self._toes[0])
        self._moved, self._anchors = np.zeros((2, 2, 2, 3))
        self._stood = np.zeros(2, dtype=np.bool_)

    def step(self, draft: Draft) -> None:
        """Keep or lift the feet of the next frame."""
        positions, elapsed = draft.positions, draft.elapsed
        stands = self._stance.step(positions[self._ankles], float(self._flat), elapsed)
        planted, weights = positions.copy(), draft.weights.copy()
        for foot in range(2):
            parts = [self._ankles[foot], self._toes[foot]]
            if stands[foot]:
                if not self._stood[foot]:
                    place = positions[parts] + self._moved[foot]
                    place[:, 1] = [self._flat, self._body.radii[parts[1]]]
                    self._anchors[foot] = place
                self._moved[foot] = self._anchors[foot] - positions[parts]
                weights[parts] = PLANTED
            else:
                self._moved[foot] *= np.exp(-elapsed / _LET_GO)
            planted[parts] += self._moved[foot]
        self._stood = stands.copy()
        draft.positions, draft.bone_weights = planted, weights
        draft.stands = stands.copy()

    def whole(self, draft: Draft, progress: Progress) -> None:  # noqa: ARG002
        """Keep and lift the feet of a take."""
        stands, heels = draft.stands, None
        if self._feet != "auto":
            stands = np.full_like(stands, self._feet == "always")
        contacts = self.given
        if contacts is None and self._file is not None:
            contacts = read_contacts(self._file, draft.time)
        if contacts is not None:
            stands, heels = feet_of(contacts), contacts[:, ::2]
        planted, down = np.empty_like(draft.positions), np.empty_like(stands)
        weights = draft.weights
        for k in parts_of(draft.time):
            planted[k], down[k] = plant_feet(
                draft.time[k],
                draft.positions[k],
                weights[k],
                stands[k],
                draft.body,
                None if heels is None else heels[k],
            )
        draft.positions, heels = planted, down
        draft.contacts = np.stack([heels, stands], axis=2).reshape(-1, 4)
        draft.stands = feet_of(draft.contacts)
        weights = np.maximum(weights, _LEAST_BONE_WEIGHT)
        for part in ankles_and_toes(draft.skeleton):
            weights[:, part] = np.where(stands, PLANTED, weights[:, part])
        draft.bone_weights = weights


class Bones(Stage):
    """Puts joints on the person's own segments, over the floor."""

    name = "bones"
    local = True

    def start(self, body: Body) -> None:
        """Forget all frames."""
        self._body, self._bones = body, BoneLengths(body)
        self._hands = Hands(body.skeleton)

    def step(self, draft: Draft) -> None:
        """Restore the lengths of the next frame."""
        body, positions = self._body, draft.positions
        there = self._bones.project(positions[None], draft.bone_weights[None])[0]
        there = self._hands.carried(positions, there, draft.confidence, body)
        draft.positions = put_on_floor(there[None], body)[0]

    def whole(self, draft: Draft, progress: Progress) -> None:  # noqa: ARG002
        """Restore the lengths of a take, as smoothly as it was before.

        What the lengths ask for trembles with the noise of neighbors, so it is
        smoothed, and the lengths are restored once more by what little is then missing.
        """
        body, weights = draft.body, draft.bone_weights
        positions, bones = put_on_floor(draft.positions, body), BoneLengths(body)
        moved = Hands(draft.skeleton).carried(
            positions, bones.project(positions, weights), draft.confidence, body
        )
        moved -= positions
        moved = smooth(draft.time, moved, np.ones(weights.shape), cutoff=_BONES_CUTOFF)
        there = positions + moved
        # Lifted toes are on longer legs: again, as the body has to follow them.
        for _ in range(_LANDINGS):
            there = put_on_floor(bones.project(there, weights), body)
        draft.positions = there


class Orient(Stage):
    """Gives every segment an orientation."""

    name = "orientation"
    local = True
    in_parts = False  # rotations keep their sign across gaps

    def start(self, body: Body) -> None:
        """Forget all frames."""
        self._body = body

    def step(self, draft: Draft) -> None:
        """Turn the segments of the next frame."""
        draft.rotations = rotations_from_positions(
            draft.positions, self._body, draft.twist
        )

    def whole(self, draft: Draft, progress: Progress) -> None:  # noqa: ARG002
        """Turn the segments of a take, continuously over time."""
        twist = _without_jumps(draft.time, draft.twist)
        rotations = np.empty((*draft.positions.shape[:2], 4))
        for k in chunks(len(rotations), CHUNK):
            prior = None if twist is None else normalize(twist[k].astype(float))
            rotations[k] = rotations_from_positions(
                draft.positions[k], draft.body, prior
            )
        draft.rotations, draft.twist = continuous(rotations), None
        roots = draft.positions[:, draft.skeleton.root]
        draft.posed = np.empty_like(draft.positions)
        for k in chunks(len(roots), CHUNK):
            draft.posed[k] = positions_from_rotations(
                draft.rotations[k], roots[k], draft.body
            )
        heights = draft.posed[..., 1]
        heights += sunk(heights, clearances(draft.body))[:, None]


def _without_jumps(time: Array, rotations: NDArray[Any] | None) -> NDArray[Any] | None:
    """Return rotations without the jumps between sets of neighboring postures."""
    if rotations is None:
        return None
    smoothed = np.empty_like(rotations)
    weights = np.ones((len(time), 1))
    for j in range(rotations.shape[1]):
        signed = continuous(rotations[:, j, None].astype(float))
        for k in parts_of(time):
            found = smooth(time[k], signed[k], weights[k], cutoff=_TWIST_CUTOFF)
            smoothed[k, j] = found[:, 0]
    return smoothed
