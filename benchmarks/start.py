"""Times that users notice first: import, help, a component in a notebook, a new estimator."""

from __future__ import annotations

import contextlib
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable


def main() -> None:
    """Print median times of 10 processes, of bare Python, and of 5 calls in this process."""
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

    import mcspectra as mcs
    from mcspectra.report.reprs import component_html

    # Use all components that need no parameters, and print the name of the slowest
    shown = {}
    for make, names in (
        (mcs.sampler, mcs.samplers.SAMPLERS),
        (mcs.density, mcs.densities.DENSITIES),
        (mcs.integrand, mcs.integrands.INTEGRANDS),
    ):
        for name in names:
            with contextlib.suppress(mcs.McspectraError):
                part = make(name)
                shown[name] = _seconds(lambda part=part: component_html(part))
    slowest = max(shown, key=shown.__getitem__)
    print(f"{f'slowest picture: {slowest} (0.3 s)':36s} {shown[slowest]:.3f} s")
    for dims in (1, 2, 5):
        f, p = mcs.integrand("constant", dims=dims), mcs.density("tent", dims=dims)
        seconds = _seconds(lambda f=f, p=p: mcs.Estimator(f, p))
        print(f"{f'an estimator in {dims} dims (0.1 s)':36s} {seconds:.3f} s")


def _seconds(call: Callable[[], object]) -> float:
    """Return the median time of 5 calls, after a first call that compiles."""
    call()
    found = []
    for _ in range(5):
        start = time.process_time()
        call()
        found.append(time.process_time() - start)
    return statistics.median(found)


if __name__ == "__main__":
    main()
