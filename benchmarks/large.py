"""Seconds and peak memory of `variance_terms` with bands of frequencies on large grids.

Each case runs in its own process.
The memory of a process that only imports the needed modules is also printed.
"""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import dataclass

CODE = """
import json, resource, sys, time
import mcspectra as mcs
dims, half_width, n, realizations = map(int, sys.argv[1:])
start = time.perf_counter()
if realizations:
    mcs.variance_terms(
        mcs.Estimator("gaussian(width=0.25)", dims=dims), "jittered", n,
        half_width=half_width, realizations=realizations, rng=1, bands="radial",
    )
else:
    import numba, scipy.special, xarray, finufft
    mcs.variance_terms
seconds = time.perf_counter() - start
try:
    # ru_maxrss starts from the memory of the process that started this one.
    with open("/proc/self/status") as status:
        used = next(int(line.split()[1]) for line in status if line.startswith("VmHWM")) * 1024
except OSError:
    unit = 1 if sys.platform == "darwin" else 1024
    used = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit
print(json.dumps([seconds, used]))
"""


@dataclass(frozen=True)
class Case:
    """One call of `variance_terms`: size of the frequency grid, and numbers of points and sets."""

    dims: int
    half_width: int
    n: int
    realizations: int

    def run(self) -> tuple[float, float]:
        """Return seconds, and the peak resident memory in MB."""
        values = (self.dims, self.half_width, self.n, self.realizations)
        command = [sys.executable, "-c", CODE, *map(str, values)]
        out = subprocess.run(command, check=True, capture_output=True, text=True).stdout
        seconds, used = json.loads(out)
        return seconds, used / 1e6


CASES = (
    Case(2, 256, 1024, 250),
    Case(2, 256, 1024, 1000),
    Case(3, 64, 1000, 8),
    Case(3, 64, 1000, 32),
    Case(4, 16, 256, 8),
    Case(4, 16, 256, 32),
)


def main() -> None:
    """Print a line for each case; four times as many realizations should take the same memory."""
    _, idle = Case(1, 1, 1, 0).run()
    print(f"imports alone {idle:.0f} MB; aim in 2-D ≤ 1000 MB")
    print(f"{'frequencies':>12s} {'pairs':>9s} {'points':>7s} {'realizations':>13s} "
          f"{'seconds':>8s} {'peak MB':>8s}")  # fmt: skip
    for case in CASES:
        seconds, used = case.run()
        side = 2 * case.half_width + 1
        print(
            f"{f'{side}^{case.dims}':>12s} {float(side) ** (2 * case.dims):9.2g} {case.n:7d} "
            f"{case.realizations:13d} {seconds:8.1f} {used:8.0f}"
        )


if __name__ == "__main__":
    main()
