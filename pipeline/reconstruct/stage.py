"""The stage that fills hidden limbs."""

from __future__ import annotations

import numpy as np

from kinefilter.characters import Body, InputError, Skeleton, State, Take
from kinefilter.characters.arrays import Array, Codes, Flags
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.draft import Draft
from kinefilter.pipeline.formats.takes import read_take
from kinefilter.pipeline.progress import Progress
from kinefilter.pipeline.stages import Stage
from kinefilter.pipeline.target.floor import leveled

from .hidden_limbs import fill_hidden
from .limbs import in_limbs
from .prior import MotionPrior
from .tracker import HiddenLimbTracker

_MOSTLY_INFERRED = 0.3  # share of tracked frames under which a guess is all there is
_LATELY = 300  # frames that the share is a mean over, live
_BETWEEN = 2.0  # s between takes: nobody moves from one to the next


class Reconstruct(Stage):
    """Lets limbs that the sensor did not see, or only guessed, go on as they went."""

    name = "reconstruct"
    in_parts = False

    def __init__(self, config: CleanConfig, prior: MotionPrior | None = None) -> None:
        self._prior, self._files = prior, config.same_person
        self._others: list[Take] | None = None

    def start(self, body: Body) -> None:
        """Forget all frames."""
        self._tracker = HiddenLimbTracker(body, self._prior)
        self._tracked, self._frames = np.zeros(len(body.skeleton)), 0

    def step(self, draft: Draft) -> None:
        """Fill the hidden joints of the next frame."""
        now = draft.state == State.TRACKED
        self._frames = min(self._frames + 1, _LATELY)
        self._tracked = self._tracked + (now - self._tracked) / self._frames
        hidden = hidden_joints(
            draft.measured, draft.state, draft.skeleton, self._tracked
        )
        draft.filled, draft.hidden = self._tracker.step(
            draft.measured, hidden, float(draft.time)
        )

    def whole(self, draft: Draft, progress: Progress) -> None:  # noqa: ARG002
        """Fill the hidden joints of a take."""
        if self._others is None:
            self._others = [read_take(file) for file in self._files]
        hidden = hidden_joints(draft.measured, draft.state, draft.skeleton)
        recorded = draft.measured[:, draft.skeleton.root]
        time, positions, first = draft.time, draft.measured, 0
        for other in self._others:
            if other.skeleton != draft.skeleton:
                raise InputError(
                    f"{other.source}: {other.skeleton.name}, but the take is "
                    f"{draft.skeleton.name}; --same-person needs the same sensor"
                )
            new = np.diff(other.time, prepend=-np.inf) > 0
            before = other.time[new] + time[0] - _BETWEEN - other.time[-1]
            # A take must not teach itself; its root is as it was recorded.
            seen = leveled(other.positions[new], draft.turn.tilt, draft.turn.roll)
            roots = seen[:, draft.skeleton.root]
            taken_out = np.isnan(recorded[:, 0])
            if len(roots) == len(recorded) and np.array_equal(
                roots[~taken_out], recorded[~taken_out]
            ):
                continue
            time = np.concatenate([before, time])
            positions = np.concatenate([seen, positions])
            blind = hidden_joints(
                other.positions[new], other.state[new], other.skeleton
            )
            hidden = np.concatenate([blind, hidden])
            first += int(new.sum())
        filled, which = fill_hidden(
            time, positions, hidden, draft.skeleton, self._prior
        )
        draft.filled, draft.hidden = filled[first:], which[first:]


def hidden_joints(
    positions: Array,
    state: Codes,
    skeleton: Skeleton,
    tracked: Array | None = None,
) -> Flags:
    """Return which joints are missing, or only inferred beyond shoulder and hip.

    Of the trunk, what the sensor infers is better than what went before; so it is of
    a joint that it hardly ever tracks.

    Args:
        positions: Joint positions [m], NaN where missing, shape (..., J, 3).
        state: Tracking states (State), shape (..., J).
        skeleton: The joints.
        tracked: Share of frames in which each joint is tracked, shape (J,); by default
            that of all frames.
    """
    now = state == State.TRACKED
    often = (now.mean(axis=0) if tracked is None else tracked) > _MOSTLY_INFERRED
    return np.asarray(np.isnan(positions[..., 0]) | ~now & often & in_limbs(skeleton))
