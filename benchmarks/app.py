"""Latency of the explorer in Chromium: the first picture, and updates after a slider's move.

The first picture is the first drawn figure of the default page, which compares two set-ups.
Its time starts when the browser asks for the page, just after the server has started.
It ends when a canvas of a figure has pixels.
The time from the command to the line with the address is printed as well.

Then the page shows the default set-up, with 256 jittered points and 129² frequencies.
Key presses move the slider that shifts the strata of the jittered points.
After each move, the server updates all figures in rounds with more and more realizations.
The page records when bokeh receives new data for the first figure.
The page also records when the first round of realizations has updated the last figure.
The server's processor time is measured for each move of the slider, and the median is printed.
Each measurement lasts from the key press until the last figure of the last round.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Any

MOVES = 8
MOST = 150.0  # limit of the time to the first figure after a move, in milliseconds
MOST_FIRST = 1500.0  # limit of the time to the first picture of a page, in milliseconds
_PATIENCE = 120_000  # longest wait for the page, in milliseconds
_FIRST = """() => {
  const painted = (canvas) => canvas.width > 1 && new Uint32Array(canvas.getContext("2d")
    .getImageData(0, 0, canvas.width, canvas.height).data.buffer).some((pixel) => pixel !== 0);
  const drawn = (root) => [...root.querySelectorAll("*")].some((each) =>
    (each.localName === "canvas" && painted(each)) || (each.shadowRoot && drawn(each.shadowRoot)));
  const look = () => {
    const figures = document.getElementById("figures");
    if (figures && drawn(figures)) window.picture = performance.now();
    else setTimeout(look, 20);
  };
  look();
}"""
_WATCH = """() => {
  window.heard = [];
  const models = [...Bokeh.documents[0]._all_models.values()];
  for (const model of models.filter((each) => each.type === "ColumnDataSource"))
    model.properties.data.change.connect(() =>
      requestAnimationFrame(() => window.heard.push([model.id, performance.now()])));
  document.addEventListener("keydown", () => { window.pressed = performance.now(); }, true);
}"""
_TIMES = "() => window.heard.map(([id, time]) => [id, time - window.pressed])"


def main() -> None:
    """Print the time to the first picture, median latencies of moves, and the processor time."""
    from playwright.sync_api import sync_playwright
    from tests.browser import chromium

    with _server() as (process, address, started), sync_playwright() as player:
        arguments = ["--headless", "--no-sandbox", "--disable-gpu"]
        browser = player.chromium.launch(executable_path=chromium(), args=arguments)
        page = browser.new_page(viewport={"width": 1300, "height": 900})
        page.set_default_timeout(_PATIENCE)
        page.add_init_script(f"({_FIRST})()")
        page.goto(address)
        # By default, Playwright would look in each frame, which delays the page
        picture = page.wait_for_function("() => window.picture", polling=200).json_value()
        page.goto(f"{address}?n=256")
        _wait(page)
        page.evaluate(_WATCH)
        found = [_move(page, process.pid) for _ in range(MOVES)]
        browser.close()
    first, every, seconds = (median(each) for each in zip(*found, strict=True))
    verdict = "met" if picture <= MOST_FIRST else "missed"
    print(f"first picture {picture:5.0f} ms (at most {MOST_FIRST:.0f}: {verdict})")
    verdict = "met" if first <= MOST else "missed"
    print(f"server start {1e3 * started:6.0f} ms, from the command to the address")
    print(f"first figure {first:6.0f} ms (at most {MOST:.0f}: {verdict})")
    print(f"all figures  {every:6.0f} ms, for the round with fewest realizations")
    print(f"server       {1e3 * seconds:6.0f} ms of processor time, all rounds")


def _move(page: Any, pid: int) -> tuple[float, float, float]:
    """Press a key on the slider; return ms to the first and last figure, and server seconds."""
    before = _processor_time(pid)
    page.evaluate("() => { window.heard.length = 0; }")
    page.get_by_role("slider", name="Strata shift, A").press("ArrowRight")
    page.wait_for_function("() => window.heard.length > 0")
    _wait(page)
    times: dict[str, float] = {}
    for source, time in page.evaluate(_TIMES):
        times.setdefault(source, time)
    return min(times.values()), max(times.values()), _processor_time(pid) - before


def _wait(page: Any) -> None:
    """Wait for the end of all rounds."""
    page.locator("main > div").first.get_by_text("A: Done.").wait_for()


@contextmanager
def _server() -> Iterator[tuple[subprocess.Popen[str], str, float]]:
    """Start the explorer; yield its process, its address and the seconds until it has started."""
    begin = perf_counter()
    with tempfile.TemporaryDirectory() as cache:
        process = subprocess.Popen(
            [sys.executable, "-m", "mcspectra", "app", "--no-browser"],
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "MCSPECTRA_CACHE": cache},
        )
        assert process.stdout is not None
        try:
            address = process.stdout.readline().split(" at ")[1].split(";")[0]
            yield process, address, perf_counter() - begin
        finally:
            process.terminate()
            process.wait(30)


def _processor_time(pid: int) -> float:
    """Return the seconds of user and system time of a process, on Linux only."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


if __name__ == "__main__":
    main()
