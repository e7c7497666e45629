"""Uniform random numbers compared with NumPy's generator, on one thread."""

from __future__ import annotations

import numpy as np

from benchmarks.timing import compare
from mcspectra.core.streams import Stream


def main() -> None:
    """Print nanoseconds per double and the ratio."""
    size = 2**17
    stream, generator = Stream.from_rng(0), np.random.default_rng(0)
    ours, theirs, ratio = compare(
        lambda: stream.uniforms(0, 1, size), lambda: generator.random(size), rounds=50
    )
    print(f"mcspectra {1e9 * ours / size:.2f} ns, NumPy {1e9 * theirs / size:.2f} ns per double")
    print(f"NumPy's time over ours: {1 / ratio:.2f}")


if __name__ == "__main__":
    main()
