"""Takes from the files of sensors and their tools, in any known format."""

# ruff: noqa: A002 - "format" is the name that users know

import os
import re
from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from pathlib import Path

from kinefilter.characters import InputError, Take
from kinefilter.characters.arrays import check_choice
from kinefilter.pipeline.upright import with_y_up

from .files import AnyPath, beginning, check_file
from .recording import Mocap, Recording, at_rate
from .rows import open_rows
from .sheets import header_cells

_V2_CELLS = 101  # time, and x, y, z and state of 25 joints
_DESCRIBED = ("kinefilter", "kinect-v2", "kinect-v1")  # in the error message
_JOINTS = re.compile(r"\b(HipCenter|Spine(Base)?)(?![a-z])", re.IGNORECASE)
"""Joints of which every take's header has at least one."""
_JSON_KEYS = {
    "openpose": ('"people"', '"pose_keypoints_3d"'),
    "mmpose": ('"meta_info"', '"instance_info"', '"instances"', '"keypoint_scores"'),
    "azure": ('"bone_list"', '"joint_names"', '"timestamp_usec"', '"joint_positions"'),
}
"""Keys of which takes in JSON have at least one near the beginning."""
_NPY, _C3D = "NUMPY", "\x02P"  # beginnings of files, decoded without other bytes
_CLIPS = (b"glTF", b"PXR-USDC", b"#usda", b"PK\x03\x04")  # beginnings of files
_BEGINNING = 2**16  # characters: ten times the length of a bone list


def _cells(line: str) -> list[str]:
    return line.strip().split(",")


def _words(line: str) -> list[str]:
    return line.replace(",", " ").split()


def _has(line: str, layout: str) -> bool:
    return line[:1] in ("{", "[") and any(key in line for key in _JSON_KEYS[layout])


FORMATS: dict[str, tuple[str, Callable[[str], bool]]] = {
    "npy": ("keypoints:read_npy", lambda line: line.startswith(_NPY)),
    "c3d": ("markers:read_c3d", lambda line: line.startswith(_C3D)),
    "trc": ("markers:read_trc", lambda line: line.startswith("PathFileType")),
    "freemocap": ("keypoints:read_freemocap", lambda line: "left_hip_x" in line),
    "openpose": ("keypoints:read_openpose", lambda line: _has(line, "openpose")),
    "mmpose": ("keypoints:read_mmpose", lambda line: _has(line, "mmpose")),
    "kinefilter": ("sheets:read_kinefilter", lambda line: "time" in header_cells(line)),
    "kinect-v2": (
        "sheets:read_kinect_v2",
        # The last cell may end with a comma, too.
        lambda line: ";" not in line and len(_cells(line)) - _V2_CELLS in (0, 1),
    ),
    "kinect-v1": (
        "sheets:read_kinect_v1",
        lambda line: ";" in line and "{" not in line,
    ),
    "msrc-12": ("sheets:read_msrc_12", lambda line: len(_words(line)) == 81),
    "msr-action3d": (
        "datasets:read_msr_action3d",
        lambda line: len(_words(line)) == 4 and "," not in line,
    ),
    "ntu": ("datasets:read_ntu", lambda line: line.strip().isdigit()),
    "azure": ("azure:read_azure", lambda line: line.startswith("{")),
    "bvh": ("mocap:bvh_mocap", lambda line: _words(line) == ["HIERARCHY"]),
}
"""For each format by name: the module and function that read a path into a Recording or
Mocap, and a predicate on a file's first line. The first match is the file's format."""


