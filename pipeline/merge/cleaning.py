"""Cleans what several sensors recorded of a person into one clip."""

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import replace

import numpy as np

from kinefilter.characters import Body, Origin, Take
from kinefilter.characters.arrays import Array, Flags, check_kind
from kinefilter.pipeline.clean_result import CleanResult
from kinefilter.pipeline.cleaner import Cleaner
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.correct import Corrector
from kinefilter.pipeline.draft import Draft
from kinefilter.pipeline.edits import Edit, check_edits, edited, read_edits
from kinefilter.pipeline.failures.sides import swapped_back
from kinefilter.pipeline.formats.recording import Recording
from kinefilter.pipeline.progress import Progress, silent
from kinefilter.pipeline.stages import Correct
from kinefilter.pipeline.target.floor import leveled
from kinefilter.pipeline.uncertainty import uncertainty

from .alignment import IDENTITY, Alignment
from .session import Merged, fuse, merge

_SURE = 0.01  # m of uncertainty at which a joint's weight is its reliability
_MOVED = 0.1  # m by which correction moves a joint whose weight then drops to 1/e


def clean_session(
    takes: Sequence[Take | Recording],
    config: CleanConfig | None = None,
    *,
    body: int | None = None,
    calibration: Sequence[Alignment] = (),
    edits: Sequence[Edit] | None = None,
    progress: Progress = silent,
) -> tuple[CleanResult, Merged]:
    """Return the clip of a person whom several sensors recorded, and the merged take.

    Each sensor's take is corrected separately, with left and right as agreed among the
    sensors, since methods know a sensor's errors and depend on where it stands. The
    corrected takes are fused, weighted also by their uncertainty, and pass through the
    remaining stages. The first take's clock is the clip's.

    Arguments and errors are those of ``merge`` and ``Cleaner``. ``edits`` are manual
    corrections to the merged take, by default those that the config names.
    """
    config = CleanConfig() if config is None else config
    check_kind(config, CleanConfig, "the config")
    if edits is None:
        edits = read_edits(config.edits) if config.edits else ()
    config = replace(config, edits=None)
    merged = merge(takes, body=body, calibration=calibration, progress=progress)
    check_edits(merged.take, edits)  # before any work is done
    cleaner, before = _cleaner(merged, config, (), progress), None
    if edits:
        before = cleaner.unedited(merged.take, progress)
        cleaner = _cleaner(merged, config, edits, progress)
    result = cleaner.clean(merged.take, edits=edits, before=before, progress=progress)
    return result, merged


def _cleaner(
    merged: Merged, config: CleanConfig, edits: Sequence[Edit], progress: Progress
) -> Cleaner:
    """Return a cleaner for a merged take that uses each sensor's corrected joints."""
    # Alignments hold in the sensors' own frames, so these are not leveled; failures
    # were repaired before sides were settled.
    corrector = _without_failures(Cleaner(replace(config, tilt=0.0)).until("correct"))
    corrected, scores = [], []
    pairs = zip(merged.takes, (IDENTITY, *merged.alignments), strict=True)
    stamps = merged.take.time
    for k, (take, found) in enumerate(pairs):
        time = found.clock.inverse(take.time)
        frames = np.searchsorted(stamps, time).clip(max=len(stamps) - 1)
        swapped = merged.swapped[frames, k]  # as the sensors agree
        take = swapped_back(take, np.stack([swapped, swapped], axis=1))
        take = edited(take, edits, time - stamps[0])
        draft = corrector.whole(take, progress)
        positions = np.where(draft.missing[..., None], np.nan, draft.positions)
        corrected.append(replace(take, positions=positions))
        moved = np.linalg.norm(draft.positions - take.positions, axis=2)
        sure = (_SURE / uncertainty(draft)) ** 2
        scores.append(draft.reliability * sure * np.exp(-np.nan_to_num(moved) / _MOVED))
    fused = fuse(corrected, scores, merged.alignments, progress)
    # A person who turns away from one sensor is not a failure of all sensors.
    cleaner = _without_failures(Cleaner(config))
    return cleaner.replaced(Corrected(config, fused.take.positions))


def _without_failures(cleaner: Cleaner) -> Cleaner:
    names = [stage.name for stage in cleaner.stages]
    return cleaner.without("failures") if "failures" in names else cleaner


class Corrected(Correct):
    """Uses joints that were corrected already; without any, corrects them itself.

    ``places`` are the joints [m] of a take (T, J, 3) or of the next frame (J, 3), in
    the sensor frame, NaN where there are none.
    """

    in_parts = False
    local = False  # the joints are those of the whole take

    def __init__(self, config: CleanConfig, places: Array | None = None) -> None:
        super().__init__(config)
        self._plain = Correct(replace(config, method="none", model=None, preset=None))
        self.places = places

    def start(self, body: Body) -> None:
        """Reset the state for a new motion."""
        super().start(body)
        self._plain.start(body)

    def copied(self) -> Corrector:
        """Return the method with a state of its own; reading it again takes long."""
        return deepcopy(self._corrector)

    def step(self, draft: Draft) -> None:
        """Correct the next frame."""
        if self.places is None:
            super().step(draft)
        else:
            self._plain.step(draft)
            self._apply(draft, self.places)

    def whole(self, draft: Draft, progress: Progress) -> None:
        """Correct a take."""
        if self.places is None:
            super().whole(draft, progress)
        else:
            self._plain.whole(draft, progress)
            known = self._apply(draft, self.places)
            draft.origin[known & ~draft.missing] = Origin.CORRECTED

    @staticmethod
    def _apply(draft: Draft, places: Array) -> Flags:
        """Move joints to where they were corrected, and return which (..., J)."""
        places = leveled(places, draft.turn.tilt, draft.turn.roll)
        known = ~np.isnan(places[..., 0])
        draft.positions = np.where(known[..., None], places, draft.positions)
        return known
