"""A whole clip in one npz file, with what every joint's origin is."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import fields
from typing import Any

import numpy as np

from kinefilter.characters import (
    Body,
    Clip,
    InputError,
    Prop,
    Shape,
    skeleton_named,
)

from .files import atomic_path
from .npz import read_arrays

_NO_ARRAYS = ("root", "rotations", "body", "source", "props", "tilt", "floor")
_ARRAYS = (
    "time",
    "positions",
    "rotations",
    *(f.name for f in fields(Clip) if f.name not in ("time", *_NO_ARRAYS)),
)
_FRAME = ("tilt", "floor")  # archives of older versions lack them
_SHAPE = tuple(field.name for field in fields(Shape) if field.name != "kind")
_BODY = tuple(field.name for field in fields(Body) if field.name != "skeleton")


def write_npz(clip: Clip, path: str | os.PathLike[str]) -> None:
    """Write every array of a clip and every measure of its body under its own name.

    Besides them there are ``skeleton``, ``joints`` and ``source``, and for each prop
    ``prop:K:name``, ``positions``, ``rotations``, ``kinds`` and, for each of its
    shapes, ``prop:K:L:size`` and so on. Equal clips give equal bytes.

    Raises:
        InputError: The file cannot be written.
    """
    arrays: dict[str, Any] = {name: getattr(clip, name) for name in _ARRAYS + _FRAME}
    measures: dict[str, Any] = {name: getattr(clip.body, name) for name in _BODY}
    # An open file, as numpy adds .npz to a name that ends in .NPZ.
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(
            file,
            **arrays,
            **measures,
            **_props_as_arrays(clip.props),
            skeleton=np.array(clip.skeleton.name),
            joints=np.array(clip.skeleton.joints),
            source=np.array(clip.source),
        )


def read_npz(path: str | os.PathLike[str]) -> Clip:
    """Read a clip that write_clip wrote as npz.

    Raises:
        InputError: There is no such file, or it holds no clip.
    """
    name = os.fspath(path)
    arrays = read_arrays(path, "a clip that kinefilter wrote")
    try:
        return _clip(arrays)
    except InputError as error:
        raise InputError(f"{name}: {error}") from None
    except KeyError as error:
        raise InputError(
            f"{name}: holds no clip (no array {error.args[0]}); expected an npz that "
            "kinefilter wrote"
        ) from None
    except (ValueError, TypeError, IndexError):
        raise InputError(
            f"{name}: its arrays are no clip; expected an npz that kinefilter wrote"
        ) from None


def _clip(archive: dict[str, Any]) -> Clip:
    skeleton = skeleton_named(str(archive["skeleton"]))
    measures: dict[str, Any] = {name: archive[name] for name in _BODY}
    arrays = {name: archive[name] for name in _ARRAYS}
    frame = {name: archive.get(name, np.nan) for name in _FRAME}
    for name, array in (*arrays.items(), *measures.items(), *frame.items()):
        if np.asarray(array).dtype.kind not in "biuf":
            raise InputError(f"{name} holds no numbers; write the clip again")
    if arrays["time"].dtype.kind != "f":
        raise InputError("time holds no numbers; write the clip again")
    numbers = {name: measures[name].item() for name in ("height", "mass")}
    positions = arrays.pop("positions")
    if positions.shape != (len(arrays["time"]), len(skeleton), 3):
        raise InputError(f"positions have shape {positions.shape}; write it again")
    return Clip(
        **arrays,
        root=positions[:, skeleton.root],
        body=Body(skeleton=skeleton, **(measures | numbers)),
        source=str(archive["source"]),
        props=tuple(props_from_arrays(archive)),
        tilt=np.asarray(frame["tilt"]).item(),
        floor=np.asarray(frame["floor"]).item(),
    )


def _props_as_arrays(props: tuple[Prop, ...]) -> dict[str, Any]:
    arrays: dict[str, Any] = {}
    for k, prop in enumerate(props):
        arrays[f"prop:{k}:name"] = np.array(prop.name)
        arrays[f"prop:{k}:positions"] = prop.positions
        arrays[f"prop:{k}:rotations"] = prop.rotations
        arrays[f"prop:{k}:kinds"] = np.array([shape.kind for shape in prop.shapes])
        for n, shape in enumerate(prop.shapes):
            for name in _SHAPE:
                arrays[f"prop:{k}:{n}:{name}"] = getattr(shape, name)
    return arrays


def props_from_arrays(archive: dict[str, Any]) -> Iterator[Prop]:
    """Yield the props whose arrays are named as ``write_npz`` names them."""
    k = 0
    while f"prop:{k}:name" in archive:
        shapes = [
            Shape(kind, *(archive[f"prop:{k}:{n}:{name}"] for name in _SHAPE))
            for n, kind in enumerate(archive[f"prop:{k}:kinds"].tolist())
        ]
        yield Prop(
            str(archive[f"prop:{k}:name"]),
            tuple(shapes),
            archive[f"prop:{k}:positions"],
            archive[f"prop:{k}:rotations"],
        )
        k += 1
