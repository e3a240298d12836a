"""A person's way through the app in a real browser, the network denied; pictures of it on request.

`STEPAX_TEST_PICTURES=FOLDER` keeps screenshots, `python -m tests.app.test_browser` prints times.
"""

import asyncio
import os
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from tests.app.at_hand import compare
from tests.app.serving import serving
from tests.browser import drive, needs_chromium


pytest.importorskip("bokeh")
pytestmark = needs_chromium

HELPERS = """
window.deep = (selector, root = document) => {
  let found = [...root.querySelectorAll(selector)];
  for (const e of root.querySelectorAll("*"))
    if (e.shadowRoot) found = found.concat(deep(selector, e.shadowRoot));
  return found;
};
window.button = (text) => deep("button").find((b) => b.textContent.trim() == text);
window.choose = (option, value) => {
  const list = deep("select").find((s) => [...s.options].some((o) => o.text == option));
  list.value = [...list.options].find((o) => o.text == value).value;
  list.dispatchEvent(new Event("change", {bubbles: true}));
};
window.cells = (k) => deep(".slick-row").map((row) => row.children[k].textContent.trim());
window.views = () => {
  const found = [];
  const walk = (view) => {found.push(view); for (const v of view.children()) walk(v);};
  for (const root of Bokeh.index.roots) walk(root);
  return found;
};
// where a mark stands in the window
window.place = (mark) => {
  for (const view of views()) {
    const data = view.model.type == "GlyphRenderer" && view.model.data_source.data;
    if (!data || !data.mark) continue;
    const k = Array.from(data.mark).indexOf(mark);
    if (k < 0) continue;
    const plot = view.plot_view, box = plot.el.getBoundingClientRect();
    const scale = plot.frame;
    return [box.x + scale.x_scale.compute(data.x[k]), box.y + scale.y_scale.compute(data.y[k])];
  }
};
window.busy = () => deep(".bk-clearfix").some((d) => /^(Computing|Comparing)/.test(d.textContent));
true
"""

COLD = 600.0
"""Seconds that a first comparison may take on a busy machine."""


