"""The studies of the papers: what they measure, write and refuse."""

from __future__ import annotations

import csv
import inspect
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from kinefilter.characters import KINECT_V1, SKELETONS, InputError, standard_body
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.lab.simulation import simulate
from kinefilter.pipeline.lab.studies import STUDIES, Study, reproduce, shum
from kinefilter.pipeline.lab.studies import study as output
from kinefilter.pipeline.lab.studies.shum import bone_errors
from kinefilter.pipeline.lab.studies.study import Options, Panel, Series
from kinefilter.pipeline.lab.studies.study_takes import (
    CLASSES,
    first_person,
    study_takes,
)
from kinefilter.scenes import load_scene
from kinefilter.scenes.library import perform, prop_poses, random_body

POSTURE = standard_body(KINECT_V1).rest_positions
SMALL = Study(
    title="Made up",
    columns=("what", "cm", "paper_cm"),
    rows=(("one", 1.25, None), ("two", 3, 4.5)),
    panels=(
        Panel("what", "cm", (Series("ours", ["one", "two"], [1.25, 3.0], "bars"),)),
        Panel("n", "cm", (Series("n", [1.0, 2.0], [3.0, 4.0]),), log_x=True),
        Panel("n", "cm", (Series("paper", (), [2.0], "level"),)),
    ),
    across=2,
)


def test_eq_18_counts_each_part_from_its_parent() -> None:
    moved = np.stack([POSTURE, POSTURE])
    truth = moved + np.array([0.0, 1.0, -2.0])
    assert bone_errors(moved, truth, KINECT_V1).max() < 1e-12
    moved[1, KINECT_V1.index("HandLeft")] += [0.0, 0.06, 0.08]
    moved[1, KINECT_V1.index("KneeRight")] += [0.3, 0.0, 0.0]
    # The hand moves one segment, the knee the thigh and the shank: of 2 x 19.
    expected = (0.1 + 2 * 0.3) / 38
    found = bone_errors(moved, truth, KINECT_V1).mean()
    assert found == pytest.approx(expected)


def test_a_missing_joint_costs_its_segments_alone() -> None:
    moved = POSTURE[None].copy()
    moved[0, KINECT_V1.index("ElbowLeft")] = np.nan
    errors = bone_errors(moved, POSTURE[None] * 1.1, KINECT_V1)
    assert np.isnan(errors).sum() == 2
    same = bone_errors(moved, POSTURE[None], KINECT_V1)
    assert np.nanmax(same) == 0.0


