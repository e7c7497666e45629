"""What all tests share."""

import signal

import pytest


@pytest.fixture(scope="session", autouse=True)
def own_cache(tmp_path_factory):
    """Keep the user's cache out of the tests, and the tests out of the user's cache."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MCSPECTRA_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture
def hear_interrupts():
    """Let processes that a test starts hear SIGINT, though a shell that runs tests in the background
    makes them, and their children, ignore it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)
