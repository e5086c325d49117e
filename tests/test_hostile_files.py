"""Every reader against damaged files: an InputError, or a result, and nothing else.

Valid small files are mutated: bytes flipped, cut, lines dropped, doubled and swapped,
numbers replaced by what no number should be, arrays of other types and shapes.
``KINEFILTER_FUZZ=20000 pytest tests/test_hostile_files.py`` tries that many of each.
"""

from __future__ import annotations

import gzip
import os
import random
import struct
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from mutations import mutated, mutated_arrays
from published_layouts import azure_json, msr_action3d_text, msrc_12_text, ntu_text
from test_mocap_files import ARM, ARM_MOTION, standing, write_c3d

from kinefilter.characters import (
    CONTACTS,
    KINECT_V1,
    KINECT_V2,
    Clip,
    InputError,
    State,
    Take,
)
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.contents import contents_of
from kinefilter.pipeline.database import PostureDatabase
from kinefilter.pipeline.formats import (
    read_bvh,
    read_clip,
    read_contacts,
    read_recording,
    write_clip,
    write_take_csv,
)
from kinefilter.pipeline.formats.mocap import RIGS, kinect_motion, read_mocap
from kinefilter.pipeline.lab.methods.joint_offsets import JointOffsets
from kinefilter.pipeline.models import Model, load_model, save_model
from kinefilter.pipeline.pairs import read_pairs

MakeClip = Callable[..., Clip]
Reader = Callable[[Path], object]

EXAMPLES = int(os.environ.get("KINEFILTER_FUZZ", "100"))

# The valid files


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


def write_valid(folder: Path, make_clip: MakeClip) -> dict[str, Path]:
    """Write a small valid file for every reader."""
    v1, v2 = small_take(KINECT_V1), small_take(KINECT_V2)
    two = Take(v2.time, v2.positions + np.array([2, 0, 0]), v2.state, KINECT_V2)
    texts = {
        "kinect-v1.csv": _kinect_v1_text(v1),
        "kinect-v2.csv": _kinect_v2_text(v2),
        "msrc-12.csv": msrc_12_text(v1),
        "msr-action3d.txt": msr_action3d_text(v1),
        "ntu.skeleton": ntu_text([v2, two]),
        "azure.json": azure_json([v2, two], levels=True),
        "arm.amc": ARM_MOTION,
        "arm.asf": ARM,
    }
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    write_take_csv(v1, folder / "kinefilter.csv")
    packed = gzip.compress((folder / "kinefilter.csv").read_bytes(), mtime=0)
    (folder / "zipped.csv").write_bytes(packed)
    clip = make_clip(3)
    for suffix in ("bvh", "npz", "usda", "usdc"):
        write_clip(clip, folder / f"clip.{suffix}")
    header, rows = ",".join(("time", *CONTACTS)), "0,1,1,0,0\n0.1,0,0,1,1\n"
    (folder / "contacts.csv").write_text(f"{header}\n{rows}", encoding="utf-8")
    write_c3d(folder / "points.c3d", standing(KINECT_V1, "plug_in_gait"))
    _write_arrays(folder)
    return {path.name: path for path in sorted(folder.iterdir())}


