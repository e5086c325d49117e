"""Clips as files: round trips, the same bytes, nothing half written."""

from __future__ import annotations

import errno
import io
import os
import subprocess
import sys
import time
import zipfile
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from text_files import write_text

from kinefilter.characters import (
    KINECT_V1,
    KINECT_V2,
    Body,
    Clip,
    InputError,
    Origin,
    Shape,
    State,
)
from kinefilter.pipeline import formats
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.formats import (
    atomic_path,
    check_folder,
    check_writable,
    npz,
    read_clip,
    read_take,
    write_clip,
)
from kinefilter.pipeline.formats.files import check_file

MakeClip = Callable[..., Clip]
EXTENSIONS = [".usda", ".usdc", ".usd", ".usdz", ".glb", ".bvh", ".csv", ".npz"]


def names_in(folder: Path) -> list[str]:
    return [path.name for path in folder.iterdir()]


# Round trips


@st.composite
def clips(draw: st.DrawFn) -> dict[str, object]:
    steps = draw(
        st.lists(st.sampled_from([0.0, 1 / 30, 0.0333, 0.5]), min_size=1, max_size=8)
    )
    return {
        "skeleton": draw(st.sampled_from([KINECT_V1, KINECT_V2])),
        "seed": draw(st.integers(0, 2**32 - 1)),
        "wild": draw(st.booleans()),
        "time": draw(st.floats(0.0, 1e5)) + np.cumsum([0.0, *steps]),
    }


round_trip = settings(
    max_examples=25,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)


@round_trip
@given(options=clips())
def test_csv_keeps_time_positions_and_states(
    make_clip: MakeClip, tmp_path: Path, options: dict[str, object]
) -> None:
    clip = make_clip(**options)
    write_clip(clip, tmp_path / "clip.csv")
    take = read_take(tmp_path / "clip.csv")
    assert take.skeleton is clip.skeleton
    np.testing.assert_array_equal(take.time, clip.time)
    measured = clip.origin == Origin.MEASURED
    assert np.all(take.state[~measured] == State.INFERRED)
    assert np.all(take.state[measured] == np.maximum(clip.state[measured], 1))
    np.testing.assert_allclose(take.positions, clip.positions, rtol=0, atol=6e-10)


@round_trip
@given(options=clips())
def test_npz_keeps_every_field(
    make_clip: MakeClip, tmp_path: Path, options: dict[str, object]
) -> None:
    clip = replace(make_clip(**options), tilt=-0.1, floor=0.7)
    write_clip(clip, tmp_path / "clip.npz")
    again = read_clip(tmp_path / "clip.npz")
    for field in fields(Clip):
        if field.name not in ("body", "props"):
            np.testing.assert_array_equal(
                getattr(again, field.name), getattr(clip, field.name)
            )
    for field in fields(Body):
        np.testing.assert_array_equal(
            getattr(again.body, field.name), getattr(clip.body, field.name)
        )


@pytest.mark.parametrize("number", [np.zeros(3), np.array("low")])
def test_an_npz_whose_floor_is_no_number_is_refused(
    make_clip: MakeClip, tmp_path: Path, number: NDArray[Any]
) -> None:
    write_clip(make_clip(3), tmp_path / "clip.npz")
    with np.load(tmp_path / "clip.npz") as archive:
        arrays = {**archive, "floor": number}
    np.savez(tmp_path / "clip.npz", **arrays)
    with pytest.raises(InputError, match=r"clip\.npz"):
        read_clip(tmp_path / "clip.npz")


def test_npz_keeps_props(
    make_clip: MakeClip, furnish: Callable[[Clip], Clip], tmp_path: Path
) -> None:
    clip = furnish(make_clip(5))
    write_clip(clip, tmp_path / "clip.npz")
    again = read_clip(tmp_path / "clip.npz")
    for prop, found in zip(clip.props, again.props, strict=True):
        assert found.name == prop.name
        np.testing.assert_array_equal(found.positions, prop.positions)
        np.testing.assert_array_equal(found.rotations, prop.rotations)
        for shape, other in zip(prop.shapes, found.shapes, strict=True):
            for field in fields(Shape):
                np.testing.assert_array_equal(
                    getattr(other, field.name), getattr(shape, field.name)
                )


