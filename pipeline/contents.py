"""The contents of files that kinefilter can read, for ``kinefilter info``."""

import json
import os
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Group, RenderableType
from rich.table import Table

from kinefilter.characters import KINECT_V1, Clip, InputError, State, Take
from kinefilter.characters.arrays import Array
from kinefilter.characters.gaps import describe_gaps, long_gaps
from kinefilter.characters.motion import CONTACTS, Origin, distinct_stamps, nominal_step
from kinefilter.characters.skeleton import SIDES

from .database import PostureDatabase
from .edits import LIMBS, read_edits
from .factory import load_model
from .failures import Failure, find_failures
from .formats import Recording, read_recording
from .formats.files import (
    CALIBRATION,
    LARGEST_TOML,
    beginning,
    check_file,
    read_limited,
)
from .formats.glb_reader import read_glb, read_glb_times
from .formats.guarded import read_usd
from .formats.mocap import RIGS, kinect_motion, read_mocap
from .formats.npz import array_names, read_npz
from .formats.plain import counted
from .formats.recording import Mocap
from .formats.rig import own_skeleton
from .formats.sheets import claims_contacts, contact_table
from .pairs import read_pairs
from .settings import Settings, as_table, overlaid, read_settings

_GAP = 1.5  # nominal steps; longer ones contain frames that never arrived
_PARTS = {
    f"{side.lower()} {limb}": (top + side, *LIMBS[f"{side.lower()}-{limb}"])
    for limb, top in (("arm", "Shoulder"), ("leg", "Hip"))
    for side in SIDES
}
_USD = (b"#usda", b"PXR-USDC")
_IN_PLACE = 1e-5  # m over the floor: no one stands so still
_LISTED = 30  # joint names listed on a terminal
_SHOWN_APART = {"file", "kind", "format", "bodies", "notes", "body", "most_seen"}
_SHOWN_APART |= {"states", "gaps", "failures"}


def contents_of(
    path: str | os.PathLike[str],
    *,
    format: str | None = None,  # noqa: A002 - the word users know
) -> dict[str, Any]:
    """Return the contents of a file, ready for ``json.dump``.

    Always has ``file``, ``kind`` and ``format``; for takes ``unit``, ``notes`` and
    ``bodies``. ``format`` is as for ``read_take``. Raises an InputError if unreadable.
    """
    file, name = check_file(path), os.fspath(path)
    with file.open("rb") as opened:
        start = opened.read(8)
    packed = start.startswith(b"PK")
    unzipped = file.name.lower().removesuffix(".gz")
    if format is not None:
        contents = _of_recording(read_recording(path, format=format))
    elif start.startswith(_USD) or (packed and file.suffix.lower() == ".usdz"):
        found = json.loads(str(read_usd("contents_arrays", name)["json"]))
        contents = {"kind": "clip", "format": "usd"} | found
    elif start.startswith(b"glTF"):
        contents = _of_glb(path)
    elif packed:
        contents = _of_npz(name)
    elif unzipped.endswith((".c3d", ".trc")):
        try:
            contents = _of_recording(read_recording(path))
        except InputError:  # markers that are not a take
            contents = _of_mocap(read_mocap(file))
    elif unzipped.endswith(".amc"):
        contents = _of_mocap(read_mocap(file))
    elif claims_contacts(file):
        contents = _of_contacts(file)
    elif CALIBRATION in beginning(file):
        contents = _of_calibration(file)
    elif beginning(file).startswith(('{"take": ', "take,status,")):
        contents = _of_manifest(file)
    elif file.suffix.lower() == ".toml":
        contents = _of_toml(file)
    else:
        contents = _of_recording(read_recording(path))
    return {"file": name} | contents


def _of_glb(path: str | os.PathLike[str]) -> dict[str, Any]:
    people, times, root = read_glb_times(path)
    if len(people) == 1 and own_skeleton(people[0]) is not None:
        return {"format": "glb"} | _of_clip(read_glb(path))
    form = "vrma" if os.fspath(path).lower().endswith(".vrma") else "glb"
    many = {"people": len(people)} if len(people) > 1 else {}
    known = {"kind": "clip", "format": form, **many, "joints": len(people[0])}
    moves = {} if root is None else {"in_place": root != "travel"}
    return known | _timing(times) | moves


