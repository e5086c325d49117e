"""What somebody who looks at a take says of it: what is wrong, and how it really was.

An edits file is TOML; seconds count from the take's first frame::

    [[distrust]]                # what the sensor says there counts for nothing
    joints = ["right-arm"]
    begin = 3.2
    end = 3.9

    [[exchange]]                # left and right
    begin = 5.0
    end = 5.5

    [[contact]]                 # whether a foot stands on the floor
    part = "left foot"
    stands = true
    begin = 7.0
    end = 7.4

    [[pin]]                     # where a joint is
    joint = "WristRight"
    time = 3.5
    position = [0.31, 1.42, 0.2]
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import chain, count
from pathlib import Path
from typing import Any

import numpy as np

from kinefilter.characters import CONTACTS, InputError, State, Take
from kinefilter.characters.arrays import Array, Flags, shown
from kinefilter.characters.motion import LATEST
from kinefilter.characters.skeleton import SIDES

from .formats.files import new_text, read_toml

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
FEET: dict[str, tuple[int, ...]] = {
    "both feet": (0, 1, 2, 3),
    "left foot": (0, 1),
    "right foot": (2, 3),
    **{name: (k,) for k, name in enumerate(CONTACTS)},
}
"""What can stand: columns of contacts, by name."""

_FIELDS = {
    "distrust": ("joints", "begin", "end"),
    "exchange": ("begin", "end"),
    "contact": ("part", "stands", "begin", "end"),
    "pin": ("joint", "time", "position"),
}
_EXPECTED = "expected tables " + ", ".join(
    f"[[{kind}]] with {', '.join(names[:-1])} and {names[-1]}"
    for kind, names in _FIELDS.items()
)
_HEAD = "# What was seen in a take, for --edits; seconds after its first frame.\n"
_FARTHEST = 1e4  # m; no sensor sees that far
_ROUNDED = 5e-4  # s by which a time in a file may miss the frame that it was taken from


@dataclass(frozen=True)
class Edit:
    """What is so from one time to another [s], counted from the take's first frame."""

    kind: str
    """``distrust``, ``exchange``, ``contact`` or ``pin``."""
    begin: float
    end: float
    """Of a pin the same time as ``begin``."""
    joints: tuple[str, ...] = ()
    """Joints that are distrusted, or limbs (LIMBS); or the one that is pinned."""
    part: str = ""
    """What stands or does not (FEET)."""
    stands: bool = False
    """Whether it stands."""
    position: tuple[float, ...] = ()
    """Where the joint is pinned [m], the clip's frame, (3,)."""

    def __str__(self) -> str:
        return f"edited: {self.told}"

    @property
    def told(self) -> str:
        """What is said, in words."""
        what = ", ".join(self.joints)
        when = f"from {self.begin:.4g} to {self.end:.4g} s"
        return {
            "distrust": f"{what} distrusted {when}",
            "exchange": f"left and right exchanged {when}",
            "contact": f"{self.part} {('lifts', 'stands')[self.stands]} {when}",
            "pin": f"{what} pinned at {self.begin:.4g} s",
        }[self.kind]

    def frames(self, since: Array) -> Flags:
        """Return in which frames it is so, given times [s] (T,) since the first."""
        if self.kind == "pin":
            nearest = np.abs(since - self.begin).argmin()
            return np.asarray(np.arange(len(since)) == nearest)
        begin, end = self.begin - _ROUNDED, self.end + _ROUNDED
        return np.asarray((begin <= since) & (since <= end))

    def _fields(self) -> dict[str, Any]:
        known = vars(self) | {"joint": (*self.joints, "")[0], "time": self.begin}
        return {name: known[name] for name in _FIELDS[self.kind]}


def read_edits(path: Path) -> tuple[Edit, ...]:
    """Read an edits file; raises InputError if it is malformed."""
    table, source = read_toml(path, _EXPECTED), os.fspath(path)
    found: list[Edit] = []
    for kind, rows in table.items():
        if kind not in _FIELDS or not isinstance(rows, list):
            raise InputError(f"{source}: unknown {shown(kind)}; {_EXPECTED}")
        for number, row in enumerate(rows, start=1):
            found.append(_edit(kind, row, f"{source}: {kind} {number}"))
    return tuple(found)


def edits_text(edits: Iterable[Edit]) -> str:
    """Return an edits file of edits, by kind."""
    by_kind = sorted(edits, key=lambda edit: list(_FIELDS).index(edit.kind))
    tables = [
        "\n".join(
            [f"[[{edit.kind}]]"]
            + [
                f"{name} = {json.dumps(value)}"
                for name, value in edit._fields().items()
            ]
        )
        for edit in by_kind
    ]
    return "\n\n".join([_HEAD.rstrip(), *tables]) + "\n"


