"""`power_at` for listed frequencies, compared with direct sums in NumPy on one thread."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

import mcspectra as mcs
from benchmarks.timing import compare
from mcspectra.core.checks import Array
from mcspectra.spectra.transforms import direct_sum

REALIZATIONS = 4


def _real(dims: int, count: int) -> Array:
    return np.random.default_rng(0).uniform(-32.0, 32.0, (count, dims))


def _subset(dims: int, count: int) -> Array:
    """Return integer frequencies with three nonzero components."""
    generator = np.random.default_rng(1)
    m = np.zeros((count, dims))
    m[:, :3] = generator.integers(1, 9, (count, 3))
    return m


CASES: tuple[tuple[str, Callable[[int, int], Array], int, int, int], ...] = (
    # Each case: label, function that makes frequencies, dims, n, and number of frequencies
    ("2-D, real", _real, 2, 1024, 2000),
    ("2-D, real", _real, 2, 4096, 4000),
    ("6-D, real", _real, 6, 1024, 2000),
    ("6-D, three axes of integers", _subset, 6, 1024, 2000),
)


def main() -> None:
    """Print milliseconds per realization, the chosen engine, and the direct sum's time."""
    for what, make, dims, n, count in CASES:
        frequencies = make(dims, count)
        points = mcs.sampler("random", dims=dims).draw(n, realizations=REALIZATIONS, rng=1)
        engines: set[str] = set()

        def ours(nu: Array = frequencies, n: int = n, engines: set[str] = engines) -> None:
            found = mcs.spectra.power_at(
                "random", n, nu, realizations=REALIZATIONS, rng=1, workers=1
            )
            engines.add(found.attrs["engine"])

        def theirs(nu: Array = frequencies, points: Array = points) -> None:
            for x in points:
                direct_sum(x, nu)

        seconds, reference, ratio = compare(ours, theirs, rounds=5)
        print(
            f"{what}, {n} points, {count} frequencies: {1e3 * seconds / REALIZATIONS:.2f} ms "
            f"({', '.join(engines)}), direct sum {1e3 * reference / REALIZATIONS:.2f} ms, "
            f"its time over ours {1 / ratio:.1f}"
        )


if __name__ == "__main__":
    main()
