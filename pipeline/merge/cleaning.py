"""Cleans what several sensors recorded of a person into one clip."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from kinefilter.characters import Origin, Take, Tracking
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.cleaner import Cleaner, CleanResult
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.draft import Draft
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
        progress: Wraps the frame loops, for a progress bar.

    Raises:
        InputError: As ``merge`` and ``clean``.
    """
    config = CleanConfig() if config is None else config
    merged = merge(takes, body=body, calibration=calibration, progress=progress)
    # The frames stay those of the sensors, in which their alignments hold; failures
    # were mended before sides were settled.
    corrector = _without_failures(Cleaner(replace(config, tilt=0.0)).until("correct"))
    corrected, scores = [], []
    for take in merged.untangled():
        draft = corrector.whole(take, progress)
        places = np.where(draft.missing[..., None], np.nan, draft.positions)
        corrected.append(replace(take, positions=places))
        moved = np.linalg.norm(draft.positions - take.positions, axis=2)
        sure = (_SURE / uncertainty(draft)) ** 2
        scores.append(draft.reliability * sure * np.exp(-np.nan_to_num(moved) / _MOVED))
    fused = fuse(corrected, scores, merged.alignments, progress)
    cleaner = Cleaner(config, tracking=tracking)
    given = _Corrected(config, fused.take.positions)
    # A person who turns away from one sensor is no failure of all.
    cleaner = _without_failures(cleaner.replaced(given))
    return cleaner.clean(merged.take, progress=progress), merged


def _without_failures(cleaner: Cleaner) -> Cleaner:
    names = [stage.name for stage in cleaner.stages]
    return cleaner.without("failures") if "failures" in names else cleaner


class _Corrected(Correct):
    """Puts joints where they were corrected already.

    Args:
        config: The settings; the method is not asked again.
        places: Corrected joints [m], the take's frame, NaN where none is, (T, J, 3).
    """

    in_parts = False

    def __init__(self, config: CleanConfig, places: Array) -> None:
        super().__init__(replace(config, method="none", model=None, preset=None))
        self._places = places

    def whole(self, draft: Draft, progress: Progress) -> None:
        """Put the joints of a take there."""
        missing = draft.missing
        super().whole(draft, progress)
        places = leveled(self._places, draft.turn.tilt, draft.turn.roll)
        known = ~np.isnan(places[..., :1])
        draft.positions = np.where(known, places, draft.positions)
        draft.origin[known[..., 0] & ~missing] = Origin.CORRECTED
