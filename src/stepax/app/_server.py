"""The server of the app: on this machine alone, a page for each tab, one worker for all."""

import dataclasses
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

from ._state import (
    MOST_BYTES,
    State,
    compared,
    example,
    glanced,
    glimpsed,
    methods_of,
    offered,
    read,
)


MOST_MESSAGE = MOST_BYTES * 4 // 3 + 1_000_000
"""Bytes of one message from a page: a file of `MOST_BYTES` in base 64, and what is around it."""

WARM = (
    ("quick look", False, glimpsed), ("quick look", False, glanced),
    ("quick look", False, compared), ("quick look", True, glanced),
    ("quick look", True, compared), ("all", False, compared), ("all", True, compared),
)  # fmt: skip
"""What is compiled beforehand, in this order: groups, whether with known levels, and how much.

What a person asks for waits for no more than one of them.
"""

TEMPLATE = """
{% block preamble %}
<meta name="viewport" content="width=device-width, initial-scale=1">
<link rel="icon" href="data:,">
<style>
  html, body { margin: 0; padding: 0; background: #fff; }
  body { padding: 0 14px; font-family: system-ui, "Segoe UI", Helvetica, Arial, sans-serif; }
</style>
{% endblock %}
"""

NEEDS_BOKEH = 'The app needs Bokeh: pip install "stepax[app]".'


class App:
    """A running server: `address`, and `stop()`.

    `file`: the record that every new page begins with. `warm`: compile at once what the first
    comparisons need.
    """

    def __init__(self, file: Path | None = None, warm: bool = True, port: int = 0):
        try:
            from bokeh.application import Application
            from bokeh.application.handlers import FunctionHandler
            from bokeh.server.server import Server
        except ImportError:
            raise ImportError(NEEDS_BOKEH) from None

        self._first = None if file is None else (file.name, file.read_bytes())
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="stepax")
        self._stopped = threading.Event()
        # Origins of other sites are refused: Bokeh's default allows this address alone.
        self._server = Server(
            Application(FunctionHandler(self._open)), port=port, address="127.0.0.1",
            websocket_max_message_size=MOST_MESSAGE, keep_alive_milliseconds=10_000,
        )  # fmt: skip
        self.address = f"http://localhost:{self._server.port}/"
        self._to_warm = [*WARM] if warm else []

    def _open(self, document: Any) -> None:
        """A new tab."""
        from ._page import Page

        document.template = TEMPLATE
        page = Page(document, self._submit)
        if self._first is not None:
            page.load(*self._first)
        if self._to_warm:  # once there is a page: compiling would hold it up
            document.add_timeout_callback(self._warm, 300)

    def _submit(self, task: Callable[[], Any]) -> Future:
        return self._worker.submit(task)

    def _warm(self, _: Future | None = None) -> None:
        """Compile what a group of methods needs, then the next: people's own work goes between."""
        if self._to_warm and not self._stopped.is_set():
            group = self._to_warm.pop(0)
            self._worker.submit(_compile, *group).add_done_callback(self._warm)

    def run(self) -> None:
        """Serve until it is stopped, or interrupted."""
        self._server.start()
        self._server.io_loop.start()

    def stop(self) -> None:
        """End; from any thread."""
        self._stopped.set()
        self._worker.shutdown(wait=False, cancel_futures=True)
        loop = self._server.io_loop
        loop.add_callback(self._server.stop)
        loop.add_callback(loop.stop)


def _compile(group: str, held: bool, compare: Callable[[State], State]) -> None:
    """A comparison of a group on the example: what it compiles serves every other record.

    `held`: with known levels, which is another program.
    """
    state = read(offered(State(methods=methods_of(group)), *example()))
    if held:
        state = dataclasses.replace(state, levels={"initial": 22.0, "final": 54.0})
    compare(state)


def serve(file: Path | None, browser: bool, port: int = 0) -> None:
    """Serve until interrupted; opens the page in a browser, or prints where it is."""
    import webbrowser

    from .._compilation import quick_compilation

    if file is not None and not file.is_file():
        raise FileNotFoundError(f"There is no file {file}.")
    app = App(file, port=port)
    print(f"The app is at {app.address} until you press Ctrl-C.", flush=True)
    if browser:
        app._server.io_loop.add_callback(webbrowser.open, app.address)
    try:
        with quick_compilation():
            app.run()
    except KeyboardInterrupt:
        app.stop()
