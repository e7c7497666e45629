"""What all tests share."""

import gc
import os
import signal
import sys
from collections import Counter
from importlib.util import find_spec
from pathlib import Path

import pytest

# Before workers, one a core, load numpy: two threads of BLAS in each wait for one another, which was three
# quarters of the processor time of fits.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Tests, and the processes that they start, keep compiled modules although PYTHONDONTWRITEBYTECODE is set:
# to rewrite the assert statements of all tests again is most of the time of collection, in each worker.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

from mcspectra.core import trust
from mcspectra.samplers import external
from tests.browser import chromium

HERE = Path(__file__).parent
NO_BROWSER = (
    "there is no browser that Playwright can drive; install Chromium, or name one in CHROMIUM, and run: "
    "make test PYTEST_ARGS='-m browser'"
)
NO_QMCPY = "QMCPy is not installed; with a C compiler, pip install 'mcspectra[qmcpy]' builds it"


@pytest.fixture(scope="session", autouse=True)
def own_cache(tmp_path_factory):
    """Keep the user's cache out of the tests, and the tests out of the user's cache.

    Workers share it: an optimized set is made once.
    """
    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MCSPECTRA_CACHE", str(folder / "mcspectra-cache"))
        yield


@pytest.fixture(autouse=True)
def own_trust():
    """Keep what a test allows specs to run out of the tests after it."""
    before, own = trust.process_trust(), set(external._own)
    yield
    trust._process = before
    external._own.clear()
    external._own.update(own)


@pytest.fixture
def hear_interrupts():
    """Let processes that a test starts hear SIGINT, though a shell that runs tests in the background
    makes them, and their children, ignore it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture(scope="module")
def browser():
    """A Chromium that asks nothing of a network; for tests marked `browser`."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        found = playwright.chromium.launch(
            executable_path=chromium(),
            args=["--no-sandbox", "--disable-gpu", "--disable-background-networking"],
        )
        yield found
        found.close()


def pytest_xdist_auto_num_workers():
    """One worker more than cores: a seventh of the time tests wait for processes, pages and clusters."""
    return (os.cpu_count() or 1) + 1


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Collect no garbage while tests are collected, and pass over what is there then ever after.

    Modules and items stay to the end; to look through them takes a third of a second each time.
    """
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def _waits(item):
    """Whether it is one of those that wait for processes and clusters, or use all of the package at once."""
    folder = item.path.parent
    return folder == HERE or folder == HERE / "studies"


def pytest_collection_modifyitems(items):
    """Tests that wait come first: one worker waits while the others compute, and none is alone at the end.

    Tests that take minutes have time for them.
    """
    items.sort(key=lambda item: not _waits(item))
    for item in items:
        if item.get_closest_marker("endurance"):
            item.add_marker(pytest.mark.timeout(3000))


def pytest_runtest_setup(item):
    """Skip tests of pages on a machine without a browser."""
    if item.get_closest_marker("browser") and chromium() is None:
        pytest.skip(NO_BROWSER)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    """Skip what asks for QMCPy where it could not be built; with MCSPECTRA_REQUIRE_ALL nothing may skip."""
    report = yield
    if report.failed and "mcspectra[qmcpy]" in report.longreprtext and not find_spec("qmcpy"):
        report.outcome, report.longrepr = "skipped", (*item.location[:2], NO_QMCPY)
    if report.skipped and os.environ.get("MCSPECTRA_REQUIRE_ALL"):
        report.outcome = "failed"
        report.longrepr = f"{item.nodeid}: {report.longrepr[2]}, and MCSPECTRA_REQUIRE_ALL is set"
    return report


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(collector):
    """A file that skips itself fails likewise."""
    report = yield
    if report.skipped and os.environ.get("MCSPECTRA_REQUIRE_ALL"):
        report.outcome = "failed"
        report.longrepr = (
            f"{collector.nodeid}: {report.longrepr[2]}, and MCSPECTRA_REQUIRE_ALL is set"
        )
    return report


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_terminal_summary(terminalreporter):
    """Say loudly, below all else, what was not tested."""
    yield
    reports = terminalreporter.stats.get("skipped", [])
    reasons = Counter(report.longrepr[2].removeprefix("Skipped: ") for report in reports)
    for reason, count in reasons.items():
        terminalreporter.write_line(f"{count} NOT TESTED: {reason}", red=True, bold=True)