class Server:
    """The command `stepax app`, and where it serves."""

    def __init__(self, cache):
        code = "from stepax._cli import main; main()"
        command = [sys.executable, "-c", code, "app", "--no-browser"]
        environment = os.environ | {"JAX_COMPILATION_CACHE_DIR": str(cache)}
        self.process = subprocess.Popen(
            command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        line = self.process.stdout.readline()
        self.address = next(word for word in line.split() if word.startswith("http"))

    def end(self):
        self.process.terminate()
        return self.process.communicate(timeout=30)[1]


async def opened(page, address, width=1400):
    """A page that is ready."""
    await page.show(address, width, 1000)
    await page.until("window.Bokeh && Bokeh.documents.length > 0 && Bokeh.documents[0].is_idle")
    await page.run(HELPERS)


async def settled(page, rows):
    """The table has rows of methods, and nothing is going on."""
    await page.until(f"cells(1).length >= {rows} && !busy()", COLD)


def errors(page):
    """Complaints but for one of a list's own library, which concerns its makers."""
    return [text for text in page.complaints if "allowHTML" not in text]


def second_file(folder):
    """Another record, of another length."""
    t = np.arange(0, 300, 1.0)
    u = 10.0 * (t >= 30)
    rng = np.random.default_rng(0)
    y = 5 + 2 * u * (1 - np.exp(-np.maximum(t - 38, 0) / 25)) + 0.02 * rng.standard_normal(t.size)
    path = folder / "second.csv"
    np.savetxt(path, np.c_[t, u, y], delimiter=",", header="time (s),u (%),y (K)", comments="")
    return path


async def way(page, address, folder, times):
    """Load, drag the final level, compare first-order methods, take a report away."""
    pictures = Path(os.environ.get("STEPAX_TEST_PICTURES", folder))
    start = time.perf_counter()
    await opened(page, address)
    times["page"] = time.perf_counter() - start
    await page.keep_downloads(folder)
    start = time.perf_counter()
    await page.run("button('Use the example').click()")
    await page.until("cells(1).length >= 2", COLD)
    times["example identified"] = time.perf_counter() - start
    await page.until("cells(1).length >= 4", COLD)
    times["example by all fits"] = time.perf_counter() - start
    await settled(page, 6)
    times["example compared"] = time.perf_counter() - start
    await page.screenshot(pictures / "app_example.png")
    before = await page.run("cells(4)")

    x, y = await page.until("place('final')")
    start = time.perf_counter()
    await page.drag((x, y), (x, y - 30))
    await page.until(f"!busy() && cells(4).join() != {','.join(before)!r}", COLD)
    times["final level dragged"] = time.perf_counter() - start
    after = await page.run("cells(4)")
    assert float(after[0]) > float(before[0])  # a wrong level fits worse

    await page.run("choose('first order', 'first order')")
    start = time.perf_counter()
    await asyncio.sleep(0.3)
    await page.run("button('Compare').click()")
    await settled(page, 12)
    times["first order compared"] = time.perf_counter() - start
    assert "fopdt_fit" in await page.run("cells(1)")
    await page.screenshot(pictures / "app_first_order.png")

    await page.run("button('report').click()")
    report = folder / "heater.html"
    for _ in range(1200):
        if report.exists():
            break
        await asyncio.sleep(0.1)
    text = report.read_text()
    assert "Set by hand: initial" in text and "stepax app" in text and "viteckova_1" in text

    await page.until("!busy()", 60)
    start = time.perf_counter()
    await page.attach("deep('input[type=file]')[0]", second_file(folder))
    await page.until("deep('.bk-clearfix').some(d => d.textContent.includes('second.csv'))", COLD)
    times["next file"] = time.perf_counter() - start
    (folder / "bad.csv").write_text("nothing\n")
    await page.until("!busy()", COLD)
    await page.attach("deep('input[type=file]')[0]", folder / "bad.csv")
    await page.until("deep('.message').length > 0 || deep('.bk-clearfix').some("
                     "d => d.textContent.includes('bad.csv needs'))")  # fmt: skip
    assert await page.run("cells(1).length") > 0
    await page.size(390, 3000)
    await asyncio.sleep(1)
    assert await page.run("document.documentElement.scrollWidth") == 390
    await page.screenshot(pictures / "app_phone.png")
    assert errors(page) == []
    assert [x for x in page.requests if not x.startswith(address)] == []


def test_the_way_with_models_at_hand(tmp_path, monkeypatch):
    """All of it but the numbers."""
    monkeypatch.setattr("stepax.app._state.compare", partial(compare, []))
    times = {}
    with serving(warm=False) as address:
        drive(lambda page: way(page, address, tmp_path, times))


@pytest.mark.long
def test_a_persons_way(tmp_path, tmp_path_factory):
    server = Server(tmp_path_factory.mktemp("cache"))
    times = {}
    try:
        drive(lambda page: way(page, server.address, tmp_path, times))

        async def closed_while_computing(page):
            await opened(page, server.address)
            await page.run("button('Use the example').click()")
            await asyncio.sleep(0.2)
            await page.show("about:blank")
            await opened(page, server.address)
            await page.run("button('Use the example').click()")
            await settled(page, 6)

        drive(closed_while_computing)
    finally:
        said = server.end()
    print({name: round(seconds, 2) for name, seconds in times.items()})
    assert "Traceback" not in said


if __name__ == "__main__":
    import tempfile

    folder = Path(tempfile.mkdtemp())
    for what in ("cold", "cached"):
        server, times = Server(folder / "cache"), {}
        inner = folder / what
        inner.mkdir()
        try:
            drive(lambda page, inner=inner: way(page, server.address, inner, times))  # noqa: B023
        finally:
            server.end()
        print(what, {name: round(seconds, 2) for name, seconds in times.items()})
