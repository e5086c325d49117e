"""Every example runs, on what comes with kinefilter, and does what it says."""

from __future__ import annotations

import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from batch_takes import short_take

from kinefilter import read_clip, read_take
from kinefilter.pipeline.formats import read_bvh, write_take_csv
from kinefilter.pipeline.lab.simulation import simulate, write_pairs

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "scenes" / "examples"


def run(name: str, *arguments: object) -> str:
    command = [sys.executable, str(EXAMPLES / name), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def take(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("takes") / "short.csv"
    write_take_csv(short_take(90), path)
    return path


def test_a_folder_is_cleaned_and_a_broken_take_stops_nothing(
    take: Path, tmp_path: Path
) -> None:
    takes, clips = tmp_path / "takes", tmp_path / "clips"
    takes.mkdir()
    shutil.copy(take, takes / "b.csv")
    (takes / "a.csv").write_text("no take\n")
    told = run("clean_folder.py", takes, clips)
    assert "a.csv" in told
    assert "b.csv: jitter" in told
    assert [path.name for path in clips.iterdir()] == ["b.usdc"]


def test_a_character_follows_and_is_pushed(take: Path) -> None:
    lines = run("follow_and_push.py", take).splitlines()
    assert len(lines) == 90
    ahead = [float(line.split("[")[1].rstrip("] m").split()[2]) for line in lines]
    # The push lets the chest lag behind or run ahead of where it was.
    assert np.ptp(ahead[62:75]) > np.ptp(ahead[45:58])


def test_methods_are_compared_on_pairs(tmp_path: Path) -> None:
    pair = simulate("basic", "wave", sensor="v1", seed=4)
    brief = replace(pair, take=pair.take.at(slice(45)), truth=pair.truth[:45])
    write_pairs([brief], tmp_path / "p.npz")
    told = run("compare_methods.py", tmp_path / "p.npz", "none", "local-pca")
    assert [line.split(":")[0] for line in told.splitlines()] == [
        "raw",
        "none",
        "local-pca",
    ]


def test_a_clip_is_written_on_a_rig_of_ones_own(take: Path, tmp_path: Path) -> None:
    run("own_rig.py", take, tmp_path / "clip.bvh")
    names = read_bvh(tmp_path / "clip.bvh").names
    assert {"Root", "Chest", "Skull", "LHand", "RFoot"} <= set(names)


def test_a_method_of_ones_own_corrects(take: Path, tmp_path: Path) -> None:
    run("own_corrector.py", take, tmp_path / "clip.npz")
    clip, raw = read_clip(tmp_path / "clip.npz"), read_take(take)
    assert len(clip) == len(raw)
    assert np.isfinite(clip.positions).all()


@pytest.mark.parametrize(
    "path", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.name
)
def test_an_example_without_arguments_prints_its_usage(path: Path) -> None:
    usage = path.read_text(encoding="utf-8").split("    python ")[1].split("\n")[0]
    command = [sys.executable, str(path)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr.startswith(f"usage: {usage}\n")


@pytest.mark.parametrize("name", ["own_rig.py", "own_corrector.py"])
def test_an_example_refuses_what_it_cannot_write_in_one_line(
    take: Path, tmp_path: Path, name: str
) -> None:
    command = [sys.executable, EXAMPLES / name, take, tmp_path / "rig.foo"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
    assert "unknown extension '.foo'" in done.stderr


def test_there_are_no_examples_that_are_not_run() -> None:
    tested = Path(__file__).read_text(encoding="utf-8")
    for path in EXAMPLES.glob("*.py"):
        assert f'"{path.name}"' in tested
