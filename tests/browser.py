"""The browser of the tests: find one, or install one by ``python -m tests.browser``."""

import os
import shutil
import subprocess
import sys
from functools import lru_cache

PLAYWRIGHT = (sys.executable, "-m", "playwright")
NAMES = ("chromium", "chromium-browser", "google-chrome")


@lru_cache
def chromium():
    """Return a Chromium that starts: of ``CHROMIUM``, otherwise of PATH, otherwise Playwright's.

    None if there is none, or Playwright lacks a library of the system.
    """
    if not _succeeds(*PLAYWRIGHT, "--version"):
        return None
    chosen = os.environ.get("CHROMIUM")
    if chosen:
        return chosen if _succeeds(chosen, "--version") else None
    for name in NAMES:
        path = shutil.which(name)
        if path and _succeeds(path, "--version"):
            return path
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        path = playwright.chromium.executable_path
    return path if _succeeds(path, "--version") else None


def get():
    """Return a Chromium that starts; if necessary, install one by Playwright or Debian."""
    ways = [[(*PLAYWRIGHT, "install", "chromium")]]
    if shutil.which("apt-get") and os.geteuid() == 0:
        packages = ("chromium", "libatomic1")  # Playwright itself needs the second package
        ways.append([("apt-get", "-qq", "update"), ("apt-get", "-qq", "-y", "install", *packages)])
    for commands in ways:
        if chromium() or os.environ.get("CHROMIUM"):
            break
        print(f"The tests have no browser yet; trying '{' '.join(commands[-1])}'.", flush=True)
        all(_succeeds(*command) for command in commands)
        chromium.cache_clear()
    return chromium()


def _succeeds(*command):
    """Whether a command can be run and exits with 0."""
    try:
        done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, check=False)
    except OSError:
        return False
    return done.returncode == 0


if __name__ == "__main__":
    found = get()
    print(f"Browser of the tests: {found or 'not available; they will be skipped'}")
    sys.exit(0 if found else 1)
