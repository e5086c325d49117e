"""Small valid files of every layout that is read, their readers, and their damage."""

from __future__ import annotations

import gzip
import json
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from mutations import mutated, mutated_arrays
from published_layouts import (
    azure_json,
    freemocap_csv,
    landmarks,
    mmpose_json,
    msr_action3d_text,
    msrc_12_text,
    ntu_text,
    openpose_frames,
)
from test_mocap_files import ARM, ARM_MOTION, standing, write_c3d, write_trc

from kinefilter.characters import CONTACTS, KINECT_V1, KINECT_V2, Clip, State, Take
from kinefilter.pipeline.contents import contents_of
from kinefilter.pipeline.database import PostureDatabase
from kinefilter.pipeline.edits import read_edits
from kinefilter.pipeline.factory import Model, load_model, save_model
from kinefilter.pipeline.formats import (
    read_bvh,
    read_clip,
    read_contacts,
    read_recording,
    write_clip,
    write_take_csv,
)
from kinefilter.pipeline.formats.keypoints import BLAZEPOSE
from kinefilter.pipeline.formats.mocap import RIGS, kinect_motion, read_mocap
from kinefilter.pipeline.lab.methods.baselines import JointOffsets
from kinefilter.pipeline.pairs import read_pairs

Reader = Callable[[Path], object]


def small_take(skeleton: Any, frames: int = 3) -> Take:
    rng = np.random.default_rng(0)
    positions = 2.0 + rng.uniform(-0.5, 0.5, (frames, len(skeleton), 3)).round(3)
    state = np.full(positions.shape[:2], State.TRACKED, dtype=np.uint8)
    return Take(np.arange(frames) / 30, positions, state, skeleton)


def _kinect_v1_text(take: Take) -> str:
    rows = [
        ";".join(" ".join(map(str, place)) for place in frame)
        for frame in take.positions.tolist()
    ]
    return "\n".join([";".join(KINECT_V1.joints), *rows]) + "\n"


def _kinect_v2_text(take: Take) -> str:
    return "".join(
        f"{t * 333_333}," + "".join(f"{x},{y},{z},2," for x, y, z in frame) + "\n"
        for t, frame in enumerate(take.positions.tolist())
    )


def write_valid(folder: Path, clip: Clip, v1: Take, v2: Take) -> dict[str, Path]:
    """Write a valid file for every reader, of a clip and a take of each Kinect."""
    two = Take(v2.time, v2.positions + np.array([2, 0, 0]), v2.state, KINECT_V2)
    texts = {
        "kinect-v1.csv": _kinect_v1_text(v1),
        "kinect-v2.csv": _kinect_v2_text(v2),
        "msrc-12.csv": msrc_12_text(v1),
        "msr-action3d.txt": msr_action3d_text(v1),
        "ntu.skeleton": ntu_text([v2, two]),
        "azure.json": azure_json([v2, two], levels=True),
        "openpose.json": json.dumps(openpose_frames([v2, two])),
        "mmpose.json": mmpose_json([v2, two], named=True),
        "freemocap.csv": freemocap_csv(v2, start="2024-01-01 12:00:00"),
        "arm.amc": ARM_MOTION,
        "arm.asf": ARM,
    }
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    write_take_csv(v1, folder / "kinefilter.csv")
    packed = gzip.compress((folder / "kinefilter.csv").read_bytes(), mtime=0)
    (folder / "zipped.csv").write_bytes(packed)
    for suffix in ("bvh", "npz", "usda", "usdc", "glb"):
        write_clip(clip, folder / f"clip.{suffix}")
    header, rows = ",".join(("time", *CONTACTS)), "0,1,1,0,0\n0.1,0,0,1,1\n"
    edits = '[[distrust]]\njoints = ["left-arm", "Head"]\nbegin = 0\nend = 1.5\n'
    (folder / "edits.toml").write_text(edits, encoding="utf-8")
    (folder / "contacts.csv").write_text(f"{header}\n{rows}", encoding="utf-8")
    write_c3d(folder / "points.c3d", standing(KINECT_V1, "plug_in_gait"))
    write_trc(folder / "points.trc", standing(KINECT_V1, "plug_in_gait"))
    write_trc(folder / "pose2sim.trc", standing(KINECT_V2, "keypoints"))
    np.save(folder / "mediapipe.npy", landmarks(v2, BLAZEPOSE).astype(np.float32))
    _write_arrays(folder)
    return {path.name: path for path in sorted(folder.iterdir())}


