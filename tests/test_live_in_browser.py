"""Poses in a real browser: its own pages get them, those of elsewhere do not."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
from browser import Browser
from live_session import SAMPLE, WS, Sender, config, running, sample_frame

from kinefilter.pipeline.live.live_config import AccessConfig

_TOKEN = "0123456789abcdef"
_THREE_LINES = """
return new Promise(done => {
    const lines = [], stream = new WebSocket(arguments[0]);
    stream.onerror = () => done("refused");
    stream.onmessage = event => {
        lines.push(JSON.parse(event.data));
        if (lines.length == 3) { stream.close(); done(lines); }
    };
})
"""


@pytest.fixture
def page(tmp_path: Path) -> Iterator[tuple[Path, str]]:
    """Return an empty page as a file and as a server of this machine has it."""

    class Quiet(SimpleHTTPRequestHandler):
        def log_message(self, *_: object) -> None:
            pass

    path = tmp_path / "page.html"
    path.write_text("<!doctype html><title>page</title>", encoding="utf-8")
    serving = partial(Quiet, directory=str(tmp_path))
    with ThreadingHTTPServer(("127.0.0.1", 0), serving) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield path, f"http://127.0.0.1:{server.server_port}/page.html"
        server.shutdown()
        thread.join()


async def _seen(browser: Browser, address: str, sender: Sender) -> Any:
    """Return what a page gets from an address while frames come."""
    asking = asyncio.ensure_future(
        asyncio.to_thread(browser.run, _THREE_LINES, address)
    )
    row = 0
    while not asking.done():
        sender.send(sample_frame(row % 290, time=row / 30.0))
        await asyncio.wait([asking], timeout=1 / 30)
        row += 1
    return asking.result()


def test_a_page_of_this_machine_draws_poses_and_a_file_from_anywhere_does_not(
    browser: Browser, page: tuple[Path, str], tmp_path: Path
) -> None:
    (tmp_path / "token").write_text(_TOKEN, encoding="utf-8")
    path, served = page

    async def session() -> None:
        access = AccessConfig(token_file=tmp_path / "token")
        async with running(config(WS), access) as (_, (source, out)):
            sender = Sender(source)
            browser.open(path)
            with_token = f"{out}/?token={_TOKEN}"
            assert await _seen(browser, with_token, sender) == "refused"
            browser.run("location.href = arguments[0]", served)
            assert await _seen(browser, str(out), sender) == "refused"
            names, *poses = await _seen(browser, with_token, sender)
        assert tuple(names["joints"]) == SAMPLE.skeleton.joints
        assert poses[0]["time"] < poses[1]["time"]
        assert len(poses[0]["positions"]) == len(names["joints"])

    asyncio.run(session())
