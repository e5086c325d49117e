"""A person whom several sensors see, followed by what all of them see.

Frame by frame, as ``merge.clean_session`` does it with takes: each sensor's joints are
scored, sides are settled among the sensors, joints are corrected sensor by sensor, as
methods know from where a sensor looks, and fused.
"""

from __future__ import annotations

import numpy as np

from kinefilter.characters import Body
from kinefilter.pipeline.avatar import Avatar, Pose
from kinefilter.pipeline.cleaner import Cleaner
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.correct import Corrector
from kinefilter.pipeline.draft import Draft
from kinefilter.pipeline.merge import Corrected, Fusion, Sight
from kinefilter.pipeline.merge.alignment import HERE
from kinefilter.pipeline.merge.rigid import Placement

from .config import LiveConfig
from .crowd import Person
from .messages import SeenBody
from .sensors import OLDEST, Sensors
from .tally import Event

_LONGEST_STEP = 0.5  # s: a pause in the stream is no time in which weights follow
_OWN = HERE.placed.shift  # where a sensor is in its own frame
_BY_JOINT = ("measured", "state", "reliability", "geometry", "deciding_term")


class FusedPerson(Person):
    """Follows one person by all sensors that see them.

    Until a second sensor is placed, as ``Person`` does.
    """

    def __init__(self, config: LiveConfig, sensors: Sensors) -> None:
        self._sensors = sensors
        self._given = Corrected(CleanConfig())
        self._views: list[_View] = []
        self._fusions: list[Fusion] = []
        self._last: float | None = None
        super().__init__(config)
        sensors.followed.add(self)

    def start(self) -> None:
        """Start over, as the leading sensor's clock does."""
        super().start()
        self._views, self._fusions, self._last = [], [], None
        self._given.places = None

    def step(self, seen: SeenBody, time: float) -> Pose | None:
        """Return the pose after a frame of the leading sensor, or of another one.

        Raises InputError, as ``Person.step`` does.
        """
        self.place = np.nanmean(seen.positions, axis=0)
        if self._avatar is None or not (self._sensors.joined or self._views):
            return super().step(seen, time)
        if not self._views:
            body, streams = self._avatar.body, self._sensors.streams
            self._views = [_View(body, self._given.copied()) for _ in streams]
            # Raw joints settle the sides, corrected ones are followed.
            self._fusions = [Fusion(body.skeleton, len(streams)) for _ in range(2)]
        before, self._last = self._last, time
        elapsed = 1.0 / 30.0 if before is None else min(time - before, _LONGEST_STEP)
        moments = self._moments(seen, time)
        each = list(zip(self._views, moments, strict=True))
        sights = [
            moment and view.sight(*moment, corrected=False) for view, moment in each
        ]
        raw = self._fusions[0].step(sights, elapsed)
        for view, exchanged in zip(self._views, raw.exchanged, strict=True):
            view.correct(exchanged=bool(exchanged))
        sights = [
            moment and view.sight(*moment, corrected=True) for view, moment in each
        ]
        settled = np.zeros_like(raw.exchanged)
        self._given.places = self._fusions[1].step(sights, elapsed, settled).positions
        if sum(sight is not None for sight in sights) > 1:
            self._sensors.tally.count(Event.FUSED)
        return self._avatar.step(raw.positions, time, raw.state)

    def _follow(self, body: Body) -> Avatar:
        avatar = super()._follow(body)
        avatar.cleaner = avatar.cleaner.replaced(self._given)
        avatar.start()
        return avatar

    def _moments(
        self, seen: SeenBody, time: float
    ) -> list[tuple[float, Placement] | None]:
        """Take what sensors saw until now; return when that is, and where they are.

        By each sensor's clock [s]; None of those of which that is not known.
        """
        moments: list[tuple[float, Placement] | None] = []
        joined = self._sensors.joined
        for view, stream in zip(self._views, self._sensors.streams, strict=True):
            if stream is self._sensors.lead:
                if not seen.carried:
                    view.take(seen, time)
                moments.append((time, HERE.placed))
            elif stream in joined and stream.clock and stream.placed:
                now = stream.clock.at(time)
                for frame in stream.until(now, view.time):
                    found = self._sensors.match(stream, frame, self)
                    if found is not None:
                        view.take(found[0], frame.time)
                moments.append((now, stream.placed))
            else:
                view.start()
                moments.append(None)
        return moments


class _View:
    """What one sensor sees of a person, frame by frame, and what corrects it."""

    def __init__(self, body: Body, corrector: Corrector) -> None:
        cleaner = Cleaner(CleanConfig(tilt=0.0), corrector=corrector).until("correct")
        self._body, self._head = body, cleaner.until("reliability")
        self._tail = cleaner.stages[len(self._head.stages) :]
        self.start()

    def start(self) -> None:
        """Forget all frames."""
        self.time = -np.inf  # of the last frame [s]
        # The last frame in the sensor's own frame, as it came and corrected.
        self._seen: list[Sight | None] = [None, None]
        self._waiting: Draft | None = None
        self._exchanged = False
        self._head.start(self._body)
        for stage in self._tail:
            stage.start(self._body)

    def take(self, seen: SeenBody, time: float) -> None:
        """Score the next frame, with a stamp later than the last [s]."""
        self.correct(exchanged=self._exchanged)
        draft = self._head.step(seen.positions, time, seen.state)
        self.time, self._waiting = time, draft
        self._seen[0] = Sight(draft.measured, draft.reliability, draft.state, _OWN)

    def correct(self, *, exchanged: bool) -> None:
        """Correct the last frame, if need be with left and right exchanged."""
        draft, self._waiting, self._exchanged = self._waiting, None, exchanged
        if draft is None:
            return
        if exchanged:
            for name in _BY_JOINT:
                setattr(draft, name, getattr(draft, name)[draft.skeleton.mirror])
        for stage in self._tail:
            if draft.appears and not stage.goes_on:
                stage.start(self._body)
            stage.step(draft)
        places = np.where(draft.missing[:, None], np.nan, draft.positions)
        self._seen[1] = Sight(places, draft.reliability, draft.state, _OWN)

    def sight(self, time: float, placed: Placement, *, corrected: bool) -> Sight | None:
        """Return what it saw last, None if that is long before a time of its clock [s].

        Joints that go on as they went until then are no nearer to the truth.
        """
        last = self._seen[corrected]
        if last is None or abs(time - self.time) > OLDEST:
            return None
        places = placed.apply(last.positions)
        return last._replace(positions=places, sensor=placed.shift)
