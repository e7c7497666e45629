"""Processes of tests."""

import subprocess
import sys


def python(*arguments, check=False, **options):
    """Run Python to its end; return its exit code and its output as text."""
    command = [sys.executable, *map(str, arguments)]
    return subprocess.run(command, check=check, capture_output=True, text=True, **options)
