"""What all tests share."""

import os
import signal

import pytest

from tests.browser import chromium


@pytest.fixture(scope="session", autouse=True)
def own_cache(tmp_path_factory):
    """Keep the user's cache out of the tests, and the tests out of the user's cache.

    Workers share it: an optimised set is made once.
    """
    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MCSPECTRA_CACHE", str(folder / "mcspectra-cache"))
        yield


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


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip tests of pages on a machine without a browser."""
    if item.get_closest_marker("browser") and chromium() is None:
        pytest.skip("there is no browser")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item):
    """With MCSPECTRA_REQUIRE_ALL, fail where a test would skip, unless it needs a GPU."""
    report = yield
    if report.skipped and os.environ.get("MCSPECTRA_REQUIRE_ALL") and "gpu" not in item.keywords:
        report.outcome = "failed"
        report.longrepr = f"{item.nodeid}: {report.longrepr[2]}, and MCSPECTRA_REQUIRE_ALL is set"
    return report


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter):
    """Say loudly, below all else, that pages were not tested."""
    yield
    skipped = terminalreporter.stats.get("skipped", [])
    count = sum("browser" in report.keywords for report in skipped)
    if count:
        text = (
            f"{count} TESTS OF PAGES WERE SKIPPED: there is no browser. Install Chromium, or name one in "
            "CHROMIUM, then: make test PYTEST_ARGS='-m browser'"
        )
        terminalreporter.write_line(text, red=True, bold=True)
