"""Cleans what several sensors recorded of a person into one clip."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import replace
from functools import partial

import numpy as np

from kinefilter.characters import Body, Origin, Take, Tracking
from kinefilter.characters.arrays import Array, Flags
from kinefilter.pipeline.cleaner import Cleaner, CleanResult
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.correct import Corrector
from kinefilter.pipeline.draft import Draft
from kinefilter.pipeline.edits import Edit, edited, read_edits
from kinefilter.pipeline.formats.recording import Recording
from kinefilter.pipeline.progress import Progress, silent
from kinefilter.pipeline.stages import Correct
from kinefilter.pipeline.target.floor import leveled
from kinefilter.pipeline.uncertainty import uncertainty

from .alignment import Alignment
from .session import Merged, fuse, merge

_SURE = 0.01  # m of uncertainty at which reliability alone decides
_MOVED = 0.1  # m by which correction moved a joint that counts a third


def clean_session(
    takes: Sequence[Take | Recording],
    config: CleanConfig | None = None,
    *,
    body: int | None = None,
    calibration: Sequence[Alignment] = (),
    tracking: Tracking | None = None,
    edits: Sequence[Edit] | None = None,
    progress: Progress = silent,
) -> tuple[CleanResult, Merged]:
    """Return the clip of a person whom several sensors recorded, and what was merged.

    Each sensor's take is corrected by itself, with its sides as all sensors have them,
    as methods know what a sensor errs by and from where it looks. What they make of it
    is fused, by their uncertainty, too, and goes through the stages that follow.

    Args:
        takes: What each sensor recorded; the first one's clock is the clip's.
        config: What to do; by default as ``clean`` does.
        body: Which person of the first recording; see ``merge``.
        calibration: Where and when the other sensors are; see ``merge``.
        tracking: How hard the simulated character is pulled.
        edits: What somebody says of the merged take; by default what the config's file
            says.
        progress: Wraps the frame loops, for a progress bar.

    Raises:
        InputError: As ``merge`` and ``clean``.
    """
    config = CleanConfig() if config is None else config
    if edits is None:
        edits = read_edits(config.edits) if config.edits else ()
    config = replace(config, edits=None)
    merged = merge(takes, body=body, calibration=calibration, progress=progress)
    edited(merged.take, edits)  # refused before any work is done
    cleaner, before = _cleaner(merged, config, (), tracking, progress), None
    if edits:
        before = cleaner.unedited(merged.take, progress)
        cleaner = _cleaner(merged, config, edits, tracking, progress)
    clean = partial(cleaner.clean, edits=edits, before=before)
    return clean(merged.take, progress=progress), merged


def _cleaner(
    merged: Merged,
    config: CleanConfig,
    edits: Sequence[Edit],
    tracking: Tracking | None,
    progress: Progress,
) -> Cleaner:
    """Return what cleans a merged take, with joints where each sensor's are right."""
    # The frames stay those of the sensors, in which their alignments hold; failures
    # were mended before sides were settled.
    corrector = _without_failures(Cleaner(replace(config, tilt=0.0)).until("correct"))
    corrected, scores = [], []
    for take, since in merged.untangled():
        take = edited(take, edits, since)
        draft = corrector.whole(take, progress)
        places = np.where(draft.missing[..., None], np.nan, draft.positions)
        corrected.append(replace(take, positions=places))
        moved = np.linalg.norm(draft.positions - take.positions, axis=2)
        sure = (_SURE / uncertainty(draft)) ** 2
        scores.append(draft.reliability * sure * np.exp(-np.nan_to_num(moved) / _MOVED))
    fused = fuse(corrected, scores, merged.alignments, progress)
    # A person who turns away from one sensor is no failure of all.
    cleaner = _without_failures(Cleaner(config, tracking=tracking))
    return cleaner.replaced(Corrected(config, fused.take.positions))


def _without_failures(cleaner: Cleaner) -> Cleaner:
    names = [stage.name for stage in cleaner.stages]
    return cleaner.without("failures") if "failures" in names else cleaner


class Corrected(Correct):
    """Puts joints where they were corrected already; without any, corrects them.

    Args:
        config: The settings.
        places: Corrected joints of the take, (T, J, 3), or of the next frame, (J, 3)
            [m], the sensor's frame, NaN where none is.
    """

    in_parts = False
    local = False  # the places are those of the whole take

    def __init__(self, config: CleanConfig, places: Array | None = None) -> None:
        super().__init__(config)
        self._plain = Correct(replace(config, method="none", model=None, preset=None))
        self.places = places

    def start(self, body: Body) -> None:
        """Forget all frames."""
        super().start(body)
        self._plain.start(body)

    def copied(self) -> Corrector:
        """Return the method with a state of its own; to read one takes long."""
        return deepcopy(self._corrector)

    def step(self, draft: Draft) -> None:
        """Correct the next frame."""
        if self.places is None:
            super().step(draft)
        else:
            self._plain.step(draft)
            self._put(draft, self.places)

    def whole(self, draft: Draft, progress: Progress) -> None:
        """Correct a take."""
        if self.places is None:
            super().whole(draft, progress)
        else:
            self._plain.whole(draft, progress)
            known = self._put(draft, self.places)
            draft.origin[known & ~draft.missing] = Origin.CORRECTED

    @staticmethod
    def _put(draft: Draft, places: Array) -> Flags:
        """Put joints there, and return which."""
        places = leveled(places, draft.turn.tilt, draft.turn.roll)
        known = ~np.isnan(places[..., 0])
        draft.positions = np.where(known[..., None], places, draft.positions)
        return known
