"""A headless Chromium that a test drives by its DevTools protocol; no network but this machine.

Debian's `chromium`; a test that needs it is skipped where there is none.
"""

import asyncio
import base64
import contextlib
import json
import shutil
import subprocess
import tempfile
import urllib.request
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import pytest


CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None)
needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium")

FLAGS = (
    "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage",
    "--hide-scrollbars",
    "--no-first-run", "--disable-background-networking", "--disable-component-update",
    "--disable-sync", "--remote-debugging-port=0",
    # every name but that of this machine is unknown
    "--host-resolver-rules=MAP * ~NOTFOUND , EXCLUDE localhost , EXCLUDE 127.0.0.1",
)  # fmt: skip


class Tab:
    """One page: what it asked for, and what it complained of.

    `requests`: addresses but for data inside the page itself. `complaints`: exceptions, errors and
    warnings of the console.
    """

    def __init__(self, socket: Any):
        self._socket, self._number = socket, 0
        self._answers: dict[int, asyncio.Future] = {}
        self.requests: list[str] = []
        self.complaints: list[str] = []
        self._reader = asyncio.ensure_future(self._read())

    async def _read(self) -> None:
        while (text := await self._socket.read_message()) is not None:
            message = json.loads(text)
            if "id" in message:
                future = self._answers.pop(message["id"])
                if not future.done():
                    future.set_result(message)
            else:
                self._notice(message["method"], message["params"])

    def _notice(self, event: str, params: dict[str, Any]) -> None:
        if event == "Network.requestWillBeSent":
            address = params["request"]["url"]
            if not address.startswith(("data:", "blob:")):
                self.requests.append(address)
        elif event == "Runtime.exceptionThrown":
            details = params["exceptionDetails"]
            self.complaints.append(str(details.get("exception", details).get("description")))
        elif event == "Runtime.consoleAPICalled" and params["type"] in ("error", "warning"):
            said = " ".join(str(x.get("value", x.get("description"))) for x in params["args"])
            self.complaints.append(said)
        elif event == "Log.entryAdded" and params["entry"]["level"] in ("error", "warning"):
            self.complaints.append(params["entry"]["text"])

    async def closed(self) -> None:
        """When nothing comes any more."""
        await asyncio.wait_for(self._reader, 10)

    async def call(self, method: str, **params: Any) -> dict[str, Any]:
        """One command of the protocol; an error of the browser's is a `RuntimeError`."""
        self._number += 1
        future = asyncio.get_running_loop().create_future()
        self._answers[self._number] = future
        message = {"id": self._number, "method": method, "params": params}
        await self._socket.write_message(json.dumps(message))
        answer = await asyncio.wait_for(future, 60)
        if "error" in answer:
            raise RuntimeError(f"{method}: {answer['error']}")
        return answer["result"]

    async def show(self, address: str, width: int = 1400, height: int = 900) -> None:
        """Go to an address in a window of a size; small ones are a phone's."""
        await self.size(width, height)
        await self.call("Page.navigate", url=address)
        await self.until("document.readyState == 'complete'")

    async def size(self, width: int, height: int) -> None:
        """Change the size of the window."""
        await self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width, height=height, deviceScaleFactor=1, mobile=width < 600,
        )  # fmt: skip

    async def run(self, expression: str) -> Any:
        """Value of an expression in the page."""
        found = await self.call(
            "Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True
        )
        if "exceptionDetails" in found:
            raise RuntimeError(f"{expression}: {found['exceptionDetails']}")
        return found["result"].get("value")

    async def until(self, expression: str, seconds: float = 30.0) -> Any:
        """Wait for an expression to hold."""
        loop = asyncio.get_running_loop()
        end = loop.time() + seconds
        while loop.time() < end:
            with contextlib.suppress(RuntimeError):  # between two pages
                if value := await self.run(expression):
                    return value
            await asyncio.sleep(0.05)
        raise AssertionError(f"did not come to hold in {seconds} s: {expression}")

    async def mouse(self, kind: str, x: float, y: float, pressed: int = 0) -> None:
        """Move, press or release the mouse."""
        button = "left" if pressed or kind != "mouseMoved" else "none"
        await self.call(
            "Input.dispatchMouseEvent", type=kind, x=x, y=y, button=button, buttons=pressed,
            clickCount=1 if kind != "mouseMoved" else 0,
        )  # fmt: skip

    async def click(self, x: float, y: float) -> None:
        """A click at a place of the window."""
        await self.mouse("mouseMoved", x, y)
        await self.mouse("mousePressed", x, y, 1)
        await self.mouse("mouseReleased", x, y)

    async def drag(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        """Press at one place, move in steps, release at another."""
        await self.mouse("mouseMoved", *start)
        await self.mouse("mousePressed", *start, 1)
        for share in (0.05, 0.2, 0.4, 0.6, 0.8, 1.0):
            x, y = (a + share * (b - a) for a, b in zip(start, end, strict=True))
            await self.mouse("mouseMoved", x, y, 1)
            await asyncio.sleep(0.03)
        await self.mouse("mouseReleased", *end)

    async def attach(self, element: str, path: Path) -> None:
        """Choose a file in the field that an expression gives."""
        found = await self.call("Runtime.evaluate", expression=element)
        field = found["result"]["objectId"]
        await self.call("DOM.setFileInputFiles", files=[str(path)], objectId=field)

    async def keep_downloads(self, folder: Path) -> None:
        """Files that a page hands over go to a folder."""
        await self.call("Page.setDownloadBehavior", behavior="allow", downloadPath=str(folder))

    async def screenshot(self, path: Path, whole: bool = True) -> None:
        """The page as PNG: all of it, or what the window shows."""
        found = await self.call("Page.captureScreenshot", captureBeyondViewport=whole)
        path.write_bytes(base64.b64decode(found["data"]))

    async def print(self, path: Path) -> None:
        """The page on paper, as PDF."""
        options = {"preferCSSPageSize": True, "printBackground": True}
        found = await self.call("Page.printToPDF", **options)
        path.write_bytes(base64.b64decode(found["data"]))


@contextlib.asynccontextmanager
async def tab() -> AsyncIterator[Tab]:
    """A page of a browser of its own, which ends with it."""
    from tornado.websocket import websocket_connect

    assert CHROMIUM is not None
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        command = [CHROMIUM, *FLAGS, f"--user-data-dir={profile}", "about:blank"]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            port = await _port(Path(profile) / "DevToolsActivePort", process)
            pages = json.load(urllib.request.urlopen(f"http://127.0.0.1:{port}/json"))
            address = next(x["webSocketDebuggerUrl"] for x in pages if x["type"] == "page")
            socket = await websocket_connect(address, max_message_size=2**28)
            page = Tab(socket)
            for domain in ("Page", "Runtime", "Network", "Log"):
                await page.call(f"{domain}.enable")
            try:
                yield page
            finally:
                socket.close()
                await page.closed()
        finally:
            process.terminate()
            process.wait(20)


async def _port(file: Path, process: subprocess.Popen) -> int:
    """The port that the browser chose."""
    for _ in range(600):
        if file.exists() and (text := file.read_text().split()):
            return int(text[0])
        assert process.poll() is None, "the browser ended"
        await asyncio.sleep(0.05)
    raise AssertionError("the browser does not start")


def drive(story: Callable[[Tab], Any]) -> None:
    """Run a story, a coroutine function of a page, in a browser of its own."""

    async def run() -> None:
        async with tab() as page:
            await story(page)

    asyncio.run(run())
