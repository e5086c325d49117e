"""The motion database: its postures and its files."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from skeletons import every_skeleton

from kinefilter import PostureDatabase
from kinefilter.characters import KINECT_V1, InputError, Skeleton
from kinefilter.pipeline.database import builtin_database


def made_up(count: int = 60, skeleton: Skeleton = KINECT_V1) -> PostureDatabase:
    rng = np.random.default_rng(0)
    positions = rng.normal(0.0, 0.3, (count, len(skeleton), 3))
    return PostureDatabase(
        positions.astype(np.float32).astype(float),
        np.array([f"m{k % 3}" for k in range(count)]),
        skeleton,
    )


# Neighbors


def test_neighbors_are_no_more_than_there_are_and_never_nearer_than_zero() -> None:
    base = made_up(5)
    for posture in base.positions:
        nearest, distances = base.neighbors(posture, np.ones(20), 30)
        assert sorted(nearest.tolist()) == [0, 1, 2, 3, 4]
        assert (distances >= 0.0).all()
        assert (np.diff(distances) >= 0.0).all()


def test_spacing_is_the_root_mean_square_distance_to_the_nearest_other() -> None:
    base = made_up()
    flat = base.positions.reshape(60, -1)
    pairs = np.sum((flat[:, None] - flat[None]) ** 2, axis=-1)
    np.fill_diagonal(pairs, np.inf)
    expected = np.median(np.sqrt(pairs.min(axis=1) / 20))
    assert base.spacing == pytest.approx(float(expected))
    words = f"60 postures of 3 motions, kinect_v1, {100 * expected:.1f} cm apart"
    assert base.summary == words
    one = replace(base, labels=np.full_like(base.labels, base.labels[0]))
    assert one.summary.startswith("60 postures of 1 motion, ")


# Files


def test_saving_and_loading_keeps_everything_without_pickle(tmp_path: Path) -> None:
    base, path = made_up(), tmp_path / "base.npz"
    base.save(path)
    with np.load(path, allow_pickle=False) as file:
        assert all(file[key].dtype != object for key in file.files)
    again = PostureDatabase.load(path)
    for name in ("positions", "labels"):
        np.testing.assert_array_equal(getattr(again, name), getattr(base, name))
    assert again.skeleton is base.skeleton
    assert str(path) in again.source
    assert [p.name for p in tmp_path.iterdir()] == ["base.npz"]


def test_saving_twice_gives_the_same_bytes(tmp_path: Path) -> None:
    made_up().save(tmp_path / "a.npz")
    PostureDatabase.load(tmp_path / "a.npz").save(tmp_path / "b.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


@every_skeleton
def test_a_stored_spacing_is_the_measured_one(
    tmp_path: Path, skeleton: Skeleton
) -> None:
    shipped = builtin_database(skeleton)
    assert "spacing" in vars(shipped)  # so that clean need not measure it
    again = replace(shipped)
    assert "spacing" not in vars(again)
    assert again.spacing == pytest.approx(shipped.spacing, rel=1e-12)
    turns = np.zeros((60, 20, 4))  # older files have rotations, and no spacing
    np.savez(tmp_path / "old.npz", rotations=turns, **parts_of(made_up()))
    old = PostureDatabase.load(tmp_path / "old.npz")
    assert old.spacing == made_up().spacing


def parts_of(base: PostureDatabase) -> dict[str, Any]:
    return {
        "positions": base.positions,
        "labels": base.labels,
        "skeleton": np.array(base.skeleton.name),
    }


def broken_files() -> Iterator[tuple[str, bytes]]:
    """Yield what may lie where a database should, each under a name."""
    parts = parts_of(made_up(4))

    def npz(**changes: Any) -> bytes:
        buffer = io.BytesIO()
        arrays = {k: v for k, v in {**parts, **changes}.items() if v is not None}
        np.savez(buffer, **arrays)
        return buffer.getvalue()

    yield "empty", b""
    yield "text", b"time,Head.x\n"
    yield "cut off", npz()[:900]
    for name in parts:
        yield f"without {name}", npz(**{name: None})
    positions = parts["positions"]
    yield "positions of other joints", npz(positions=positions[:, :-1])
    yield "fewer positions", npz(positions=positions[:-1])
    yield "flat positions", npz(positions=positions.ravel())
    holes = positions.copy()
    holes[1, 2, 0] = np.nan
    yield "positions with NaN", npz(positions=holes)
    yield "other skeleton", npz(skeleton=np.array("kinect_v2"))
    yield (
        "one posture",
        npz(**{k: parts[k][:1] for k in ("positions", "labels")}),
    )
    yield "a negative spacing", npz(spacing=np.array(-0.05))
    yield "many spacings", npz(spacing=np.array([0.05, 0.06]))
    yield "pickled labels", npz(labels=np.array([{}] * 4, dtype=object))
    yield "pickled positions", npz(positions=parts["positions"].astype(object))


@pytest.mark.parametrize("content", [pytest.param(c, id=n) for n, c in broken_files()])
def test_a_broken_database_is_refused_naming_the_file(
    tmp_path: Path, content: bytes
) -> None:
    path = tmp_path / "bad.npz"
    path.write_bytes(content)
    with pytest.raises(InputError, match=re.escape(str(path))) as caught:
        PostureDatabase.load(path)
    assert "database build" in str(caught.value)


def test_a_missing_database_says_how_to_make_one(tmp_path: Path) -> None:
    for path in (tmp_path / "none.npz", tmp_path):
        with pytest.raises(InputError, match=r"no such database.*database build"):
            PostureDatabase.load(path)


def test_an_unknown_skeleton_is_refused(tmp_path: Path) -> None:
    parts = parts_of(made_up(4))
    np.savez(tmp_path / "a.npz", **{**parts, "skeleton": np.array("octopus")})
    with pytest.raises(InputError, match="octopus"):
        PostureDatabase.load(tmp_path / "a.npz")
