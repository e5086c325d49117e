"""Every reader against damaged files: an InputError, or a result, and nothing else.

Valid small files are mutated: bytes flipped, cut, lines dropped, doubled and swapped,
numbers replaced by what no number should be, arrays of other types and shapes.
``tests/abuse.py --only files`` tries many more, and commands with them.
"""

from __future__ import annotations

import gzip
import random
import struct
import warnings
import zipfile
from pathlib import Path

import pytest
from conftest import MakeClip
from hostile_files import READERS, as_mocap, damaged, small_take, write_valid
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from kinefilter.characters import KINECT_V1, KINECT_V2, InputError
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.contents import contents_of
from kinefilter.pipeline.database import PostureDatabase
from kinefilter.pipeline.factory import load_model
from kinefilter.pipeline.formats import read_bvh, read_clip, read_recording
from kinefilter.pipeline.pairs import read_pairs

EXAMPLES = 100


@pytest.fixture(scope="module")
def valid(
    tmp_path_factory: pytest.TempPathFactory, make_clip: MakeClip
) -> dict[str, Path]:
    folder, takes = tmp_path_factory.mktemp("valid"), (KINECT_V1, KINECT_V2)
    return write_valid(folder, make_clip(3), *map(small_take, takes))


def test_the_unharmed_files_are_read(valid: dict[str, Path]) -> None:
    assert set(READERS) == set(valid)
    for name, readers in READERS.items():
        for reader in readers:
            if reader is not as_mocap or name == "clip.bvh":
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
        ("azure.json", 15_206),
    ],
)
def test_what_long_runs_have_found_stays_mended(
    valid: dict[str, Path], tmp_path: Path, name: str, seed: int
) -> None:
    try_damaged(valid, tmp_path, name, seed)


def try_damaged(valid: dict[str, Path], folder: Path, name: str, seed: int) -> None:
    """Read a file with something wrong in it, which is the same for the same seed."""
    rng = random.Random(seed)
    path = folder / name
    path.write_bytes(damaged(name, valid[name].read_bytes(), rng))
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
