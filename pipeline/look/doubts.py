"""Frames of a clip that a person should check."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from scipy.ndimage import uniform_filter1d

from kinefilter.characters import Clip
from kinefilter.characters.arrays import Flags
from kinefilter.characters.motion import nominal_step
from kinefilter.pipeline.failures import Failure

_UNLIKELY = 0.4  # reliability of the worst joint, averaged over _WINDOW. A guess
_WINDOW = 0.5  # s


def doubtful(clip: Clip, failures: Iterable[Failure] = ()) -> Flags:
    """Return the frames where the tracker failed or a joint is hardly reliable, (T,).

    Hands are left out, as their reliability is nearly always low.
    """
    joints = np.flatnonzero(~clip.skeleton.hands)
    step = float(np.nan_to_num(nominal_step(clip.time)) or 1)
    rates = np.nan_to_num(clip.reliability[:, joints], nan=1.0)
    means = uniform_filter1d(rates, max(round(_WINDOW / step), 1), axis=0)
    flags = means.min(axis=1) < _UNLIKELY
    for failure in failures:
        flags |= (failure.start <= clip.time) & (clip.time <= failure.end)
    return np.asarray(flags)
