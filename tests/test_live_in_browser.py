"""Poses in a real browser: its own pages get and draw them, others do not."""

from __future__ import annotations

import asyncio
import os
import threading
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import Browser
from live_session import SAMPLE, WS, Sender, config, do, running, sample_frame

from kinefilter.characters import (
    KINECT_V1,
    KINECT_V2,
    Clip,
    Motion,
    Skeleton,
    standard_body,
)
from kinefilter.pipeline.formats import write_clip
from kinefilter.pipeline.live.live_config import AccessConfig
from kinefilter.pipeline.live.tally import Event

WINDOW = {"size": (900, 640), "webgl": True}  # of the browser
_THREE = os.environ.get("KINEFILTER_THREE", "")
_PLACES = """
const person = people.get(arguments[0]), places = {};
if (!person) return null;
person.updateMatrixWorld(true);
person.traverse((bone) => {
    const { elements } = bone.matrixWorld;
    if (bone.isBone) places[bone.name] = elements.slice(12, 15);
});
return [places, person.userData.positions];
"""
_CLICK = """
const [x, y, z] = people.get(arguments[0]).userData.positions[arguments[1]];
const at = camera.position.clone().set(x, y, z).project(camera);
const clientX = innerWidth * (1 + at.x) / 2, clientY = innerHeight * (1 - at.y) / 2;
const click = new MouseEvent("click", { clientX, clientY });
document.querySelector("canvas").dispatchEvent(click);
"""
_SAID = "return document.querySelector('p')?.textContent"
_NEEDS_THREE = pytest.mark.skipif(not _THREE, reason="no three.js in KINEFILTER_THREE")
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


def _put_example(folder: Path, skeleton: Skeleton) -> None:
    """Put the example page into a folder, with three.js and a GLB of a skeleton."""
    turns = np.tile([1.0, 0.0, 0.0, 0.0], (2, len(skeleton), 1))
    body, root = standard_body(skeleton, height=1.8), np.zeros((2, 3))
    still = Motion(time=np.array([0.0, 1.0]), body=body, root=root, rotations=turns)
    write_clip(Clip.of(still), folder / "avatar.glb")
    example = files("kinefilter.scenes") / "examples" / "avatar.html"
    (folder / "avatar.html").write_bytes(example.read_bytes())
    (folder / "node_modules").symlink_to(Path(_THREE) / "node_modules")


@_NEEDS_THREE
def test_the_example_page_says_that_the_skin_has_other_joints(
    browser: Browser, page: tuple[Path, str], tmp_path: Path
) -> None:
    _put_example(tmp_path, KINECT_V2)
    served = page[1].replace("page.html", "avatar.html")

    async def session() -> None:
        async with running(config(WS)) as (_, (source, out)):
            sender, said, sent = Sender(source), "", 0
            await asyncio.to_thread(browser.open, f"{served}?poses={out}")
            while not said:
                sender.send(sample_frame(sent % 290, time=sent / 30.0))
                sent += 1
                said = await asyncio.to_thread(browser.run, _SAID)
            assert "joints of kinect_v1" in said
            assert "--skeleton" in said

    do(session())


@_NEEDS_THREE
def test_the_example_page_draws_people_where_they_are_and_pushes_them(
    browser: Browser, page: tuple[Path, str], tmp_path: Path
) -> None:
    _put_example(tmp_path, KINECT_V1)
    chest, served = KINECT_V1.girdle, page[1].replace("page.html", "avatar.html")

    async def session() -> None:
        async with running(config(scene="box")) as (run, (source, out)):
            sender, sent, drawn = Sender(source), 0, None

            async def asked(script: str, *arguments: object) -> Any:
                return await asyncio.to_thread(browser.run, script, *arguments)

            await asyncio.to_thread(browser.open, f"{served}?poses={out}")
            loaded = "return Boolean(window.people)"
            while not await asked(loaded):
                await asyncio.sleep(0.1)
            while drawn is None or sent < 40:
                sender.send(sample_frame(sent, "1", "2"))
                sent += 1
                drawn = await asked(_PLACES, "2")
            places, positions = await asked(_PLACES, "2")
            for name, position in zip(KINECT_V1.joints, positions, strict=True):
                assert np.abs(np.subtract(places[name], position)).max() < 1e-3
            for far in (chest, KINECT_V1.index("HandLeft")):
                before = run.tally.events[Event.OBEYED]
                await asked(_CLICK, "2", far)
                while run.tally.events[Event.OBEYED] == before:
                    await asyncio.sleep(0.05)
            assert not run.tally.malformed

    do(session())
