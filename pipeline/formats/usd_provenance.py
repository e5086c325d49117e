"""Where the motion of a USD character came from, and how far it can be trusted.

Per frame, ``/Character`` has these attributes. Arrays are in the order of
``kinefilter:joints``, lengths in meters whatever the stage's unit:

``kinefilter:reliability``
    Rate in [0, 1] of each joint's measurement.
``kinefilter:decidingTerm``
    Which term decided it, an index of ``kinefilter:decidingTermNames``.
``kinefilter:origin``
    Where each joint came from, an index of ``kinefilter:originNames``.
``kinefilter:movedByCorrection``, ``kinefilter:movedByPhysics``
    How far each joint was moved, -1 where nothing was measured.
``kinefilter:contacts``
    Which of ``kinefilter:contactNames`` stand on the floor.
``kinefilter:externalForce``
    Body weights that no muscle and no floor gives; no sample without physics.

What cleaning did to the whole take stands there once, unless it is not known:

``kinefilter:sensorTilt``
    Angle in radians by which the take was turned about the sensor's x axis, positive
    where the floor rose away from the sensor: ``y cos - z sin`` is up.
``kinefilter:floorHeight``
    Height of the floor in the take so leveled, which was then taken off.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import CONTACTS, Clip, Origin, Term
from kinefilter.characters.arrays import Array

from .usd_character import CHARACTER

_UNMEASURED = -1.0


def write_provenance(layer: Any, clip: Clip, codes: Array) -> None:
    """Say in attributes of the character where its motion came from.

    Args:
        layer: Where; ``/Character`` is defined.
        clip: The motion.
        codes: Time code of each frame, shape (T,).
    """
    from pxr import Sdf, Vt

    types = Sdf.ValueTypeNames
    names = {
        "joints": clip.skeleton.joints,
        "decidingTermNames": [term.name.lower() for term in Term],
        "originNames": [origin.name.lower() for origin in Origin],
        "contactNames": CONTACTS,
    }
    for name, values in names.items():
        _attribute(layer, name, types.TokenArray).default = Vt.TokenArray(values)
    for name, number in (("sensorTilt", clip.tilt), ("floorHeight", clip.floor)):
        if np.isfinite(number):
            _attribute(layer, name, types.Double).default = number
    for name, numbers in (
        ("reliability", clip.reliability),
        ("movedByCorrection", clip.moved_by_correction),
        ("movedByPhysics", clip.moved_by_physics),
    ):
        halves = np.where(np.isnan(numbers), _UNMEASURED, numbers).astype(np.float16)
        _sample(layer, _attribute(layer, name, types.HalfArray), codes, halves)
        layer.Save()
    for name, flags in (
        ("decidingTerm", clip.deciding_term),
        ("origin", clip.origin),
    ):
        _sample(layer, _attribute(layer, name, types.UCharArray), codes, flags)
    contacts = _attribute(layer, "contacts", types.BoolArray)
    _sample(layer, contacts, codes, clip.contacts)
    force = _attribute(layer, "externalForce", types.Float)
    simulated = np.isfinite(clip.external_force)
    with Sdf.ChangeBlock():
        for code, value in zip(
            codes[simulated].tolist(),
            clip.external_force[simulated].tolist(),
            strict=True,
        ):
            layer.SetTimeSample(force.path, code, value)


def _attribute(layer: Any, name: str, kind: Any) -> Any:
    from pxr import Sdf

    character = layer.GetPrimAtPath(CHARACTER)
    return Sdf.AttributeSpec(character, f"kinefilter:{name}", kind, declaresCustom=True)


def _sample(layer: Any, attribute: Any, codes: Array, rows: NDArray[Any]) -> None:
    """Set one sample a frame, an array of a type as wide as numpy's."""
    from pxr import Sdf, Vt

    arrays = {"half[]": Vt.HalfArray, "uchar[]": Vt.UCharArray, "bool[]": Vt.BoolArray}
    convert = arrays[str(attribute.typeName)].FromNumpy
    with Sdf.ChangeBlock():
        for code, row in zip(codes.tolist(), np.ascontiguousarray(rows), strict=True):
            layer.SetTimeSample(attribute.path, code, convert(row))
