"""A running explorer, and its pages in a browser without requests to other machines."""

import os
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.fixture(scope="module")
def terminal(tmp_path_factory):
    """Standard error of the explorer."""
    return tmp_path_factory.mktemp("terminal") / "stderr"


@pytest.fixture(scope="module")
def address(tmp_path_factory, terminal):
    """Address of a running explorer with its own cache."""
    cache = str(tmp_path_factory.mktemp("cache"))
    with terminal.open("wb") as stderr:
        process = subprocess.Popen(
            [sys.executable, "-m", "tests.app.small", "app", "--no-browser"],
            cwd=Path(__file__).parents[2],
            stdout=subprocess.PIPE,
            stderr=stderr,
            text=True,
            env={**os.environ, "MCSPECTRA_CACHE": cache, "OMP_NUM_THREADS": "1"},
        )
        assert process.stdout is not None
        try:
            yield process.stdout.readline().split(" at ")[1].split(";")[0]
        finally:
            process.terminate()
            process.wait(30)
            process.stdout.close()


@pytest.fixture(scope="module")
def seen():
    """Requests to other machines and errors of the page, over all tests."""
    return {"elsewhere": [], "errors": []}


@pytest.fixture(scope="module")
def context(browser, address, seen):
    """Tabs with a common cache of the explorer's scripts, which a rule for requests would empty."""
    from playwright.sync_api import expect
    from tests.app.visit import PATIENCE

    def note(request):
        if not request.url.startswith((address, "data:", "blob:")):
            seen["elsewhere"].append(request.url)

    made = browser.new_context(viewport={"width": 1300, "height": 900})
    made.set_default_timeout(PATIENCE)
    expect.set_options(timeout=PATIENCE)
    made.on("request", note)
    made.on("weberror", lambda error: seen["errors"].append(str(error.error)))
    made.on(
        "console",
        lambda message: seen["errors"].append(message.text) if message.type == "error" else None,
    )
    yield made
    made.close()


@pytest.fixture(scope="module")
def page(context):
    """The tab of most tests."""
    return context.new_page()
