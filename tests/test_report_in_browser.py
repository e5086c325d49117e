"""The page of a report in a headless Chromium."""

from __future__ import annotations

from pathlib import Path

import pytest
from browser import Browser

from kinefilter.pipeline.cli import main
from kinefilter.scenes import SAMPLE

_PIXELS = "return document.getElementById('figures').toDataURL()"


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report")
    clip, path = str(folder / "clip.npz"), folder / "report.html"
    assert main(["clean", str(SAMPLE), "-o", clip]) == 0
    assert main(["report", clip, "--take", str(SAMPLE), "-o", str(path)]) == 0
    return path


def test_a_page_plays_and_scrubs_without_network_and_errors(
    browser: Browser, page: Path
) -> None:
    browser.open(page)
    start = browser.run(_PIXELS)
    browser.run(
        "const s = document.getElementById('scrubber'); s.value = 150;"
        "s.dispatchEvent(new Event('input'))"
    )
    scrubbed = browser.run(_PIXELS)
    assert scrubbed != start
    clock = "return document.getElementById('clock').textContent"
    assert "frame 151 of 298" in browser.run(clock)
    browser.run("document.getElementById('play').click()")
    # Three pictures later, or as soon as the frame is another one.
    later = browser.run(
        "const s = document.getElementById('scrubber');"
        "return new Promise((done) => { const wait = () => s.value !== '150'"
        " ? done(Number(s.value)) : requestAnimationFrame(wait); wait(); })"
    )
    assert later > 150
    browser.run("document.getElementById('play').click()")
    assert browser.run(_PIXELS) != scrubbed
    rows = "return document.querySelectorAll('#metrics .pass, #metrics .fail').length"
    assert browser.run(rows) == 8
    assert browser.run("return document.getElementById('session').hidden")  # one sensor
    assert browser.console() == []
    assert set(browser.requests()) <= {page.as_uri(), "data:,"}


def test_the_mouse_turns_the_figures_and_a_map_moves_them(
    browser: Browser, page: Path
) -> None:
    browser.open(page)
    start = browser.run(_PIXELS)
    browser.run(
        "document.getElementById('figures').dispatchEvent(new PointerEvent("
        "'pointermove', { buttons: 1, movementX: 60, movementY: 5 }))"
    )
    turned = browser.run(_PIXELS)
    assert turned != start
    browser.run(
        "const map = document.querySelector('.plot'), a = map.getBoundingClientRect();"
        "const at = { clientX: a.right - 1, clientY: a.top + 20, bubbles: true };"
        "map.dispatchEvent(new PointerEvent('pointermove', at));"
        "map.dispatchEvent(new PointerEvent('pointerdown', at))"
    )
    assert browser.run(_PIXELS) != turned
    tip = browser.run("return document.getElementById('tip').textContent")
    assert "decided by" in tip
    assert "origin: " in tip
    assert browser.console() == []
