"""Valid files with something wrong in them, the same for the same random numbers."""

from __future__ import annotations

import io
import random
import re
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
NO_NUMBERS = [
    *(b"nan", b"1e400", b"-1e400", b"1e300", b"-1", b"0", b"", b"1_0", b"0x10"),
    *(b"9" * 400, b"9" * 5000, b"99999999999", b"1e-400", b"\xff", b"word", b"1 2"),
    *(b"null", b"[]", b"{}", b'"1"', "\u0663".encode()),
]

INNER_NUMBER = re.compile(rb"(?<=[,; ])(?:-?\d+\.\d+|\d)(?![\d.])")
POSSIBLE = b"0.0 1.0 -1.5 0.5 3.7 -2.25 12.0 0.001 40.0".split()


def mutated(data: bytes, rng: random.Random) -> bytes:
    """Return a file's bytes with one to four things wrong."""
    for _ in range(rng.randint(1, 4)):
        data = rng.choice(MUTATIONS)(data, rng)
    return data


def gently_mutated(data: bytes, rng: random.Random) -> bytes:
    """Return a text with some thirty numbers at most changed, each to one of its kind.

    Those at the beginning of a line, which may be times and counts, stay.
    """
    count = len(INNER_NUMBER.findall(data))
    share = rng.randint(1, 30) / max(count, 1)

    def other(hit: re.Match[bytes]) -> bytes:
        if rng.random() > share:
            return hit[0]
        return rng.choice(POSSIBLE if b"." in hit[0] else [b"0", b"1", b"2"])

    return INNER_NUMBER.sub(other, data)


def _flip(data: bytes, rng: random.Random) -> bytes:
    changed = bytearray(data)
    for _ in range(rng.randint(1, 8) if data else 0):
        changed[rng.randrange(len(data))] = rng.randrange(256)
    return bytes(changed)


def _cut(data: bytes, rng: random.Random) -> bytes:
    return data[: rng.randint(0, len(data))]


def _drop(data: bytes, rng: random.Random) -> bytes:
    first = rng.randint(0, len(data))
    return data[:first] + data[first + rng.randint(1, 200) :]


def _insert(data: bytes, rng: random.Random) -> bytes:
    at = rng.randint(0, len(data))
    return data[:at] + rng.randbytes(rng.randint(1, 20)) + data[at:]


def _lines(data: bytes, rng: random.Random) -> bytes:
    """Drop, double or swap lines."""
    lines = data.split(b"\n")
    a, b = (rng.randrange(len(lines)) for _ in range(2))
    kind = rng.randrange(3)
    if kind == 0:
        del lines[a]
    elif kind == 1:
        lines.insert(b, lines[a])
    else:
        lines[a], lines[b] = lines[b], lines[a]
    return b"\n".join(lines)


def _number(data: bytes, rng: random.Random) -> bytes:
    found = list(NUMBER.finditer(data))
    if not found:
        return data
    hit = rng.choice(found)
    return data[: hit.start()] + rng.choice(NO_NUMBERS) + data[hit.end() :]


MUTATIONS = [_flip, _cut, _drop, _insert, _lines, _number, _number]


def mutated_arrays(data: bytes, rng: random.Random) -> bytes:
    """Return an npz with an array missing, of another type, shape or value."""
    with np.load(io.BytesIO(data)) as file:
        arrays: dict[str, Any] = {key: file[key] for key in file.files}
    for _ in range(rng.randint(1, 3)):
        key = rng.choice(sorted(arrays))
        change = rng.choice(ARRAY_MUTATIONS)
        changed = change(arrays[key], rng)
        if changed is None:
            del arrays[key]
        else:
            arrays[key] = changed
        if not arrays:
            break
    out = io.BytesIO()
    np.savez(out, **arrays)
    return out.getvalue()


def _other_value(array: Any, rng: random.Random) -> Any:
    changed = np.array(array)
    if changed.size and changed.dtype.kind in "fiub":
        value: Any = rng.choice([0, 1, 255, -1, 2**31, np.nan, np.inf, -1e300])
        with np.errstate(all="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            changed.reshape(-1)[rng.randrange(changed.size)] = np.array(value).astype(
                changed.dtype
            )
    elif changed.dtype.kind == "U":
        changed = np.full(changed.shape, rng.choice(["", "x", "kinect_v2", "\0", "9"]))
    return changed


def _other_shape(array: Any, rng: random.Random) -> Any:
    shapes = [array.reshape(-1), array[None], array.T]
    if array.ndim:
        shapes += [array[:0], np.concatenate([array, array])]
    return rng.choice(shapes)


def _other_type(array: Any, rng: random.Random) -> Any:
    if rng.random() < 0.5:
        return array.astype(rng.choice([str, bytes]))
    kind = rng.choice(["complex", "datetime64[s]", "bool", "float16", "int8"])
    return np.zeros(rng.choice([(), (1,), (0, 3), array.shape]), dtype=kind)


def _missing(array: Any, rng: random.Random) -> None:  # noqa: ARG001 - same signature
    return None


ARRAY_MUTATIONS: list[Callable[[Any, random.Random], Any]] = [
    *(_missing, _other_shape, _other_shape, _other_type),
    *(_other_value, _other_value),
]
