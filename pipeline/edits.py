"""Manual corrections to a take: what is wrong in it, and how it really was.

An edits file is TOML with ``_FIELDS``, times in seconds after the take's first frame;
CONVENTIONS.md describes it.
"""

import json
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import chain, count
from pathlib import Path
from typing import Any, Literal

import numpy as np

from kinefilter.characters import CONTACTS, Clip, InputError, Skeleton, Take
from kinefilter.characters.arrays import Array, Flags, shown
from kinefilter.characters.motion import LATEST_TIME_STAMP
from kinefilter.characters.skeleton import SIDES

from .field_types import converted
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
"""Joints of each limb, by its name; a sensor may lack some."""
LIMBS |= {f"{p}s": LIMBS[f"left-{p}"] + LIMBS[f"right-{p}"] for p in _PARTS}
FEET: dict[str, tuple[int, ...]] = {
    "both feet": (0, 1, 2, 3),
    "left foot": (0, 1),
    "right foot": (2, 3),
    **{name: (k,) for k, name in enumerate(CONTACTS)},
}
"""Columns of the contacts (CONTACTS), by the name of what is planted."""

_SPAN: dict[str, Any] = {"begin": float, "end": float}
_FIELDS: dict[str, dict[str, Any]] = {
    "distrust": {"joints": tuple[str, ...], **_SPAN},
    "exchange": _SPAN,
    "contact": {"part": Literal[tuple(FEET)], "stands": bool, **_SPAN},
    "pin": {"joint": str, "time": float, "position": tuple[float, ...]},
}
_EXPECTED = "expected tables " + ", ".join(
    f"[[{kind}]] with {' and '.join(', '.join(types).rsplit(', ', 1))}"
    for kind, types in _FIELDS.items()
)
_HEADER = (
    "# Manual corrections to a take, for --edits; times [s] after its first frame."
)
_FARTHEST = 1e4  # m; no sensor sees that far
_ROUNDING = 5e-4  # s by which a time in a file may miss the frame it was taken from


@dataclass(frozen=True)
class Edit:
    """A manual correction over a span of time [s] after the take's first frame."""

    kind: str  # ``distrust``, ``exchange``, ``contact`` or ``pin``
    begin: float
    end: float  # equal to ``begin`` for a pin
    joints: tuple[str, ...] = ()  # joints or limbs to distrust, or the joint to pin
    part: str = ""  # the part of the feet (FEET) whose contact is given
    stands: bool = False  # whether that part is planted
    position: tuple[float, ...] = ()  # of the pinned joint [m], clip's frame, (3,)
    source: str = field(default="", compare=False, repr=False)  # x.edits.toml: pin 1

    def __str__(self) -> str:
        return f"edited: {self.summary}"

    @property
    def summary(self) -> str:
        """The edit in words."""
        what, when = ", ".join(self.joints), self.when
        return {
            "distrust": f"{what} distrusted {when}",
            "exchange": f"left and right swapped {when}",
            "contact": f"{self.part} {('lifted', 'planted')[self.stands]} {when}",
            "pin": f"{what} pinned {when}",
        }[self.kind]

    @property
    def when(self) -> str:
        """The time in words."""
        begin, end = f"{self.begin:.4g}", f"{self.end:.4g}"
        return f"at {begin} s" if begin == end else f"from {begin} to {end} s"

    def frames(self, since: Array) -> Flags:
        """Return which frames are edited, by their times [s] after the first, (T,)."""
        if self.kind == "pin":
            nearest = np.abs(since - self.begin).argmin()
            return np.asarray(np.arange(len(since)) == nearest)
        begin, end = self.begin - _ROUNDING, self.end + _ROUNDING
        return np.asarray((begin <= since) & (since <= end))


def edits_beside(path: Path) -> Path:
    """Return the file of edits of a take or clip: wave.edits.toml for wave.csv.gz."""
    return path.parent / f"{Path(path.name.removesuffix('.gz')).stem}.edits.toml"


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
    """Return the text of an edits file, sorted by kind."""
    lines, order = [_HEADER], list(_FIELDS)
    for edit in sorted(edits, key=lambda edit: order.index(edit.kind)):
        values = vars(edit) | {"joint": (*edit.joints, "")[0], "time": edit.begin}
        lines.append(f"\n[[{edit.kind}]]")
        lines += [f"{n} = {json.dumps(values[n])}" for n in _FIELDS[edit.kind]]
    return "\n".join(lines) + "\n"


class EditsFile:
    """An edits file that others may change at the same time."""

    def __init__(self, path: Path) -> None:
        self.path, self._known = path, ""

    def read(self) -> tuple[Edit, ...]:
        """Return its edits, none if there is no file; errors as for ``read_edits``."""
        edits = read_edits(self.path) if self.path.exists() else ()
        self._known = edits_text(edits)
        return edits

    def write(self, edits: Iterable[Edit]) -> Path | None:
        """Write edits; return where another program's changes were moved to, if any."""
        backup, text = None, edits_text(edits)
        if self.path.exists():
            current = self.path.read_text(encoding="utf-8", errors="surrogateescape")
            if current not in (self._known, text):
                numbers = (self.path.with_suffix(f".{n}.toml") for n in count(1))
                backup = next(path for path in numbers if not path.exists())
                self.path.rename(backup)
        with new_text(self.path) as file:
            file.write(text)
        self._known = text
        return backup