def _of_npz(name: str) -> dict[str, Any]:
    arrays, contents = array_names(name), dict[str, Any]()
    if "moved_by_physics" in arrays:
        contents = _of_clip(read_npz(name))
    elif "mocap" in arrays:
        pairs = read_pairs(name)
        contents = {
            "kind": "pairs",
            "skeleton": pairs[0].take.skeleton.name if pairs else None,
            "clips": len(pairs),
            "frames": sum(len(pair.take) for pair in pairs),
            "people": sorted({pair.subject for pair in pairs}),
        }
    elif "trained_on" in arrays:
        model = load_model(Path(name))
        contents = {"kind": "model", "skeleton": model.skeleton.name}
        contents |= {"method": model.method, "learned_from": model.source}
    elif "labels" in arrays:
        base = PostureDatabase.load(Path(name))
        contents = {
            "kind": "database",
            "skeleton": base.skeleton.name,
            "postures": len(base),
            "motions": len(set(base.labels.tolist())),
            "recorded": base.recorded,
        }
    elif "global_joint_positions" in arrays:
        raise InputError(
            f"{name}: is an export with --rig (smplx, for example) for other tools, "
            "which cannot be read back; write a clip without --rig"
        )
    else:
        wrong = "not a kinefilter clip, pairs file, model or motion database"
        hint = f"it has the arrays {', '.join(sorted(arrays)[:5])[:100] or '(none)'}"
        raise InputError(f"{name}: {wrong}; {hint}")
    return {"format": "npz"} | contents


def _of_clip(clip: Clip) -> dict[str, Any]:
    standing = clip.contacts.mean(axis=0).tolist()
    force = clip.external_force[np.isfinite(clip.external_force)]
    travel = float(np.ptp(clip.root[:, [0, 2]], axis=0).max())
    return {
        "kind": "clip",
        "unit": "m",
        "source": clip.source,
        "skeleton": clip.skeleton.name,
        "joints": len(clip.skeleton),
        **_timing(clip.time),
        "height_m": clip.body.height,
        "mass_kg": clip.body.mass,
        "reliability": float(clip.reliability.mean()),
        "origin": origin_shares(clip),
        "in_place": travel < _IN_PLACE,  # then planted feet slide
        "standing": dict(zip(CONTACTS, standing, strict=True)),
        "external_force_body_weights": float(force.mean()) if len(force) else None,
        "states": _states(clip),
    }


def origin_shares(clip: Clip) -> dict[str, float]:
    """Return the share of joints in all frames by the name of their origin."""
    return {o.name.lower(): float(np.mean(clip.origin == o)) for o in Origin}


def _of_contacts(path: Path) -> dict[str, Any]:
    time, contacts = contact_table(path)
    shares = contacts.mean(axis=0).tolist()
    return {
        "kind": "contacts",
        "format": "csv",
        "rows": len(time),
        "start_s": float(time[0]),
        "seconds": float(time[-1] - time[0]),
        "share_of_rows_on_the_floor": dict(zip(CONTACTS, shares, strict=True)),
    }


def _of_toml(path: Path) -> dict[str, Any]:
    named = path.name.lower().endswith(".edits.toml")
    if named or "[[" in read_limited(path, LARGEST_TOML):
        edits = [edit.summary for edit in read_edits(path)]
        return {"kind": "edits", "format": "toml", "edits": len(edits), "notes": edits}
    options = as_table(overlaid(Settings(), read_settings(path)))
    return {"kind": "settings", "format": "toml", "options": options}


def _of_manifest(path: Path) -> dict[str, Any]:
    from .batch.manifest import parse_rows

    note = "'kinefilter batch' resumes from manifest.jsonl; manifest.csv is for reading"
    known: dict[str, Any] = {"kind": "manifest of a batch", "notes": [note]}
    if beginning(path).startswith("take,"):
        return known | {"format": "csv"}
    last = {row.take: row.status for row in parse_rows(path.read_bytes(), str(path))[0]}
    return known | {"format": "json lines", "takes": len(last)} | Counter(last.values())


def _of_calibration(path: Path) -> dict[str, Any]:
    from .merge import read_calibration

    places = [found.placed for found in read_calibration(path)]
    angles = [np.degrees(place.turn.magnitude()) for place in places]
    sensors = json.loads(path.read_text(encoding="utf-8"))["sensors"]
    return {
        "kind": "calibration",
        "format": "json",
        "sensors": [sensor.get("source") for sensor in sensors],
        "turned_degrees": [round(float(angle), 1) for angle in angles],
        "away_m": [round(float(np.linalg.norm(p.shift)), 2) for p in places],
    }


def _of_mocap(mocap: Mocap) -> dict[str, Any]:
    contents = {
        "kind": "mocap",
        "format": Path(mocap.source.removesuffix(".gz")).suffix[1:].lower(),
        "joints": len(mocap.names),
        "names": list(mocap.names),
        **_timing(mocap.stamps),
    }
    try:
        motion = kinect_motion(mocap, KINECT_V1, RIGS)
    except InputError as error:
        notes = [*mocap.notes, str(error)]
        return contents | {"rig": None, "unit": None, "notes": notes}
    notes = list(mocap.notes)
    return contents | {"rig": motion.rig, "unit": motion.unit, "notes": notes}


