"""The page of kinefilter view in a headless Chromium."""

from __future__ import annotations

import io
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from time import monotonic

import av
import numpy as np
import pytest
import viser
from browser import Browser
from numpy.typing import NDArray
from short_takes import write_short_sample
from viewing import viewing

from kinefilter import CleanConfig, Cleaner, clean, clean_session, read_take
from kinefilter.pipeline.batch.manifest import read_rows
from kinefilter.pipeline.batch.run import clean_files
from kinefilter.pipeline.edits import Edit, read_edits
from kinefilter.pipeline.lab.simulation import simulate_session
from kinefilter.pipeline.look.drawing import Drawing
from kinefilter.pipeline.look.viewer import CleanAgain, Viewer
from kinefilter.pipeline.look.viewer_server import opened_server
from kinefilter.pipeline.progress import Progress
from kinefilter.pipeline.settings import Settings, hash_of

FRAMES = 90  # of the take that is viewed
WINDOW = {"size": (900, 640), "webgl": True}  # of the browser
_PATIENCE = 60.0  # s: WebGL on a busy processor is slow
_CANVAS = (slice(190, 490), slice(0, 510))  # the scene, without panel and messages

_PRESS = """
const named = [...document.querySelectorAll('button')].filter(
  (b) => b.textContent.trim() === arguments[0]);
named[0].click();
"""
_CHECK = """
const label = [...document.querySelectorAll('label')].find(
  (l) => l.textContent.trim() === arguments[0]);
let row = label;
while (!row.querySelector('input[type=checkbox]')) row = row.parentElement;
row.querySelector('input[type=checkbox]').click();
"""
_UNFOLD = """
[...document.querySelectorAll('div')].filter(
  (d) => d.textContent.trim() === arguments[0] && d.children.length <= 2).pop().click();
"""
_TEXT = "return document.body.innerText"
_LISTED = "return [...document.querySelectorAll('input')].map((i) => i.value).join()"


