"""Take pictures of the page of view and of a report, as README shows them.

    python tests/pictures/pages.py OUT_DIR

Writes view.png and report.png. Needs Debian's chromium and chromium-driver, and viser.
"""

from __future__ import annotations

import sys
import tempfile
import threading
import time
from dataclasses import replace
from pathlib import Path

from matplotlib import image

sys.path.insert(0, str(Path(__file__).parents[1]))

from browser import Browser

from kinefilter import clean, read_take
from kinefilter.characters import Clip, Take
from kinefilter.pipeline.look.comparison import compare
from kinefilter.pipeline.look.drawing import Drawing
from kinefilter.pipeline.look.page import write_report
from kinefilter.pipeline.look.viewer import Viewer
from kinefilter.pipeline.look.viewer_server import opened_server
from kinefilter.pipeline.workers import one_thread
from kinefilter.scenes import SAMPLE

VIEW, REPORT = (1040, 730), (1060, 1040)  # pixels of the windows, their bars included
FRAME = 75  # of the sample take: the punch, with the wrist out of place
SETTLED = 2.0  # s that a page may take to move to what it was told
PRESS = """
[...document.querySelectorAll('button')].find(
  (b) => b.textContent.trim() === arguments[0]).click();
"""
CLOSE = "document.querySelectorAll('.mantine-CloseButton-root').forEach(b => b.click())"


def take_view(take: Take, out: Path) -> Clip:
    """Write the picture of view; return the clip."""
    drawing = Drawing.of(clean(take), take)
    with opened_server() as server:
        viewer = Viewer(server, drawing, Path("wave_punch_bend.edits.toml"))
        work = threading.Thread(target=viewer.run)
        work.start()
        with Browser(size=VIEW, webgl=True) as browser:
            browser.open(viewer.address)
            wait(browser, 0)
            tens = range(10, FRAME, 10)
            for frame in (*tens, *range(tens[-1] + 1, FRAME + 1)):
                browser.run(PRESS, "+10" if frame in tens else "+1")
                wait(browser, frame)
            browser.screenshot()  # waits for the first picture to be drawn
            browser.run(CLOSE)
            write(browser, out)
        viewer.stop()
        work.join()
    return drawing.clip


def take_report(clip: Clip, take: Take, out: Path) -> None:
    """Write the picture of a report."""
    with tempfile.TemporaryDirectory() as folder, Browser(size=REPORT) as browser:
        page = Path(folder) / "report.html"
        write_report(compare(clip, take), page)
        browser.open(page)
        browser.run(
            "const s = document.getElementById('scrubber'); s.value = arguments[0];"
            "s.dispatchEvent(new Event('input'))",
            FRAME,
        )
        write(browser, out)


def wait(browser: Browser, frame: int) -> None:
    """Wait until the page of view shows a frame."""
    words = f"frame {frame + 1} of"
    while words not in browser.run("return document.body.innerText"):
        time.sleep(0.1)


def write(browser: Browser, out: Path) -> None:
    """Write what a window shows, without the bars that it is larger by."""
    time.sleep(SETTLED)
    out.write_bytes(browser.screenshot())
    height, width = image.imread(out).shape[:2]
    print(f"wrote {out}, {width} x {height}, {out.stat().st_size // 1000} kB")


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    with one_thread():
        path = SAMPLE
        sample = replace(read_take(path), source=path.name)
        motion = take_view(sample, folder / "view.png")
        take_report(motion, sample, folder / "report.png")
