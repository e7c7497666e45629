"""Configuration and fixtures of all tests."""

import gc
import os
import pickle
import signal
import sys
from collections import Counter
from importlib.util import find_spec
from pathlib import Path

import pytest

# Set this before workers load numpy, one per core: with two threads of BLAS in each, they wait for
# one another, which took three quarters of the processor time of fits.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Tests and their processes keep compiled modules in spite of PYTHONDONTWRITEBYTECODE: rewriting the
# assert statements of all tests again takes most of the time of collection, in each worker.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False


def _in_memory(folder="/dev/shm", room=2**31):
    """Return whether a folder in memory can be written, has room, and may hold programs."""
    if sys.platform != "linux" or not os.access(folder, os.W_OK):
        return False
    found = os.statvfs(folder)
    return found.f_bavail * found.f_frsize > room and not found.f_flag & os.ST_NOEXEC


# Temporary folders are in memory if possible. A disk may take 5 ms to remove a folder, which was
# half of the time of tests that write stores: the tests of studies remove twenty thousand folders.
if _in_memory():
    os.environ.setdefault("PYTEST_DEBUG_TEMPROOT", "/dev/shm")

from mcspectra.core import trust
from mcspectra.rendering import backend
from mcspectra.samplers import external
from tests.browser import chromium

HERE = Path(__file__).parent
NO_BROWSER = (
    "Playwright cannot start a browser; install Chromium, or name one in CHROMIUM, and run: "
    "make test PYTEST_ARGS='-m browser'"
)
NO_QMCPY = "QMCPy is not installed; with a C compiler, pip install 'mcspectra[qmcpy]' builds it"


def _shared(tmp_path_factory):
    """Return a temporary folder that all workers of this run share."""
    folder = tmp_path_factory.getbasetemp()
    return folder.parent if "PYTEST_XDIST_WORKER" in os.environ else folder


@pytest.fixture(scope="session", autouse=True)
def own_cache(tmp_path_factory):
    """Separate the cache of the tests from the user's cache.

    Workers share it, so that an optimized set is computed once.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MCSPECTRA_CACHE", str(_shared(tmp_path_factory) / "mcspectra-cache"))
        yield


@pytest.fixture(scope="session")
def once(tmp_path_factory):
    """Return a function ``once(name, make)`` for values of fixtures that take seconds.

    One worker calls `make`; the others wait and read the value. Each worker has its own copy.
    """
    import fcntl

    def value(name, make):
        file = _shared(tmp_path_factory) / f"{name}.pickle"
        with file.with_suffix(".lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not file.exists():
                content = pickle.dumps(make())
                file.write_bytes(content)
        return pickle.loads(file.read_bytes())

    return value


@pytest.fixture(scope="session", autouse=True)
def one_thread_of_drjit():
    """Let Dr.Jit use one thread unless a test gives a number: a core has more than one worker.

    With a thread per core, threads that wait for small kernels take a third of the processor time.
    """
    imported = backend._imported

    def with_one_thread():
        mitsuba = imported()
        import drjit

        drjit.set_thread_count(1)
        return mitsuba

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(backend, "_imported", with_one_thread)
        yield


@pytest.fixture(autouse=True)
def own_trust():
    """Reset the code that a test allows specs to run."""
    before, own = trust.process_trust(), set(external._own)
    yield
    trust._process = before
    external._own.clear()
    external._own.update(own)


@pytest.fixture(autouse=True)
def own_figures():
    """Close the figures that a test left open in pyplot."""
    yield
    if "matplotlib.pyplot" in sys.modules:
        sys.modules["matplotlib.pyplot"].close("all")


@pytest.fixture(scope="module")
def coarse_pixels():
    """Let integrals of pixels take 2^14 evaluations instead of 2^21, for tests of other things."""
    from mcspectra.rendering import pixel

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pixel, "_POINTS", 2**10)
        yield


@pytest.fixture
def hear_interrupts():
    """Let processes of a test receive SIGINT, even if a background shell ignores it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture(scope="module")
