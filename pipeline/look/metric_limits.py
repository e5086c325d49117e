"""Limits of a clip's metrics, such as ``skate>0.003``; what is beyond them fails."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from typing import Literal

from kinefilter.characters import InputError
from kinefilter.pipeline.formats.files import LARGEST_TOML, parse_toml, read_limited

from .comparison import METRICS

_FORM = re.compile(r"\s*(\w+)\s*([<>])\s*(\S+)\s*")
_EXPECTED = 'expected a list of limits, fail_on = ["skate > 0.003"],'


@dataclass(frozen=True)
class Limit:
    """A metric beyond a number fails."""

    metric: str
    """Name of the metric, one of ``METRICS``."""
    side: Literal["<", ">"]
    """Which side of the number fails."""
    number: float
    """In the metric's unit."""

    def __str__(self) -> str:
        return f"{self.metric}{self.side}{self.number:g}"

    def fails(self, figures: Mapping[str, float]) -> bool:
        """Return whether a metric is beyond the limit; NaN (not measured) is not."""
        value = figures[self.metric]
        return value > self.number if self.side == ">" else value < self.number


def parse_limit(text: str) -> Limit:
    """Return the limit that a text such as ``skate>0.003`` describes.

    Raises:
        InputError: It is not a metric, < or >, and a finite number.
    """
    form = _FORM.fullmatch(text)
    if form is None or form[1] not in METRICS:
        raise InputError(
            f"{text!r}: expected a metric, < or >, and a number, as skate>0.003; "
            f"metrics: {', '.join(METRICS)}"
        )
    try:
        number = float(form[3])
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise InputError(f"{text!r}: {form[3]!r} is no number; write it as 0.003")
    return Limit(form[1], ">" if form[2] == ">" else "<", number)


def read_limits(path: str | os.PathLike[str] | None = None) -> tuple[Limit, ...]:
    """Read the limits of a TOML file, a list ``fail_on`` of texts.

    Args:
        path: The file; by default the limits that ship with kinefilter.

    Raises:
        InputError: There is no such file, it is not TOML, or a limit is malformed.
    """
    if path is None:
        name = "thresholds.toml"
        text = resources.files(__package__).joinpath(name).read_text(encoding="utf-8")
    else:
        name, text = os.fspath(path), read_limited(path, LARGEST_TOML)
    table = parse_toml(text, name, _EXPECTED)
    texts = table.get("fail_on")
    listed = isinstance(texts, list) and all(isinstance(t, str) for t in texts)
    if not listed or len(table) > 1:
        raise InputError(f"{name}: {_EXPECTED} and nothing else")
    try:
        return tuple(parse_limit(limit) for limit in table["fail_on"])
    except InputError as error:
        raise InputError(f"{name}: {error}") from None
