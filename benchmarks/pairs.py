"""Pair correlation of 4096 points in 200 bins, compared with `freud.density.RDF`.

Both programs count the pairs of a periodic square up to the same distance.
Both programs divide the counts by the expected count for random points.
Both programs use default settings on one thread.
"""

from __future__ import annotations

import freud
import numpy as np

import mcspectra as mcs
from benchmarks.timing import compare
from mcspectra.spectra.pairs import count_pairs

POINTS, BINS = 4096, 200
DISTANCES = (0.49, 0.1)  # largest distance; the program freud needs it below 0.5


def main() -> None:
    """Print milliseconds, their ratio, and the largest difference of the counts."""
    freud.parallel.set_num_threads(1)
    points = mcs.sampler("jittered", dims=2).draw(POINTS, rng=1)[0]
    for distance in DISTANCES:
        _compare(points, distance)


def _compare(points: np.ndarray, distance: float) -> None:
    edges = np.linspace(0.0, distance, BINS + 1)
    system = (
        freud.box.Box.square(1.0),
        np.column_stack([points - 0.5, np.zeros(POINTS)]).astype(np.float32),
    )
    rdf = freud.density.RDF(bins=BINS, r_max=distance)
    ours, theirs, ratio = compare(
        lambda: count_pairs(points, edges, wrap=True), lambda: rdf.compute(system), rounds=7
    )
    counted = 2 * count_pairs(points, edges, wrap=True)
    print(f"r ≤ {distance}, {BINS} bins: {counted.sum() / 2:.3g} pairs")
    print(f"  count_pairs, {1e9 * ours / counted.sum() * 2:.1f} ns a pair: {1e3 * ours:.1f} ms")
    print(f"  freud.density.RDF:          {1e3 * theirs:.1f} ms")
    print(f"  ratio (aim ≤ 0.5):          {ratio:.3f}")
    # freud computes in float32, so it may count pairs at the border of a bin in the neighboring bin
    differ = np.abs(counted - rdf.bin_counts).sum() / counted.sum()
    print(f"  pairs that freud has in other bins: {differ:.1e} of all")


if __name__ == "__main__":
    main()