@pytest.fixture
def few_postures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let table III of Shum reconstruct every eighth posture of a motion."""
    whole = shum._standard_postures
    monkeypatch.setattr(shum, "_standard_postures", lambda *who: whole(*who)[::8])


@pytest.mark.usefixtures("few_postures")
def test_postures_come_nearer_the_more_joints_are_given() -> None:
    study = reproduce("shum-table-3", Options(), quick=True)
    foot_and_hand, hands, ends, middles, whole = (row[1] for row in study.rows)
    assert foot_and_hand > ends
    assert hands > ends > middles > whole > 0.0
    assert study.rows[-1][2] == 0.0  # reliable joints stay where they are
    assert [row[3] for row in study.rows] == [6.38, 5.60, 4.52, 4.15, 3.90]


def test_more_sampling_lowers_the_energy_and_the_solver_is_below_all(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(shum, "_FRAMES", 15)
    fewer = {"postures": (500, (50, 500)), "neighbors": (30, (30,))}
    fewer |= {name: shum._PARAMETERS[name] for name in ("steps", "samples")}
    fewer["dimensions"] = (20, (20,))
    monkeypatch.setattr(shum, "_PARAMETERS", fewer)
    study = reproduce("shum-figure-8", Options(), quick=True)
    for parameter in ("steps", "samples"):
        rows = [row for row in study.rows if row[0] == parameter]
        sampled = [row[3] for row in rows if row[2] == "stochastic"]
        solved = [row[3] for row in rows if row[2] == "solver"]
        assert len(sampled) == 2
        assert sampled[0] > sampled[1] > solved[0] == solved[1]


def test_what_was_recorded_is_wrong_and_the_truth_is_not() -> None:
    (pair,) = study_takes("a", Options(), count=1)
    raw = bone_errors(pair.take.positions, pair.truth, pair.take.skeleton)
    assert 0.02 < np.nanmean(raw) < 0.2
    assert not bone_errors(pair.truth, pair.truth, pair.take.skeleton).any()


def test_nobody_of_a_study_taught_the_database_or_another_class() -> None:
    from kinefilter.pipeline.lab import database_build

    seen = [
        int(pair.clip[-4:])
        for kind in CLASSES
        for pair in study_takes(kind, Options(), count=2 if kind == "a" else 1)
    ]
    assert len(set(seen)) == len(seen)
    assert min(seen) >= database_build._PEOPLE
    assert max(seen) < first_person(0, learners=True) < first_person(1)


def test_in_class_b_things_hide_the_body_and_nobody_moves_them() -> None:
    first = first_person(0) + len(CLASSES["a"])
    for k, (scene, motion, sensor) in enumerate(CLASSES["b"]):
        skeleton = SKELETONS[f"kinect_{sensor}"]
        body = random_body(skeleton, np.random.default_rng(first + k))
        poses = prop_poses(load_scene(scene), perform(motion, body, seed=first + k))
        for pose in poses.values():
            np.testing.assert_array_equal(pose, np.broadcast_to(pose[0], pose.shape))
    for k, pair in zip((0, 4, 8), study_takes("b", Options(), count=3), strict=True):
        _, motion, sensor = CLASSES["b"][k]
        bare = simulate("basic", motion, sensor=sensor, seed=first + k)
        np.testing.assert_array_equal(pair.truth[:9], bare.truth[:9])
        assert (pair.take.state == 2).mean() < (bare.take.state == 2).mean() - 0.03


def test_quick_studies_take_less_of_what_there_is() -> None:
    for name, (run, quick) in STUDIES.items():
        defaults = inspect.signature(run).parameters
        assert quick, name
        for parameter, size in quick.items():
            assert 0 < size < defaults[parameter].default, name


def test_a_study_becomes_a_table_and_a_plot(tmp_path: Path) -> None:
    table, plot = output.write_study("small", SMALL, tmp_path / "new")
    with table.open(encoding="utf-8", newline="") as file:
        rows = list(csv.reader(file))
    assert rows == [[*SMALL.columns], ["one", "1.25", ""], ["two", "3", "4.5"]]
    assert plot.read_bytes().startswith(b"\x89PNG\r\n\x1a\n")
    assert sorted(p.name for p in table.parent.iterdir()) == ["small.csv", "small.png"]


def test_an_interrupted_study_leaves_what_was_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(_: Study, path: Path) -> None:
        path.write_bytes(b"half")
        raise KeyboardInterrupt

    (tmp_path / "small.csv").write_text("old", encoding="utf-8")
    monkeypatch.setattr(output, "draw", interrupted)
    with pytest.raises(KeyboardInterrupt):
        output.write_study("small", SMALL, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["small.csv"]
    assert (tmp_path / "small.csv").read_text(encoding="utf-8") == "old"


@pytest.mark.parametrize("name", ["shum-table-9", "Reliability"])
def test_an_unknown_study_is_refused_before_anything_is_made(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "studies"
    assert main(["reproduce", "reliability", name, "-o", str(out)]) == 2
    error = capsys.readouterr().err
    assert name in error
    assert "shum-table-3" in error
    assert not out.exists()


def test_without_matplotlib_nothing_is_computed(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def missing(_: str) -> None:
        return None

    monkeypatch.setattr("importlib.util.find_spec", missing)
    monkeypatch.setitem(STUDIES, "reliability", pytest.fail)
    assert main(["reproduce", "reliability", "-o", str(tmp_path / "s")]) == 2
    assert 'pip install "kinefilter[reproduce]"' in capsys.readouterr().err
    with pytest.raises(InputError, match="matplotlib"):
        output.write_study("small", SMALL, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("", encoding="utf-8")
    for out in ("file", "file/studies"):
        assert main(["reproduce", "reliability", "-o", str(tmp_path / out)]) == 2
        assert out.partition("/")[0] in capsys.readouterr().err


@pytest.mark.usefixtures("few_postures")
def test_the_command_writes_and_prints_the_table(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["reproduce", "shum-table-3", "--quick", "-o", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    with (tmp_path / "shum-table-3.csv").open(encoding="utf-8", newline="") as file:
        names, *rows = csv.reader(file)
    assert names[0] == "joints_given"
    assert len(rows) == 5
    assert all(row[0] in printed for row in rows)
    assert (tmp_path / "shum-table-3.png").is_file()


def test_help_loads_nothing_heavy() -> None:
    code = (
        "import sys; from kinefilter.pipeline.cli import main\n"
        "try: main(['--help'])\n"
        "except SystemExit: pass\n"
        "heavy = ('pxr', 'mujoco', 'scipy', 'sklearn', 'matplotlib', 'av', 'OpenGL')\n"
        "sys.exit(str([m for m in heavy if m in sys.modules] or ''))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert "reproduce" in done.stdout
    assert done.stderr.strip() == ""