@pytest.fixture(scope="module")
def brief(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a file with the beginning of the sample, where an arm is doubtful."""
    return write_short_sample(tmp_path_factory.mktemp("brief"), FRAMES)


@pytest.fixture(scope="module")
def viewed(brief: Path) -> Drawing:
    take = read_take(brief)
    return Drawing.of(clean(take), take)


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    return tmp_path / "take.edits.toml"


@pytest.fixture
def viewer(viewed: Drawing, brief: Path, saved: Path) -> Iterator[Viewer]:
    take, cleaner = read_take(brief), Cleaner()
    before = cleaner.unedited(take)

    def again(edits: Sequence[Edit], progress: Progress) -> Drawing:
        found = cleaner.clean(take, edits=edits, before=before, progress=progress)
        return Drawing.of(found, take)

    with _running(viewed, saved, again) as opened:
        yield opened


@contextmanager
def _running(
    drawing: Drawing, saved: Path, again: CleanAgain | None = None
) -> Iterator[Viewer]:
    with opened_server() as server:
        opened = Viewer(server, drawing, saved, again)
        work = threading.Thread(target=opened.run)
        work.start()
        try:
            yield opened
        finally:
            opened.stop()
            work.join()


@pytest.fixture
def page(browser: Browser, viewer: Viewer) -> Browser:
    browser.open(viewer.address)
    _wait(lambda: f"frame 1 of {FRAMES}" in browser.run(_TEXT))
    return browser


def _wait(reached: Callable[[], bool]) -> None:
    end = monotonic() + _PATIENCE
    while not reached():
        assert monotonic() < end, "the page did not get there"


def _pixels(browser: Browser) -> NDArray[np.float64]:
    """Return the scene as it is seen."""
    with av.open(io.BytesIO(browser.screenshot())) as file:
        frame = next(file.decode(video=0))
    return frame.to_ndarray(format="rgb24")[_CANVAS].astype(float)


def _seen(
    browser: Browser, expected: Callable[[NDArray[np.float64]], bool]
) -> NDArray[np.float64]:
    """Return the scene as soon as it is as expected."""
    pixels = [_pixels(browser)]
    _wait(lambda: expected(pixels[-1]) or bool(pixels.append(_pixels(browser))))
    return pixels[-1]


def _blues(pixels: NDArray[np.float64]) -> int:
    """Return how many pixels are as blue as reliable joints, which the skin is not."""
    red, _, blue = np.moveaxis(pixels, 2, 0)
    return int(((blue > 80) & (red < 0.5 * blue)).sum())


def _changed(one: NDArray[np.float64], other: NDArray[np.float64]) -> int:
    """Return how many pixels differ visibly."""
    return int((np.abs(one - other).max(axis=2) > 30.0).sum())


def test_the_page_shows_the_motion_and_curves_plays_and_asks_nobody_else(
    page: Browser, viewer: Viewer
) -> None:
    start = _seen(page, lambda pixels: _blues(pixels) > 50)
    shown = start
    for name in ("skin", "raw", "cleaned", "physics", "contacts", "forces"):
        page.run(_CHECK, name)
        shown = _seen(page, lambda now, shown=shown: _changed(shown, now) > 150)
    assert _changed(shown, start) > 5000
    page.run(_PRESS, "Play")
    _wait(lambda: "frame 1 of" not in page.run(_TEXT))
    page.run(_PRESS, "Pause")
    _wait(lambda: "Pause" not in page.run(_TEXT))
    own = (f"{viewer.address}/", f"blob:{viewer.address}/", "data:")
    assert all(address.startswith(own) for address in page.requests())
    _draws_the_curves_of_a_joint(page)
    assert not [line for line in page.console() if "SEVERE" in line]


def _draws_the_curves_of_a_joint(page: Browser) -> None:
    curves = (
        "return [...document.querySelectorAll('#curves .curve')]"
        ".map((curve) => curve.getAttribute('d'))"
    )
    page.run(_UNFOLD, "Curves")
    _wait(lambda: len(page.run(curves)) == 2)
    assert all(curve.startswith("M") for curve in page.run(curves))


def test_edits_are_made_undone_saved_and_the_take_is_cleaned_with_them(
    page: Browser, brief: Path, saved: Path
) -> None:
    take = read_take(brief)
    bars = (
        "return [...document.querySelectorAll('#timeline .row')]"
        ".map((row) => row.getAttribute('d'))"
    )
    page.run(_PRESS, "Next doubtful stretch")
    _wait(lambda: "frame 1 of" not in page.run(_TEXT))
    page.run(_PRESS, "+10")
    whole = page.run(bars)
    assert whole[4] == ""
    page.run(_PRESS, "end here")
    page.run(_PRESS, "lifted")
    _wait(lambda: page.run(bars)[4] != "")
    page.run(_PRESS, "distrust")
    _wait(lambda: "2. left-arm distrusted" in page.run(_LISTED))
    page.run(_PRESS, "undo")
    _wait(lambda: "1. both feet lifted" in page.run(_LISTED))
    page.run(_PRESS, "redo")
    _wait(lambda: "2. left-arm distrusted" in page.run(_LISTED))
    assert not saved.exists()
    page.run(_PRESS, "Save edits")
    _wait(lambda: f"saved {saved}" in page.run(_TEXT))
    by_kind = {edit.kind: edit for edit in read_edits(saved)}
    assert by_kind["distrust"].joints == ("left-arm",)
    assert by_kind["contact"].part == "both feet"
    page.run(_PRESS, "Save and clean again")
    _wait(lambda: f"cleaned with {saved}" in page.run(_TEXT))
    again = clean(take, CleanConfig(edits=saved)).clip
    inside = by_kind["contact"].frames(take.time - take.time[0])
    assert not again.contacts[inside].any()
    shown = [row.count("M") for row in page.run(bars)[:4]]
    runs = (np.diff(again.contacts.astype(int), axis=0) == 1).sum(axis=0)
    assert shown == (runs + again.contacts[0]).tolist()
    page.run(_PRESS, "remove")
    _wait(lambda: "2. " not in page.run(_LISTED))


@pytest.mark.usefixtures("here")
def test_a_listed_take_is_cleaned_again_in_the_folder_of_its_batch(
    browser: Browser, brief: Path, tmp_path: Path
) -> None:
    takes, clips = tmp_path / "takes", tmp_path / "clips"
    takes.mkdir()
    (takes / "wave.csv").write_bytes(brief.read_bytes())
    quick = Settings(CleanConfig(method="none", physics=False))
    once = clean_files([str(takes)], str(clips), quick, suffix=".npz").rows[0].clips[0]
    with viewing([str(clips), "--take", str(takes)]) as (_, address):
        browser.open(address)
        _wait(lambda: f"frame 1 of {FRAMES}" in browser.run(_TEXT))
        browser.run(_PRESS, "distrust")
        _wait(lambda: "1. left-arm distrusted" in browser.run(_LISTED))
        browser.run(_PRESS, "Save and clean again")
        _wait(lambda: f"cleaned with {takes / 'wave.edits.toml'}" in browser.run(_TEXT))
        (row,) = read_rows(clips)
        assert any("left-arm distrusted" in note for note in row.clips[0].notes)
        assert once.sha256 != row.clips[0].sha256 == hash_of(clips / "wave.npz")
        (takes / "wave.csv").unlink()
        browser.run(_PRESS, "Save and clean again")
        _wait(lambda: "wave.csv: there is no such file" in browser.run(_TEXT))
    assert read_rows(clips) == [row]
    (takes / "wave.csv").write_bytes(brief.read_bytes())
    again = clean_files([str(takes)], str(clips), quick, suffix=".npz")
    assert again.rows == []


def test_a_page_from_elsewhere_cannot_connect(
    browser: Browser, viewed: Drawing, saved: Path, tmp_path: Path
) -> None:
    files = partial(SimpleHTTPRequestHandler, directory=str(tmp_path))
    with (
        _running(viewed, saved) as viewer,
        ThreadingHTTPServer(("127.0.0.1", 0), files) as elsewhere,
    ):
        threading.Thread(target=elsewhere.serve_forever, daemon=True).start()
        browser.open(f"http://127.0.0.1:{elsewhere.server_port}")
        assert not _connects(browser, viewer.address)
        _wait(lambda: any("403" in line for line in browser.console()))
        elsewhere.shutdown()


def _connects(browser: Browser, address: str) -> bool:
    script = (
        "const socket = new WebSocket(arguments[0], arguments[1]);"
        "return new Promise((done) => {"
        " socket.onopen = () => done(true);"
        " socket.onerror = () => done(false); })"
    )
    words = f"viser-v{viser.__version__}"
    return bool(browser.run(script, address.replace("http:", "ws:"), words))


def test_sensors_are_shown_where_they_stand_each_in_its_color(
    browser: Browser, saved: Path
) -> None:
    views = simulate_session("basic", "walk", sensors=("v2", "v2"), seed=3)
    takes = [
        replace(view.pair.take, source=f"sensor.{name}.csv")
        for view, name in zip(views, ("<i>", "b"), strict=True)
    ]
    result, merged = clean_session(takes, CleanConfig("none", physics=False))
    drawing = Drawing.of(result, merged.take, merged)
    with _running(drawing, saved) as viewer:
        browser.open(viewer.address)
        _wait(lambda: "2: sensor.b" in browser.run(_TEXT))
        assert "1: sensor.<i>" in browser.run(_TEXT)
        pixels = _seen(browser, lambda seen: _pinks(seen) > 100)
        browser.run(_CHECK, "2: sensor.b")
        _seen(browser, lambda seen: _pinks(seen) < 0.1 * _pinks(pixels))


def _pinks(pixels: NDArray[np.float64]) -> int:
    """Return how many pixels are as pink as what is of the second sensor."""
    red, green, blue = np.moveaxis(pixels, 2, 0)
    return int(((red > blue + 30.0) & (blue > green + 30.0)).sum())
