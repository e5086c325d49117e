"""The sensors of a session on the pages of view and report: where they are is true."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import Browser
from live_sensors import first_frames
from real_data import DATA

from kinefilter import CleanConfig, clean_session, read_take
from kinefilter.characters import KINECT_V1, Take
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.formats import write_take_csv
from kinefilter.pipeline.lab.simulation import SimulatedView, simulate_session
from kinefilter.pipeline.look.drawing import Drawing, Sensor
from kinefilter.pipeline.look.viewer import status_html
from kinefilter.pipeline.merge import Merged
from kinefilter.pipeline.merge.lag import Spline
from kinefilter.scenes.sensor import in_sensor_frame
from kinefilter.scenes.sensor.geometry import SENSORS

QUICK = CleanConfig("none", physics=False)
FRAMES = 150  # of each take


@pytest.fixture(scope="module")
def views() -> list[SimulatedView]:
    sensors = ("v2", "v1")
    seen = simulate_session("basic", "walk", sensors=sensors, degrees=90.0, seed=3)
    return first_frames(seen, FRAMES)


@pytest.fixture(scope="module")
def files(
    tmp_path_factory: pytest.TempPathFactory, views: list[SimulatedView]
) -> list[str]:
    """The takes, and the clip that was made of them."""
    folder = tmp_path_factory.mktemp("session")
    paths = [str(folder / name) for name in ("front.csv", "<b>side.csv", "clip.usdc")]
    for view, path in zip(views, paths, strict=False):
        write_take_csv(view.pair.take, Path(path))
    cleaning = ["--method", "none", "--no-physics", "--report"]
    page = str(folder / "clean.html")
    assert main(["clean", *paths[:2], "-o", paths[2], *cleaning, page]) == 0
    return [*paths, page]


@pytest.fixture(scope="module")
def session(files: list[str]) -> tuple[Drawing, Merged]:
    return _drawn(files[:2])


def _drawn(
    paths: Iterable[str | Path], frames: int | None = None
) -> tuple[Drawing, Merged]:
    takes = [read_take(path).at(slice(frames)) for path in paths]
    result, merged = clean_session(takes, QUICK)
    return Drawing.of(result, merged.take, merged), merged


def _in_own_frame(points: Any, sensor: Sensor) -> Any:
    """Return points of the room as a sensor sees them: left, up, away, from it."""
    eye, *corners = sensor.frustum
    upper_left, upper_right, lower_right, _ = corners
    axes = [upper_left - upper_right, upper_right - lower_right]
    axes.append(np.mean(corners, axis=0) - eye)
    return (points - eye) @ np.transpose([a / np.linalg.norm(a) for a in axes])


def test_every_sensor_has_the_joints_before_it_where_it_saw_them(
    session: tuple[Drawing, Merged], files: list[str]
) -> None:
    """From where the second stands in the room, they are as in its own take."""
    drawing, merged = session
    time = merged.take.time
    for sensor, path, mended, stamps in zip(
        drawing.sensors,
        files,
        merged.takes,
        (time, merged.alignments[0].clock.at(time)),
        strict=False,
    ):
        take, names = read_take(path), sensor.skeleton.joints
        own = [k for k, name in enumerate(take.skeleton.joints) if name in names[3:]]
        there = [names.index(take.skeleton.joints[k]) for k in own]
        seen = _in_own_frame(sensor.positions, sensor)[:, there]
        given = Spline(mended.time, mended.positions).at(stamps)
        # Where the tracker took left for right, they were put back.
        apart = _apart(seen, given, own, np.array(take.skeleton.mirror)[own])
        assert np.isfinite(apart).mean() > 0.8
        assert np.nanmax(apart) < 1e-6, sensor.name
        recorded = mended.positions[:, own]
        apart = _apart(recorded, take.positions, own, take.skeleton.mirror[own])
        assert np.nanpercentile(apart, 75) == 0.0, sensor.name


def _apart(seen: Any, given: Any, own: list[int], mirrored: Any) -> Any:
    """Return distances [m] from given joints, or from those of the other side."""
    both = [seen - given[:, own], seen - given[:, mirrored]]
    return np.min(np.linalg.norm(both, axis=3), axis=0)


def test_the_second_sensor_stands_where_it_recorded(
    session: tuple[Drawing, Merged], views: list[SimulatedView]
) -> None:
    """The truth, as each sensor has it, is at one place in the room."""
    drawing, _ = session
    points = np.random.default_rng(1).normal(size=(20, 3))
    there = [in_sensor_frame(points, view.sensor) for view in views]
    first, second = (
        _in_room(seen, sensor)
        for seen, sensor in zip(there, drawing.sensors, strict=True)
    )
    assert np.linalg.norm(first - second, axis=1).max() < 0.1


def _in_room(points: Any, sensor: Sensor) -> Any:
    """Return where in the room points of a sensor's own frame are."""
    origin, *axes = _in_own_frame(np.vstack([np.zeros(3), np.eye(3)]), sensor)
    return (points - origin) @ np.linalg.inv(np.array(axes) - origin)


