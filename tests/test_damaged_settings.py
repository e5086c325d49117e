"""Damaged models, databases and rigs, and numbers that mean nothing, are refused."""

from __future__ import annotations

import random
import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mutations import mutated_arrays
from test_bad_values import NO_VALUES, misfits, refused, with_one

import kinefilter
from kinefilter.characters import KINECT_V1, InputError, Take, standard_body
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.database import PostureDatabase
from kinefilter.pipeline.formats import write_take_csv
from kinefilter.pipeline.formats.clips import read_rig_map
from kinefilter.retarget import rig_map

SHIPPED = Path(rig_map.__file__).parents[1] / "pipeline" / "embedded"


def still_take(frames: int = 10) -> Take:
    rest = standard_body(KINECT_V1).rest_positions + np.array([0.0, 0.0, 2.5])
    places = np.tile(rest, (frames, 1, 1))
    states = np.full(places.shape[:2], 2)
    return Take(np.arange(frames) / 30, places, states, KINECT_V1)


@pytest.mark.parametrize("seed", [4, 9, 13, 42])
def test_a_damaged_model_of_the_default_method_is_refused(
    tmp_path: Path, seed: int
) -> None:
    rng, path = random.Random(seed), tmp_path / "model.npz"
    data = (SHIPPED / "learned.npz").read_bytes()
    if rng.random() >= 0.15:  # as those that were found
        data = mutated_arrays(data, rng)
    path.write_bytes(data)
    config = kinefilter.CleanConfig(model=path, physics=False)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            kinefilter.clean(still_take(), config)
        except InputError as error:
            assert str(error).startswith(str(path))  # noqa: PT017 - it may be sound


def test_a_database_of_one_posture_many_times_is_refused(tmp_path: Path) -> None:
    path, v1 = tmp_path / "database.npz", SHIPPED / "kinect_v1_postures.npz"
    with np.load(v1) as file:
        arrays = {key: file[key] for key in file.files}
    for wrong in (np.zeros_like, lambda places: places * 1e9):
        np.savez(path, **{**arrays, "positions": wrong(arrays["positions"])})
        with pytest.raises(InputError, match=r"database\.npz"):
            PostureDatabase.load(path)


@pytest.mark.parametrize(
    "number", ["true", "nan", "inf", "1e400", "9" * 400, "9" * 5000, "[" * 9999]
)
def test_rigs_with_numbers_that_are_none_are_refused(
    tmp_path: Path, number: str
) -> None:
    path = tmp_path / "rig.toml"
    text = (Path(rig_map.__file__).parent / "rigs" / "unity.toml").read_text()
    path.write_text(re.sub(r"offset = \[[^,]*", f"offset = [{number}", text, count=1))
    with pytest.raises(InputError, match=r"rig\.toml") as caught:
        read_rig_map(str(path))
    assert len(str(caught.value)) < 400


@pytest.mark.parametrize(
    "line",
    [
        *(
            "replay {take} --out - --speed 1e-300",
            "simulate box -o {out}.csv --seed=-1",
        ),
        *(
            "reproduce shum-table-3 -o {out} --seed=-1",
            "clean {take} -o {out} --seed=-1",
        ),
        *("evaluate {take} --hide left-arm --gap " + "9" * 400,),
        *("clean {take} -o {out} --model " + "x" * 5000 + ".npz",),
        *("clean {take} -o {out} --database " + "x" * 5000 + ".npz",),
    ],
)
def test_numbers_and_names_that_mean_nothing_end_with_code_2(
    tmp_path: Path, line: str
) -> None:
    take = tmp_path / "take.csv"
    write_take_csv(still_take(), take)
    assert main(line.format(out=tmp_path / "out.bvh", take=take).split()) == 2
    assert [path.name for path in tmp_path.iterdir()] == ["take.csv"]


def test_databases_of_no_postures_are_refused() -> None:
    rng = np.random.default_rng(0)
    given: dict[str, Any] = {
        "positions": rng.normal(size=(4, 20, 3)),
        "labels": np.array(["a", "b", "c", "d"]),
        "skeleton": KINECT_V1,
    }
    array = given["positions"]
    refused(lambda v: PostureDatabase(**given | {"positions": v}), misfits(array))
    wrong = ((str(v), with_one(array, v)) for v in (np.nan, np.inf, 1e300))
    refused(lambda v: PostureDatabase(**given | {"positions": v}), wrong)
    for name in ("labels", "skeleton"):
        values = iter(NO_VALUES.items())
        refused(lambda v, n=name: PostureDatabase(**given | {n: v}), values)
