"""Batches in which takes of several sensors are of one session."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from batch_folders import QUICK, clean_folder, table_of
from batch_takes import second_view, short_take, write_session

from kinefilter.characters import InputError
from kinefilter.pipeline.batch.manifest import Row
from kinefilter.pipeline.batch.plan import Job, find_sources, plan_jobs
from kinefilter.pipeline.batch.run import Outcome, clean_files
from kinefilter.pipeline.batch.store import store_at
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.formats import write_take_csv
from kinefilter.pipeline.settings import Settings

TOGETHER = replace(QUICK, sessions="{name}_{sensor}.csv*")
FLAGS = ["--method", "none", "--no-physics", "--to", "bvh"]


@pytest.fixture
def both(tmp_path: Path) -> Path:
    """Return a folder with a session of two sensors, a take, and a list."""
    folder = tmp_path / "takes"
    folder.mkdir()
    write_session(folder, "nod", short_take(90, start=60))
    write_take_csv(short_take(20), folder / "alone.csv")
    (folder / "nod.sync.csv").write_text("milliseconds,A,B\n0,1,2\n")
    return folder


def _made(outcome: Outcome) -> dict[str, Row]:
    return {row.take: row for row in outcome.rows if row.status != "no take"}


@pytest.mark.usefixtures("here")
def test_a_session_is_one_clip_and_one_row(both: Path, tmp_path: Path) -> None:
    """The clip is that of clean; no take of the session is cleaned by itself."""
    out = tmp_path / "clips"
    made = _made(clean_folder(both, out, TOGETHER))
    assert {take: row.status for take, row in made.items()} == {
        "nod": "done",
        "alone.csv": "done",
    }
    assert {path.name for path in out.glob("*.bvh")} == {"nod.bvh", "alone.bvh"}
    words = [str(both / f"nod_{sensor}.csv") for sensor in "AB"]
    clip = tmp_path / "clip.bvh"
    assert main(["clean", *words, "-o", str(clip), *FLAGS[:-2]]) == 0
    assert (out / "nod.bvh").read_bytes() == clip.read_bytes()
    first, second = made["nod"].sensors
    assert (first["sensor"], first["source"]) == ("A", "nod_A.csv")
    assert (second["sensor"], second["source"]) == ("B", "nod_B.csv")
    assert second["lag_seconds"] == pytest.approx(33657.5, abs=0.01)
    assert second["turned_degrees"] == pytest.approx(-60.0, abs=1.0)
    assert any("people hardly walk" in note for note in made["nod"].clips[0].notes)
    (cell,) = (row["sensors"] for row in table_of(out) if row["take"] == "nod")
    assert cell.startswith("sensor A, source nod_A.csv, lag_seconds 0, ")
    assert "; sensor B, source nod_B.csv, lag_seconds 33657.50" in cell
    assert made["alone.csv"].sensors == ()


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(
    ("change", "redone"),
    [
        ("nothing", set()),
        ("second take", {"nod"}),
        ("clip", {"nod"}),
        ("other sensor first", {"nod"}),
        ("cutoff", {"nod", "alone.csv"}),
    ],
)
def test_only_what_changed_is_done_again(
    both: Path, tmp_path: Path, change: str, redone: set[str]
) -> None:
    out, settings = tmp_path / "clips", replace(TOGETHER, sensors=("A", "B"))
    clean_folder(both, out, settings)
    if change == "second take":
        take = second_view(short_take(90, start=60), seed=5)
        write_take_csv(take, both / "nod_B.csv")
    elif change == "clip":
        (out / "nod.bvh").unlink()
    elif change == "other sensor first":
        settings = replace(settings, sensors=("B", "A"))
    elif change == "cutoff":
        settings = replace(settings, config=replace(QUICK.config, cutoff=3.0))
    assert _made(clean_folder(both, out, settings)).keys() == redone


@pytest.mark.usefixtures("here")
def test_a_take_without_a_partner_is_cleaned_by_itself_and_told(
    both: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    second, out = both / "nod_B.csv", tmp_path / "clips"
    kept = second.read_bytes()
    second.unlink()
    words = ["batch", str(both), "-o", str(out), *FLAGS, "--sessions"]
    words.append("{name}_{sensor}.csv")
    assert main(words) == 0
    assert "1 without a partner (see manifest.csv)" in capsys.readouterr().out
    (row,) = (row for row in table_of(out) if row["sensors"])
    assert (row["take"], row["output"]) == ("nod_A.csv", "nod_A.bvh")
    assert "no take of another sensor" in row["notes"]
    words += ["--sensors", "A", "B"]
    assert main(words) == 0
    (row,) = (row for row in table_of(out) if row["sensors"])
    assert "no take of B" in row["notes"]
    second.write_bytes(kept)
    assert main(words) == 0
    assert "1 clip of several sensors" in capsys.readouterr().out


@pytest.mark.usefixtures("here")
def test_a_session_that_is_refused_fails_with_the_reason(
    both: Path, tmp_path: Path
) -> None:
    """And nothing else does."""
    write_take_csv(short_take(90), both / "same_A.csv")
    write_take_csv(short_take(90), both / "same_B.csv")
    write_take_csv(short_take(20), both / "short_A.csv")
    write_take_csv(short_take(20, seed=1), both / "short_B.csv")
    write_take_csv(short_take(20), both / "broken_A.csv")
    (both / "broken_B.csv").write_text("time,Head.x\nno,take\n")
    write_take_csv(short_take(20), both / "empty_A.csv")
    (both / "empty_B.csv").write_text("")
    write_take_csv(short_take(20), both / "twice_A.csv")
    write_take_csv(short_take(20), both / "twice_A.csv.txt")
    made = _made(clean_folder(both, tmp_path / "clips", TOGETHER))
    errors = {take: row.error for take, row in made.items() if row.status == "failed"}
    for take, words in (
        ("same", "same_A.csv and same_B.csv: the takes are identical"),
        ("short", "short_B.csv"),
        ("empty", "empty_B.csv"),
        ("twice", "twice_A.csv, twice_A.csv.txt: several are by the same sensor"),
    ):
        assert words in errors.pop(take)
    assert not errors
    assert [one["source"] for one in made["same"].sensors] == [
        "same_A.csv",
        "same_B.csv",
    ]
    assert made["nod"].status == made["alone.csv"].status == "done"
    note = made["broken"].clips[0].notes[0]  # it claims to be no take
    assert note == "broken_B.csv is not a take; cleaned without it"


@pytest.mark.usefixtures("here")
def test_all_people_of_a_session_are_too_many(both: Path, tmp_path: Path) -> None:
    settings = replace(TOGETHER, body="all")
    made = _made(clean_folder(both, tmp_path / "clips", settings))
    assert "--body all works with one sensor only" in made["nod"].error
    assert made["alone.csv"].status == "done"


@pytest.mark.usefixtures("here")
def test_takes_of_a_session_may_be_of_any_format(tmp_path: Path) -> None:
    """And of any frame rate: here one in MSRC-12's, with every other frame."""
    take, takes = short_take(120, start=60), tmp_path / "takes"
    takes.mkdir()
    write_take_csv(take, takes / "nod_A.csv")
    other = second_view(take).at(np.arange(120) % 2 == 0)
    cells = np.concatenate([other.positions, other.state[..., None]], axis=2)
    rows = np.column_stack([1e6 * other.time, cells.reshape(len(other), -1)])
    np.savetxt(takes / "nod_B.txt", rows, fmt="%.5f")
    settings = replace(QUICK, sessions="{name}_{sensor}.*")
    made = _made(clean_folder(takes, tmp_path / "clips", settings))
    assert made["nod"].status == "done", made["nod"].error
    assert made["nod"].clips[0].frames == 120
    assert made["nod"].sensors[1]["turned_degrees"] == pytest.approx(-60.0, abs=2.0)


