"""All gross failures of a take, and the trust that they cost."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Skeleton, Take, Term
from kinefilter.pipeline.reliability import Reliability

from .failure import Failure, FailureKind, lasting
from .leaps import leaps
from .mirrored import mirrored, unmirrored
from .postures import bent_backwards, out_of_range, through_head

_LONG = 0.8  # s: a knee bent backwards for less is noise, or a kick seen from the front
_SHORT = 0.3  # s: an arm is where it cannot be for less when it only brushes by
_DOUBTED = (FailureKind.BENT_BACKWARDS, FailureKind.THROUGH_HEAD)
"""What correction does not believe. An arm beyond its range is closer to the truth than
what correction invents for it: 27 against 39 cm in 14 recorded clips. A limb that leaps
may be where it belongs before or after: real kicks were taken down."""


def find_failures(take: Take) -> tuple[Failure, ...]:
    """Return the gross failures in a take, time stamps strictly increasing."""
    found = lasting(take, FailureKind.MIRRORED, "body", mirrored(take))
    take = unmirrored(take, found)  # parts are named as they will be when it is mended
    for side in ("Left", "Right"):
        found += _of_arm(take, side) + _of_leg(take, side)
    return tuple(sorted(found, key=lambda failure: failure.first))


def _of_arm(take: Take, side: str) -> list[Failure]:
    part = f"{side.lower()} arm"

    def posture(kind: FailureKind, frames: NDArray[np.bool_]) -> list[Failure]:
        return lasting(take, kind, part, frames, shortest=_SHORT)

    leaping = leaps(take, side, "arm")
    return [
        *posture(FailureKind.THROUGH_HEAD, through_head(take, side)),
        *posture(FailureKind.OUT_OF_RANGE, out_of_range(take, side)),
        *lasting(take, FailureKind.LEAPING, part, leaping),
    ]


def _of_leg(take: Take, side: str) -> list[Failure]:
    part, backwards = f"{side.lower()} leg", bent_backwards(take, side)
    kind, leaping = FailureKind.BENT_BACKWARDS, leaps(take, side, "leg")
    return [
        *lasting(take, kind, part, backwards, shortest=_LONG),
        *lasting(take, FailureKind.LEAPING, part, leaping),
    ]


def distrust(
    reliability: Reliability, failures: tuple[Failure, ...], skeleton: Skeleton
) -> Reliability:
    """Return a reliability that is 0 where a limb is where no limb can be.

    It is so from elbow or knee on. Mirrored bodies are mended before; arms beyond their
    range and limbs that leap are left as they are.
    """
    rate, geometry = reliability.rate.copy(), reliability.geometry.copy()
    term = reliability.term.copy()
    for failure in failures:
        if failure.kind in _DOUBTED:
            limb = _limb(skeleton, failure.part)
            rate[failure.frames, limb] = 0.0
            geometry[failure.frames, limb] = 0.0
            term[failure.frames, limb] = Term.FAILURE
    return replace(reliability, rate=rate, geometry=geometry, term=term)


def _limb(skeleton: Skeleton, part: str) -> list[int]:
    """Return the joints beyond shoulder or hip of a part such as ``left arm``."""
    side, limb = part.split()
    top = {"arm": "Shoulder", "leg": "Hip"}[limb] + side.capitalize()
    return skeleton.beyond(skeleton.index(top))