def read_take(
    path: AnyPath,
    *,
    format: str | None = None,
    body: int | None = None,
    fps: float | None = None,
) -> Take:
    """Read a recording of a person.

    Formats (FORMATS; see CONVENTIONS.md) are detected by content, and may be gzipped.

    A joint that is not tracked, not a number, exactly at the origin, where sensors put
    joints that they do not see, or one of a few over 10 km away is missing: NaN and
    state 0. Joints from trackers of images count as tracked from a confidence of 0.5,
    and below it as inferred.

    ``format`` overrides the detected one. ``body`` is a person's number, from 1 in
    order of appearance; the default is the one tracked in most frames. ``fps`` is the
    frame rate of a file without time stamps, by default 30. Raises InputError if the
    file is missing, malformed, without joints or not in meters, or if it has time
    stamps although ``fps`` is given.
    """
    return read_recording(path, format=format, fps=fps).take(body)


def read_takes(path: AnyPath, *, format: str | None = None) -> tuple[Take, ...]:
    """Read everyone's take, in order of appearance; raises InputError as read_take."""
    return read_recording(path, format=format).takes


def read_recording(
    path: AnyPath, *, format: str | None = None, fps: float | None = None
) -> Recording:
    """Read all takes in a file, and its format; raises InputError as read_take."""
    source = os.fspath(check_file(path))
    if format is not None:
        check_choice(format, FORMATS, "take format")
    with Path(source).open("rb") as file:
        if file.read(8).startswith(_CLIPS):
            raise InputError(f"{source}: is a clip or an archive; give the take")
    name = format or _detected(_first_line(source), source)
    module, _, function = FORMATS[name][0].partition(":")
    read: Callable[[str], Recording | Mocap]
    read = getattr(import_module(f".{module}", __package__), function)
    found = read(source)
    if isinstance(found, Mocap):
        from .mocap import recording_of  # loads more readers

        found = recording_of(found)
    recording = replace(found, format=name)
    takes = tuple(map(with_y_up, recording.takes))
    if takes != recording.takes:
        note = "y points down, judging by feet and toes: it was negated"
        recording = replace(recording, takes=takes, notes=(*recording.notes, note))
    return at_rate(recording, fps)


def claims_take(path: AnyPath) -> bool:
    """Return True if a file looks like a recording from its beginning.

    Joint names in a header, or numbers, distinguish a damaged recording from notes and
    other tables. Of OpenPose's files, the first stands for all frames. TRC and C3D are
    read in full, since those of bare markers are mocap that lies beside takes. Raises
    InputError if the file is missing, empty or not text.
    """
    from .keypoints import claims_npy, frame_files

    line, source = _first_line(os.fspath(path)), os.fspath(path)
    try:
        name = _detected(line, source)
        if name in _JSON_KEYS:
            first = name != "openpose" or frame_files(source)[0][1] == Path(source)
            return first and _has(line, name)
        if name in ("kinefilter", "kinect-v1"):
            return _JOINTS.search(line) is not None
        if name == "npy":
            return claims_npy(source)
        if name in ("c3d", "trc"):
            from .mocap import has_joints, read_mocap  # loads more readers

            try:
                return has_joints(read_mocap(path))
            except InputError:  # damaged, or there is no reader of C3D
                return name == "trc"
        return name in ("bvh", "freemocap") or bool([float(w) for w in _words(line)])
    except (InputError, ValueError):
        return False


def _first_line(source: str) -> str:
    if source.lower().removesuffix(".gz").endswith(".npy"):
        return _NPY  # even if it is damaged
    start = beginning(source, _BEGINNING)
    if start.startswith(("{", "[", _NPY, _C3D)):
        return start  # JSON may be a single line, and binary files have no lines
    with open_rows(source) as (_, line, _):
        return line


def _detected(line: str, source: str) -> str:
    for name, (_, begins) in FORMATS.items():
        if begins(line):
            return name
    others = [name for name in FORMATS if name not in _DESCRIBED]
    raise InputError(
        f"{source}: row 1 is of no known layout ({len(_cells(line))} comma-separated "
        "cells); expected a kinefilter CSV (header time,Joint.x,Joint.y,Joint.z,"
        f"Joint.state), Kinect v2 rows of {_V2_CELLS} numbers, Kinect v1 joint names "
        f"separated by ;, or one of the other formats: {', '.join(others)}"
    )