def _write_arrays(folder: Path) -> None:
    rng = np.random.default_rng(0)
    PostureDatabase(
        rng.normal(size=(4, 20, 3)),
        rng.normal(size=(4, 20, 4)),
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
    return {"joints": np.arange(20), "shares": np.full((20, 6), 0.01)}


# How they are read

TIME = np.linspace(0.0, 0.1, 4)


def _motion(path: Path) -> object:
    """Read mocap and look for a Kinect's joints in it, as databases do."""
    mocap = read_mocap(path, [path.with_name("arm.asf")])
    return kinect_motion(mocap, KINECT_V1, RIGS)


TAKES = (
    *("kinefilter.csv", "zipped.csv", "kinect-v1.csv", "kinect-v2.csv"),
    *("msrc-12.csv", "msr-action3d.txt", "ntu.skeleton", "azure.json"),
)
READERS: dict[str, list[Reader]] = {
    **{name: [read_recording, contents_of] for name in TAKES},
    "clip.bvh": [read_bvh, read_clip, read_recording, contents_of, _motion],
    "arm.amc": [_motion, contents_of],
    "arm.asf": [lambda path: read_mocap(path.with_name("arm.amc"), [path])],
    "points.c3d": [_motion],
    "contacts.csv": [lambda path: read_contacts(path, TIME)],
    "clip.npz": [read_clip, contents_of, lambda path: read_contacts(path, TIME)],
    "database.npz": [PostureDatabase.load, contents_of],
    "model.npz": [load_model, contents_of],
    "pairs.npz": [read_pairs, contents_of],
    "clip.usda": [contents_of, read_clip],
    "clip.usdc": [contents_of, read_clip],
}


@pytest.fixture(scope="module")
def valid(
    tmp_path_factory: pytest.TempPathFactory, make_clip: MakeClip
) -> dict[str, Path]:
    return write_valid(tmp_path_factory.mktemp("valid"), make_clip)


def test_the_unharmed_files_are_read(valid: dict[str, Path]) -> None:
    assert set(READERS) == set(valid)
    for name, readers in READERS.items():
        for reader in readers:
            if reader is not _motion or name == "clip.bvh":
                assert reader(valid[name]) is not None


NATIVE = ("points.c3d", "clip.usda", "clip.usdc")
"""Read in a process of their own, most of a second each: a fiftieth of the examples."""


def fuzzed(examples: int) -> settings:
    return settings(
        parent=quick, max_examples=max(2, examples), phases=[Phase.generate]
    )


quick = settings(
    max_examples=EXAMPLES,
    deadline=None,
    database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)


@pytest.mark.parametrize("name", sorted(set(READERS).difference(NATIVE)))
@fuzzed(EXAMPLES)
@given(seed=st.integers(0, 2**64 - 1))
def test_damaged_files_raise_input_errors_and_nothing_else(
    valid: dict[str, Path], tmp_path: Path, name: str, seed: int
) -> None:
    try_damaged(valid, tmp_path, name, seed)


@pytest.mark.parametrize("name", NATIVE)
@fuzzed(EXAMPLES // 50)
@given(seed=st.integers(0, 2**64 - 1))
def test_damaged_files_do_not_hang_libraries_or_eat_memory(
    valid: dict[str, Path], tmp_path: Path, name: str, seed: int
) -> None:
    try_damaged(valid, tmp_path, name, seed)


@pytest.mark.parametrize(
    ("name", "seed"),
    [
        *(("clip.npz", 4), ("clip.npz", 47), ("kinefilter.csv", 95)),
        *(("pairs.npz", 176), ("database.npz", 1051), ("database.npz", 104_775)),
        *(("clip.bvh", 100_170), ("contacts.csv", 102_861), ("points.c3d", 46)),
    ],
)
def test_what_long_runs_have_found_stays_mended(
    valid: dict[str, Path], tmp_path: Path, name: str, seed: int
) -> None:
    try_damaged(valid, tmp_path, name, seed)


def try_damaged(valid: dict[str, Path], folder: Path, name: str, seed: int) -> None:
    """Read a file with something wrong in it, which is the same for the same seed."""
    rng = random.Random(seed)
    data = valid[name].read_bytes()
    whole = name.endswith(".npz") and rng.random() < 0.7
    if name == "zipped.csv" and rng.random() < 0.7:
        data = gzip.compress(mutated(gzip.decompress(data), rng), 1, mtime=0)
    else:
        data = mutated_arrays(data, rng) if whole else mutated(data, rng)
    path = folder / name
    path.write_bytes(data)
    if name.startswith("arm."):
        other = "arm.asf" if name == "arm.amc" else "arm.amc"
        (folder / other).write_bytes(valid[other].read_bytes())
    for reader in READERS[name]:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            try:
                reader(path)
            except InputError as error:
                message = str(error)
                assert message
                assert "\n" not in message
                assert len(message) < 1000


# Files made to ask for much


def test_a_header_of_a_million_joints_is_refused(tmp_path: Path) -> None:
    names = ",".join(f"J{k}.x" for k in range(1_000_000))
    double = ",".join(["a.x"] * 300_000)
    for header in (f"time,{names}", f"time,{double}", ";".join(["J"] * 400_000)):
        path = tmp_path / "take.csv"
        path.write_text(f"{header}\n0,1\n", encoding="utf-8")
        with pytest.raises(InputError, match=r"take\.csv: row 1"):
            read_recording(path)
    joints = "JOINT J\n{\n" * 1_000_000
    path.write_text(f"HIERARCHY\nROOT R\n{{\n{joints}", encoding="utf-8")
    with pytest.raises(InputError, match="joint number 1001"):
        read_bvh(path)


@pytest.mark.parametrize("frames", ["1000000000000", "1e300", "9" * 400])
def test_absurd_frame_counts_are_refused_before_memory_is_asked_for(
    valid: dict[str, Path], tmp_path: Path, frames: str
) -> None:
    text = valid["clip.bvh"].read_text().replace("Frames: 3", f"Frames: {frames}")
    path = tmp_path / "a.bvh"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"more than any recording|positive number"):
        read_bvh(path)
    lines = valid["ntu.skeleton"].read_text().splitlines()
    path.write_text("\n".join([frames, *lines[1:]]), encoding="utf-8")
    with pytest.raises(InputError, match=r"row \d+|row 1 is of no known"):
        read_recording(path)


@pytest.mark.parametrize("line", [b"\n", b"0,0,0\n", b"0" * 4096, b" " * 4096])
def test_gzip_files_that_inflate_without_end_are_refused(
    tmp_path: Path, line: bytes
) -> None:
    path = tmp_path / "bomb.csv"
    header = b"time,Head.x,Head.y,Head.z\n"
    with gzip.open(path, "wb", compresslevel=1) as file:
        file.write(header)
        block = line * (2**20 // len(line))
        for _ in range(100):
            file.write(block)
    with pytest.raises(InputError, match=r"bomb\.csv"):
        read_recording(path)


def npz_with(path: Path, header: bytes, body: bytes) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("time.npy", header + body)
    return path


@pytest.mark.parametrize("shape", ["(1000000000000,)", "(4294967296, 4294967296)"])
def test_npz_arrays_larger_than_the_archive_are_refused(
    tmp_path: Path, shape: str
) -> None:
    words = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}"
    padded = words.encode().ljust(117) + b"\n"
    header = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(padded)) + padded
    path = npz_with(tmp_path / "bomb.npz", header, b"\0" * 64)
    for reader in (read_clip, PostureDatabase.load, load_model, read_pairs):
        with pytest.raises(InputError, match=r"bomb\.npz"):
            reader(path)


