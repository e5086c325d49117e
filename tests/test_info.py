"""``kinefilter info``: what is in every file that kinefilter reads."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from published_layouts import azure_json, msrc_12_text, ntu_text
from real_data import TAKES, recorded
from scipy.spatial.transform import Rotation
from text_files import write_text

from kinefilter.characters import KINECT_V1, KINECT_V2, Clip, State, Take
from kinefilter.pipeline.batch.manifest import Row, write_csv
from kinefilter.pipeline.batch.store import store_at
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.contents import contents_of, contents_of_take
from kinefilter.pipeline.database import PostureDatabase
from kinefilter.pipeline.formats import write_clip, write_contacts, write_take_csv
from kinefilter.pipeline.formats.export import Export
from kinefilter.pipeline.lab.simulation import simulate, write_pairs
from kinefilter.pipeline.merge import Alignment, write_calibration
from kinefilter.pipeline.merge.lag import Clock
from kinefilter.pipeline.merge.rigid import Placement

MakeClip = Callable[..., Clip]


def told(path: Path, capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    """Return what the command prints as JSON; the table has to print, too."""
    assert main(["info", str(path)]) == 0
    assert str(path) in capsys.readouterr().out
    assert main(["info", str(path), "--json"]) == 0
    contents: dict[str, Any] = json.loads(capsys.readouterr().out)
    return contents


def test_a_table_of_contacts_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], make_clip: MakeClip
) -> None:
    clip, path = make_clip(), tmp_path / "contacts.csv"
    write_contacts(clip, path)
    contents = told(path, capsys)
    assert (contents["kind"], contents["rows"]) == ("contacts", len(clip))
    shares = contents["share_of_rows_on_the_floor"]
    assert shares["ToeRight"] == pytest.approx(clip.contacts[:, 3].mean())


def test_edits_and_calibrations_are_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    edits, calibration = tmp_path / "wave.edits.toml", tmp_path / "hall.json"
    write_text(edits, '[[distrust]]\njoints = ["arms"]\nbegin = 1\nend = 2.5\n')
    contents = told(edits, capsys)
    assert (contents["kind"], contents["edits"]) == ("edits", 1)
    assert contents["notes"] == ["arms distrusted from 1 to 2.5 s"]
    turn, shift = (
        Rotation.from_euler("y", 90.0, degrees=True),
        np.array([3.0, 0.0, 4.0]),
    )
    clock = Clock(0.0, 1.5)
    found = Alignment(clock, Placement(turn, shift), np.nan, np.inf, np.inf)
    merged: Any = SimpleNamespace(sources=("hall/A.csv", "B.csv"), alignments=(found,))
    write_calibration(merged, calibration)
    contents = told(calibration, capsys)
    assert contents["sensors"] == ["A.csv", "B.csv"]
    assert (contents["turned_degrees"], contents["away_m"]) == ([90.0], [5.0])


def test_settings_and_the_manifests_of_a_batch_are_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = 'format = "ntu"\nmodel = "a.npz"\n'
    contents = told(write_text(tmp_path / "kinefilter.toml", text), capsys)
    options = {"format": "ntu", "model": str(tmp_path / "a.npz")}
    assert (contents["kind"], contents["options"]) == ("settings", options)
    rows = [Row("a.csv", "failed", "a.bvh", ""), Row("b.csv", "done", "b.bvh", "")]
    rows.append(replace(rows[0], status="done"))
    lines = "".join(row.as_json() + "\n" for row in rows)
    contents = told(write_text(tmp_path / "manifest.jsonl", lines), capsys)
    assert (contents["kind"], contents["takes"]) == ("manifest of a batch", 2)
    assert contents["done"] == 2
    write_csv(rows, store_at(str(tmp_path)))
    contents = told(tmp_path / "manifest.csv", capsys)
    assert (contents["kind"], contents["format"]) == ("manifest of a batch", "csv")


def test_several_files_are_told_and_one_that_is_refused_stops_none(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    names = ("a.csv", "locked.csv", "none.csv", "b.csv")
    paths = [str(tmp_path / name) for name in names]
    for path in (paths[0], paths[1], paths[3]):
        write_take_csv(walk(), path)
    monkeypatch.setattr(os, "access", lambda path, _: Path(path).name != "locked.csv")
    assert main(["info", *paths]) == 1
    printed = capsys.readouterr()
    assert [path for path in paths if f"{path}: take" in printed.out] == paths[::3]
    assert printed.err.count("\n") == 2
    assert "none.csv: there is no such file" in printed.err
    assert "locked.csv: cannot be read; check permissions" in printed.err
    assert main(["info"]) == 2


def walk() -> Take:
    return simulate("basic", "walk", skeleton="kinect_v2", seed=1).take


def test_gaps_and_repeats_are_counted() -> None:
    take = walk()
    time = np.arange(len(take)) / 30.0
    time[10:] += 3 / 30.0  # three frames never arrived
    time[20] = time[19]
    contents = contents_of_take(replace(take, time=time))
    assert contents["dropped_frames"] == 3 + 1  # the repeated one left a hole
    assert contents["repeated_frames"] == 1
    assert contents["longest_gap_s"] == pytest.approx(4 / 30)
    assert contents["fps"] == pytest.approx(30.0)


def test_states_are_shares_of_each_part_of_the_body() -> None:
    take = walk()
    state = np.full(take.state.shape, State.TRACKED, dtype=np.uint8)
    left = [KINECT_V2.index(j) for j in ("HipLeft", "KneeLeft")]
    state[:, left] = State.INFERRED
    positions = take.positions.copy()
    hidden = KINECT_V2.index("ThumbRight")
    positions[:, hidden], state[:, hidden] = np.nan, State.NOT_TRACKED
    contents = contents_of_take(replace(take, state=state, positions=positions))
    states = contents["states"]
    assert states["left leg"] == {"not_tracked": 0, "inferred": 0.5, "tracked": 0.5}
    assert states["right arm"]["not_tracked"] == pytest.approx(1 / 6)
    assert states["trunk"]["tracked"] == 1.0
    assert contents["joints_never_seen"] == ["ThumbRight"]
    for shares in states.values():
        assert sum(shares.values()) == pytest.approx(1.0)


def test_a_mirrored_stretch_is_told_with_its_time() -> None:
    take = simulate("basic", "wave", skeleton="kinect_v2", seed=1).take
    contents = contents_of_take(take)
    swapped = take.positions.copy()
    swapped[40:80] = swapped[40:80][:, KINECT_V2.mirror]
    failures = contents_of_take(replace(take, positions=swapped))["failures"]
    assert "mirrored" not in {f["kind"] for f in contents["failures"]}
    mirrored = [f for f in failures if f["kind"] == "mirrored"]
    assert len(mirrored) == 1
    assert mirrored[0]["start_s"] == pytest.approx(take.time[40], abs=0.2)


@recorded
def test_recorded_failures_and_inferred_joints_are_told(
    capsys: pytest.CaptureFixture[str],
) -> None:
    contents = told(TAKES / "labanotation" / "joints.csv", capsys)
    (body,) = contents["bodies"]
    assert (contents["format"], body["skeleton"]) == ("kinect-v2", "kinect_v2")
    assert body["frames"] == 371
    contents = told(TAKES / "ui-prmd" / "m03_s07_e10_inc_failure.csv", capsys)
    assert contents["bodies"][0]["failures"]


def test_people_formats_and_units_are_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    take = walk()
    other = replace(take, positions=take.positions + np.array([1.5, 0, 0]))
    contents = told(write_text(tmp_path / "a", ntu_text([take, other])), capsys)
    assert [body["body"] for body in contents["bodies"]] == [1, 2]
    assert (contents["kind"], contents["format"]) == ("take", "ntu")
    contents = told(write_text(tmp_path / "b", azure_json([take])), capsys)
    assert (contents["format"], contents["unit"]) == ("azure", "mm")
    assert "Kinect v2" in contents["notes"][0]
    small = Take(
        np.arange(4) / 30, np.ones((4, 20, 3)), np.ones((4, 20), np.uint8), KINECT_V1
    )
    contents = told(write_text(tmp_path / "c", msrc_12_text(small)), capsys)
    assert contents["format"] == "msrc-12"


@pytest.mark.parametrize("extension", ["usda", "usdc", "bvh", "csv", "npz"])
def test_every_written_clip_is_told(
    make_clip: MakeClip,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    extension: str,
) -> None:
    clip = make_clip(31, KINECT_V2)
    path = tmp_path / f"clip.{extension}"
    write_clip(clip, path)
    contents = told(path, capsys)
    about = contents.get("bodies", [contents])[0]
    assert about["frames"] == 31
    assert about["fps"] == pytest.approx(30.0)
    assert about["seconds"] == pytest.approx(1.0)
    if extension == "npz":
        assert contents["reliability"] == pytest.approx(clip.reliability.mean())
        assert sum(contents["origin"].values()) == pytest.approx(1.0)
        assert contents["height_m"] == clip.body.height
    if extension.startswith("usd"):
        assert (contents["unit"], contents["up_axis"]) == ("1 m", "Y")
        assert "kinefilter:contacts" in contents["attributes"]
        assert set(KINECT_V2.joints) <= set(contents["names"])


def test_an_export_that_cannot_be_read_back_is_named(
    make_clip: MakeClip, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_clip(make_clip(31, KINECT_V2), tmp_path / "clip.npz", Export(rig="smplx"))
    assert main(["info", str(tmp_path / "clip.npz")]) == 2
    assert "clip.npz: is an export with --rig (smplx," in capsys.readouterr().err


def test_databases_and_pairs_are_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_pairs([simulate("basic", "wave", sensor="v1")], tmp_path / "pairs.npz")
    contents = told(tmp_path / "pairs.npz", capsys)
    assert (contents["kind"], contents["clips"]) == ("pairs", 1)
    rng = np.random.default_rng(0)
    base = PostureDatabase(
        rng.normal(size=(5, 20, 3)),
        np.array(["a", "b", "a", "b", "c"]),
        KINECT_V1,
    )
    base.save(tmp_path / "base.npz")
    contents = told(tmp_path / "base.npz", capsys)
    assert (contents["kind"], contents["motions"]) == ("database", 3)


def test_a_missing_or_unknown_file_ends_with_code_2_and_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    np.savez(tmp_path / "other.npz", surprise=np.zeros(3))
    write_text(tmp_path / "note.txt", "hello\n")
    for name in ("none.csv", "other.npz", "note.txt"):
        assert main(["info", str(tmp_path / name)]) == 2
        printed = capsys.readouterr()
        assert printed.out == ""
        assert printed.err.count("\n") == 1
        assert name in printed.err


def test_json_has_no_nan(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    take = walk()
    alone = replace(take, time=np.zeros(len(take)))
    write_take_csv(alone, tmp_path / "a.csv")
    contents = told(tmp_path / "a.csv", capsys)
    assert contents["bodies"][0]["fps"] is None
    json.dumps(contents_of(tmp_path / "a.csv"), allow_nan=False)
