"""Processes that tests start."""

import subprocess
import sys


def python(*arguments, check=False, **options):
    """A process of Python that has ended: its code, and what it printed as text."""
    command = [sys.executable, *map(str, arguments)]
    return subprocess.run(command, check=check, capture_output=True, text=True, **options)