def test_npz_archives_that_inflate_to_gigabytes_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "bomb.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        archive.writestr("time.npy", b"\0" * 2**20)
    data = path.read_bytes()
    # The directory at the end of the archive says how large it will be.
    at = data.rindex(b"PK\x01\x02")
    claimed = data[: at + 24] + struct.pack("<I", 2**32 - 2) + data[at + 28 :]
    path.write_bytes(claimed)
    with pytest.raises(InputError, match="more than kinefilter writes"):
        read_clip(path)


def test_packages_that_are_packed_are_no_usd(
    valid: dict[str, Path], tmp_path: Path
) -> None:
    path = tmp_path / "bomb.usdz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("clip.usda", valid["clip.usda"].read_text() + "\n" * 10**7)
    with pytest.raises(InputError, match=r"bomb\.usdz.*packed"):
        contents_of(path)


def test_a_damaged_take_ends_with_code_2_and_nothing_written(
    valid: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, cut in (("ntu.skeleton", 900), ("azure.json", 9000), ("clip.bvh", 900)):
        take = tmp_path / name
        take.write_bytes(valid[name].read_bytes()[:cut])
        out = tmp_path / "out.usda"
        assert main(["clean", str(take), "-o", str(out)]) == 2
        assert capsys.readouterr().err.count("\n") == 1
        assert not out.exists()
