"""One motion seen by two sensors, and how near they are to each other."""

from __future__ import annotations

import json
import shutil
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from real_data import DATA, recorded

from kinefilter.characters import KINECT_V2, Take, standard_body
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.formats import write_take_csv
from kinefilter.pipeline.lab import training, two_views
from kinefilter.pipeline.lab.methods.fourier_ridge_learner import FourierRidgeLearner
from kinefilter.pipeline.lab.view_sessions import LIMBS, find_sessions
from kinefilter.pipeline.workers import workers
from kinefilter.retarget import HeadingFrame
from kinefilter.scenes.library import perform

DELAY = 33_000.25  # s between the sensors' clocks


def _write(
    folder: Path,
    name: str,
    positions: NDArray[np.float64],
    time: NDArray[np.float64],
) -> str:
    state = np.full(positions.shape[:2], 2, dtype=np.uint8)
    write_take_csv(Take(time, positions, state, KINECT_V2), folder / f"{name}.csv")
    return str(folder / f"{name}.csv")


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Return the arguments for a gesture before one sensor and beside another."""
    folder = tmp_path_factory.mktemp("views")
    act = perform("wave", standard_body(KINECT_V2), seed=1).at(slice(0, 120))
    time, count = act.time, len(act.time)
    toward = HeadingFrame(np.tile([0.0, -1.0, 2.4], (count, 1)), np.full(count, np.pi))
    beside = HeadingFrame(np.tile([0.3, -0.8, 2.0], (count, 1)), toward.yaw / 2)
    front, side = (frame.restore(act.positions) for frame in (toward, beside))
    files = [
        _write(folder, "a", side, time + DELAY),
        _write(folder, "b", front, time),
    ]
    ticks = np.stack([time * 1000, time + DELAY, time], axis=1)
    rows = "\n".join(",".join(f"{v:.6f}" for v in row) for row in ticks)
    (folder / "x_90deg_wave.sync.csv").write_text(f"milliseconds,A,B\n{rows}\n")
    return [*files, "--sync", str(folder / "x_90deg_wave.sync.csv")]


def test_two_views_of_one_motion_agree(session: list[str], tmp_path: Path) -> None:
    out = tmp_path / "views.json"
    arguments = ["--methods", "none", "--no-physics", "--json", str(out)]
    assert main(["evaluate", "--views", *session, *arguments]) == 0
    (found,) = json.loads(out.read_text("utf-8"))["sessions"]
    assert found["side"] == "A"
    assert found["angle"] == "90deg"
    for limb in LIMBS:
        assert found["rows"]["raw"][limb]["all"] < 0.5
        assert found["rows"]["none"][limb]["all"] < 2.0
    assert found["rows"]["raw"]["trunk"]["all"] is None  # who stands has no heading


@recorded
def test_a_trunk_beside_the_sensor_turns_as_the_sensor_in_front_sees_it() -> None:
    """The one beside it shows it turned toward itself."""
    sessions = find_sessions([DATA / "two-kinects" / "p10_90deg_steps"], None)
    methods = ["none", "default"]
    (found,) = two_views.compare_views(sessions, methods, physics=False)["sessions"]
    none, default = (found["rows"][method]["trunk"]["all"] for method in methods)
    assert default < 0.5 * none


def test_learned_has_not_learned_from_the_person_that_it_is_told_on(
    session: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two people beside a sensor, and somebody with markers."""
    monkeypatch.setattr(training, "_SIMULATED", 0)
    monkeypatch.setattr(two_views, "workers", partial(workers, 1))
    for person in ("ann", "bob"):
        name = f"{person}_90deg_wave"
        for file, end in zip((*session[:2], session[3]), ("_A", "_B", ""), strict=True):
            kind = ".csv" if end else ".sync.csv"
            shutil.copy(file, tmp_path / f"{name}{end}{kind}")
    marked, out = tmp_path / "marked.npz", tmp_path / "views.json"
    made = ["--motion", "wave", "--sensor", "v1", "-o", str(tmp_path / "take.csv")]
    assert main(["simulate", "basic", *made, "--pairs", str(marked)]) == 0
    taught, fit = [], FourierRidgeLearner.fit

    def noted(
        model: FourierRidgeLearner, *args: Any, **options: Any
    ) -> FourierRidgeLearner:
        taught.append(options["views"].people)
        return fit(model, *args, **options)

    monkeypatch.setattr(FourierRidgeLearner, "fit", noted)
    options = ["--train", str(marked), "--methods", "learned", "--no-physics"]
    views = ["--views", str(tmp_path), *options, "--json", str(out)]
    assert main(["evaluate", *views]) == 0
    assert taught == [("bob",), ("ann",)]
    for found in json.loads(out.read_text("utf-8"))["sessions"]:
        for limb in LIMBS:
            assert found["rows"]["learned"][limb]["all"] < 3.0


def test_views_that_are_read_at_different_times_do_not_agree(
    session: list[str], tmp_path: Path
) -> None:
    lines = Path(session[3]).read_text("utf-8").splitlines()
    cells = [line.split(",") for line in lines[1:]]
    late = zip(cells[15:], cells[:-15], strict=True)
    wrong = [f"{b[0]},{a[1]},{b[2]}" for a, b in late]
    sync, out = tmp_path / "late_90deg_wave.sync.csv", tmp_path / "views.json"
    sync.write_text("\n".join([lines[0], *wrong]))
    arguments = ["--sync", str(sync), "--methods", "none", "--json", str(out)]
    assert main(["evaluate", "--views", *session[:2], *arguments]) == 0
    (found,) = json.loads(out.read_text("utf-8"))["sessions"]
    assert max(found["rows"]["raw"][limb]["all"] for limb in LIMBS) > 3.0


def test_sessions_that_are_none_are_refused(
    session: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = tmp_path / "other.sync.csv"
    other.write_text("milliseconds,A,B\n0,1,2\n30,1,2\n")
    text = tmp_path / "text.sync.csv"
    text.write_text("hello")
    for arguments, message in (
        ([str(tmp_path / "nothing")], "no session"),
        ([str(other)], "no takes other_A"),
        ([session[0], "--sync", session[3]], "--sync is for two takes"),
        ([*session[:2], "--sync", str(other)], "do the takes belong together?"),
        ([*session[:2], "--sync", str(text)], "not stamps of two sensors"),
        ([*session, "--methods", "best"], "method 'best': expected one"),
    ):
        assert main(["evaluate", "--views", *arguments]) == 2
        assert message in capsys.readouterr().err