def browser():
    """A Chromium without network access, for tests marked `browser`."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        found = playwright.chromium.launch(
            executable_path=chromium(),
            args=[
                "--no-sandbox",
                "--disable-gpu",
                "--disable-background-networking",
                "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
            ],
        )
        yield found
        found.close()


# Packages whose tests wait for processes a large part of the time
WAITING = ("tests", "tests/cli", "tests/studies")


def pytest_xdist_auto_num_workers(config):
    """Use one worker for each core, and one more if the tests wait for processes.

    Each worker imports the package, and makes the fixtures of its modules anew.
    """
    paths = [os.path.relpath(path.partition("::")[0]) for path in config.args]
    return (os.cpu_count() or 1) + any(path in WAITING for path in paths)


# Tests of a file share compiled kernels, results of fixtures, and a browser or a cluster, so they
# run in one worker, which saves a tenth of the processor time. Dr.Jit also compiles a kernel anew
# if other scenes are in memory. The tests of these files, and of files outside the folders of
# packages, run in any worker: they wait for processes, or take most of the time of their folder.
APART = {
    "tests/profiler/test_profile.py",
    "tests/studies/test_executors.py",
    "tests/studies/test_faults.py",
    "tests/studies/test_run.py",
    "tests/studies/test_trials.py",
}

# Files whose tests take a second or more each
LONG = {
    "tests/cli/test_map.py",
    "tests/core/test_decoding.py",
    "tests/core/test_ordered.py",
    "tests/improve/test_learned.py",
    "tests/improve/test_planning.py",
    "tests/prediction/test_paired.py",
    "tests/prediction/test_subsets.py",
    "tests/rendering/test_paths.py",
    "tests/report/test_bench_page.py",
    "tests/reproduction/test_closed_forms.py",
    "tests/reproduction/test_environment_channels.py",
    "tests/reproduction/test_exhibits.py",
    "tests/studies/test_cluster.py",
    "tests/studies/test_cluster_studies.py",
    "tests/studies/test_executors.py",
    "tests/studies/test_faults.py",
    "tests/studies/test_path.py",
    "tests/studies/test_pixel.py",
    "tests/studies/test_run.py",
    "tests/studies/test_trials.py",
}


def _file(nodeid):
    return nodeid.partition("::")[0]


def _scope(nodeid):
    """Return the file of a test, or the test itself if its file is not kept together."""
    file = _file(nodeid)
    return nodeid if file in APART or file.rpartition("/")[0] == "tests" else file


def pytest_xdist_make_scheduler(config, log):
    """Run all tests of a scope in one worker, in the order of `pytest_collection_modifyitems`."""
    from xdist.scheduler import LoadScopeScheduling

    class Scheduling(LoadScopeScheduling):
        def _split_scope(self, nodeid):
            return _scope(nodeid)

    config.option.loadscopereorder = False
    return Scheduling(config, log)


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Turn the garbage collector off during collection, and exempt all existing objects from it.

    Modules and items live until the end. One pass over them takes a third of a second.
    """
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def _waits(item):
    """Return whether a test may wait for processes or clusters, or uses the whole package."""
    folder = item.path.parent
    return folder == HERE or folder == HERE / "studies"


def pytest_collection_modifyitems(items):
    """Start with long scopes and with tests that wait for other processes; give slow tests time.

    A browser's tests take seconds each, as those of `LONG` do, and the other scopes are the longer
    the more tests they have. Long scopes at the end would leave the other workers without work.
    """
    scopes = [_scope(item.nodeid) for item in items]
    sizes = Counter(scopes)
    in_browser = {
        scope
        for scope, item in zip(scopes, items, strict=True)
        if sizes[scope] > 1 and item.get_closest_marker("browser")
    }
    items.sort(
        key=lambda item: (
            (scope := _scope(item.nodeid)) not in in_browser,
            _file(scope) not in LONG,
            -sizes[scope],
            not _waits(item),
        )
    )
    for item in items:
        if item.get_closest_marker("endurance"):
            item.add_marker(pytest.mark.timeout(3000))


def pytest_runtest_setup(item):
    """Skip tests of pages on a machine without a browser."""
    if item.get_closest_marker("browser") and chromium() is None:
        pytest.skip(NO_BROWSER)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    """Skip tests of QMCPy if it is missing; with MCSPECTRA_REQUIRE_ALL, skipped tests fail."""
    report = yield
    if report.failed and "mcspectra[qmcpy]" in report.longreprtext and not find_spec("qmcpy"):
        report.outcome, report.longrepr = "skipped", (*item.location[:2], NO_QMCPY)
    if report.skipped and os.environ.get("MCSPECTRA_REQUIRE_ALL"):
        report.outcome = "failed"
        report.longrepr = f"{item.nodeid}: {report.longrepr[2]}, and MCSPECTRA_REQUIRE_ALL is set"
    return report


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(collector):
    """With MCSPECTRA_REQUIRE_ALL, a file that skips itself fails as well."""
    report = yield
    if report.skipped and os.environ.get("MCSPECTRA_REQUIRE_ALL"):
        report.outcome = "failed"
        report.longrepr = (
            f"{collector.nodeid}: {report.longrepr[2]}, and MCSPECTRA_REQUIRE_ALL is set"
        )
    return report


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_terminal_summary(terminalreporter):
    """Print the tests that did not run, clearly, below all other output."""
    yield
    reports = terminalreporter.stats.get("skipped", [])
    reasons = Counter(report.longrepr[2].removeprefix("Skipped: ") for report in reports)
    for reason, count in reasons.items():
        terminalreporter.write_line(f"{count} NOT TESTED: {reason}", red=True, bold=True)
