"""What somebody who looks at a take says of it: where joints are wrong, and sides.

An edits file is TOML; seconds count from the take's first frame::

    [[distrust]]                # what the sensor says there counts for nothing
    joints = ["right-arm"]
    begin = 3.2
    end = 3.9

    [[exchange]]                # left and right
    begin = 5.0
    end = 5.5
"""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any, Literal

import numpy as np

from kinefilter.characters import InputError, State, Take
from kinefilter.characters.arrays import shown
from kinefilter.characters.motion import LATEST
from kinefilter.characters.skeleton import SIDES

from .draft import Draft
from .formats.files import read_toml
from .progress import Progress
from .stages import Stage

_PARTS = {
    "arm": ("Elbow", "Wrist", "Hand", "HandTip", "Thumb"),
    "hand": ("Wrist", "Hand", "HandTip", "Thumb"),
    "leg": ("Knee", "Ankle", "Foot"),
    "shin": ("Ankle", "Foot"),
}
LIMBS = {
    f"{side.lower()}-{part}": tuple(joint + side for joint in joints)
    for part, joints in _PARTS.items()
    for side in SIDES
}
"""Joints that go with a limb, by its name; a sensor may lack some."""
LIMBS |= {f"{p}s": LIMBS[f"left-{p}"] + LIMBS[f"right-{p}"] for p in _PARTS}
_EXPECTED = (
    "expected tables [[distrust]] with joints, begin and end, and [[exchange]] with "
    "begin and end"
)


@dataclass(frozen=True)
class Edit:
    """What is so from one time to another [s], counted from the take's first frame."""

    kind: Literal["distrust", "exchange"]
    joints: tuple[str, ...]
    """Joints that are distrusted, or limbs (LIMBS)."""
    begin: float
    end: float

    def __str__(self) -> str:
        what = {"exchange": "left and right exchanged"}
        told = what.get(self.kind, f"{', '.join(self.joints)} distrusted")
        return f"edited: {told} from {self.begin:g} to {self.end:g} s"


def read_edits(path: Path) -> tuple[Edit, ...]:
    """Read an edits file, exchanges first; raises InputError if it is malformed."""
    table, source = read_toml(path, _EXPECTED), os.fspath(path)
    found: list[Edit] = []
    for kind, rows in table.items():
        if kind not in ("distrust", "exchange") or not isinstance(rows, list):
            raise InputError(f"{source}: unknown {shown(kind)}; {_EXPECTED}")
        for number, row in enumerate(rows, start=1):
            found.append(_edit(kind, row, f"{source}: {kind} {number}"))
    if not found:
        raise InputError(f"{source}: no edits; {_EXPECTED}")
    return tuple(sorted(found, key=lambda edit: edit.kind != "exchange"))


def _edit(kind: Any, row: Any, where: str) -> Edit:
    names = {"begin", "end"} | ({"joints"} if kind == "distrust" else set())
    if not isinstance(row, dict) or set(row) != names:
        raise InputError(f"{where}: expected {', '.join(sorted(names))}; {_EXPECTED}")
    joints = row.get("joints", [])
    if not isinstance(joints, list) or not all(isinstance(j, str) for j in joints):
        raise InputError(
            f"{where}: joints is {shown(joints)}, expected a list of names"
        )
    if kind == "distrust" and not joints:
        raise InputError(
            f"{where}: no joints; name some, or a limb: {', '.join(LIMBS)}"
        )
    times = row["begin"], row["end"]
    if not all(type(time) in (int, float) and abs(time) < LATEST for time in times):
        raise InputError(f"{where}: begin and end are seconds after the first frame")
    begin, end = map(float, times)
    if not 0.0 <= begin < end:
        raise InputError(
            f"{where}: begin {begin:g}, end {end:g}: expected 0 or more, and the "
            "end after the beginning"
        )
    return Edit(kind, tuple(joints), begin, end)


class Edited(Stage):
    """Does to a take what somebody said of it, before anything else is done."""

    name = "edits"
    in_parts = False  # times count from the first frame of the whole take

    def __init__(self, path: Path) -> None:
        self._path, self.edits = path, read_edits(path)

    def step(self, draft: Draft) -> None:
        """Do nothing: nobody has seen the frames that are to come."""

    def whole(self, draft: Draft, progress: Progress) -> None:  # noqa: ARG002 - at once
        """Edit a take; raises InputError if it has no such joint or frame."""
        take = draft.take()
        for edit in self.edits:
            since = take.time - take.time[0]
            frames = (edit.begin <= since) & (since <= edit.end)
            if not frames.any():
                raise InputError(
                    f"{self._path}: no frame from {edit.begin:g} to {edit.end:g} s; "
                    f"the take is {since[-1]:.1f} s long"
                )
            if edit.kind == "exchange":
                take = take.exchanged(frames)
            else:
                take = _without(take, frames, self._joints(edit, take))
        if not np.isfinite(take.positions).any():
            raise InputError(
                f"{self._path}: distrusts every joint of the whole take; leave some"
            )
        draft.measured, draft.state = take.positions, take.state

    def _joints(self, edit: Edit, take: Take) -> list[int]:
        known = take.skeleton.joints
        for name in edit.joints:
            if name not in LIMBS and name not in known:
                raise InputError(
                    f"{self._path}: unknown joint {shown(name)}; known: "
                    f"{', '.join((*LIMBS, *known))}"
                )
        names = chain.from_iterable(LIMBS.get(name, (name,)) for name in edit.joints)
        return [take.skeleton.index(name) for name in names if name in known]


def _without(take: Take, frames: Any, joints: list[int]) -> Take:
    positions, state = take.positions.copy(), take.state.copy()
    where = np.ix_(frames, joints)
    positions[where], state[where] = np.nan, State.NOT_TRACKED
    return replace(take, positions=positions, state=state)
