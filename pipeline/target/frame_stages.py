"""The stages that turn and move the sensor's frame: y up, the floor level and at 0."""

from collections import deque
from collections.abc import Sequence
from statistics import median

import numpy as np

from kinefilter.characters import Body, InputError
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.draft import Draft
from kinefilter.pipeline.progress import Progress
from kinefilter.pipeline.stages import SharedStage
from kinefilter.pipeline.upright import Turn, find_turn, given_turn

from . import feet, floor
from .tilt import TiltEvidence, sensor_tilt

_WINDOW = 64  # frames, two seconds, after which and from which a live turn is found
_EARLY = (1, 2, 4, 8, 16, 32)  # frames after which it is sought before that
_WATCHED = 20 * _WINDOW  # frames after which it stays as it is
_FEW = 1  # frames of standing straight that are enough for a live turn
# s between two frames that are evidence of a live tilt, as neighbors add little; also
# the most that any frame of a take counts for.
_LOOK = 0.15
_TILT_TIME = 0.5  # s in which a live tilt follows what is found
_FLOOR_TIME = 2.0  # s whose median sole is roughly the floor
_FLOOR_NEAR = 0.5  # m: feet are off it by less, except in jumps. A guess.
_FLOOR_FAR = 1.5  # m by which a given floor is above the feet: a mistake
_FLOOR_FALLS, _FLOOR_RISES = 0.2, 0.01  # share per frame: feet sink rarely, lift often


class Upright(SharedStage):
    """Stage that turns frames upright if the sensor was upside down or tilted far.

    In live motion the turn is found from the last seconds, until it is settled.
    """

    name = "upright"

    def __init__(self, config: CleanConfig) -> None:
        self._given = None if config.tilt is None else given_turn(config.tilt)

    def start(self, body: Body) -> None:
        """Reset the state for a new motion."""
        self._recent: deque[Array] = deque(maxlen=_WINDOW)
        self._frames, self._turn = 0, self._given or Turn()

    def step(self, draft: Draft) -> None:
        """Turn the next frame by what the frames so far show."""
        if self._given is None and self._frames < _WATCHED:
            self._recent.append(draft.measured)
            self._frames += 1
            # Not in every frame, as it takes as long as some stages do.
            if self._frames in _EARLY or self._frames % _WINDOW == 0:
                turn = find_turn(np.array(self._recent), draft.skeleton, _FEW)
                # A person who leans in the first frames may be running.
                counts = abs(turn.roll) > np.pi / 2.0 or self._frames >= _WINDOW
                # Later doubts do not invalidate what was found before.
                if counts and not (turn.doubt and self._turn.roll):
                    self._turn = turn
        self._apply(draft)

    def together(self, drafts: Sequence[Draft], progress: Progress) -> None:
        """Turn takes, by how most of the people stand."""
        before, skeleton = drafts[0].unedited, drafts[0].skeleton
        measured = [draft.measured for draft in drafts]
        turn = before.done.turn if before else self._given
        self._turn = turn or find_turn(np.concatenate(measured), skeleton)
        for draft in drafts:
            self._apply(draft)

    def _apply(self, draft: Draft) -> None:
        turn = draft.turn = self._turn
        draft.measured = floor.leveled(draft.measured, turn.tilt, turn.roll)
        if draft.face is not None:
            draft.face = floor.leveled(draft.face, turn.tilt, turn.roll)


