"""Conversion of settings to the types their fields are annotated with."""

import os
from contextlib import suppress
from functools import cache
from inspect import signature
from numbers import Integral, Real
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from kinefilter.characters import InputError
from kinefilter.characters.arrays import shown

_WORDS = {
    Path: "the path of a file",
    str: "text",
    bool: "true or false",
    float: "a number",
    int: "a whole number",
    tuple[str, ...]: 'a list such as ["a", "b"]',
    tuple[float, ...]: "a list of numbers",
}


@cache
def type_hints(kind: Any) -> dict[str, Any]:
    """Return the type of each field of a class of settings."""
    return get_type_hints(kind)


def keyword_hints(kind: Any) -> dict[str, Any]:
    """Return the type of each keyword-only argument of a constructor."""
    given = signature(kind, eval_str=True).parameters.values()
    return {p.name: p.annotation for p in given if p.kind is p.KEYWORD_ONLY}


def check_fields(settings: Any) -> None:
    """Convert each field of a frozen dataclass to its type, or raise InputError."""
    kind: Any = type(settings)
    for name, hint in type_hints(kind).items():
        value = getattr(settings, name)
        if value is not None or NoneType not in get_args(hint):
            where = f"--{name.replace('_', '-')}"
            object.__setattr__(settings, name, converted(value, hint, where))


def converted(value: object, hint: Any, where: str) -> Any:
    """Return a value converted to the type of a hint, or raise an InputError."""
    union = get_origin(hint) in (Union, UnionType)
    kinds = [k for k in (get_args(hint) if union else (hint,)) if k is not NoneType]
    for kind in kinds:
        if get_origin(kind) is Literal:
            if isinstance(value, str) and value in get_args(kind):
                return value
        elif get_origin(kind) is tuple:
            if isinstance(value, list | tuple):
                return tuple(converted(one, get_args(kind)[0], where) for one in value)
        elif kind is Path:
            if isinstance(value, str | os.PathLike):
                return Path(value)
        elif isinstance(value, bool) or kind not in (int, float):
            if type(value) is kind:
                return value
        elif isinstance(value, Integral if kind is int else Real):
            with suppress(OverflowError, ValueError):  # of 400 digits
                return kind(value)
    allowed = " or ".join(
        ", ".join(f'"{word}"' for word in get_args(kind) if isinstance(word, str))
        or _WORDS.get(kind, "paths of files")
        for kind in kinds
    )
    raise InputError(f"{where} = {shown(value)}: expected {allowed}")