def _jobs(root: Path, *inputs: str, settings: Settings) -> dict[str, Job]:
    out = store_at(str(root.parent / "out"))
    places = [str(root / name) for name in inputs or ("",)]
    jobs = plan_jobs(find_sources(places, out.root), out, settings, ".bvh")
    return {job.take: job for job in jobs}


def _files(root: Path, *names: str) -> Path:
    for name in names:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text("a take")
    return root


@pytest.mark.parametrize(
    ("pattern", "sensors", "names", "found"),
    [
        (
            "{name}_{sensor}.csv*",
            (),
            ["x/a_L.csv", "x/a_R.csv.gz", "y/a_L.csv", "y/a_M.csv", "y/a_R.csv"],
            {"x/a": "L R", "y/a": "L M R"},
        ),
        ("{name}_{sensor}.csv", (), ["a_b_1.csv", "a_b_2.csv"], {"a_b": "1 2"}),
        ("{sensor}_{name}.csv", (), ["1_a_b.csv", "2_a_b.csv"], {"a_b": "1 2"}),
        (
            "{name}/{sensor}.csv",
            (),
            ["d/x/L.csv", "d/x/R.csv", "L.csv", "R.csv"],
            {"d/x": "L R", "root": "L R"},
        ),
        (
            "{sensor}/{name}.csv",
            (),
            ["L/a.csv", "R/a.csv", "d/L/a.csv", "d/R/a.csv"],
            {"a": "L R", "d/a": "L R"},
        ),
        (
            "{name}_{sensor}*.csv",
            ("B", "A"),
            ["a_A_person0.csv", "a_B_person0.csv", "a_C.csv", "a_take_A.csv"],
            {"a": "B A", "a_C.csv": "", "a_take_A.csv": "A"},
        ),
        (
            "{name}_{sensor}.csv",
            (),
            ["a.1_L.csv", "a.1_R.csv", "b.2_L.csv", "b.2_R.csv"],
            {"a.1": "L R", "b.2": "L R"},
        ),
        ("{name}?{sensor}.csv", (), ["a-1.csv", "a-2.csv"], {"a": "1 2"}),
        (
            "{name}_{sensor}.csv",
            (),
            ["a_1.csv", "a_2.csv", "a.csv", "a.txt"],
            {"a": "1 2", "a.csv": "", "a.txt": ""},
        ),
    ],
)
def test_sessions_are_what_differs_only_in_the_sensor(
    pattern: str,
    sensors: tuple[str, ...],
    names: list[str],
    found: dict[str, str],
    tmp_path: Path,
) -> None:
    root = _files(tmp_path / "root", *names)
    settings = Settings(sessions=pattern, sensors=sensors)
    jobs = _jobs(root, settings=settings)
    assert {take: " ".join(job.sensors) for take, job in jobs.items()} == found
    assert sum(len(job.sources) for job in jobs.values()) == len(names)
    assert len({job.output for job in jobs.values()}) == len(jobs)
    for take, job in jobs.items():
        if len(job.sources) > 1 and "a.csv" not in names:
            assert job.output == f"{take}.bvh"
            assert job.size > sum(source.file.size for source in job.sources)


