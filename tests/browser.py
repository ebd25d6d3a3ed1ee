# SPDX-License-Identifier: BSD-3-Clause
"""A headless Chromium driven over its debugging pipe: what a page does, asks for, and looks like."""

import base64
import json
import os
import select
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from time import monotonic
from typing import Any, Self

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
OPTIONS = (
    "--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--disable-background-networking",
    "--disable-component-update", "--no-first-run", "--hide-scrollbars", "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader", "--remote-debugging-pipe",
)  # fmt: skip


def find_browser() -> str | None:
    """Path of an installed browser; None where there is none."""
    return next((path for path in map(shutil.which, NAMES) if path), None)


class Browser:
    """One tab. Messages are JSON, parted by NUL, over the file descriptors 3 and 4 of the browser."""

    def __init__(self, path: str, *, patience: float = 60.0) -> None:
        self.patience = patience
        self.events: list[dict[str, Any]] = []
        self._profile = tempfile.TemporaryDirectory(prefix="browser-", ignore_cleanup_errors=True)
        its_input, self._to = os.pipe()
        self._from, its_output = os.pipe()
        # The shell puts the pipe's ends where the browser looks for them; Python would need a fork hook for that.
        command = f'exec "$0" "$@" 3<&{its_input} 4>&{its_output}'
        words = [path, *OPTIONS, f"--user-data-dir={self._profile.name}", "about:blank"]
        self._process = subprocess.Popen(
            ["/bin/bash", "-c", command, *words],
            pass_fds=(its_input, its_output), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        os.close(its_input)
        os.close(its_output)
        self._buffer, self._last, self._session = b"", 0, ""
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.call(f"{domain}.enable")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.terminate()
        self._process.wait(timeout=20)
        os.close(self._to)
        os.close(self._from)
        self._profile.cleanup()

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """One command of the protocol and its answer."""
        self._last += 1
        message = {"id": self._last, "method": method, "params": params}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._to, json.dumps(message).encode() + b"\0")
        while (answer := self._next()).get("id") != self._last:
            self.events.append(answer)
        if "error" in answer:
            raise RuntimeError(f"{method}: {answer['error']}")
        return answer["result"]

    def evaluate(self, expression: str) -> Any:
        """Value of a JavaScript expression in the page; promises are awaited."""
        answer = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in answer:
            raise RuntimeError(f"{expression}: {answer['exceptionDetails']}")
        return answer["result"].get("value")

    def open(self, address: str | Path, width: int = 1280, height: int = 900) -> None:
        """Show a page at a size; `width` below 500 is a phone."""
        self.resize(width, height)
        self.events.clear()
        url = address.resolve().as_uri() if isinstance(address, Path) else address
        if failed := self.call("Page.navigate", url=url).get("errorText"):
            raise ConnectionError(f"{url}: {failed}")
        self.wait_for("document.readyState === 'complete'")

    def resize(self, width: int, height: int) -> None:
        """Size of the window, CSS pixels."""
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width, height=height, deviceScaleFactor=1, mobile=width < 500,
        )  # fmt: skip

    def wait_for(self, condition: str) -> None:
        """Wait until a JavaScript expression holds."""
        self._wait(lambda: bool(self.evaluate(condition)), condition)

    def press(self, key: str) -> None:
        """Press and release a key."""
        for kind in ("keyDown", "keyUp"):
            text = {"text": key} if len(key) == 1 and kind == "keyDown" else {}
            self.call("Input.dispatchKeyEvent", type=kind, key=key, **text)

    def screenshot(self, path: Path, *, full: bool = False, clip: str | None = None, **options: Any) -> None:
        """Picture of the window, of the whole page, or of the element that a CSS selector names."""
        if clip is not None:
            box = self.evaluate(
                f"(r => ({{x: r.x + scrollX, y: r.y + scrollY, width: r.width, height: r.height}}))"
                f"(document.querySelector({json.dumps(clip)}).getBoundingClientRect())"
            )
            options["clip"] = {**box, "scale": 1}
        kind = {".png": "png", ".webp": "webp", ".jpg": "jpeg"}[path.suffix]
        answer = self.call(
            "Page.captureScreenshot", format=kind, captureBeyondViewport=full or clip is not None, **options
        )
        path.write_bytes(base64.b64decode(answer["data"]))

    def errors(self) -> list[str]:
        """What the page complained about since it was opened."""
        found = []
        for event in self.events:
            params = event.get("params", {})
            if event.get("method") == "Runtime.exceptionThrown":
                found.append(str(params["exceptionDetails"].get("exception", params["exceptionDetails"])))
            elif event.get("method") == "Runtime.consoleAPICalled" and params["type"] in ("error", "assert"):
                found.append(" ".join(str(a.get("value", a.get("description"))) for a in params["args"]))
            elif event.get("method") == "Log.entryAdded" and params["entry"]["level"] == "error":
                found.append(params["entry"]["text"])
        return found

    def requests(self) -> list[str]:
        """Addresses that the page asked for since it was opened, its own included."""
        sent = (e["params"]["request"]["url"] for e in self.events if e.get("method") == "Network.requestWillBeSent")
        return [url[:200] for url in sent if not url.startswith(("data:", "blob:"))]

    def _wait(self, is_done: Callable[[], bool], what: str) -> None:
        end = monotonic() + self.patience
        while not is_done():
            if monotonic() > end:
                shown = self.call("Runtime.evaluate", expression="location.href + ': ' + document.body?.innerText")
                value = shown["result"].get("value")
                msg = f"the page did not get to: {what}; it said {self.errors()}, it shows {value!r}"
                raise TimeoutError(msg)
            select.select([], [], [], 0.05)

    def _next(self) -> dict[str, Any]:
        end = monotonic() + self.patience
        while b"\0" not in self._buffer:
            if not select.select([self._from], [], [], max(end - monotonic(), 0))[0]:
                raise TimeoutError("the browser does not answer")
            part = os.read(self._from, 1 << 20)
            if not part:
                raise ConnectionError("the browser has gone")
            self._buffer += part
        message, _, self._buffer = self._buffer.partition(b"\0")
        return json.loads(message)
