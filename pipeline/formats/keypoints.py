"""Takes from the 3D landmarks that trackers of camera images find.

These are arrays (npy), FreeMoCap's CSV, and the JSON of OpenPose (``--write_json`` with
``--3d``) and of MMPose's 3D lifters; CONVENTIONS.md describes their layouts. Files
without time stamps are read at 30 frames a second (``recording.at_rate``).
"""

import csv
import io
import os
import re
from dataclasses import replace
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import KINECT_V2, InputError
from kinefilter.characters.arrays import Array
from kinefilter.characters.motion import check_order

from .files import array_of, list_in, number_in, read_bytes, read_json, refused
from .markers import mocap_of_points
from .mocap import kinect_joints, plain_name, recording_of
from .npz import read_array
from .plain import counted
from .recording import ASSUMED_FPS, Recording, Sighting, not_by_kinect, takes_of_people
from .rows import MOST_FRAMES, RowReader, open_rows
from .sheets import separator_of

_LARGEST = 2**29  # bytes
_LONGEST_STAMP = 40  # characters
_FRAME_FILE = re.compile(r"(.*?)(\d{12})(_keypoints\.json)")


def _sides(words: str) -> list[str]:
    return [side + word for word in words.split() for side in "lr"]


BLAZEPOSE = (
    *("nose", "leyeinner", "leye", "leyeouter", "reyeinner", "reye", "reyeouter"),
    *("lear", "rear", "mouthleft", "mouthright"),
    *_sides("shoulder elbow wrist pinky index thumb hip knee ankle heel footindex"),
)
"""MediaPipe's landmarks of a pose in its order (PoseLandmark)."""
COCO = ("nose", *_sides("eye ear shoulder elbow wrist hip knee ankle"))
_TOES = ("bigtoe", "smalltoe", "heel")
WHOLE_BODY = (*COCO, *(side + toe for side in "lr" for toe in _TOES))
"""COCO-WholeBody's landmarks without those of face and hands, which follow."""
HALPE = (*COCO, "head", "neck", "hip", *_sides(" ".join(_TOES)))
BODY_25 = (
    *("nose", "neck", "rshoulder", "relbow", "rwrist", "lshoulder", "lelbow", "lwrist"),
    *("midhip", "rhip", "rknee", "rankle", "lhip", "lknee", "lankle"),
    *("reye", "leye", "rear", "lear"),
    *(side + toe for side in "lr" for toe in _TOES),
)
HUMAN_36M = (
    *("root", "rhip", "rknee", "rfoot", "lhip", "lknee", "lfoot"),
    *("spine", "thorax", "neckbase", "head"),
    *("lshoulder", "lelbow", "lwrist", "rshoulder", "relbow", "rwrist"),
)
_IN_NPY = dict.fromkeys((33, 75, 543, 553), BLAZEPOSE)
_IN_NPY |= {133: WHOLE_BODY, 26: HALPE, 137: BODY_25}
"""First landmarks of an array, by its number of landmarks. 17 and 25 are ambiguous:
COCO or Human3.6M, BODY_25 or Kinect v2."""
_IN_JSON = {17: HUMAN_36M, 25: BODY_25, 26: HALPE, 33: BLAZEPOSE, 133: WHOLE_BODY}
"""For files that do not name their landmarks; 3D lifters give Human3.6M's 17."""


def read_npy(source: str) -> Recording:
    """Read an array of landmarks; raises InputError if it is malformed."""
    array = _read_npy(source)
    if not _is_pose(array.shape) or array.dtype.kind not in "fiu":
        counts = ", ".join(map(str, sorted(_IN_NPY)))
        raise InputError(
            f"{source}: {array.dtype} of shape {array.shape}, expected numbers of shape"
            f" (frames, landmarks, 3 or 4) with {counts} landmarks; give others as TRC"
        )
    names = _IN_NPY[array.shape[1]]
    with np.errstate(invalid="ignore"):  # casting signaling NaN would warn
        values = array[:, : len(names)].astype(np.float64)
    visibility = values[..., 3] if values.shape[2] == 4 else None
    mocap = mocap_of_points(names, values[..., :3], ASSUMED_FPS, source, visibility)
    return replace(recording_of(mocap), timed=False)


