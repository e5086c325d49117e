"""Arrays in npz files, read only up to the size that the file has, and clips."""

import os
import warnings
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields
from itertools import count
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from kinefilter.characters import Body, Clip, InputError, Prop, Shape, skeleton_named

from .files import AnyPath, atomic_path, check_file, refused

_LARGEST = 2**31  # bytes of all arrays: nine hours of the largest skeleton's positions
_KINDS = "biufUS"  # numpy's letters for Booleans, numbers and text
_MOST_ARRAYS = 1000

_FIRST = ("time", "positions", "rotations")
_ONCE = ("tilt", "floor", "roll")  # numbers of the whole clip; a roll of 0 is left out
_OTHERS = (*_FIRST, *_ONCE, "root", "body", "source", "props")
_ARRAYS = (*_FIRST, *(f.name for f in fields(Clip) if f.name not in _OTHERS))
_PROP = ("name", "positions", "rotations")
_SHAPE = tuple(field.name for field in fields(Shape) if field.name != "kind")
_BODY = tuple(field.name for field in fields(Body) if field.name != "skeleton")

_OURS = "a file that kinefilter wrote"


@contextmanager
def _archive(path: AnyPath, expected: str = _OURS) -> Iterator[zipfile.ZipFile]:
    check_file(path)
    with (
        refused(path, f"cannot be read as npz; expected {expected}"),
        zipfile.ZipFile(path) as archive,
    ):
        yield archive


def array_names(path: AnyPath) -> set[str]:
    """List the names of the arrays in an npz file, or raise InputError."""
    with _archive(path) as archive:
        return {name.removesuffix(".npy") for name in archive.namelist()}


def read_arrays(path: AnyPath, expected: str = _OURS) -> dict[str, NDArray[Any]]:
    """Read the arrays of an npz file without executing anything in it.

    The size that the archive claims is checked before anything is read. Raises
    InputError if the file is missing or damaged, contains objects, or is over 2 GB;
    ``expected`` then says what to give instead.
    """
    with _archive(path, expected) as archive:
        members = archive.infolist()
        size = sum(member.file_size for member in members)
        if size > _LARGEST or len(members) > _MOST_ARRAYS:
            raise InputError(
                f"{os.fspath(path)}: {len(members)} arrays of {size / 1e6:.0f} MB are "
                f"more than kinefilter writes; give {expected}"
            )
        arrays = {}
        for member in members:
            with archive.open(member) as file:
                arrays[member.filename.removesuffix(".npy")] = read_array(file)
        return arrays


def read_array(file: IO[bytes]) -> NDArray[Any]:
    """Read an array in npy format; raises ValueError for others than _KINDS.

    Also raises what numpy does for damaged files, all of which ``refused`` knows. For
    an array that claims to be larger than its file, memory is reserved but never used.
    """
    with warnings.catch_warnings(action="ignore"):  # about a header from Python 2
        array = np.asarray(npy.read_array(file, allow_pickle=False))
    if array.dtype.kind not in _KINDS:
        raise ValueError("not numbers or text")
    return array


def write_arrays(path: AnyPath, arrays: Mapping[str, Any]) -> None:
    """Write arrays as npz, whole or not at all; equal arrays give equal bytes."""
    # Pass an open file: numpy would add .npz to a name that ends in .NPZ.
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **arrays)


def clip_as_arrays(clip: Clip) -> dict[str, Any]:
    """Return the arrays of a clip and the measures of its body by the fields' names.

    There are also ``skeleton``, ``joints`` and ``source``, for each prop
    ``prop:K:name``, ``:positions``, ``:rotations`` and ``:kinds``, and for each of its
    shapes ``prop:K:L:size`` and so on.
    """
    return {
        **{name: getattr(clip, name) for name in (*_ARRAYS, "tilt", "floor")},
        **{name: getattr(clip.body, name) for name in _BODY},
        **_props_as_arrays(clip.props),
        "skeleton": np.array(clip.skeleton.name),
        "joints": np.array(clip.skeleton.joints),
        "source": np.array(clip.source),
        **({"roll": np.array(clip.roll)} if clip.roll else {}),
    }


def read_npz(path: AnyPath) -> Clip:
    """Read a clip that write_clip wrote as npz; raises InputError for other files."""
    arrays = read_arrays(path, "a clip that kinefilter wrote")
    with refused(path, "its arrays are not those of a clip; write it again"):
        return clip_of_arrays(arrays)


def clip_of_arrays(archive: dict[str, Any]) -> Clip:
    """Return the clip whose arrays these are, or raise what ``refused`` knows."""
    archive = {"roll": 0.0, **archive}
    names = (*_ARRAYS, *_ONCE, *_BODY)
    for name in ("skeleton", "source", *names):
        if name not in archive:
            wrong = f"not a kinefilter clip, or one with --rig (no array {name})"
            raise InputError(f"{wrong}; 'kinefilter info' tells what it is")
    skeleton = skeleton_named(str(archive["skeleton"]))
    arrays: dict[str, Any] = {name: np.asarray(archive[name]) for name in names}
    arrays |= {name: arrays[name].item() for name in (*_ONCE, "height", "mass")}
    body = Body(skeleton, **{name: arrays.pop(name) for name in _BODY})
    positions = arrays.pop("positions")
    if positions.shape != (len(arrays["time"]), len(skeleton), 3):
        raise InputError(f"positions have shape {positions.shape}; write it again")
    return Clip(
        **arrays,
        root=positions[:, skeleton.root],
        body=body,
        source=str(archive["source"]),
        props=tuple(_props_from_arrays(archive)),
    )


def _props_as_arrays(props: Iterable[Prop]) -> dict[str, NDArray[Any]]:
    arrays: dict[str, NDArray[Any]] = {}
    for k, prop in enumerate(props):
        for name in _PROP:
            arrays[f"prop:{k}:{name}"] = np.asarray(getattr(prop, name))
        arrays[f"prop:{k}:kinds"] = np.array([shape.kind for shape in prop.shapes])
        for n, shape in enumerate(prop.shapes):
            for name in _SHAPE:
                arrays[f"prop:{k}:{n}:{name}"] = getattr(shape, name)
    return arrays


def _props_from_arrays(archive: dict[str, Any]) -> Iterator[Prop]:
    for k in count():
        if f"prop:{k}:name" not in archive:
            return
        shapes = [
            Shape(kind, *(archive[f"prop:{k}:{n}:{name}"] for name in _SHAPE))
            for n, kind in enumerate(archive[f"prop:{k}:kinds"].tolist())
        ]
        name, places, turns = (archive[f"prop:{k}:{part}"] for part in _PROP)
        yield Prop(str(name), tuple(shapes), places, turns)
