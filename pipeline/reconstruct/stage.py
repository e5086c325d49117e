"""The stage that fills hidden limbs."""

from __future__ import annotations

import numpy as np

from kinefilter.characters import Body, InputError, Skeleton, State, Take
from kinefilter.characters.arrays import Array, Codes, Flags
from kinefilter.characters.motion import distinct_stamps
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.draft import Draft
from kinefilter.pipeline.formats.takes import read_take
from kinefilter.pipeline.progress import Progress
from kinefilter.pipeline.stages import Stage
from kinefilter.pipeline.target.floor import leveled

from .hidden_limbs import fill_hidden, fill_unseen
from .limbs import in_limbs
from .prior import MotionPrior, default_prior
from .tracker import HiddenLimbTracker

_MOSTLY_INFERRED = 0.3  # share of tracked frames up to which inferred joints are kept
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
        measured, root = draft.measured, draft.skeleton.root
        hidden = hidden_joints(measured, draft.state, draft.skeleton, self._tracked)
        if not self._tracked[root]:
            measured, hidden[root] = with_root(measured, draft.body), False
        time = float(draft.time)
        draft.filled, draft.hidden = self._tracker.step(measured, hidden, time)

    def whole(self, draft: Draft, progress: Progress) -> None:
        """Fill the hidden joints of a take."""
        if self._others is None:
            self._others = [read_take(file) for file in self._files]
        skeleton, time, positions = draft.skeleton, draft.time, draft.measured
        hidden = hidden_joints(positions, draft.state, skeleton)
        if hidden[:, skeleton.root].all():
            positions = with_root(positions, draft.body)
        recorded, first = positions[:, skeleton.root], 0
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
        own, prior = filled[first:], self._prior or default_prior()
        unseen = np.asarray(hidden.all(axis=0))
        found = fill_unseen(draft.time, own, unseen, draft.body, prior)
        draft.filled, draft.hidden = found[0], which[first:] | found[1]


def with_root(positions: Array, body: Body) -> Array:
    """Return joints (..., J, 3) with a root that the sensor does not see.

    It is between the hips, or straight below whichever other joints of the trunk are
    seen, as far as in the rest pose.
    """
    skeleton, rest = body.skeleton, body.rest_positions
    spine = [[j] for j in reversed(skeleton.ancestors(skeleton.girdle))]
    hips, shoulders = skeleton.sides("Hip"), skeleton.sides("Shoulder")
    root = np.full_like(positions[..., 0, :], np.nan)
    for joints in (hips, *spine, shoulders, [skeleton.index("Head")]):
        above = (rest[joints] - rest[skeleton.root]).mean(axis=0) * [0.0, 1.0, 0.0]
        found = positions[..., joints, :].mean(axis=-2) - above
        root = np.where(np.isnan(root), found, root)
    rooted = positions.copy()
    rooted[..., skeleton.root, :] = root
    return rooted


def hidden_joints(
    positions: Array, state: Codes, skeleton: Skeleton, tracked: Array | None = None
) -> Flags:
    """Return True for joints that are missing, or of a limb and only inferred.

    Inferred joints of the trunk, and those hardly ever tracked, are not hidden: what
    the sensor infers is better there. ``tracked`` (J,) is the share of frames in which
    each joint is tracked; by default that of the take.
    """
    now = state == State.TRACKED
    often = (now.mean(axis=0) if tracked is None else tracked) > _MOSTLY_INFERRED
    return np.asarray(np.isnan(positions[..., 0]) | ~now & often & in_limbs(skeleton))