def _is_pose(shape: tuple[int, ...]) -> bool:
    return len(shape) == 3 and shape[1] in _IN_NPY and shape[2] in (3, 4)


def claims_npy(source: str) -> bool:
    """Return True if an array's shape is one of landmarks, or raise InputError."""
    return _is_pose(_read_npy(source).shape)


def _read_npy(source: str) -> NDArray[Any]:
    data = io.BytesIO(read_bytes(source, _LARGEST))
    with refused(source, "cannot be read as npy; expected an array of numbers"):
        return read_array(data)


def read_freemocap(source: str) -> Recording:
    """Read a table with a column per coordinate; raises InputError if malformed."""
    with open_rows(source) as (row, line, lines):
        split = partial(_cells, source=source, separator=separator_of(line))
        header = [cell.strip() for cell in split(line)]
        at = {cell: k for k, cell in reversed(list(enumerate(header)))}
        found = dict.fromkeys(cell.rpartition("_")[0] for cell in header)
        names = [n for n in found if f"{n}_z" in at and plain_name(n) in BLAZEPOSE]
        needed = [f"{name}_{axis}" for name in names for axis in "xyz"]
        if missing := [cell for cell in needed if cell not in at]:
            raise InputError(f"{source}: row {row} has no column {missing[0]!r}")

        def cells(line: str) -> str:
            given = split(line)
            given += [""] * (len(header) - len(given))
            time = _seconds(given[at["timestamp"]]) if "timestamp" in at else ""
            values = [given[at[cell]].strip().replace(",", ".") for cell in needed]
            return ",".join([time, *values, *given[len(header) :]])

        reader = RowReader(source, ("timestamp", *needed), cells)
        values = reader.read(lines, row + 1, MOST_FRAMES).values
    positions = values[:, 1:].reshape(len(values), len(names), 3)
    mocap = mocap_of_points(tuple(names), positions, ASSUMED_FPS, source)
    time = values[:, 0]
    if np.isnan(time).any():
        return replace(recording_of(mocap), timed=False)
    check_order(time, lambda k: f"{source}: frame {k + 1}: 'timestamp'", "frames")
    return recording_of(mocap, time - time[:1])


def _cells(line: str, source: str, separator: str) -> list[str]:
    try:
        return next(csv.reader([line], delimiter=separator), [])
    except csv.Error as error:
        raise InputError(f"{source}: not CSV ({error}); export it again") from None


def _seconds(stamp: str) -> str:
    """Convert a time stamp, in seconds or an ISO date and time, to seconds."""
    stamp = stamp.strip()[:_LONGEST_STAMP]
    try:
        return repr(datetime.fromisoformat(stamp).timestamp())
    except (ValueError, OverflowError, OSError):
        return stamp


_Body = tuple[tuple[str, ...], Array, Array]  # names, positions and confidence


def read_openpose(source: str) -> Recording:
    """Read OpenPose's files of frames; raises InputError if one is malformed."""
    frames, numbers, flat = list[list[_Body | None]](), [], False
    for number, path in frame_files(source):
        root = read_json(path, _LARGEST)
        listed = root if isinstance(root, list) else [root]
        for k, frame in enumerate(listed):
            where = f"{path}: frame {k + 1}" if len(listed) > 1 else os.fspath(path)
            people = list_in(frame, "people", where, "OpenPose")
            frames.append([_openpose_body(person, where) for person in people])
            numbers.append(float(number + k))
            flat = flat or any(person.get("pose_keypoints_2d") for person in people)
    if flat and not any(body for bodies in frames for body in bodies):
        wrong = "'pose_keypoints_3d' is empty in all frames"
        raise InputError(f"{source}: {wrong}; run OpenPose with --3d")
    return _recording(frames, numbers, source)


def frame_files(source: str) -> list[tuple[int, Path]]:
    """Return the number and path of a frame's file and all beside it, in order."""
    path = Path(source)
    name = _FRAME_FILE.fullmatch(path.name)
    if name is None:
        return [(0, path)]
    files = {}
    for file in path.parent.iterdir():
        other = _FRAME_FILE.fullmatch(file.name)
        if other and other[1] == name[1]:
            files[int(other[2])] = file
        if len(files) > MOST_FRAMES:
            raise InputError(f"{source}: over {MOST_FRAMES:,} frames; split them")
    return sorted(files.items())