def _of_recording(recording: Recording) -> dict[str, Any]:
    return {
        "kind": "take",
        "format": recording.format,
        "unit": recording.unit,
        "notes": list(recording.notes),
        "bodies": [
            {"body": k + 1, "most_seen": k == recording.main} | contents_of_take(take)
            for k, take in enumerate(recording.takes)
        ],
    }


def contents_of_take(take: Take) -> dict[str, Any]:
    """Return the contents of a take: time, states of parts of the body, failures."""
    missing = take.state == State.NOT_TRACKED
    once = take.at(distinct_stamps(take.time))
    return {
        "skeleton": take.skeleton.name,
        "joints": len(take.skeleton),
        **_timing(take.time),
        "frames_without_anyone": int(np.sum(missing.all(axis=1))),
        "joints_never_seen": np.array(take.skeleton.joints)[missing.all(0)].tolist(),
        "states": _states(take),
        "failures": failures_as_json(find_failures(once)),
    }


def failures_as_json(failures: Iterable[Failure]) -> list[dict[str, Any]]:
    """Return failures and their times [s], ready for ``json.dump``."""
    return [
        {"kind": f.kind.name.lower(), "part": f.part}
        | {"start_s": f.start, "end_s": f.end, "done": f.kind.done}
        for f in failures
    ]


def gaps_as_json(time: Array) -> list[dict[str, float]]:
    """Return the time stamps [s] around long gaps, ready for ``json.dump``."""
    return [{"start_s": start, "end_s": end} for start, end in long_gaps(time)]


def _timing(time: Array) -> dict[str, Any]:
    steps = np.diff(time)
    nominal = nominal_step(time)  # NaN without two frames, which then have no gaps
    gaps = steps[steps > _GAP * nominal]
    return {
        "frames": len(time),
        "start_s": float(time[0]) if len(time) else 0.0,
        "seconds": float(time[-1] - time[0]) if len(time) else 0.0,
        "fps": 1.0 / nominal if nominal > 0.0 else None,
        "repeated_frames": int(np.sum(steps == 0)),
        "dropped_frames": int(np.sum(np.round(gaps / nominal) - 1)),
        "longest_gap_s": float(gaps.max(initial=0.0)),
        "gaps": gaps_as_json(time),
    }


def _states(motion: Take | Clip) -> dict[str, dict[str, float]]:
    part_of = {joint: part for part, joints in _PARTS.items() for joint in joints}
    parts = np.array([part_of.get(j, "trunk") for j in motion.skeleton.joints])
    shares = {}
    for part in ("trunk", *_PARTS):
        codes = motion.state[:, parts == part]
        shares[part] = {s.name.lower(): float(np.mean(codes == s)) for s in State}
    return shares


def as_tables(contents: dict[str, Any]) -> RenderableType:
    """Return the result of ``contents_of`` as lines and tables."""
    title = f"{contents['file']}: {contents['kind']}, {contents['format']}"
    lines = [title, *_facts(contents)]
    bodies = contents.get("bodies", [])
    for body in bodies:
        most = ", seen in most frames" * (body["most_seen"] and len(bodies) > 1)
        lines.append(f"body {body['body']} of {len(bodies)}{most}")
        lines += _facts(body)
    return Group(*lines, *contents.get("notes", []))


def _facts(facts: dict[str, Any]) -> list[RenderableType]:
    lines: list[RenderableType] = [
        f"  {key.replace('_', ' ')}: {_text(value)}"
        for key, value in facts.items()
        if key not in _SHOWN_APART
    ]
    gaps = [(gap["start_s"], gap["end_s"]) for gap in facts.get("gaps", ())]
    lines += [f"  {gap}" for gap in describe_gaps(gaps, facts.get("start_s", 0.0))]
    if "states" in facts:
        names = [state.name.lower().replace("_", " ") for state in State]
        table = Table("part", *names, title="tracking states", title_justify="left")
        for part, shares in facts["states"].items():
            table.add_row(part, *(f"{share:.0%}" for share in shares.values()))
        lines.append(table)
    if "failures" in facts:
        found = [(f["part"], f["kind"].replace("_", " ")) for f in facts["failures"]]
        lines += [
            f"  tracker failure: {part} {kind}, {counted(count, 'time')}"
            for (part, kind), count in Counter(found).items()
        ] or ["  no tracker failure found; clean also tells which limbs it moved far"]
    return lines


def _text(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, dict):
        return ", ".join(f"{key} {_text(item)}" for key, item in value.items())
    if isinstance(value, list):
        more = f", ... ({len(value)})" if len(value) > _LISTED else ""
        return ", ".join(map(str, value[:_LISTED])) + more or "none"
    return "unknown" if value is None else str(value)