def _edit(kind: str, row: Any, where: str) -> Edit:
    types = _FIELDS[kind]
    if not isinstance(row, dict) or set(row) != set(types):
        raise InputError(f"{where}: expected {', '.join(types)}; {_EXPECTED}")
    values = {n: converted(row[n], t, f"{where}: {n}") for n, t in types.items()}
    if kind == "pin":
        values["joints"] = (values.pop("joint"),)
        values["begin"] = values["end"] = values.pop("time")
    edit = Edit(kind, **values, source=where)
    if kind == "distrust" and not edit.joints:
        raise InputError(f"{where}: name joints, or a limb: {', '.join(LIMBS)}")
    near = len(edit.position) == 3 and all(abs(x) < _FARTHEST for x in edit.position)
    if kind == "pin" and not near:
        place = shown(row["position"])
        raise InputError(f"{where}: position is {place}, expected three numbers [m]")
    if not 0.0 <= edit.begin <= edit.end < LATEST_TIME_STAMP:
        raise InputError(
            f"{where}: times {edit.begin:g} to {edit.end:g}: expected seconds after "
            "the first frame, the end not before the beginning"
        )
    return edit


def with_contacts(contacts: Flags, edits: Iterable[Edit], since: Array) -> Flags:
    """Return contacts (T, 4) with edits applied; ``since`` as for ``Edit.frames``."""
    contacts = contacts.copy()
    for edit in edits:
        if edit.kind == "contact":
            parts = np.isin(np.arange(contacts.shape[1]), FEET[edit.part])
            contacts[edit.frames(since)[:, None] & parts] = edit.stands
    return contacts


def exchanged(edits: Iterable[Edit], since: Array) -> Flags:
    """Return where sides are swapped, (T,); ``since`` as for ``Edit.frames``."""
    frames = np.zeros(len(since), np.bool_)
    for edit in edits:
        if edit.kind == "exchange":
            frames ^= edit.frames(since)
    return frames


def distrusted(edits: Iterable[Edit], since: Array, skeleton: Skeleton) -> Flags:
    """Return which joints are distrusted, (T, J); ``since`` as for ``Edit.frames``."""
    wrong = np.zeros((len(since), len(skeleton)), np.bool_)
    for edit in edits:
        if edit.kind == "distrust":
            names = list(chain.from_iterable(LIMBS.get(n, (n,)) for n in edit.joints))
            wrong |= edit.frames(since)[:, None] & np.isin(skeleton.joints, names)
    return wrong


def edited(take: Take, edits: Sequence[Edit], since: Array) -> Take:
    """Return a take with sides swapped, then without distrusted joints."""
    swapped = take.swapped(exchanged(edits, since))
    return swapped.without(distrusted(edits, since, take.skeleton))


def check_edits(take: Take, edits: Sequence[Edit]) -> None:
    """Raise an InputError if edits do not fit a take, or none of its joints is left."""
    since, pinned = take.time - take.time[0], set[tuple[str, int]]()
    for edit in edits:
        frames, where = edit.frames(since), edit.source or f"{take.source}: an edit"
        known = (*(() if edit.kind == "pin" else LIMBS), *take.skeleton.joints)
        for name in edit.joints:
            if name not in known:
                hint = f"known: {', '.join(known)}"
                raise InputError(f"{where}: unknown joint {shown(name)}; {hint}")
        if not frames.any() or edit.begin > since[-1] + _ROUNDING:
            hint = f"the take is {since[-1]:.1f} s long"
            raise InputError(f"{where}: no frame is {edit.when}; {hint}")
        if edit.kind == "pin":
            if (len(edit.joints), len(edit.position)) != (1, 3):
                raise InputError(f"{where}: a pin needs one joint and x, y, z of it")
            pin = edit.joints[0], int(frames.argmax())
            if pin in pinned:
                raise InputError(f"{where}: {pin[0]} is pinned there already; keep one")
            pinned.add(pin)
    if not np.isfinite(edited(take, edits, since).positions).any():
        raise InputError(f"{take.source}: the edits distrust every joint; leave some")


class EditHistory:
    """Edits, and with them contacts (T, 4) and edited frames (T,) of a clip."""

    def __init__(self, edits: Iterable[Edit], clip: Clip) -> None:
        self._states, self._current = [tuple(edits)], 0
        self.mark_saved()
        self.look_at(clip)

    def look_at(self, clip: Clip) -> None:
        """Use the contacts and times of a clip."""
        self._clip, self.since = clip, clip.time - clip.time[0]
        self._go_to(self._current)

    @property
    def edits(self) -> tuple[Edit, ...]:
        """The edits as they are now."""
        return self._states[self._current]

    @property
    def unsaved(self) -> bool:
        """Whether the edits differ from those last saved."""
        return self.edits != self._saved

    def replace(self, edits: Iterable[Edit]) -> None:
        """Replace all edits, as one step that can be undone."""
        if (changed := tuple(edits)) != self.edits:
            self._states[self._current + 1 :] = [changed]
            self._go_to(self._current + 1)

    def undo(self) -> None:
        """Undo the last change, if there is one."""
        self._go_to(max(self._current - 1, 0))

    def redo(self) -> None:
        """Redo the change undone last, if there is one."""
        self._go_to(min(self._current + 1, len(self._states) - 1))

    def mark_saved(self) -> None:
        """Record that the current edits are saved."""
        self._saved = self.edits

    def _go_to(self, state: int) -> None:
        self._current = state
        self.contacts = with_contacts(self._clip.contacts, self.edits, self.since)
        self.edited = np.zeros(len(self.since), dtype=np.bool_)
        for edit in self.edits:
            self.edited |= edit.frames(self.since)