def test_fields_of_view_are_those_of_the_sensors(
    session: tuple[Drawing, Merged],
) -> None:
    """As the virtual Kinects have them; the person is within."""
    drawing, merged = session
    assert merged.takes[1].skeleton == KINECT_V1
    for sensor, kind in zip(drawing.sensors, ("v2", "v1"), strict=True):
        left, up, away = _in_own_frame(sensor.frustum[1:], sensor).T
        for extent, known in zip((left, up), SENSORS[kind].field_of_view, strict=True):
            size = 2.0 * np.degrees(np.arctan(np.abs(extent / away)))
            np.testing.assert_allclose(size, np.degrees(known), atol=1.0)
        left, up, away = np.moveaxis(_in_own_frame(sensor.positions, sensor), 2, 0)
        assert np.nanmedian(away) > 0.8
        assert np.nanmedian(np.abs(np.arctan2(left, away))) < np.radians(28.0)
        floor = sensor.edges[-1, 1]
        np.testing.assert_allclose(floor, sensor.frustum[0] * [1.0, 0.0, 1.0])


def test_sensors_are_layers_of_their_own(session: tuple[Drawing, Merged]) -> None:
    drawing, merged = session
    names = [sensor.name for sensor in drawing.sensors]
    assert names == ["1: front", "2: <b>side"]
    assert all(drawing.layers[name] for name in names)
    status = status_html(drawing.clip, 5, drawing.sensors)
    assert "2: &lt;b&gt;side" in status
    assert f"share {merged.shares[5, 1].mean():.0%}" in status
    unseen = replace(drawing.sensors[0], residuals=np.full((6, 25), np.nan))
    assert "sees no one" in status_html(drawing.clip, 5, [unseen])


@pytest.fixture(scope="module")
def reported(files: list[str]) -> dict[str, Any]:
    """Return what is on the page of ``report``."""
    page = Path(files[2]).with_name("report.html")
    takes = ["--take", files[0], "--take", files[1]]
    assert main(["report", files[2], *takes, "-o", str(page)]) == 0
    return _contents(page)


def test_a_page_has_what_each_sensor_saw(
    session: tuple[Drawing, Merged], files: list[str], reported: dict[str, Any]
) -> None:
    found = reported
    _, merged = session
    for k, sensor in enumerate(found["sensors"]):
        shape = merged.residuals[k].shape
        apart = np.frombuffer(base64.b64decode(sensor["residuals"]["i2"]), "<i2")
        known = np.isfinite(merged.residuals[k])
        np.testing.assert_allclose(
            apart.reshape(shape)[known], merged.residuals[k][known] * 1e3, atol=1.0
        )
        shares = np.frombuffer(base64.b64decode(sensor["shares"]["u1"]), "u1")
        np.testing.assert_allclose(
            shares.reshape(shape), merged.shares[:, k] * 100.0, atol=0.51
        )
        assert sensor["figures"]["source"].endswith(Path(files[k]).name)


def _contents(page: Path) -> dict[str, Any]:
    text = page.read_text(encoding="utf-8")
    return json.loads(text.split('id="data">')[1].split("</script>")[0])


def test_clean_and_report_write_the_same_sensors(
    files: list[str], reported: dict[str, Any]
) -> None:
    assert reported["sensors"] == _contents(Path(files[3]))["sensors"]


