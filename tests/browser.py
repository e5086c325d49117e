"""A headless Chromium, asked over the WebDriver protocol."""

from __future__ import annotations

import base64
import json
import shutil
import subprocess
import tempfile
import urllib.error
import urllib.request
from pathlib import Path
from typing import Any

_START = 20.0  # s that the driver may take to start


class Browser:
    """One window of Chromium; use as a context, which ends it.

    Logs what its pages request and say on the console.

    Args:
        size: Width and height of the window in pixels.
        webgl: Whether pages can draw with WebGL, on the processor.
    """

    def __init__(
        self, *, size: tuple[int, int] = (1360, 900), webgl: bool = False
    ) -> None:
        gl = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader")
        self._profile = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        self._driver = subprocess.Popen(
            ["chromedriver", "--port=0"], stdout=subprocess.PIPE, text=True
        )
        self._address = f"http://127.0.0.1:{self._port()}/session"
        options = {
            "binary": shutil.which("chromium"),
            "args": [
                *("--headless=new", "--no-sandbox", "--hide-scrollbars"),
                *(gl if webgl else ("--disable-gpu",)),
                "--window-size={},{}".format(*size),
                f"--user-data-dir={self._profile.name}",
            ],
        }
        asked = {
            "goog:chromeOptions": options,
            "goog:loggingPrefs": {"browser": "ALL", "performance": "ALL"},
        }
        made = self._send("POST", "", {"capabilities": {"alwaysMatch": asked}})
        self._address += f"/{made['sessionId']}"

    def __enter__(self) -> Browser:
        return self

    def __exit__(self, *_: object) -> None:
        try:
            self._send("DELETE", "")
        finally:
            self._driver.terminate()
            self._driver.communicate()
            self._profile.cleanup()

    def open(self, page: Path | str) -> None:
        """Open a file or an address; what the browser did before is not logged."""
        address = page.as_uri() if isinstance(page, Path) else page
        self._send("POST", "/url", {"url": "about:blank"})
        self.console()
        self.requests()
        self._send("POST", "/url", {"url": address})

    def run(self, script: str, *arguments: Any) -> Any:
        """Return what a JavaScript function body returns, waited for."""
        body = {"script": script, "args": list(arguments)}
        return self._send("POST", "/execute/sync", body)

    def console(self) -> list[str]:
        """Return what came up on the console since the last call."""
        entries = self._send("POST", "/se/log", {"type": "browser"})
        return [entry["message"] for entry in entries]

    def requests(self) -> list[str]:
        """Return the addresses that were requested since the last call."""
        entries = self._send("POST", "/se/log", {"type": "performance"})
        messages = [json.loads(entry["message"])["message"] for entry in entries]
        return [
            message["params"]["request"]["url"]
            for message in messages
            if message["method"] == "Network.requestWillBeSent"
        ]

    def screenshot(self) -> bytes:
        return base64.b64decode(self._send("GET", "/screenshot"))

    def _port(self) -> int:
        assert self._driver.stdout is not None
        for line in self._driver.stdout:
            if "started successfully on port" in line:
                return int(line.rstrip().rstrip(".").rpartition(" ")[2])
        raise RuntimeError("chromedriver did not start")

    def _send(self, method: str, path: str, body: Any = None) -> Any:
        data = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(
            self._address + path, data, {"Content-Type": "application/json"}
        )
        request.method = method
        try:
            with urllib.request.urlopen(request, timeout=_START) as answer:
                return json.load(answer)["value"]
        except urllib.error.HTTPError as error:
            raise RuntimeError(error.read().decode("utf-8", "replace")) from None


def missing() -> str | None:
    """Return what to install where there is no browser."""
    if shutil.which("chromium") and shutil.which("chromedriver"):
        return None
    return "needs Debian's chromium and chromium-driver: apt install them"
