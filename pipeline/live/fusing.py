"""Follows one person with all sensors that see them.

It does frame by frame what ``merge.clean_session`` does with takes: scores the joints
of each sensor, settles left and right among the sensors, corrects the joints of each
sensor separately, since methods depend on where it stands, and fuses them.
"""

import numpy as np

from kinefilter.characters import Body
from kinefilter.pipeline.avatar import Avatar, Pose
from kinefilter.pipeline.cleaner import Cleaner
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.correct import Corrector
from kinefilter.pipeline.draft import Draft
from kinefilter.pipeline.merge import Corrected, Fusion, Sight
from kinefilter.pipeline.merge.alignment import IDENTITY
from kinefilter.pipeline.merge.rigid import Placement
from kinefilter.pipeline.physics.shared_scene import SharedScene

from .crowd import Person
from .live_config import LiveConfig
from .messages import SeenBody
from .sensors import MAX_AGE, Sensors
from .tally import Event

_LONGEST_STEP = 0.5  # s: during a pause in the stream, weights do not follow
_ORIGIN = IDENTITY.placed.shift  # where a sensor is in its own frame
_BY_JOINT = ("measured", "state", "reliability", "geometry", "deciding_term")
_Moment = tuple[float, Placement]  # time by a sensor's clock [s], and its placement


class FusedPerson(Person):
    """Follows one person with all sensors that see them, first with the lead alone."""

    def __init__(
        self,
        config: LiveConfig,
        sensors: Sensors,
        scene: SharedScene | None = None,
        name: str = "",
    ) -> None:
        self._sensors = sensors
        self._corrected = Corrected(CleanConfig())
        self._views: list[_View] = []
        self._fusions: list[Fusion] = []
        self._last: float | None = None
        super().__init__(config, scene, name)
        sensors.people.add(self)

    def start(self) -> None:
        """Start over, because the leading sensor's clock restarted."""
        super().start()
        self._views, self._fusions, self._last = [], [], None
        self._corrected.places = None

    def step(self, seen: SeenBody, time: float) -> Pose | None:
        """Return the pose after a frame of any sensor; arguments as ``Person.step``."""
        self.place = seen.place
        if self.avatar is None or not (self._sensors.joined or self._views):
            return super().step(seen, time)
        if not self._views:
            body, streams = self.avatar.measured, self._sensors.streams
            self._views = [_View(body, self._corrected.copied()) for _ in streams]
            # Raw joints settle the sides; corrected joints are followed.
            self._fusions = [Fusion(body.skeleton, len(streams)) for _ in range(2)]
        before, self._last = self._last, time
        elapsed = 1.0 / 30.0 if before is None else min(time - before, _LONGEST_STEP)
        each = list(zip(self._views, self._moments(seen, time), strict=True))
        sights = [view.sight(moment, corrected=False) for view, moment in each]
        raw = self._fusions[0].step(sights, elapsed)
        for view, swapped in zip(self._views, raw.swapped, strict=True):
            view.correct(swapped=bool(swapped))
        sights = [view.sight(moment, corrected=True) for view, moment in each]
        fused = self._fusions[1].step(sights, elapsed, np.zeros_like(raw.swapped))
        self._corrected.places = fused.positions
        if sum(sight is not None for sight in sights) > 1:
            self._sensors.tally.events[Event.FUSED] += 1
        return self.avatar.step(raw.positions, time, raw.state)

    def _make_avatar(self, body: Body, measured: Body | None = None) -> Avatar:
        avatar = super()._make_avatar(body, measured)
        avatar.cleaner = avatar.cleaner.replaced(self._corrected)
        avatar.start()
        return avatar

    def _moments(self, seen: SeenBody, time: float) -> list[_Moment | None]:
        """Pass new frames to the views; return each sensor's moment, if it is known."""
        moments, joined = list[_Moment | None](), self._sensors.joined
        for view, stream in zip(self._views, self._sensors.streams, strict=True):
            if stream is self._sensors.lead:
                if not seen.from_other_sensor:
                    view.take(seen, time)
                moments.append((time, IDENTITY.placed))
            elif stream in joined and stream.clock and stream.placed:
                now = stream.clock.at(time)
                for frame in stream.recent(now, view.time):
                    found = self._sensors.match(stream, frame, self)
                    if found is not None:
                        view.take(found, frame.time)
                moments.append((now, stream.placed))
            else:
                view.start()
                moments.append(None)
        return moments


class _View:
    """Scores and corrects what one sensor sees of a person, frame by frame."""

    def __init__(self, body: Body, corrector: Corrector) -> None:
        cleaner = Cleaner(CleanConfig(tilt=0.0), corrector=corrector).until("correct")
        self._body, self._head = body, cleaner.until("reliability")
        self._tail = cleaner.without(*(stage.name for stage in self._head.stages))
        self.start()

    def start(self) -> None:
        self.time = -np.inf  # of the last frame [s]
        # What the last frame shows, in the sensor's own frame.
        self._raw: Sight | None = None
        self._corrected: Sight | None = None
        self._waiting: Draft | None = None
        self._swapped = False
        self._head.start(self._body)
        self._tail.start(self._body)

    def take(self, seen: SeenBody, time: float) -> None:
        """Score the next frame, with a time stamp later than the last [s]."""
        self.correct(swapped=self._swapped)
        draft = self._head.step(seen.positions, time, seen.state)
        self.time, self._waiting = time, draft
        self._raw = Sight(draft.measured, draft.reliability, draft.state, _ORIGIN)

    def correct(self, *, swapped: bool) -> None:
        """Correct the last frame once, after undoing swapped left and right."""
        draft, self._waiting, self._swapped = self._waiting, None, swapped
        if draft is None:
            return
        if swapped:
            for name in _BY_JOINT:
                setattr(draft, name, getattr(draft, name)[draft.skeleton.mirror])
        self._tail.go_on(draft)
        positions = np.where(draft.missing[:, None], np.nan, draft.positions)
        self._corrected = Sight(positions, draft.reliability, draft.state, _ORIGIN)

    def sight(self, moment: _Moment | None, *, corrected: bool) -> Sight | None:
        """Return the last frame, placed for a moment; None if it is too old by then."""
        # Extrapolated to the moment, joints would be no nearer to the truth.
        last = self._corrected if corrected else self._raw
        if moment is None or last is None or abs(moment[0] - self.time) > MAX_AGE:
            return None
        positions = moment[1].apply(last.positions)
        return last._replace(positions=positions, sensor=moment[1].shift)