def test_takes_that_do_not_fit_the_clip_are_refused(
    files: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    front, side, clip, _ = files
    page = tmp_path / "report.html"
    for arguments, words in (
        (["--take", front], f"{clip} with --take {front}: "),
        (["--take", side, "--take", front], f"--take {side} --take {front}: "),
        (["--take", front, "--take", front], "takes are identical"),
        (["--take", front, "--calibration", clip], "takes of several sensors"),
        (["--take", front, "--take", side, "--calibration", clip], "not a calibration"),
        ([], "--take"),
    ):
        assert main(["report", clip, *arguments, "-o", str(page)]) == 2, arguments
        assert words in capsys.readouterr().err
        assert not page.exists()


def test_people_who_stand_need_the_calibration_of_their_clip(
    files: list[str],
    views: list[SimulatedView],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Without it the page says what is unsure."""
    folder = tmp_path
    paths = [str(folder / "front.csv"), str(folder / "side.csv")]
    for view, path in zip(views, paths, strict=True):
        write_take_csv(_standing(view.pair.take.at(slice(60))), Path(path))
    known, page = str(folder / "known.json"), folder / "page.html"
    clip, unsure = str(folder / "clip.npz"), folder / "unsure.html"
    quick = ["--method", "none", "--no-physics"]
    merged = ["-o", str(folder / "m.csv"), "--save-calibration", known]
    assert main(["merge", *files[:2], *merged]) == 0
    assert main(["clean", *paths, "-o", clip, *quick, "--report", str(unsure)]) == 0
    told = "give a --calibration from another take"
    assert told in unsure.read_text(encoding="utf-8")
    assert main(["clean", *paths, "-o", clip, *quick, "--calibration", known]) == 0
    takes = ["--take", paths[0], "--take", paths[1]]
    capsys.readouterr()
    assert main(["report", clip, *takes, "-o", str(page)]) == 2
    assert "with its --calibration" in capsys.readouterr().err
    with_it = ["--calibration", known]
    assert main(["report", clip, *takes, *with_it, "-o", str(page)]) == 0
    assert told not in page.read_text(encoding="utf-8")
    shift = json.loads(Path(known).read_text())["sensors"][1]["shift_meters"]
    away = _contents(page)["sensors"][1]["figures"]["away_meters"]
    assert away == pytest.approx(np.linalg.norm(shift))


def _standing(take: Take) -> Take:
    """Return a walk on the spot."""
    root = take.positions[:, take.skeleton.root]
    off = (root - np.nanmedian(root, axis=0)) * [1.0, 0.0, 1.0]
    return replace(take, positions=take.positions - off[:, None])


_ROOM = "return document.getElementById('room').toDataURL()"
_HIDDEN = "return document.getElementById('session').hidden"


def test_the_page_draws_the_room_and_turns_it(
    browser: Browser, files: list[str]
) -> None:
    browser.open(Path(files[3]))
    assert browser.run(_HIDDEN) is False
    start = browser.run(_ROOM)
    browser.run(
        "document.getElementById('room').dispatchEvent(new PointerEvent("
        "'pointermove', { buttons: 1, movementX: 60, movementY: 5 }))"
    )
    turned = browser.run(_ROOM)
    assert turned != start
    browser.run(
        "const map = document.querySelector('#session .plot');"
        "const a = map.getBoundingClientRect();"
        "const at = { clientX: a.right - 1, clientY: a.top + 20, bubbles: true };"
        "map.dispatchEvent(new PointerEvent('pointermove', at));"
        "map.dispatchEvent(new PointerEvent('pointerdown', at))"
    )
    assert browser.run(_ROOM) != turned
    tip = browser.run("return document.getElementById('tip').textContent")
    assert "2: <b>side: " in tip
    assert "from merged, share " in tip
    rows = "return document.querySelectorAll('#sensors tr').length"
    assert browser.run(rows) == 3
    assert browser.console() == []


@pytest.mark.skipif(not DATA.is_dir(), reason="needs ../shared/data")
def test_recorded_sensors_look_at_the_person() -> None:
    folder = DATA / "two-kinects"
    names = [f"p02_90deg_walk_{which}.csv.gz" for which in "AB"]
    drawing, _ = _drawn((folder / name for name in names), 300)
    for sensor in drawing.sensors:
        root = _in_own_frame(sensor.positions[:, sensor.skeleton.root], sensor)
        left, _, away = root[~np.isnan(root[:, 0])].T
        assert away.min() > 0.5
        assert (np.abs(np.arctan2(left, away)) < np.radians(40.0)).all()
        # The second's height was not recorded; that it stands in the room was.
        assert 0.3 < sensor.frustum[0, 1] < 2.0
