"""Joints pinned to a place by an edit; neighbors in time and in the body follow."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from kinefilter.characters import InputError, Origin
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.draft import Draft
from kinefilter.pipeline.edits import Edit
from kinefilter.pipeline.reconstruct.foothold import middle_joint
from kinefilter.pipeline.reconstruct.limbs import limbs

from .feet import PLANTED, ankles_and_toes

_RAISED = 0.01  # m: a foot that is pinned higher has left the floor. A guess.
_FARTHEST = 2.0  # m from where the joint is; more is hardly meant. A guess
_AROUND = 0.5  # s before and after a pin in which the joint joins its own path


def pin(draft: Draft, pins: Sequence[Edit]) -> None:
    """Move joints to their pins, and the joints beyond them along with them.

    If a limb's end is pinned, its elbow or knee bends as before; restoring bone lengths
    handles what is out of reach. If the trunk is pinned, planted feet stay. A foot that
    a pin raises does not stand. Raises InputError for a pin over 2 m from its joint.
    """
    skeleton, since = draft.skeleton, draft.time - draft.time[0]
    for one in pins:
        joint = one.joints[0]
        place = draft.positions[one.frames(since).argmax(), skeleton.index(joint)]
        if not (far := np.linalg.norm(place - one.position)) <= _FARTHEST:
            raise InputError(
                f"{one.source or one}: {joint} is {far:.1f} m away from there, at "
                f"{place.round(2).tolist()}; pin it within {_FARTHEST:g} m of that, in "
                "meters in the clip's frame of reference"
            )
    positions, weights = draft.positions.copy(), draft.bone_weights.copy()
    origin, stands = draft.origin.copy(), weights >= PLANTED
    for name in dict.fromkeys(pinned.joints[0] for pinned in pins):
        j = skeleton.index(name)
        own = sorted((p for p in pins if p.joints[0] == name), key=lambda p: p.begin)
        places = {int(p.frames(since).argmax()): p.position for p in own}
        frames = list(places)
        away = np.array(list(places.values())) - positions[frames, j]
        curve = _curve(since[frames], np.column_stack([away, np.ones(len(away))]))
        moves, firm = np.split(curve(np.clip(since, *curve.x[[0, -1]])), [3], axis=1)
        ends = (x for x in limbs(skeleton) if j in skeleton.descendants(x[1]))
        limb = next(ends, None)
        first = j if limb is None else limb[2]
        for k in (first, *skeleton.descendants(first)):
            stays = stands[:, k, None] & (limb is None)
            positions[:, k] += np.where(stays, 0.0, moves)
        if limb is not None:
            _, middle, end = limb
            lengths = (draft.body.lengths[middle], draft.body.lengths[end])
            top, inner, outer = np.moveaxis(positions[:, limb], 1, 0)
            there, _ = middle_joint(top, inner, outer, lengths)
            positions[:, middle] += firm * (there - positions[:, middle])
        weights[:, j] = np.maximum(weights[:, j], PLANTED * firm[:, 0])
        moved = origin[frames, j] == Origin.MEASURED
        origin[np.array(frames)[moved], j] = Origin.CORRECTED
    _, toes = ankles_and_toes(skeleton)
    raised = (positions - draft.positions)[:, toes, 1] > _RAISED
    draft.stands = draft.stands & ~raised
    draft.contacts = draft.contacts & ~raised.repeat(2, axis=1)
    draft.positions, draft.bone_weights, draft.origin = positions, weights, origin


def _curve(times: Array, values: Array) -> Any:  # a CubicHermiteSpline
    """Return a curve through values (N, C) at times [s] (N,), falling to 0 beyond."""
    from scipy.interpolate import CubicHermiteSpline  # takes long to load

    ends = [t + d for t in times for d in (-_AROUND, _AROUND)]
    ends = [t for t in ends if np.abs(times - t).min() >= _AROUND - 1e-6]
    knots = dict.fromkeys(ends, np.zeros_like(values[0]))
    knots |= dict(zip(times, values, strict=True))
    at = sorted(knots)
    rows = np.array([knots[t] for t in at])
    return CubicHermiteSpline(at, rows, np.zeros_like(rows))
