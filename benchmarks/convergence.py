"""Convergence of jittered points compared with one fused numba loop: sample, evaluate, accumulate.

The task has five counts from 16 to 4096, 1000 realizations, two integrands and one thread.
The fused loop is written for this one task, and has no array of points or values.
The loop evaluates both integrands at each point.
The loop uses the package's own generator, and sums only the estimates and their squares.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

import mcspectra as mcs
from benchmarks.timing import compare
from mcspectra.core.checks import Array
from mcspectra.core.jit import kernel
from mcspectra.core.streams import Stream, mix_uniform

COUNTS = (16, 64, 256, 1024, 4096)
REALIZATIONS = 1000
RADIUS = 0.3


@kernel
def _fused(keys: Array, side: int, rate: float, radius: float, sums: Array) -> None:
    """Add I and I² of all realizations to `sums`, where I is an estimate.

    The rows of `sums` (2, 2) are for a Gaussian and for a disk.
    """
    scale = 1.0 / (side * side)
    for r in range(len(keys)):
        k0, k1 = keys[r, 0], keys[r, 1]
        smooth, inside = 0.0, 0
        for i in range(side):
            for j in range(side):
                place = 2 * (i * side + j)
                x = (i + mix_uniform(k0, k1, place)) / side - 0.5
                y = (j + mix_uniform(k0, k1, place + 1)) / side - 0.5
                square = x * x + y * y
                smooth += math.exp(-rate * square)
                inside += square < radius * radius
        for f, value in enumerate((smooth * scale, inside * scale)):
            sums[f, 0] += value
            sums[f, 1] += value * value


def main() -> None:
    """Print milliseconds and the ratio, and check that package and loop give equal variances."""
    stream = Stream.from_rng(0)
    integrands = [
        mcs.Estimator("gaussian(width=0.25)", dims=2),
        mcs.Estimator(f"disk(radius={RADIUS})", dims=2),
    ]
    sums = np.zeros((len(COUNTS), 2, 2))

    def fused() -> None:
        sums[:] = 0.0
        for n, out in zip(COUNTS, sums, strict=True):
            keys = stream.child(n).keys(0, REALIZATIONS)
            _fused(keys, math.isqrt(n), 0.5 / 0.25**2, RADIUS, out)

    def ours() -> None:
        mcs.convergence(integrands, "jittered", COUNTS, realizations=REALIZATIONS, workers=1)

    _report(ours, fused)
    mean, square = sums[..., 0] / REALIZATIONS, sums[..., 1] / REALIZATIONS
    expected = (square - mean**2) * REALIZATIONS / (REALIZATIONS - 1)
    found = mcs.convergence(integrands, "jittered", COUNTS, realizations=REALIZATIONS)
    error = np.abs(found["variance"].values.T / expected - 1).max()
    print(f"largest relative difference of the variances: {error:.1e}")


def _report(ours: Callable[[], None], fused: Callable[[], None]) -> None:
    a, b, ratio = compare(ours, fused)
    points = sum(COUNTS) * REALIZATIONS
    print(f"convergence, {len(COUNTS)} counts, {points:.3g} points, 2 integrands: {1e3 * a:.0f} ms")
    print(f"fused loop in numba:                                   {1e3 * b:.0f} ms")
    print(f"ratio, one thread (aim ≤ 1.5; best over best {a / b:.2f}):    {ratio:.2f}")


if __name__ == "__main__":
    main()