def recording_of_frame(name: str) -> str | None:
    """Return what OpenPose's files of a recording begin with, None of others."""
    found = _FRAME_FILE.fullmatch(name)
    return found and found[1]


def _openpose_body(person: Any, where: str) -> _Body | None:
    values = person.get("pose_keypoints_3d") if isinstance(person, dict) else None
    if values == []:  # as of people whom too few cameras see, although with --3d
        return None
    numbers = array_of(values)
    if numbers.ndim != 1 or len(numbers) != 4 * len(BODY_25):
        raise InputError(
            f"{where} has no 'pose_keypoints_3d' with x, y, z and confidence of "
            f"BODY_25's {len(BODY_25)} landmarks; run OpenPose with --3d"
        )
    places = numbers.reshape(-1, 4)
    return BODY_25, places[:, :3], places[:, 3]


def read_mmpose(source: str) -> Recording:
    """Read predictions of MMPose's 3D lifters; raises InputError if malformed."""
    root = read_json(source, _LARGEST)
    if not isinstance(root, list):
        listed = list_in(root, "instance_info", source, "MMPose")
        names = _landmark_names(root.get("meta_info"))
    else:
        listed, names = root, None
    frames, numbers = list[list[_Body | None]](), []
    for k, frame in enumerate(listed):
        where = f"{source}: frame {k + 1}"
        bodies = list_in(frame, "instances", where, "MMPose")
        frame = {"frame_id": float(k), **frame}
        numbers.append(number_in(frame, "frame_id", where, MOST_FRAMES))
        frames.append([_mmpose_body(body, names, where) for body in bodies])
    return _recording(frames, numbers, source)


def _landmark_names(meta: Any) -> tuple[str, ...] | None:
    table = meta.get("keypoint_id2name") if isinstance(meta, dict) else None
    if not isinstance(table, dict):
        return None
    return tuple(plain_name(str(table.get(str(k)))) for k in range(len(table)))


def _mmpose_body(body: Any, names: tuple[str, ...] | None, where: str) -> _Body:
    body = body if isinstance(body, dict) else {}
    places, scores = (array_of(body.get(k)) for k in ("keypoints", "keypoint_scores"))
    if places.ndim == 3 and len(places) == 1:
        places = places[0]
    names = names or _IN_JSON.get(len(places) if places.ndim else 0)
    valid = names is not None and places.ndim == 2 and places.shape[1] == 3
    if not valid or names is None or not len(names) <= len(places) == scores.size:
        counts = ", ".join(map(str, _IN_JSON))
        raise InputError(
            f"{where} has 'keypoints' of shape {places.shape} with {scores.size} "
            f"'keypoint_scores', expected x, y, z of {counts} landmarks or of those "
            "that 'meta_info' names; use a 3D lifter"
        )
    return names, places[: len(names)], scores.reshape(-1)[: len(names)]


def _recording(
    frames: list[list[_Body | None]], numbers: list[float], source: str
) -> Recording:
    time = (np.array(numbers) - numbers[:1]) / ASSUMED_FPS
    check_order(time, lambda k: f"{source}: frame {k + 1}: its number", "frames")
    found = [
        (frame, number, *body)
        for frame, bodies in enumerate(frames)
        for number, body in enumerate(bodies)
        if body is not None
    ]
    if not found:
        raise InputError(f"{source}: no one in {counted(len(frames), 'frame')}")
    frame_of, number_of, names, points, scores = zip(*found, strict=True)
    if len(set(names)) > 1:
        raise InputError(f"{source}: bodies have different landmarks; split it")
    places, confidence = np.stack(points), np.stack(scores)
    mocap = mocap_of_points(names[0], places, ASSUMED_FPS, source, confidence)
    positions, motion, notes = kinect_joints(mocap, KINECT_V2)
    sightings = list(map(Sighting, frame_of, number_of, positions, motion.state))
    takes, others = takes_of_people(time, sightings, KINECT_V2, source)
    people = Recording(takes, unit=motion.unit or "unknown", notes=notes + others)
    return not_by_kinect(replace(people, timed=False))