def _write_arrays(folder: Path) -> None:
    rng = np.random.default_rng(0)
    PostureDatabase(
        rng.normal(size=(4, 20, 3)),
        np.array(["a", "b", "c", "d"]),
        KINECT_V1,
    ).save(folder / "database.npz")
    joints = rng.normal(size=(5, 20, 3))
    np.savez_compressed(
        folder / "pairs.npz",
        joints=np.array(KINECT_V1.joints),
        fps=np.float32(30),
        subject=np.array("s1"),
        kinect=joints,
        mocap=joints,
        clip=np.array(["m01_s01_e01", "m01_s01_e02"]),
        start=np.array([0, 3]),
        stop=np.array([3, 5]),
    )
    learner = JointOffsets.from_arrays(
        KINECT_V1, {key: np.array(a) for key, a in _offsets().items()}
    )
    model = Model(learner, "joint-offsets", KINECT_V1, "made up")
    save_model(model, folder / "model.npz")


def _offsets() -> dict[str, Any]:
    """Return the fitted arrays of joint offsets."""
    shares = np.full((20, 6), 0.01)
    return {"joints": np.arange(20), "shares": shares, "settings": "{}"}


# How they are read

TIME = np.linspace(0.0, 0.1, 4)


def as_mocap(path: Path) -> object:
    """Read mocap and look for a Kinect's joints in it, as databases do."""
    mocap = read_mocap(path, [path.with_name("arm.asf")])
    return kinect_motion(mocap, KINECT_V1, RIGS)


TAKES = (
    *("kinefilter.csv", "zipped.csv", "kinect-v1.csv", "kinect-v2.csv"),
    *("msrc-12.csv", "msr-action3d.txt", "ntu.skeleton", "azure.json"),
    *("openpose.json", "mmpose.json", "freemocap.csv", "mediapipe.npy"),
    "pose2sim.trc",
)
READERS: dict[str, list[Reader]] = {
    **{name: [read_recording, contents_of] for name in TAKES},
    "clip.bvh": [read_bvh, read_clip, read_recording, contents_of, as_mocap],
    "arm.amc": [as_mocap, contents_of],
    "arm.asf": [lambda path: read_mocap(path.with_name("arm.amc"), [path])],
    "points.c3d": [as_mocap, read_recording],
    "points.trc": [as_mocap, contents_of],
    "contacts.csv": [lambda path: read_contacts(path, TIME)],
    "edits.toml": [read_edits],
    "clip.npz": [read_clip, contents_of, lambda path: read_contacts(path, TIME)],
    "database.npz": [PostureDatabase.load, contents_of],
    "model.npz": [load_model, contents_of],
    "pairs.npz": [read_pairs, contents_of],
    "clip.usda": [contents_of, read_clip],
    "clip.usdc": [contents_of, read_clip],
    "clip.glb": [contents_of, read_clip],
}


def damaged(name: str, data: bytes, rng: random.Random) -> bytes:
    """Return a valid file with something wrong in it."""
    whole = name.endswith(".npz") and rng.random() < 0.7
    if data.startswith(b"\x1f\x8b") and rng.random() < 0.7:
        return gzip.compress(mutated(gzip.decompress(data), rng), 1, mtime=0)
    return mutated_arrays(data, rng) if whole else mutated(data, rng)