def test_an_npz_that_unpacks_to_gigabytes_is_refused(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "bomb.npz", "w", zipfile.ZIP_DEFLATED) as bomb:
        with bomb.open("time.npy", "w", force_zip64=True) as part:
            header = {"descr": "<f8", "fortran_order": False, "shape": (625_000_000,)}
            np.lib.format.write_array_header_1_0(part, header)
            for _ in range(5):
                part.write(bytes(1_000_000))
        bomb.getinfo("time.npy").file_size = 5_000_000_000
    with pytest.raises(InputError, match=r"bomb\.npz: 1 arrays of 5000 MB are more"):
        read_clip(tmp_path / "bomb.npz")


@pytest.mark.parametrize(
    "shape", [(5, 4), (10**9,), (10**15,), (2**40, 2**40), (-5, 3)]
)
def test_an_array_that_claims_to_be_larger_than_its_file_is_refused(
    tmp_path: Path, shape: tuple[int, ...]
) -> None:
    file, path = io.BytesIO(), tmp_path / "clip.npz"
    header = {"descr": "<f8", "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(file, header)
    file.write(bytes(5 * 3 * 8))
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("time.npy", file.getvalue())
    with pytest.raises(InputError, match=r"clip\.npz: cannot be read as npz"):
        npz.read_arrays(path)


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("prop:0:kinds", np.array(["box", "cone"]), "unknown kind of shape 'cone'"),
        ("prop:0:kinds", np.array(["box", "mesh"]), "a mesh has no points"),
        ("prop:0:positions", np.zeros((5, 2)), "a prop: positions"),
        ("prop:1:positions", np.zeros((4, 3)), "a prop: rotations"),
        ("prop:0:1:size", np.zeros(2), "a prop: size"),
    ],
)
def test_an_npz_with_impossible_props_is_refused(
    make_clip: MakeClip,
    furnish: Callable[[Clip], Clip],
    tmp_path: Path,
    name: str,
    value: object,
    words: str,
) -> None:
    write_clip(furnish(make_clip(5)), tmp_path / "clip.npz")
    with np.load(tmp_path / "clip.npz") as archive:
        assert name in archive
        np.savez(tmp_path / "odd.npz", **{**archive, name: value})
    with pytest.raises(InputError, match=rf"odd\.npz: .*{words}"):
        read_clip(tmp_path / "odd.npz")


def test_bone_lengths_in_csv_vary_less_than_one_in_ten_million(
    make_clip: MakeClip, tmp_path: Path
) -> None:
    for skeleton in (KINECT_V1, KINECT_V2):
        clip = make_clip(300, skeleton)
        write_clip(clip, tmp_path / "clip.csv")
        positions = read_take(tmp_path / "clip.csv").positions
        bones = positions[:, skeleton.segments] - positions[:, skeleton.segment_parents]
        lengths = np.linalg.norm(bones, axis=-1)
        assert (lengths.std(axis=0) / lengths.mean(axis=0)).max() < 1e-7


# Writing


@pytest.mark.parametrize("extension", [*EXTENSIONS, ".USDA", ".NPZ", ".Bvh"])
def test_the_same_clip_gives_the_same_bytes_and_one_file(
    make_clip: MakeClip,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    extension: str,
) -> None:
    found = []
    for name, zone in (("a", "UTC0"), ("b", "XXX11")):
        (tmp_path / name).mkdir()
        monkeypatch.setenv("TZ", zone)
        time.tzset()
        path = tmp_path / name / f"{name}{extension}"
        write_clip(make_clip(5), path)
        assert names_in(tmp_path / name) == [path.name]
        found.append(path.read_bytes())
    monkeypatch.undo()
    time.tzset()
    assert found[0] == found[1]


@pytest.mark.parametrize("extension", EXTENSIONS)
def test_a_failed_write_leaves_the_older_file_and_nothing_else(
    make_clip: MakeClip,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    extension: str,
) -> None:
    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    old = write_text(tmp_path / f"clip{extension}", "older")
    monkeypatch.setattr(os, "fsync", full)
    for name in ("clip", "new"):
        path = tmp_path / f"{name}{extension}"
        with pytest.raises(InputError, match="No space left"):
            write_clip(make_clip(3), path)
    assert names_in(tmp_path) == [old.name]
    assert old.read_text() == "older"


