"""Layouts of files with a frame a row: which column is what."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

from kinefilter.characters import (
    KINECT_V1,
    KINECT_V2,
    SKELETONS,
    InputError,
    Skeleton,
)

_AXES = ("x", "y", "z")


@dataclass(frozen=True)
class Layout:
    """Which column of a file is what."""

    name: str
    """What the layout is called (pipeline.config.TakeFormat)."""
    skeleton: Skeleton
    """The joints that the file speaks of."""
    columns: tuple[str, ...]
    """What each column is called."""
    has_header: bool
    """Whether the first line is a header."""
    normalize: Callable[[str], str]
    """Turns a line into comma-separated cells, one per column."""
    seconds: float
    """One unit of the ``time`` column [s]; one frame where there is none [s]."""
    weighted: bool = False
    """States that are all 1 or 0 are no states but say that there is a point."""

    @property
    def index(self) -> dict[str, int]:
        """Index of each column by its name."""
        return {column: i for i, column in enumerate(self.columns)}


def _unquoted(cell: str) -> str:
    return cell.strip().strip('"')


def _kinefilter(line: str, source: str) -> Layout:
    columns = tuple(_unquoted(cell) for cell in line.strip().split(","))
    if columns[0] != "time":
        raise InputError(
            f"{source}: row 1, column 1 is {columns[0][:40]!r}, expected the header "
            "'time'; give the file's own format"
        )
    if len(set(columns)) < len(columns):
        twice = Counter(columns).most_common(1)[0][0]
        raise InputError(f"{source}: row 1 has column {twice[:40]!r} twice; delete one")
    joints = tuple(dict.fromkeys(c.rpartition(".")[0] or c for c in columns[1:]))
    skeleton = _skeleton_with(joints, source)
    _check_columns(columns, joints, source)
    return Layout("kinefilter", skeleton, columns, True, str, 1.0)


def _check_columns(
    columns: tuple[str, ...], joints: tuple[str, ...], source: str
) -> None:
    """Raise InputError unless every joint has its axes and nothing but a state more."""
    needed = [f"{joint}.{axis}" for joint in joints for axis in _AXES]
    allowed = {"time", *needed, *(f"{joint}.state" for joint in joints)}
    for column in columns:
        if column not in allowed:
            raise InputError(
                f"{source}: row 1, column {column[:40]!r} is unknown; expected "
                "Joint.x, Joint.y, Joint.z or Joint.state"
            )
    for column in needed:
        if column not in columns:
            raise InputError(
                f"{source}: row 1 has no column {column}; add it or delete the other "
                "columns of that joint"
            )


def _skeleton_with(joints: tuple[str, ...], source: str) -> Skeleton:
    """Return the smallest skeleton that has all the joints."""
    if not joints:
        raise InputError(f"{source}: row 1 names no joints; expected Joint.x and so on")
    skeletons = sorted(SKELETONS.values(), key=len)
    for skeleton in skeletons:
        if set(joints) <= set(skeleton.joints):
            return skeleton
    nearest = max(skeletons, key=lambda s: len(set(joints) & set(s.joints)))
    unknown = next(joint for joint in joints if joint not in nearest.joints)
    raise InputError(
        f"{source}: row 1, joint {unknown[:40]!r} is not one of {nearest.name}: "
        f"{', '.join(nearest.joints)}; rename or delete its columns"
    )


V2_CELLS = 1 + 4 * len(KINECT_V2)
"""Cells of a row of Kinect v2 CSV."""
_V2_COLUMNS = (
    "time",
    *(f"{joint}.{part}" for joint in KINECT_V2.joints for part in (*_AXES, "state")),
)


def _kinect_v2(line: str, source: str) -> Layout:  # noqa: ARG001 - same signature
    def normalize(line: str) -> str:
        # The recorder ends every cell with a comma, the last one too.
        return line[:-1] if line.count(",") == len(_V2_COLUMNS) else line

    return Layout("kinect-v2", KINECT_V2, _V2_COLUMNS, False, normalize, 100e-9)


def _kinect_v1(line: str, source: str) -> Layout:
    names = [_unquoted(name) for name in line.strip().rstrip(";").split(";")]
    joints = tuple(name for name in names if name in KINECT_V1.joints)
    strangers = [name for name in names[: len(KINECT_V1)] if name not in joints]
    if strangers or len(set(joints)) < len(KINECT_V1):
        found = f"{strangers[0][:40]!r}" if strangers else f"{len(set(joints))} joints"
        raise InputError(
            f"{source}: row 1 has {found}, expected the {len(KINECT_V1)} joint names "
            f"of {KINECT_V1.name} split by ;: {', '.join(KINECT_V1.joints)}"
        )

    def normalize(line: str) -> str:
        cells = line.split(";")
        if len(cells) == len(KINECT_V1) + 1:
            del cells[-1]  # the label of the action
        return ",".join(",".join(cell.split()) or ",," for cell in cells)

    columns = tuple(f"{joint}.{axis}" for joint in joints for axis in _AXES)
    return Layout("kinect-v1", KINECT_V1, columns, True, normalize, 1.0 / 30.0)


_MSRC_COLUMNS = (
    "time",
    *(f"{joint}.{part}" for joint in KINECT_V1.joints for part in (*_AXES, "state")),
)


def _msrc_12(line: str, source: str) -> Layout:  # noqa: ARG001 - same signature
    def normalize(line: str) -> str:
        return ",".join(line.replace(",", " ").split())

    return Layout(
        "msrc-12", KINECT_V1, _MSRC_COLUMNS, False, normalize, 1e-6, weighted=True
    )


LAYOUTS: dict[str, Callable[[str, str], Layout]] = {
    "kinefilter": _kinefilter,
    "kinect-v2": _kinect_v2,
    "kinect-v1": _kinect_v1,
    "msrc-12": _msrc_12,
}
"""How to lay out a file of each format, from its first line and its name."""