class Level(SharedStage):
    """Stage that rotates the sensor's frame so that the floor is level."""

    name = "level"
    continues = True

    def __init__(self, config: CleanConfig) -> None:
        self._given = None if config.tilt is None else float(np.radians(config.tilt))

    def start(self, body: Body) -> None:
        """Reset the state for a new motion."""
        self._turn, self._evidence = Turn(), TiltEvidence(body.skeleton)
        self._ankles, _ = feet.ankles_and_toes(body.skeleton)
        self._angles, self._found, self._since = np.zeros(2), np.zeros(2), 0.0
        self._moved = np.zeros(3)

    def step(self, draft: Draft) -> None:
        """Level the next frame by what the frames so far show of tilt and roll."""
        if draft.turn != self._turn:
            self.start(draft.body)
            self._turn = draft.turn
        if self._given is not None:
            self._angles = np.array([self._given - draft.turn.tilt, 0.0])
        else:
            self._since += draft.elapsed
            if self._since >= _LOOK:
                one = draft.positions[None], draft.confidence[None]
                self._evidence.add(*one, np.array([self._since]))
                self._found = _found([self._evidence], draft)
                self._since = 0.0
            share = 1.0 - np.exp(-draft.elapsed / _TILT_TIME)
            angles = self._angles + share * (self._found - self._angles)
            # Turned about the sensor, feet that stand would slide.
            stand = draft.positions[self._ankles].mean(axis=0)
            self._moved += floor.leveled(stand, *self._angles)
            self._moved -= floor.leveled(stand, *angles)
            self._angles = angles
        _level(draft, self._angles)
        draft.positions = draft.positions + self._moved

    def together(self, drafts: Sequence[Draft], progress: Progress) -> None:
        """Find tilt and roll, level the takes, and find the planted feet."""
        before = drafts[0].unedited
        if before:
            angles = np.array([before.planted.tilt, before.planted.roll])
        elif self._given is not None:
            angles = np.array([self._given - drafts[0].turn.tilt, 0.0])
        else:
            people = [TiltEvidence(draft.skeleton) for draft in drafts]
            for draft, person in zip(drafts, people, strict=True):
                elapsed = np.diff(draft.time, append=draft.time[-1])
                person.add(draft.positions, draft.confidence, elapsed.clip(max=_LOOK))
            angles = _found(people, drafts[0])
        for draft in drafts:
            _level(draft, angles)
            parts = [(p.time, p.positions, p.confidence) for p in draft.parts]
            stances = [feet.find_stance(*part, draft.skeleton) for part in parts]
            draft.stands = np.concatenate(stances)


class Floor(SharedStage):
    """Stage that puts the floor at y = 0."""

    name = "floor"

    def __init__(self, config: CleanConfig) -> None:
        self._given = config.floor_height

    def start(self, body: Body) -> None:
        """Reset the state for a new motion."""
        self._ankles, toes = feet.ankles_and_toes(body.skeleton)
        self._flat = feet.flat_height(body, toes[0])
        self._height = self._given
        self._soles: deque[tuple[float, float]] = deque()
        self._turn = Turn()

    def step(self, draft: Draft) -> None:
        """Follow the floor under the lower foot, unless its height was given.

        Outliers do not count: the floor stays near the recent median of that foot.
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
            # The newest counts twice, so that it decides when there are two.
            usual = median([sole, *[height for _, height in soles]])
            height = sole if self._height is None else self._height
            if abs(height - usual) > _FLOOR_NEAR:
                height = usual
            if abs(sole - usual) <= _FLOOR_NEAR:
                away = sole - height
                height += away * (_FLOOR_FALLS if away < 0.0 else _FLOOR_RISES)
            self._height = height
        draft.floor = self._height or 0.0
        draft.positions = draft.positions - [0.0, draft.floor, 0.0]

    def together(self, drafts: Sequence[Draft], progress: Progress) -> None:
        """Find the floor under everybody's feet, unless its height was given.

        Raises an InputError if nobody's feet are near the given height.
        """
        given, heights = self._given, floor.floor_heights([*map(_stood, drafts)])
        if (before := drafts[0].unedited) is not None:
            heights = [before.planted.floor]
        elif given is not None:
            if given - max(heights) > _FLOOR_FAR:
                raise InputError(
                    f"floor {given:g}: the feet are at {heights[0]:.2f} m; give the "
                    "height of the floor in the take, negative below the sensor"
                )
            heights = [given] * len(drafts)
        for draft, height in zip(drafts, heights, strict=True):
            draft.floor = height
            draft.positions = draft.positions - [0.0, height, 0.0]
            draft.stands = feet.on_floor(draft.positions, draft.stands, draft.body)


def _found(people: Sequence[TiltEvidence], draft: Draft) -> Array:
    """Return the tilt and roll [rad] that people show, (2,)."""
    angles = sensor_tilt(people, by_kinect=draft.by_kinect)
    if draft.turn.tilt or draft.turn.roll:
        angles[1] = 0.0  # one roll and then one tilt make the whole turn
    return angles


def _level(draft: Draft, angles: Array) -> None:
    draft.tilt, draft.roll = map(float, angles)
    draft.positions = floor.leveled(draft.positions, draft.tilt, draft.roll)
    if draft.face is not None:
        draft.face = floor.leveled(draft.face, draft.tilt, draft.roll)


def _stood(draft: Draft) -> floor.Stood:
    return floor.Stood(draft.positions, draft.confidence, draft.stands, draft.body)