def test_an_interrupted_block_leaves_no_file(tmp_path: Path) -> None:
    def write_half() -> None:
        with atomic_path(tmp_path / "a.usda") as temporary:
            assert temporary.suffix == ".usda"
            temporary.write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_half()
    assert names_in(tmp_path) == []


def test_an_impossible_target_is_refused_early_and_late_alike(
    make_clip: MakeClip, tmp_path: Path
) -> None:
    (tmp_path / "folder.csv").mkdir()
    (tmp_path / "file").touch()
    for name, words in {
        "clip.abc": r"'\.abc'.*\.usda, .*, \.glb, \.vrma, \.fbx, \.bvh, \.csv, \.npz",
        "clip": "unknown extension ''",
        "file/none/clip.csv": "file is a file; choose a folder",
        "folder.csv": "is a folder",
        "file/clip.csv": "file is a file; choose a folder",
    }.items():
        with pytest.raises(InputError, match=words):
            check_writable(tmp_path / name)
        with pytest.raises(InputError, match=words):
            write_clip(make_clip(2), tmp_path / name)
    assert names_in(tmp_path) == ["file", "folder.csv"]
    write_clip(make_clip(2), tmp_path / "new" / "one" / "clip.bvh")
    assert names_in(tmp_path / "new" / "one") == ["clip.bvh"]


def test_a_url_is_not_a_folder_to_create() -> None:
    with pytest.raises(InputError, match="only batch takes URLs"):
        check_folder("s3://bucket/clip.bvh")
    with pytest.raises(InputError, match="only batch takes URLs"):
        check_file("s3://bucket/take.csv")


def test_a_folder_without_rights_is_called_so(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def forbidden(path: Path) -> bool:
        raise PermissionError(errno.EACCES, "Permission denied", str(path))

    monkeypatch.setattr(Path, "is_dir", forbidden)
    with pytest.raises(InputError, match=r"^private/clip.bvh: .*Permission denied"):
        check_folder("private/clip.bvh")
    assert main(["view", "private/clip.npz"]) == 2
    assert "kinefilter: private/clip.npz: cannot" in capsys.readouterr().err


def test_npz_that_holds_no_clip_is_refused(make_clip: MakeClip, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_clip(tmp_path / "none.npz")
    with pytest.raises(InputError, match="cannot be read as npz"):
        read_clip(write_text(tmp_path / "text.npz", "text"))
    np.savez(tmp_path / "other.npz", time=np.arange(3))
    with pytest.raises(InputError, match="not a kinefilter clip"):
        read_clip(tmp_path / "other.npz")
    np.save(tmp_path / "array.npy", np.arange(3))
    (tmp_path / "array.npy").rename(tmp_path / "array.npz")
    with pytest.raises(InputError, match="cannot be read as npz"):
        read_clip(tmp_path / "array.npz")
    write_clip(make_clip(2), tmp_path / "clip.npz")
    with np.load(tmp_path / "clip.npz") as archive:
        np.savez(tmp_path / "alien.npz", **{**archive, "skeleton": "octopus"})
    with pytest.raises(InputError, match=r"alien\.npz.*'octopus'"):
        read_clip(tmp_path / "alien.npz")
    whole = (tmp_path / "clip.npz").read_bytes()
    (tmp_path / "clip.npz").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match="cannot be read as npz"):
        read_clip(tmp_path / "clip.npz")


def test_importing_the_pipeline_loads_nothing_heavy() -> None:
    code = (
        "import sys, kinefilter.pipeline.contents\n"
        "heavy = ('pxr', 'OpenGL', 'matplotlib', 'plotly', 'av', 'viser', 'dask', "
        "'mujoco')\n"
        "print([m for m in heavy if m in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"


def test_all_names_are_sorted_and_there() -> None:
    assert list(formats.__all__) == sorted(formats.__all__)
    for name in formats.__all__:
        assert hasattr(formats, name)
