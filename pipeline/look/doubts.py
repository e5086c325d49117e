"""Where a clip is to be doubted, so that somebody looks there."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from scipy.ndimage import uniform_filter1d

from kinefilter.characters import Clip
from kinefilter.characters.arrays import Flags
from kinefilter.characters.motion import nominal_step
from kinefilter.pipeline.failures import Failure

_UNLIKELY = 0.4  # reliability, of the worst joint over half a second. A guess
_LASTING = 0.5  # s


def doubtful(clip: Clip, failures: Iterable[Failure] = ()) -> Flags:
    """Return in which frames the tracker failed, or a joint is hardly reliable, (T,).

    Hands are left out: they nearly always are.
    """
    joints = np.flatnonzero(~clip.skeleton.hands)
    frames = max(
        round(_LASTING / float(np.nan_to_num(nominal_step(clip.time)) or 1)), 1
    )
    rates = np.nan_to_num(clip.reliability[:, joints], nan=1.0)
    worst = uniform_filter1d(rates, frames, axis=0).min(axis=1)
    found = worst < _UNLIKELY
    for failure in failures:
        found |= (failure.start <= clip.time) & (clip.time <= failure.end)
    return np.asarray(found)
