"""The person after correction: bones measured again on what it made of a take."""

from __future__ import annotations

import numpy as np

from kinefilter.characters import Body, Take
from kinefilter.pipeline.correct import CorrectedTake
from kinefilter.pipeline.reliability import measure_reference
from kinefilter.retarget import measured_body

_FRAMES = 20_000  # enough for medians; an hour's take is to fit a gigabyte


def corrected_body(
    take: Take,
    corrected: CorrectedTake,
    *,
    height: float | None = None,
    mass: float | None = None,
) -> Body:
    """Return the body whose bones corrected joints span.

    A method that knows where the sensor misplaces joints knows the person's lengths
    better than the sensor. What was not measured does not count.

    Args:
        take: The recording.
        corrected: What correction made of it.
        height: Stature [m]; by default from the lengths.
        mass: Body mass [kg]; by default from the stature.
    """
    frames = slice(None, None, -(-len(take) // _FRAMES))
    missing = np.isnan(take.positions[frames])
    again = Take(
        take.time[frames],
        np.where(missing, np.nan, corrected.positions[frames]),
        take.state[frames],
        take.skeleton,
        take.source,
    )
    reference = measure_reference(again)
    return measured_body(
        take.skeleton,
        reference.lengths,
        reference.directions,
        height=height,
        mass=mass,
        source=take.source,
    )
