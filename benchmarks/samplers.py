"""Samplers against NumPy's ``Generator.random`` of as many numbers: 2-D, 2^16 points, one thread."""

from __future__ import annotations

import numpy as np

import mcspectra as mcs
from benchmarks.timing import compare

SPECS = (
    "random",
    "jittered",
    "jittered | shift",
    "latin-hypercube",
    "multi-jittered",
    "halton",
    "sobol",
    "sobol | owen",
    "rank1-lattice(vector=[1, 19463]) | shift",
)


def main() -> None:
    """Print NumPy's time over ours for each sampler, and for many small sets."""
    count = 2**16
    generator = np.random.default_rng(0)
    for spec in SPECS:
        sampler = mcs.sampler(spec, dims=2)
        ours, _, ratio = compare(
            lambda sampler=sampler: sampler.draw(count, rng=1),
            lambda: generator.random((count, 2)),
            rounds=9,
        )
        print(
            f"{spec:42s} {count / ours / 1e6:8.1f} M points/s, NumPy's time over ours {1 / ratio:.2f}"
        )
    small = mcs.sampler("jittered", dims=2)
    _, _, ratio = compare(
        lambda: small.draw(16, realizations=100_000, rng=1),
        lambda: generator.random((100_000, 16, 2)),
        rounds=5,
    )
    print(f"{'100,000 sets of 16 jittered points':42s} NumPy's time over ours {1 / ratio:.2f}")


if __name__ == "__main__":
    main()