def test_sessions_of_named_files_and_of_several_folders(tmp_path: Path) -> None:
    root = _files(tmp_path / "root", "L/a.csv", "R/a.csv")
    settings = Settings(sessions="{sensor}/{name}.csv")
    for inputs in (("L", "R"), ("L/a.csv", "R/a.csv")):
        (job,) = _jobs(root, *inputs, settings=settings).values()
        assert (job.take, job.sensors) == ("a", ("L", "R"))
    sources = find_sources([str(root / f"{sensor}/a.csv") for sensor in "LR"], "out")
    with pytest.raises(InputError, match="would overwrite a take"):
        plan_jobs(sources, store_at(str(root / "R")), settings, ".csv")


@pytest.mark.usefixtures("here")
def test_a_folder_says_what_its_sessions_are(both: Path, tmp_path: Path) -> None:
    """Files of one session by any name, in an order, by a calibration."""
    day = both / "day"
    day.mkdir()
    first, second = write_session(day, "walk", short_take(90, start=60))
    first.rename(day / "front.csv")
    second.rename(day / "side.csv")
    words = [str(day / "side.csv"), str(day / "front.csv")]
    merged = ["-o", str(tmp_path / "m.csv"), "--save-calibration"]
    assert main(["merge", *words, *merged, str(day / "places.json")]) == 0
    (day / "kinefilter.toml").write_text(
        'sessions = "{name}/{sensor}.csv"\nsensors = ["side", "front"]\n'
        'calibration = "places.json"\n'
    )
    outcome = clean_folder(both, tmp_path / "clips")
    made = _made(outcome)
    assert made.keys() == {"day", "nod_A.csv", "nod_B.csv", "alone.csv"}
    assert [one["sensor"] for one in made["day"].sensors] == ["side", "front"]
    assert made["day"].clips[0].output == "day.bvh"
    assert not any("calibration" in note for note in made["day"].clips[0].notes)
    places = (day / "places.json").read_text()
    (day / "places.json").write_text(places.replace("shift_meters", "shift_meters "))
    with pytest.raises(InputError, match=r"places\.json: not a calibration"):
        clean_folder(both, tmp_path / "clips")
    (day / "places.json").write_text(places + "\n")
    assert _made(clean_folder(both, tmp_path / "clips")).keys() == {"day"}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('sessions = "{name}.csv"', "kinefilter.toml: --sessions {name}.csv: expected"),
        ('sessions = "{name}{name}_{sensor}"', "{name} and {sensor} once each"),
        ("sessions = 3", "kinefilter.toml: sessions = 3: expected text"),
        ('sessions = "{name}-{sensor}.csv"', "matches no take"),
        ('sensors = ["A"]', "kinefilter.toml: --sensors A: expected two or more"),
        ('sensors = ["A", "A"]', "each once"),
        ('sensors = "A B"', "kinefilter.toml: sensors = 'A B': expected a list such"),
        ('sensors = ["A", "B"]', "--sensors A B: requires --sessions"),
        ('calibration = "gone.json"', "gone.json"),
    ],
)
def test_what_a_folder_says_wrong_is_refused_by_name(
    both: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    text: str,
    words: str,
) -> None:
    (both / "kinefilter.toml").write_text(text)
    assert main(["batch", str(both), "-o", str(tmp_path / "clips")]) == 2
    assert words in capsys.readouterr().err.replace("\n", " ")
    assert not (tmp_path / "clips").exists()