class EditsFile:
    """A file of edits that a program changes, and perhaps somebody else, too."""

    def __init__(self, path: Path) -> None:
        self.path, self._known = path, ""

    def read(self) -> tuple[Edit, ...]:
        """Return its edits, none where there is no file; errors as ``read_edits``."""
        edits = read_edits(self.path) if self.path.exists() else ()
        self._known = edits_text(edits)
        return edits

    def write(self, edits: Iterable[Edit]) -> Path | None:
        """Write edits; what another wrote there is kept, and where is returned."""
        kept, text = None, edits_text(edits)
        if self.path.exists():
            there = self.path.read_text(encoding="utf-8", errors="surrogateescape")
            if there not in (self._known, text):
                numbers = (self.path.with_suffix(f".{n}.toml") for n in count(1))
                kept = next(path for path in numbers if not path.exists())
                self.path.rename(kept)
        with new_text(self.path) as file:
            file.write(text)
        self._known = text
        return kept


def _edit(kind: str, row: Any, where: str) -> Edit:
    names = _FIELDS[kind]
    if not isinstance(row, dict) or set(row) != set(names):
        raise InputError(f"{where}: expected {', '.join(names)}; {_EXPECTED}")
    joints = row.get("joints", [row["joint"]] if "joint" in row else [])
    if not isinstance(joints, list) or not all(isinstance(j, str) for j in joints):
        raise InputError(
            f"{where}: joints is {shown(joints)}, expected a list of names"
        )
    if kind == "distrust" and not joints:
        raise InputError(
            f"{where}: no joints; name some, or a limb: {', '.join(LIMBS)}"
        )
    part, stands, place = (row.get(n) for n in ("part", "stands", "position"))
    if kind == "contact" and (
        not isinstance(part, str) or part not in FEET or not isinstance(stands, bool)
    ):
        raise InputError(
            f"{where}: part is {shown(part)}, stands {shown(stands)}; expected one of "
            f"{', '.join(FEET)}, and true or false"
        )
    if kind == "pin" and not (
        isinstance(place, list) and len(place) == 3 and _numbers(place, _FARTHEST)
    ):
        raise InputError(
            f"{where}: position is {shown(place)}, expected three numbers, meters in "
            "the frame of the clip"
        )
    times = [row[name] for name in ("begin", "end", "time") if name in row]
    if not _numbers(times, LATEST):
        raise InputError(f"{where}: times are seconds after the first frame")
    begin, end = float(times[0]), float(times[-1])
    if not 0.0 <= begin <= end:
        raise InputError(
            f"{where}: begin {begin:g}, end {end:g}: expected 0 or more, and the "
            "end not before the beginning"
        )
    position = tuple(map(float, place or ()))
    return Edit(kind, begin, end, tuple(joints), part or "", bool(stands), position)


def _numbers(values: Sequence[Any], limit: float) -> bool:
    return all(type(v) in (int, float) and abs(v) < limit for v in values)


def with_contacts(contacts: Flags, edits: Iterable[Edit], since: Array) -> Flags:
    """Return contacts (T, 4) as they are said to be; ``since`` as Edit.frames."""
    contacts = contacts.copy()
    for edit in edits:
        if edit.kind == "contact":
            parts = np.isin(np.arange(contacts.shape[1]), FEET[edit.part])
            contacts[edit.frames(since)[:, None] & parts] = edit.stands
    return contacts


def edited(take: Take, edits: Iterable[Edit], since: Array | None = None) -> Take:
    """Return a take with its sides as they are, and without distrusted joints.

    Args:
        take: The take.
        edits: What is said of it; sides are put back first.
        since: Times [s] of a sensor's frames since the first one of the merged take,
            (T,), for which the edits are known to fit; by default those of the take.

    Raises:
        InputError: The take has no such joint or time, or no joint is left.
    """
    fits, skeleton = since is not None, take.skeleton
    since = take.time - take.time[0] if since is None else since
    for edit in sorted(edits, key=lambda edit: edit.kind != "exchange"):
        frames = edit.frames(since)
        if not fits:
            _check(edit, frames, take)
        if edit.kind == "exchange":
            take = take.exchanged(frames)
        elif edit.kind == "distrust":
            names = chain.from_iterable(LIMBS.get(n, (n,)) for n in edit.joints)
            gone = [skeleton.index(n) for n in names if n in skeleton.joints]
            where = frames[:, None] & np.isin(np.arange(len(skeleton)), gone)
            positions, state = take.positions.copy(), take.state.copy()
            positions[where], state[where] = np.nan, State.NOT_TRACKED
            take = replace(take, positions=positions, state=state)
    if not fits and not np.isfinite(take.positions).any():
        raise InputError(
            f"{take.source}: its edits file distrusts every joint of the take; leave "
            "some"
        )
    return take


def _check(edit: Edit, frames: Flags, take: Take) -> None:
    """Raise an InputError if a take has nothing that an edit could be about."""
    known = (
        take.skeleton.joints if edit.kind == "pin" else (*LIMBS, *take.skeleton.joints)
    )
    for name in edit.joints:
        if name not in known:
            raise InputError(
                f"{take.source}: edits name an unknown joint {shown(name)}; known: "
                f"{', '.join(known)}"
            )
    long = take.time[-1] - take.time[0]
    if not frames.any() or edit.begin > long + _ROUNDED:
        raise InputError(
            f"{take.source}: edited where it has no frame from {edit.begin:g} to "
            f"{edit.end:g} s; the take is {long:.1f} s long"
        )
