"""Databases and models from more than memory holds: in parts, with the same result."""

from __future__ import annotations

import io
import tracemalloc
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kinefilter.characters import KINECT_V1, InputError, Take
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.lab import spool
from kinefilter.pipeline.lab.database_build import database_from_pairs
from kinefilter.pipeline.lab.methods import training_data as module
from kinefilter.pipeline.lab.methods.fourier_ridge_learner import FourierRidgeLearner
from kinefilter.pipeline.lab.methods.training_data import TrainingFrames, TrainingSet
from kinefilter.pipeline.lab.simulation import simulate, write_pairs
from kinefilter.pipeline.lab.spool import Spool
from kinefilter.pipeline.lab.training import training_set
from kinefilter.pipeline.pairs import PairedTake


@pytest.fixture(scope="module")
def pairs() -> list[PairedTake]:
    motions = ("squat", "wave", "punch")
    return [simulate("basic", m, sensor="v1", seed=k) for k, m in enumerate(motions)]


def in_memory(lessons: TrainingSet) -> TrainingSet:
    """The same lessons in plain arrays, as one block."""
    arrays = {k: v for k, v in vars(lessons).items() if isinstance(v, np.ndarray)}
    return replace(lessons, **{k: np.array(v) for k, v in arrays.items()})


def test_a_spool_gives_back_what_was_put_in() -> None:
    kept, rows = Spool(np.float64), np.random.default_rng(0).normal(size=(10, 4, 3))
    for part in (rows[:3], rows[3:3], rows[3:]):
        kept.add(part)
    again = kept.array()
    del kept
    np.testing.assert_array_equal(again, rows)
    with pytest.raises(ValueError, match="read-only"):
        again[0] = 0.0


def test_an_empty_spool_is_an_empty_array() -> None:
    kept = Spool(np.float32)
    kept.add(np.empty((0, 20, 3)))
    assert kept.array().shape == (0, 20, 3)


def test_a_full_disk_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    class Full(io.BytesIO):
        def fileno(self) -> int:
            raise OSError(28, "No space left on device")

    monkeypatch.setattr(spool.tempfile, "TemporaryFile", Full)
    with pytest.raises(InputError, match=r"No space left.*TMPDIR"):
        Spool(np.float64).add(np.zeros((2, 3)))


def test_lessons_are_the_same_from_a_disk_in_blocks_and_in_memory(
    pairs: list[PairedTake], monkeypatch: pytest.MonkeyPatch
) -> None:
    lessons = training_set(iter(pairs))
    whole = TrainingFrames.draw(
        in_memory(lessons), KINECT_V1, 200, 0, least_reliability=0.1
    )
    monkeypatch.setattr(module, "_BLOCK", 37)
    parts = TrainingFrames.draw(lessons, KINECT_V1, 200, 0, least_reliability=0.1)
    for name in ("postures", "offsets", "joints", "measured", "lengths"):
        np.testing.assert_array_equal(getattr(parts, name), getattr(whole, name))


def test_a_model_is_the_same_from_a_disk_in_blocks_and_in_memory(
    pairs: list[PairedTake],
) -> None:
    lessons = training_set(iter(pairs))
    whole = FourierRidgeLearner(KINECT_V1, samples=64).fit(in_memory(lessons)).arrays()
    parts = FourierRidgeLearner(KINECT_V1, samples=64).fit(lessons).arrays()
    for name, array in whole.items():
        np.testing.assert_array_equal(parts[name], array)


def test_of_many_pairs_one_at_a_time_is_in_memory(pairs: list[PairedTake]) -> None:
    count, pair = 40, pairs[0]
    take = pair.take
    few = [array[:60] for array in (take.time, take.positions, take.state)]
    pair = replace(pair, take=Take(*few, take.skeleton), truth=pair.truth[:60])
    whole = count * len(pair.take) * 20 * (3 + 3 + 1 + 1) * 8

    def many() -> Iterator[PairedTake]:
        for k in range(count):
            yield PairedTake(pair.take, pair.truth, f"p{k % 22}", f"clip{k}")

    training_set([pair])  # what is made once is not counted
    tracemalloc.start()
    lessons = training_set(many())
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(lessons) == count * len(pair.take)
    assert lessons.source == f"{count} clips of 22 people"
    assert most < whole / 4


def test_folders_stand_for_the_files_below_them(
    pairs: list[PairedTake], tmp_path: Path
) -> None:
    (tmp_path / "in" / "deep").mkdir(parents=True)
    write_pairs(pairs[:1], tmp_path / "in" / "a.npz")
    write_pairs(pairs[1:2], tmp_path / "in" / "deep" / "b.npz")
    one, two = tmp_path / "one.npz", tmp_path / "two.npz"
    files = [str(tmp_path / "in" / "a.npz"), str(tmp_path / "in" / "deep" / "b.npz")]
    assert main(["database", "build", str(tmp_path / "in"), "-o", str(one)]) == 0
    assert main(["database", "build", *files, "-o", str(two)]) == 0
    assert one.read_bytes() == two.read_bytes()


def test_a_folder_without_any_such_file_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "in").mkdir()
    out = tmp_path / "out.npz"
    for command in (["database", "build"], ["train"]):
        assert main([*command, str(tmp_path / "in"), "-o", str(out)]) == 2
        assert "no " in capsys.readouterr().err
    assert not out.exists()


def test_a_database_does_not_depend_on_how_pairs_arrive(
    pairs: list[PairedTake],
) -> None:
    listed = database_from_pairs(pairs, KINECT_V1, count=100)
    streamed = database_from_pairs(iter(pairs), KINECT_V1, count=100)
    np.testing.assert_array_equal(listed.positions, streamed.positions)
    np.testing.assert_array_equal(listed.labels, streamed.labels)
    assert listed.source == "mocap of person 0, person 1, person 2"