@pytest.mark.usefixtures("here")
def test_a_calibration_of_sensors_that_were_moved_fails_only_their_session(
    tmp_path: Path,
) -> None:
    """People who go to and fro tell where sensors are."""
    takes = tmp_path / "takes"
    takes.mkdir()
    take = short_take(90, start=60)
    path = np.linspace(0.0, 1.0, 90)[:, None, None] * [1.0, 0.0, 0.0]
    walk = replace(take, positions=take.positions + path)
    paths = [str(path) for path in write_session(takes, "walk", walk)]
    write_session(takes, "moved", walk, degrees=90.0)
    places = tmp_path / "places.json"
    merged = ["-o", str(tmp_path / "m.csv"), "--save-calibration", str(places)]
    assert main(["merge", *paths, *merged]) == 0
    settings = replace(TOGETHER, calibration=places)
    made = _made(clean_folder(takes, tmp_path / "clips", settings))
    assert made["walk"].status == "done"
    assert "30 degrees" in made["moved"].error
    assert "a sensor was moved; leave --calibration out" in made["moved"].error
    alone = replace(settings, sessions=None, sensors=())
    with pytest.raises(InputError, match=r"places\.json: requires --sessions"):
        clean_folder(takes, tmp_path / "others", alone)


@pytest.mark.usefixtures("here")
def test_a_store_by_url_gives_the_same_clips(both: Path, tmp_path: Path) -> None:
    pytest.importorskip("fsspec", reason="fsspec, of the extra cluster, is not here")
    clean_folder(both, tmp_path / "here", TOGETHER)
    (both / "kinefilter.toml").write_text('sessions = "{name}_{sensor}.csv*"\n')
    there = f"local://{tmp_path}/there"
    outcome = clean_files([f"local://{both}"], there, QUICK, suffix=".bvh")
    assert _made(outcome)["nod"].status == "done"
    for name in ("nod.bvh", "alone.bvh"):
        found = (tmp_path / "there" / name).read_bytes()
        assert found == (tmp_path / "here" / name).read_bytes()
