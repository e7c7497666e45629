"""Seconds to import the package and to show the help: median of 10 processes."""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import time


def main() -> None:
    """Print both medians beside bare Python."""
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    for label, arguments in (
        ("bare python", ["-c", "pass"]),
        ("import mcspectra (budget 0.1 s)", ["-c", "import mcspectra"]),
        ("mcspectra --help (budget 0.2 s)", ["-m", "mcspectra", "--help"]),
    ):
        seconds = []
        for _ in range(10):
            start = time.perf_counter()
            command = [sys.executable, *arguments]
            subprocess.run(command, check=True, capture_output=True, env=environment)
            seconds.append(time.perf_counter() - start)
        print(f"{label:36s} {statistics.median(seconds):.3f} s")


if __name__ == "__main__":
    main()
