"""Several people before several sensors: who is who, in one room."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from real_data import DATA
from scipy.spatial.transform import Rotation

from kinefilter import merge, read_take
from kinefilter.characters import KINECT_V2, InputError, Take
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.formats import read_recording, read_takes, write_take_csv
from kinefilter.pipeline.formats.recording import Recording
from kinefilter.pipeline.lab.simulation import simulate_session
from kinefilter.pipeline.merge.rigid import Placement, placement
from kinefilter.scenes.sensor import in_sensor_frame

Array = NDArray[np.float64]


@cache
def session() -> tuple[tuple[Take, Take], tuple[Take, Take]]:
    """Return what each of two sensors saw of one who walks, and of a taller one.

    The taller one is the first, as in a film that runs backwards, two meters aside.
    """
    views = simulate_session("basic", "walk", sensors=("v2", "v2"), seed=3)
    points = np.random.default_rng(0).normal(size=(30, 3))
    here, there = (in_sensor_frame(points, view.sensor) for view in views)
    back = placement(here, there)
    places = Placement(Rotation.identity(), np.zeros(3)), placement(there, here)
    returns = Placement(Rotation.identity(), np.zeros(3)), back
    found = []
    for k, (view, placed, undone) in enumerate(
        zip(views, places, returns, strict=True)
    ):
        source = f"sensor{k + 1}.csv, body "
        take = replace(view.pair.take, source=f"{source}1")
        joints = placed.apply(take.positions[::-1].copy())
        root = joints[:, [KINECT_V2.root]]
        joints = root + 1.12 * (joints - root) + np.array([2.0, 0.0, 0.3])
        joints, state = undone.apply(joints), take.state[::-1]
        found.append((take, Take(take.time, joints, state, KINECT_V2, f"{source}2")))
    return found[0], found[1]


def exchanged(one: Take, other: Take, begin: int, end: int) -> tuple[Take, Take]:
    """Return takes of a tracker that takes two for each other in some frames."""
    mixed = []
    for a, b in ((one, other), (other, one)):
        positions, state = a.positions.copy(), a.state.copy()
        positions[begin:end], state[begin:end] = (
            b.positions[begin:end],
            b.state[begin:end],
        )
        mixed.append(replace(a, positions=positions, state=state))
    return mixed[0], mixed[1]


def root_of(take: Take) -> Array:
    return take.positions[:, KINECT_V2.root]


def apart(one: Take, other: Take) -> float:
    """Return how far the roots of takes are apart at most [m]."""
    known = ~np.isnan(root_of(other)[:, 0])
    there = np.stack(
        [np.interp(one.time, other.time[known], x) for x in root_of(other)[known].T], 1
    )
    away = np.linalg.norm(root_of(one) - there, axis=1)
    assert np.isnan(away).mean() < 0.05
    return float(np.nanmax(away))


@pytest.mark.parametrize("body", [1, 2])
def test_who_is_exchanged_by_one_sensor_is_put_right_by_the_other(body: int) -> None:
    first, second = session()
    mixed = exchanged(*second, 60, len(second[0]))
    made = merge([Recording(first, "a"), Recording(mixed, "b")], body=body)
    alone = merge([first[body - 1], second[body - 1]])
    assert apart(made.take, alone.take) < 0.15
    assert np.nanmax(made.residuals[:, :, KINECT_V2.root]) < 0.3
    assert any("are the same person" in note for note in made.all_notes())


def test_a_sensor_that_does_not_see_the_person_is_left_out() -> None:
    first, second = session()
    made = merge([Recording(first, "a"), Recording(second[:1], "b")], body=2)
    assert made.sources == ("sensor1.csv, body 2",)
    assert apart(made.take, first[1]) < 0.05
    assert "sensor2.csv: does not show this person, and is left out" in list(
        made.all_notes()
    )


def test_commands_merge_and_clean_the_person_asked_for(tmp_path: Path) -> None:
    paths = []
    for k, (one, other) in enumerate(session()):
        both = Take(
            np.repeat(one.time, 2),
            np.stack([one.positions, other.positions], axis=1).reshape(-1, 25, 3),
            np.stack([one.state, other.state], axis=1).reshape(-1, 25),
            KINECT_V2,
        )
        paths.append(str(tmp_path / f"sensor{k}.csv"))
        write_take_csv(both, paths[-1])
    places = [root_of(take) for take in read_takes(paths[0])]
    clip, quick = str(tmp_path / "clip.npz"), ["--method", "none", "--no-physics"]
    assert main(["clean", *quick, *paths, "-o", clip, "--body", "2"]) == 0
    for body in ("1", "2"):
        out = tmp_path / f"{body}.csv"
        assert main(["merge", *paths, "-o", str(out), "--body", body]) == 0
        found = np.nanmedian(root_of(read_take(out)), axis=0)
        away = [np.linalg.norm(np.nanmedian(p, axis=0) - found) for p in places]
        assert int(np.argmin(away)) == int(body) - 1
        assert min(away) < 0.1


@pytest.mark.skipif(not DATA.is_dir(), reason="needs the recordings")
def test_recorded_person_whom_another_passes_keeps_the_identity() -> None:
    """Both sensors' files hold both people; one of them walks in front of the other."""
    folder = DATA / "two-kinects"
    first, second = (
        read_recording(next(folder.glob(f"p26_45deg_meet2_{sensor}*.csv.gz")))
        for sensor in "BA"
    )
    assert len(first.takes) == len(second.takes) == 2
    made = merge([first, second])
    away = made.residuals[:, :, KINECT_V2.root]
    assert np.nanmean(away > 0.4) < 0.01
    with pytest.raises(InputError, match="no body 3"):
        merge([first, second], body=3)
